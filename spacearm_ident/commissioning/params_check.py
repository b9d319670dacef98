"""Check a file of ROS parameters against what the nodes declare; ROS itself ignores a misspelt name."""

from __future__ import annotations

import ast
import importlib
import importlib.util
import math
import operator
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

from ..errors import UserError
from ..nodes.choices import Choices
from ..nodes.main import NODES
from .result import CheckResult, Level, fail, ok, warn
from .yaml_file import read_yaml

EVERY_NODE: Final = frozenset({"use_sim_time"})
EVERY: Final = "**"
"""`/**:` in a file: whatever node reads it."""


def check_params(path: Path) -> list[CheckResult]:
    """All checks of a parameter file."""
    try:
        data = read_yaml(path)
    except UserError as error:
        return [fail("parameters", str(error), "correct it; config/spacearm.yaml is an example")]
    results = [result for node, given in data.items() for result in _node(str(node), given)]
    for place in sorted({_place(node) for node in data}):
        results += _one_arm({node: given for node, given in data.items() if _place(node) == place})
    if any(result.level is Level.FAIL for result in results):
        return results
    told: dict[str, list[str]] = {}
    for key in map(str, data):
        told.setdefault(_scope(key), []).append(key)
    fine = [f"{', '.join(keys)}: every parameter exists; for {scope}" for scope, keys in told.items()]
    return [*(ok("parameters", sentence) for sentence in fine), *results]


FILE: Final = "file_parameter"
"""Method of `LiveNode` that declares the name of a file or folder to read."""
DECLARING: Final = ("parameter", FILE)
"""Methods of `LiveNode` that declare a parameter; their first argument is its name."""
WORDS: Final[Mapping[type, str]] = {bool: "true or false", int: "a whole number", float: "a number", str: "a text"}
"""What a value of each type is called."""


@dataclass(frozen=True)
class Declared:
    """A parameter as a node declares it.

    Attributes:
        kind: Type of its value, of an item where `several`; None: not known without ROS.
        low, high: Range of a number.
        several: Whether it is a list.
        choices: The words that a text may be; None: any.
        file: Whether it names a file or folder to read.
    """

    kind: type | None
    low: float = -math.inf
    high: float = math.inf
    several: bool = False
    choices: Choices | None = None
    file: bool = False

    def refusal(self, value: Any) -> str:
        """Why the node refuses a value; empty: it does not."""
        if self.kind is None or value is None or (isinstance(value, str) and "$(" in value):
            return ""  # Not known, not given, or put in by a launch file.
        items = value if self.several and isinstance(value, list) else [value]
        if self.several is not isinstance(value, list) or any(not self._fits(item) for item in items):
            what = WORDS[self.kind]
            return f"{value!r} is not {f'a list, each item {what}' if self.several else what}"
        if self.kind in (int, float) and not all(self.low <= float(item) <= self.high for item in items):
            return f"{value!r} is not from {self.low:g} to {self.high:g}"
        filled_in = any("$(" in str(item) for item in items)
        return "" if self.choices is None or filled_in else self.choices.refusal(value)

    def _fits(self, value: Any) -> bool:
        """Whether ROS takes a value for one of this type; a whole number does for a number."""
        if self.kind is float and isinstance(value, str):
            return bool(EXPONENT.fullmatch(value))
        taken = (int, float) if self.kind is float else (self.kind,)
        return type(value) in taken


EXPONENT: Final = re.compile(r"[-+]?\d+(\.\d*)?[eE][-+]?\d+")
"""A number to ROS (`1e-3`), which YAML 1.1 takes for a text."""


@cache
def declared_parameters(node: str) -> Mapping[str, Declared]:
    """What a node declares, read from the source of its modules (NODE*.py), so that ROS need not be there."""
    spec = importlib.util.find_spec(f"spacearm_ident.nodes.{node}")
    if spec is None or spec.origin is None:
        return {}
    files = sorted(Path(spec.origin).parent.glob(f"{node}*.py"))
    calls = (item for file in files for item in ast.walk(ast.parse(file.read_text(encoding="utf-8"))))
    return dict(pair for call in calls if isinstance(call, ast.Call) for pair in _declared(call, node))


