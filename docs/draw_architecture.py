"""Draws docs/architecture.svg from the imports in the code: `python docs/draw_architecture.py`.

`PLACES` says where each package stands, `imports` what it really imports. Every arrow must go down; those that a
longer way already shows are left out. `test/test_architecture.py` holds picture and code against each other.
"""

from __future__ import annotations

import ast
from dataclasses import dataclass, replace
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
    "api": Place(14, 20, 600, "the same from Python: import spacearm_ident as sa"),
    "cli": Place(13, 20, 600, "the command spacearm: options in, exit codes out"),
    "commissioning": Place(12, 340, 900, "files of a new arm, and checks of them and of the machine"),
    "nodes": Place(11, 340, 1060, "the five ROS 2 nodes and what only they need; the one place with rclpy"),
    "batch_session": Place(11, 226, 334, "many bags"),
    "side_by_side": Place(10, 200, 296, "on cores"),
    "bag_session": Place(10, 304, 450, "identify as a function"),
    "orbit_session": Place(10, 86, 192, "to orbit"),
    "mismatch_session": Place(10, 460, 600, "to explanation"),
    "simulation_session": Place(10, 610, 760, "from a simulation"),
    "export": Place(9, 20, 78, "models"),
    "session": Place(9, 86, 600, "bags to validated model, one pass for command and node"),
    "report": Place(8, 20, 430, "pages, figures and files out of results"),
    "layers": Place(7, 20, 308, "from a simulation to the arm"),
    "mismatch": Place(6, 20, 300, "what physics was left out"),
    "identification": Place(5, 20, 300, "fit, errors, validation, tracking"),
    "conventions": Place(5, 526, 600, "signs, units"),
    "logs": Place(5, 440, 520, "whose columns"),
    "excitation": Place(5, 310, 430, "motions, limits, criteria"),
    "simulation": Place(5, 620, 900, "the arm and its drives, apart"),
    "driver": Place(4, 620, 900, "safety, set-points, 1 kHz loop"),
    "simulations": Place(4, 20, 110, "MJCF, SDF"),
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
        ValueError: A box imports one that does not stand lower, or boxes leave no way between them.
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
        way = _way(upper, lower)
        parts.append(f'<path d="{way}" fill="none" stroke="#57606a" stroke-width="1.5" marker-end="url(#tip)"/>')
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


def _way(upper: str, lower: str) -> str:
    """An arrow's path from one box down to another past all between: straight, or with one bend between two floors."""
    one, other = PLACES[upper], PLACES[lower]
    if one.floor <= other.floor:
        raise ValueError(f"{upper} imports {lower} and does not stand above it: move them in PLACES, or the code")
    start, end = _top(one) + HEIGHT, _top(other)
    ways = [
        (abs(x - y), x, y, floor)
        for floor in range(other.floor, one.floor)
        for x in _free(one, other.floor if floor == other.floor else floor, one.floor)
        for y in _free(other, other.floor, floor + 1)
        if floor == other.floor or x != y
    ]
    straight = [x for x in _free(one, other.floor, one.floor) if other.left < x < other.right]
    if straight:
        middle = (max(one.left, other.left) + min(one.right, other.right)) // 2
        return f"M{min(straight, key=lambda x: abs(x - middle))} {start}V{end}"
    if not ways:
        raise ValueError(f"no way for the arrow from {upper} to {lower}: move them in PLACES")
    _, x, y, floor = min(ways)
    bend = _top(replace(one, floor=floor)) - (STEP - HEIGHT) // 2
    return f"M{x} {start}V{bend}H{y}V{end}"


def _free(box: Place, below: int, above: int) -> list[int]:
    """Columns under or over a box that no box on the floors strictly between stands in."""
    others = [place for place in PLACES.values() if below < place.floor < above]
    columns = range(box.left + 5, box.right, 5)
    return [x for x in columns if not any(place.left <= x <= place.right for place in others)]


if __name__ == "__main__":
    PICTURE.write_text(svg(), encoding="utf-8")
