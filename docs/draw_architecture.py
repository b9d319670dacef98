"""Draws docs/architecture.svg from the imports in the code: `python docs/draw_architecture.py`.

`PLACES` says where each package stands, `imports` what it really imports. Every arrow must go down; those that a
longer way already shows are left out. `test/test_architecture.py` holds picture and code against each other.
"""

from __future__ import annotations

import ast
from dataclasses import dataclass
from html import escape
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1] / "spacearm_ident"
PICTURE = Path(__file__).with_name("architecture.svg")


@dataclass(frozen=True)
class Place:
    """Where a box stands: its floor (0 lowest) and its span from left to right, and what it holds."""

    floor: int
    left: int
    right: int
    holds: str


PLACES = {
    "api": Place(13, 20, 600, "the same from Python: import spacearm_ident as sa"),
    "cli": Place(12, 20, 600, "the command spacearm: options in, exit codes out"),
    "commissioning": Place(11, 340, 900, "files of a new arm, and checks of them and of the machine"),
    "nodes": Place(10, 340, 1060, "the five ROS 2 nodes and what only they need; the one place with rclpy"),
    "batch_session": Place(10, 226, 334, "many bags"),
    "side_by_side": Place(9, 200, 296, "on cores"),
    "bag_session": Place(9, 304, 450, "identify as a function"),
    "orbit_session": Place(9, 86, 192, "to orbit"),
    "mismatch_session": Place(9, 460, 600, "to explanation"),
    "export": Place(8, 20, 78, "models"),
    "session": Place(8, 86, 600, "bags to validated model, one pass for command and node"),
    "report": Place(7, 20, 430, "pages, figures and files out of results"),
    "mismatch": Place(6, 20, 300, "what physics was left out"),
    "identification": Place(5, 20, 300, "fit, errors, validation, tracking"),
    "conventions": Place(5, 526, 600, "signs, units"),
    "logs": Place(5, 440, 520, "whose columns"),
    "excitation": Place(5, 310, 430, "motions, limits, criteria"),
    "simulation": Place(5, 620, 900, "the arm and its drives, apart"),
    "driver": Place(4, 620, 900, "safety, set-points, 1 kHz loop"),
    "dynamics": Place(3, 20, 700, "arm, regressor, friction, effects: the terms of the torque"),
    "recording": Place(2, 20, 600, "bags in and out, and the signals in them"),
    "canbus": Place(2, 720, 900, "CANopen, CiA 402"),
    "documents": Place(1, 20, 600, "files that others wrote, read safely"),
    "config": Place(1, 920, 1060, "where config/ is"),
    "errors": Place(0, 20, 700, "the one line a user sees"),
    "blas_threads": Place(0, 720, 1060, "one thread for BLAS"),
}
FLOORS = 1 + max(place.floor for place in PLACES.values())
STEP, HEIGHT, WIDTH = 68, 44, 1080
LOWEST = {name for name, place in PLACES.items() if place.floor == 0}


def packages() -> set[str]:
    """The packages and modules of the first level."""
    return {
        path.stem
        for path in PACKAGE.iterdir()
        if (path / "__init__.py").is_file() or (path.suffix == ".py" and path.stem != "__init__")
    }


def imported_modules(path: Path) -> set[str]:
    """Every module that a file of the package imports, anywhere in it, by its full name."""
    parents = ("spacearm_ident", *path.relative_to(PACKAGE).parts[:-1])
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = [*parents[: len(parents) - node.level + 1]] if node.level else []
            source = ".".join([*base, *([node.module] if node.module else [])])
            found.add(source)
            found.update(f"{source}.{alias.name}" for alias in node.names)
    return found


def imports() -> dict[str, set[str]]:
    """Package -> other packages that it imports."""
    names = packages()
    table: dict[str, set[str]] = {name: set() for name in names}
    for path in PACKAGE.rglob("*.py"):
        own = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
        if own not in table:  # the package's own __init__
            continue
        for module in imported_modules(path):
            parts = module.split(".")
            if parts[0] == "spacearm_ident" and len(parts) > 1 and parts[1] in names - {own}:
                table[own].add(parts[1])
    return table


def shown(table: dict[str, set[str]]) -> list[tuple[str, str]]:
    """The imports that no longer way stands for; the lowest floor is everyone's and without arrows."""

    def below(name: str) -> set[str]:
        return {further for one in table[name] for further in {one} | below(one)}

    return sorted(
        (name, one)
        for name, direct in table.items()
        for one in direct
        if one not in LOWEST and not any(one in below(other) for other in direct - {one})
    )


def svg() -> str:
    """The picture.

    Raises:
        ValueError: Two boxes that an arrow joins do not stand over each other, or a box stands between them.
    """
    height = FLOORS * STEP + 10
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" font-family="sans-serif">',
        "<title>The packages of spacearm_ident; an arrow says: imports</title>",
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="8" markerHeight="8" orient="auto">'
        '<path d="M0 0L8 4L0 8z" fill="#57606a"/></marker></defs>',
        f'<rect width="{WIDTH}" height="{height}" fill="#fff"/>',
    ]
    for upper, lower in shown(imports()):
        x = _between(upper, lower)
        start, end = _top(PLACES[upper]) + HEIGHT, _top(PLACES[lower])
        parts.append(f'<path d="M{x} {start}V{end}" stroke="#57606a" stroke-width="1.5" marker-end="url(#tip)"/>')
    for name, place in PLACES.items():
        middle, top = (place.left + place.right) // 2, _top(place)
        parts += [
            f'<rect x="{place.left}" y="{top}" width="{place.right - place.left}" height="{HEIGHT}" rx="6" '
            'fill="#eef4fb" stroke="#3b6ea5"/>',
            f'<text x="{middle}" y="{top + 18}" font-size="15" font-weight="bold" text-anchor="middle">{name}</text>',
            f'<text x="{middle}" y="{top + 35}" font-size="12" fill="#333" text-anchor="middle">'
            f"{escape(place.holds)}</text>",
        ]
    return "\n".join([*parts, "</svg>", ""])


def _top(place: Place) -> int:
    return 10 + (FLOORS - 1 - place.floor) * STEP


def _between(upper: str, lower: str) -> int:
    """Where an arrow stands that touches both boxes and nothing between."""
    one, other = PLACES[upper], PLACES[lower]
    left, right = max(one.left, other.left), min(one.right, other.right)
    if left >= right or one.floor <= other.floor:
        raise ValueError(f"{upper} imports {lower} and does not stand above it: move them in PLACES, or the code")
    middle = (left + right) // 2
    between = {name: place for name, place in PLACES.items() if other.floor < place.floor < one.floor}
    crossed = ""
    for x in sorted(range(left + 5, right, 5), key=lambda x: abs(x - middle)):
        crossed = next((name for name, place in between.items() if place.left <= x <= place.right), "")
        if not crossed:
            return x
    raise ValueError(f"the arrow from {upper} to {lower} would cross {crossed}: move it in PLACES")


if __name__ == "__main__":
    PICTURE.write_text(svg(), encoding="utf-8")
