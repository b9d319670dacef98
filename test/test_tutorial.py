"""docs/tutorial.md, carried out: its commands are read from the page, and say what the page says they say."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import pytest

from spacearm_ident.cli.main import main
from spacearm_ident.dynamics.arm import load_arm
from spacearm_ident.dynamics.model_file import load_model
from spacearm_ident.simulation.own_arm import default_model

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "tutorial.md"


def steps() -> list[tuple[str, list[str]]]:
    """Every command of the page's console blocks, continuation lines joined, and the output shown below it."""
    found: list[tuple[str, list[str]]] = []
    for block in re.findall(r"^```console\n(.*?)^```", PAGE.read_text(), re.M | re.S):
        for line in block.replace("\\\n", " ").splitlines():
            if line.startswith("$ "):
                found.append((line.removeprefix("$ "), []))
            else:
                found[-1][1].append(line)
    return found


def pattern(line: str) -> str:
    """A shown line as a whole line of output; `…` stands for anything, a line may go on with what to do (`->`)."""
    return f"^{re.escape(line).replace('…', '.*')}( -> .*)?$"


def robots() -> str:
    """The folder that the page's `ROBOTS=$(python -c '...')` finds.

    Skips where the package of its URDF is not installed.
    """
    try:
        distribution("example-robot-data")
    except PackageNotFoundError:
        pytest.skip("the tutorial's UR5 is in example-robot-data, which is not installed (pip install -e '.[test]')")
    (code,) = re.findall(r"^ROBOTS=\$\(python -c '(.*)'\)$", PAGE.read_text(), re.M)
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()


@pytest.mark.long
def test_every_command_does_what_the_page_says(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SPACEARM_RUNTIME_DIR", str(tmp_path / "run"))
    (tmp_path / "config").symlink_to(ROOT / "config")
    place = robots()
    for command, shown in steps():
        words = [word.replace("$ROBOTS", place) for word in shlex.split(command, comments=True)]
        assert words[0] == "spacearm", f"only commands of ours can be tested: {command}"
        expected = re.search(r"# exit code (\d)", command)
        code = main(words[1:])
        out, err = capsys.readouterr()
        assert code == int(expected[1] if expected else 0), f"{command}\n{out}{err}"
        for line in shown:
            assert re.search(pattern(line), out, re.M), f"{command}\nnever said: {line}\n{out}"
    identified = load_model(tmp_path / "my_arm" / "identified" / "model.yaml")
    truth = default_model(load_arm(tmp_path / "my_arm" / "arm.yaml"))
    names = [parameter.name for parameter in identified.model.parameters]
    values = dict(zip(names, identified.parameters))
    for parameter, known in zip(truth.model.parameters, truth.parameters):
        if parameter.symbol == "f_c":
            assert values[parameter.name] == pytest.approx(known, rel=0.15), parameter.name


def test_the_page_shows_commands_and_what_they_say():
    assert len(steps()) >= 7
    assert sum(len(shown) for _, shown in steps()) >= 10
