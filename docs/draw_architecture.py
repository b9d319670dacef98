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
    "api": Place(18, 20, 700, "the same from Python: import spacearm_ident as sa"),
    "cli": Place(17, 20, 700, "the command spacearm: options in, exit codes out"),
    "commissioning": Place(16, 440, 1000, "files of a new arm, and checks of them and of the machine"),
    "nodes": Place(15, 440, 1160, "the five ROS 2 nodes and what only they need; the one place with rclpy"),
    "sessions": Place(14, 20, 700, "one pass each, from bags to a result folder, for command, node and Python"),
    "export": Place(13, 20, 140, "models for others"),
    "report": Place(13, 150, 700, "pages and figures out of results"),
    "layers": Place(12, 20, 300, "from a simulation to the arm"),
    "mismatch": Place(11, 20, 280, "what physics was left out"),
    "results": Place(11, 310, 520, "files of a result folder"),
    "identification": Place(10, 20, 300, "fit, structure, validation, verdict"),
    "bayes": Place(9, 20, 300, "a model as the prior of another"),
    "environment": Place(8, 20, 200, "gravity, temperature, base"),
    "estimate": Place(7, 20, 110, "the result"),
    "solvers": Place(6, 20, 110, "PSO-LM"),
    "noise": Place(6, 210, 300, "weights, errors"),
    "simulation": Place(6, 720, 1000, "the arm and its drives, apart"),
    "regression": Place(5, 20, 110, "rows, prior"),
    "tracking": Place(5, 120, 200, "on line"),
    "simulations": Place(5, 310, 410, "MJCF, SDF"),
    "conventions": Place(5, 420, 520, "signs, units"),
    "logs": Place(5, 530, 600, "columns"),
    "excitation": Place(5, 610, 700, "motions, limits"),
    "driver": Place(5, 720, 1000, "safety, set-points, 1 kHz loop"),
    "dynamics": Place(4, 20, 800, "arm, regressor, friction, effects: the terms of the torque"),
    "signals": Place(3, 20, 700, "motions out of recordings: periods, bandwidth, filters"),
    "recording": Place(2, 20, 700, "bags in and out"),
    "canbus": Place(2, 820, 1000, "CANopen, CiA 402"),
    "documents": Place(1, 20, 700, "files that others wrote, read safely"),
    "config": Place(1, 1020, 1160, "where config/ is"),
    "errors": Place(0, 20, 450, "the one line a user sees"),
    "arrays": Place(0, 460, 620, "types of arrays"),
    "forks": Place(0, 630, 790, "work on all cores"),
    "memory": Place(0, 800, 960, "freed memory"),
    "blas_threads": Place(0, 970, 1160, "one thread for BLAS"),
}
FLOORS = 1 + max(place.floor for place in PLACES.values())
STEP, HEIGHT, WIDTH = 68, 44, 1180
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
    table = imports()
    for upper, lowers in table.items():
        for lower in sorted(lowers):
            if PLACES[upper].floor <= PLACES[lower].floor:
                raise ValueError(
                    f"{upper} imports {lower} and does not stand above it: move them in PLACES, or the code"
                )
    for upper, lower in shown(table):
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
