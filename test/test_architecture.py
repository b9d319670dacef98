"""The picture of docs/architecture.md and the rules of docs/architecture.md, held against the imports in the code."""

from __future__ import annotations

import re
import runpy
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "docs"))
import draw_architecture  # noqa: E402

PACKAGE = ROOT / "spacearm_ident"
MESSAGES = {"builtin_interfaces", "diagnostic_msgs", "nav_msgs", "rcl_interfaces", "sensor_msgs", "std_msgs"}
ROS = {"rclpy", "trajectory_msgs", *MESSAGES}


def modules(folder: Path) -> list[Path]:
    found = sorted(folder.rglob("*.py"))
    assert found, folder
    return found


def test_every_folder_of_modules_is_a_package_that_an_installation_takes_along():
    missing = {str(path.parent.relative_to(ROOT)) for path in modules(PACKAGE)} - {
        str(path.parent.relative_to(ROOT)) for path in PACKAGE.rglob("__init__.py")
    }
    assert not missing, f"{missing}: setuptools' find_packages passes over a folder without __init__.py"


def test_an_installation_takes_along_what_is_no_module(monkeypatch):
    found: dict = {}
    # Not every interpreter has setuptools.
    stand_in = SimpleNamespace(find_packages=lambda **_: [], setup=lambda **given: found.update(given))
    monkeypatch.setitem(sys.modules, "setuptools", stand_in)
    monkeypatch.chdir(ROOT)
    runpy.run_path(str(ROOT / "setup.py"))
    named = {
        str(path.relative_to(ROOT))
        for package, patterns in found["package_data"].items()
        for pattern in patterns
        for path in ROOT.joinpath(*package.split(".")).glob(pattern)
    }
    others = {
        str(path.relative_to(ROOT))
        for path in PACKAGE.rglob("*")
        if path.is_file() and path.suffix != ".py" and "__pycache__" not in path.parts
    }
    assert named == others


def test_every_package_is_in_the_picture_and_no_other():
    assert draw_architecture.packages() == set(draw_architecture.PLACES)


def test_imports_only_go_down():
    floor = {name: place.floor for name, place in draw_architecture.PLACES.items()}
    upward = [
        f"{name} imports {other}"
        for name, others in draw_architecture.imports().items()
        for other in sorted(others)
        if floor[other] >= floor[name]
    ]
    assert not upward


def test_the_picture_is_of_this_code():
    assert draw_architecture.svg() == draw_architecture.PICTURE.read_text(encoding="utf-8"), (
        "run python docs/draw_architecture.py"
    )


def test_an_import_against_the_arrows_cannot_be_drawn(monkeypatch):
    table = draw_architecture.imports()
    table["dynamics"].add("identification")
    table["identification"].discard("dynamics")
    monkeypatch.setattr(draw_architecture, "imports", lambda: table)
    with pytest.raises(ValueError, match="dynamics imports identification"):
        draw_architecture.svg()


def test_relative_imports_are_read_as_what_they_name():
    found = draw_architecture.imported_modules(PACKAGE / "dynamics" / "effects" / "effect.py")
    assert {"spacearm_ident.errors", "spacearm_ident.signals.motion", "spacearm_ident.dynamics.term"} <= found


def test_ros_is_known_to_the_nodes_alone():
    elsewhere = {
        str(path.relative_to(ROOT))
        for path in modules(PACKAGE)
        if PACKAGE / "nodes" not in path.parents
        and any(module.split(".")[0] in ROS for module in draw_architecture.imported_modules(path))
    }
    assert not elsewhere


def test_a_node_that_may_have_jobs_starts_without_what_draws_their_reports():
    """Matplotlib is a fifth of their start-up, 0.45 of 2.2 s."""
    code = "import sys, spacearm_ident.nodes.jobs; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False).returncode == 0


def test_every_call_of_a_logger_has_a_severity_of_its_own():
    """Rclpy raises where a call site gets another severity than before; `LiveNode.log` is for one known only then."""
    logged = re.compile(r"get_logger\(\)(?!\.(debug|info|warning|error|fatal)\()")
    assert not [path.name for path in modules(PACKAGE) if logged.search(path.read_text())]


def test_the_simulated_arm_is_a_second_writing_of_the_physics():
    """It shares the arm's description with the fit, and the names in model files, never a term's columns."""
    fit = ("spacearm_ident.dynamics.effects", "spacearm_ident.dynamics.friction", "spacearm_ident.dynamics.regressor")
    reads_model_files = {"parameters.py", "from_model.py"}
    shared = {
        path.name
        for path in modules(PACKAGE / "simulation")
        if any(module.startswith(fit) for module in draw_architecture.imported_modules(path))
    }
    assert shared <= reads_model_files
