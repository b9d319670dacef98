"""Tests whose dependencies are not installed are skipped, saying what is missing; none fails at its collection."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import OPTIONAL

HERE = Path(__file__).parent
ENVIRONMENT = {**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "PYTEST_ADDOPTS": ""}

WITHOUT = '''
import importlib, sys, pytest

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in sys.argv[1].split(","):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

class Importing:
    """Imports every module before it is collected, as launch_testing does."""

    def pytest_pycollect_makemodule(self, module_path):
        sys.path.insert(0, str(module_path.parent))
        importlib.import_module(module_path.stem)

sys.meta_path.insert(0, Absent())
sys.exit(pytest.main(["--collect-only", "-q", "-rs", *sys.argv[2:]], plugins=[Importing()]))
'''


def importing(module: str) -> set[Path]:
    """Test modules that import a module, themselves or by a helper beside them."""
    texts = {file: file.read_text(encoding="utf-8") for file in HERE.glob("*.py")}
    names, found = {module}, set()
    while True:
        direct = re.compile(rf"^(?:from|import) (?:{'|'.join(map(re.escape, names))})\b", re.MULTILINE)
        more = {file for file, text in texts.items() if direct.search(text)} - found
        if not more:
            return {file for file in found if file.name.startswith("test_")}
        found |= more
        names |= {file.stem for file in more}


def collected_without(modules: str, files: list[str]) -> str:
    """What pytest says of test modules where others, and all of its plugins, are not installed."""
    words = [sys.executable, "-c", WITHOUT, modules, *files]
    run = subprocess.run(words, cwd=HERE.parent, env=ENVIRONMENT, capture_output=True, text=True)
    # 5: every module was skipped.
    assert run.returncode in (0, 5), run.stdout[-3000:] + run.stderr[-1000:]
    return run.stdout


@pytest.mark.parametrize("module", ["hypothesis", "rosbags", "mcap_ros2"])
def test_modules_are_skipped_with_a_reason_where_a_test_dependency_is_missing(module):
    files = importing(module)
    assert files
    said = collected_without(module, sorted(map(str, files)))
    # Where clarabel is missing as well, a module that needs both names whichever it comes to first.
    skipped = set(re.findall(rf"(test_\w+\.py):\d+: needs (?:{module}|clarabel) ", said))
    assert skipped == {file.name for file in files}


def test_modules_are_skipped_with_a_reason_where_clarabel_is_missing():
    """It has no rosdep key, so a machine set up from package.xml lacks it."""
    said = collected_without("clarabel", ["test/test_consistency.py", "test/test_session.py", "test/test_cdr.py"])
    assert set(re.findall(r"(test_\w+\.py):\d+: needs clarabel ", said)) == {"test_consistency.py", "test_session.py"}
    assert re.search(r"test_cdr.py: [1-9]", said)


def test_a_test_that_comes_to_import_what_is_missing_is_skipped_too():
    words = [sys.executable, "-c", WITHOUT.replace('"--collect-only", ', ""), "clarabel"]
    words += ["test/test_cli.py", "-k", "help"]
    run = subprocess.run(words, cwd=HERE.parent, env=ENVIRONMENT, capture_output=True, text=True)
    assert run.returncode in (0, 5) and "needs clarabel" in run.stdout, run.stdout[-3000:] + run.stderr[-1000:]


def test_nothing_but_what_is_optional_is_skipped(tmp_path):
    (tmp_path / "test_broken.py").write_text("import a_module_that_nobody_has\n")
    words = [sys.executable, "-m", "pytest", "-q", "--rootdir", str(HERE), "-p", "conftest", str(tmp_path)]
    run = subprocess.run(
        words, cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(HERE)}, capture_output=True, text=True
    )
    # Usually 2; 1 where launch_testing is installed.
    assert run.returncode in (1, 2) and "a_module_that_nobody_has" in run.stdout, run.stdout
    assert set(OPTIONAL) == {"hypothesis", "rosbags", "mcap_ros2", "clarabel"}