def _declared(call: ast.Call, node: str) -> list[tuple[str, Declared]]:
    """The parameter a call declares, if it does."""
    named = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
    given = call.args if named in DECLARING else []
    names = [item.value for item in given[:1] if isinstance(item, ast.Constant)]
    # The name of a file is declared as a text, and has no default.
    default = next(iter(given[1:2]), None)
    value = "" if named == FILE else _literal(default)
    limits = {item.arg: _literal(item.value) for item in call.keywords if item.arg in ("low", "high")}
    ranges = {str(key): float(limit) for key, limit in limits.items() if isinstance(limit, (int, float))}
    several = isinstance(value, list)
    choices = next((_choices(node, item.value) for item in call.keywords if item.arg == "choices"), None)
    kind = type(value[0] if several else value) if value is not None else None
    if choices is not None:  # words are texts, by whatever names the default is written
        kind, several = str, isinstance(default, ast.List)
    return [
        (name, Declared(kind, several=several, choices=choices, file=named == FILE, **ranges))
        for name in names
        if isinstance(name, str)
    ]


def _choices(node: str, name: ast.expr) -> Choices | None:
    """What a node's module of choices has under a name."""
    module = importlib.import_module(f"spacearm_ident.nodes.{node}_choices")
    found = getattr(module, name.id) if isinstance(name, ast.Name) else None
    return found if isinstance(found, Choices) else None


def _literal(node: ast.expr | None) -> Any:
    """The value of an expression of literals; None of any other."""
    try:
        # Limits are products and powers of literals here and there.
        return None if node is None else _computed(node)
    except ValueError:
        return None


def _computed(node: ast.expr) -> Any:
    """As `_literal`.

    Raises:
        ValueError: It is not of literals alone.
    """
    operators = {ast.Pow: operator.pow, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Add: operator.add}
    if isinstance(node, ast.BinOp) and type(node.op) in operators:
        return operators[type(node.op)](_computed(node.left), _computed(node.right))
    return ast.literal_eval(node)


def _place(node: str) -> str:
    """The namespace in a node's full name; empty where it stands for any."""
    return str(node).rpartition("/")[0]


def _scope(key: str) -> str:
    """Which nodes heed a section of the file: ROS passes over those of other namespaces without a word."""
    place, slash, node = key.rpartition("/")
    if node == EVERY:
        return "every node" + (f" in {place} and below" if place else "")
    if not slash:
        return "any namespace"
    return f"the namespace {place} alone" if place else "nodes outside any namespace alone"


def _node(key: str, given: Any) -> Iterator[CheckResult]:
    node = key.removeprefix(f"{_place(key)}/")
    nodes = NODES if node == EVERY else (node,)
    if not set(nodes) <= set(NODES):
        yield fail("parameters", f"there is no node {node!r}", f"the nodes are {', '.join(NODES)}")
        return
    values = given.get("ros__parameters") if isinstance(given, dict) else None
    if not isinstance(values, dict):
        yield fail("parameters", f"{node} has no 'ros__parameters:'", "ROS ignores what is not under that key")
        return
    known = EVERY_NODE.union(*map(declared_parameters, nodes))
    for name, value in values.items():
        if name not in known:
            has = ", ".join(sorted(known - EVERY_NODE))
            yield fail("parameters", f"{node} has no parameter {name!r}; ROS would ignore it", f"it has {has}")
            continue
        why = next((why for one in nodes if (why := _refusal(one, str(name), value))), "")
        if why:
            yield fail("parameters", f"{node}: {name}: {why}; the node would not start", "correct it")
        elif _missing(nodes, str(name), value):
            yield warn("parameters", f"{node}: {name}: there is no {value}", "write it before the node is started")


def _missing(nodes: Iterable[str], name: str, value: Any) -> bool:
    """Whether a value names a file to read that does not exist; `$(` stands for what a launch file fills in."""
    known = (declared_parameters(node).get(name) for node in nodes)
    named = bool(value) and "$(" not in str(value) and any(one is not None and one.file for one in known)
    return named and not Path(str(value)).expanduser().exists()


def _refusal(node: str, name: str, value: Any) -> str:
    """Why a node refuses a value of one of its parameters; empty: it does not, or has none of that name."""
    known = declared_parameters(node).get(name)
    return "" if known is None else known.refusal(value)


def _one_arm(data: Mapping[str, Any]) -> Iterator[CheckResult]:
    """All nodes must be told of the same arm, or limits and torques are those of another."""
    told: dict[Path, str] = {}
    for node, given in data.items():
        values = given.get("ros__parameters") if isinstance(given, dict) else None
        for name in ("arm", "can_config"):
            file = Path(str(values[name])).expanduser() if isinstance(values, dict) and values.get(name) else None
            if file is None or not file.is_file():
                continue
            try:
                arm = file.parent / str(read_yaml(file).get("arm", "")) if name == "can_config" else file
            except UserError:
                continue
            told.setdefault(arm.resolve(), f"{node} of {arm}")
    if len(told) > 1:
        yield fail(
            "parameters", f"nodes are configured for different arms: {'; '.join(told.values())}", "name one arm file"
        )
