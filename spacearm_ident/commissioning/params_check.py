"""Whether a file of ROS parameters says what the nodes know: ROS takes a misspelt one without a word."""

from __future__ import annotations

import ast
import importlib.util
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any, Final

from ..errors import UserError
from ..nodes.main import NODES
from .result import CheckResult, Level, fail, ok, warn
from .yaml_file import read_yaml

FILES: Final = frozenset({"arm", "can_config", "model", "structure", "replay", "mismatch_reference", "trajectory_file"})
"""Parameters that name a file which must be there when the node starts or the run begins."""
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


DECLARING = {"parameter": 0, "_file": 1}
"""What the nodes' modules declare a parameter with, and which argument its name is."""


@cache
def known_parameters(node: str) -> frozenset[str]:
    """Names a node declares, read from the source of its modules (NODE*.py), so that ROS need not be there."""
    spec = importlib.util.find_spec(f"spacearm_ident.nodes.{node}")
    if spec is None or spec.origin is None:
        return frozenset()
    files = Path(spec.origin).parent.glob(f"{node}*.py")
    calls = (item for file in files for item in ast.walk(ast.parse(file.read_text(encoding="utf-8"))))
    return frozenset(name for call in calls if isinstance(call, ast.Call) for name in _declared(call))


def _declared(call: ast.Call) -> list[str]:
    """The parameter a call declares, if it does."""
    named = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
    place = DECLARING.get(named, len(call.args))
    values = [item.value for item in call.args[place : place + 1] if isinstance(item, ast.Constant)]
    return [value for value in values if isinstance(value, str)]


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
    known = EVERY_NODE.union(*map(known_parameters, nodes))
    for name, value in values.items():
        if name not in known:
            has = ", ".join(sorted(known - EVERY_NODE))
            yield fail("parameters", f"{node} has no parameter {name!r}; ROS would ignore it", f"it has {has}")
        elif name in FILES and value and not Path(str(value)).expanduser().exists():
            yield warn("parameters", f"{node}: {name}: there is no {value}", "write it before the node is started")


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
