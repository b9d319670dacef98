"""The Python API: the page's example runs, and gives what the command line gives."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import small_arm

import spacearm_ident as sa
from spacearm_ident.api import IDENTIFY_OPTIONS, OF_READ
from spacearm_ident.cli.main import main
from spacearm_ident.dynamics.arm import load_arm
from spacearm_ident.errors import UserError
from spacearm_ident.export.motion import steady
from spacearm_ident.recording import write_recording
from spacearm_ident.sessions.bags import Options

PAGE = Path(__file__).parents[1] / "docs" / "python.md"


def write_log(folder: Path, name: str = "log.csv", seed: int = 0) -> Path:
    """A CSV with its arm beside it."""
    run = small_arm.recording(16.0 if seed else 12.0, seed=seed)
    rows = np.column_stack([run.time, run.position, run.effort])
    head = "t [s],q1 [rad],q2 [rad],tau1 [Nm],tau2 [Nm]"
    lines = [head, *(",".join(map(repr, map(float, row))) for row in rows)]
    (folder / name).write_text("\n".join(lines))
    (folder / "arm.urdf").write_text(small_arm.URDF)
    return folder / name


def write_arm(folder: Path) -> Path:
    """An arm YAML with what an excitation needs."""
    (folder / "arm.yaml").write_text(
        "schema: spacearm_ident/arm/1\nurdf: arm.urdf\njoints:\n"
        "  shoulder: {acceleration_limit_rad_s2: 5}\n  elbow: {acceleration_limit_rad_s2: 5}\n"
    )
    return folder / "arm.yaml"


def blocks() -> list[str]:
    """The Python blocks of the page: the example, then the cells of the worked session."""
    return re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


def test_importing_the_package_imports_nothing_else():
    code = "import sys, spacearm_ident; print(sorted(m for m in sys.modules if m.startswith(('numpy', 'spacearm'))))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "['spacearm_ident']"


def test_completion_shows_every_function_before_its_first_use_and_types_are_known_to_checkers():
    code = "import spacearm_ident as sa; print(set(sa.__all__) - set(dir(sa)))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "set()"
    assert (Path(sa.__file__).parent / "py.typed").is_file()


def test_the_example_of_the_page_runs_and_finds_the_arm(tmp_path, monkeypatch):
    pytest.importorskip("clarabel", reason="needs clarabel")
    write_log(tmp_path)
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    exec(blocks()[0], names)
    assert (tmp_path / "fit.png").stat().st_size > 1000 and (tmp_path / "arm.xml").is_file()
    result = names["result"]
    assert isinstance(result, sa.Result)
    model = result.identified.model
    for k, joint in enumerate(small_arm.JOINTS):
        assert model.value("f_c", joint) == pytest.approx(small_arm.COULOMB[k], rel=0.1)
    q, qd, qdd = np.random.default_rng(0).uniform(-1, 1, (3, 7, 2))
    many = result.predict(q, qd, qdd)
    assert np.allclose(many[3], result.predict(q[3], qd[3], qdd[3]))
    assert np.abs(many - small_arm.identified().torque(steady(small_arm.JOINTS, q, qd, qdd))).max() < 0.5
    rows = (
        result.parameters if isinstance(result.parameters, list) else result.parameters.reset_index().to_dict("records")
    )
    assert {row["symbol"] for row in rows} >= {"f_c", "k_v1", "J_m", "m"}
    with pytest.raises(UserError, match="one shape"):
        result.predict(q[:, :1], qd, qdd)


def test_every_cell_of_the_worked_session_runs(tmp_path, monkeypatch):
    pytest.importorskip("clarabel", reason="needs clarabel")
    write_log(tmp_path, "monday.csv", 1)
    write_log(tmp_path, "friday.csv", 2)
    write_arm(tmp_path)
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"sa": sa}
    for cell in blocks()[1:]:
        exec(cell, names)
    assert names["duration_s"] == pytest.approx(16.0, abs=0.1)
    assert set(names["relative"]) == set(small_arm.JOINTS) and max(names["relative"].values()) < 0.05
    assert all(0.0 < names["relative_error"][f"f_c[{joint}]"] < 0.1 for joint in small_arm.JOINTS)
    q, qd = np.outer(names["time"], names["speed"]), np.tile(names["speed"], (len(names["time"]), 1))
    truth = small_arm.identified().torque(steady(small_arm.JOINTS, q, qd, np.zeros_like(q)))
    assert np.abs(names["torque"] - truth).max() < 0.5
    assert (tmp_path / "fit.png").stat().st_size > 1000 and (tmp_path / "arm.xml").is_file()
    assert names["changed"] == []
    assert names["trajectory"].joints == small_arm.JOINTS
    again, result = names["again"], names["result"]
    np.testing.assert_array_equal(again.identified.model.parameters, result.identified.model.parameters)


def test_the_command_line_and_the_api_give_the_same_numbers(tmp_path):
    pytest.importorskip("clarabel", reason="needs clarabel")
    log = write_log(tmp_path)
    arm = tmp_path / "arm.urdf"
    words = ["identify", str(log), "--arm", str(arm), "--friction", "coulomb-viscous", "--quiet"]
    assert main([*words, "--out", str(tmp_path / "cli")]) == 0
    ours = sa.identify(sa.read(log, arm), friction="coulomb-viscous", out=tmp_path / "api")
    theirs = sa.load(tmp_path / "cli")
    assert np.array_equal(ours.identified.model.parameters, theirs.identified.model.parameters)


def test_what_identify_refuses_because_a_run_is_read_with_it_is_an_option_of_read():
    assert {*inspect.signature(sa.read).parameters} - {"path"} == OF_READ


def test_every_option_of_the_command_has_its_effect_or_says_where_it_belongs(tmp_path):
    run = sa.read(write_log(tmp_path), tmp_path / "arm.urdf")
    model = Path(small_arm.__file__).parents[1] / "config" / "paper_arm_model.yaml"
    examples = {
        **{"friction": "coulomb-viscous", "cutoff_hz": 7.0, "solver": "cloe", "seed": 1, "structure": model},
        **{"temperature": ("f_c",), "estimate_gravity": "vector"},
    }
    for option in fields(Options):
        if option.name in IDENTIFY_OPTIONS:  # a new option has its example here
            arm = load_arm(model.with_name("paper_arm.yaml"))
            changed = replace(Options(), **{option.name: examples[option.name]})
            assert changed.settings(arm) != Options().settings(arm), option.name
        else:
            with pytest.raises(UserError, match=r"sa\.read|spacearm identify --"):
                sa.identify(run, **{option.name: 1})


def test_mistakes_are_one_line(tmp_path):
    log = write_log(tmp_path)
    with pytest.raises(UserError, match="name the arm"):
        sa.read(log)
    with pytest.raises(UserError, match="no option 'frictoin'"):
        sa.identify(sa.read(log, tmp_path / "arm.urdf"), frictoin="paper")
    with pytest.raises(UserError, match="excite"):
        sa.excite(tmp_path / "arm.urdf", no_such_option=1)
    with pytest.raises(AttributeError):
        sa.no_such_function  # noqa: B018


@pytest.mark.parametrize(
    "imports",
    ["import spacearm_ident.mismatch.finding", "from spacearm_ident import mismatch", "sa.read", "sa.mismatch"],
    ids=["subpackage first", "from", "API first", "at once"],
)
def test_mismatch_is_callable_whatever_was_imported_first(imports):
    code = (
        f"import spacearm_ident as sa; {imports}; from spacearm_ident.errors import UserError\n"
        "try: sa.mismatch('none.mcap')\n"
        "except UserError as error: print(error)\n"
        "from spacearm_ident.mismatch.finding import Explanation\n"
        "assert callable(sa.mismatch) and sa.mismatch.finding.Explanation is Explanation"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    assert "none.mcap" in run.stdout


def test_mismatch_is_a_function_and_a_package(tmp_path):
    pytest.importorskip("clarabel", reason="needs clarabel")
    from spacearm_ident.mismatch.finding import NO_MISMATCH, Explanation

    for seed in (0, 1):
        write_recording(tmp_path / f"run_{seed}.mcap", small_arm.recording(16.0, seed=seed))
    found = sa.mismatch(sa.read(tmp_path / "run_1.mcap"), tmp_path / "run_0.mcap")
    assert isinstance(found, Explanation) and found.verdict == NO_MISMATCH


def test_an_arm_is_compared_with_its_simulation(tmp_path):
    pytest.importorskip("clarabel", reason="needs clarabel")
    write_recording(tmp_path / "field.mcap", small_arm.recording(16.0, seed=1))
    (tmp_path / "arm.urdf").write_text(small_arm.URDF)
    out = tmp_path / "out"
    found = sa.compare(tmp_path / "arm.urdf", tmp_path / "field.mcap", out=out, without=["torque_ripple"])
    assert found.fit and (out / "report.html").is_file()
    with pytest.raises(UserError, match="no effect 'gremlins'"):
        sa.compare(tmp_path / "arm.urdf", tmp_path / "field.mcap", without="gremlins")


def test_identify_reads_a_path_as_read_does(tmp_path):
    pytest.importorskip("clarabel", reason="needs clarabel")
    path = tmp_path / "run.mcap"
    write_recording(path, small_arm.recording(seed=0))
    of_path, of_run = (sa.identify(one, friction="coulomb-viscous", cutoff_hz=5.0) for one in (path, sa.read(path)))
    np.testing.assert_array_equal(of_path.identified.model.parameters, of_run.identified.model.parameters)


class Frame:
    """What of a pandas DataFrame is used: columns, columns by their names, and numbers."""

    def __init__(self, values: np.ndarray, columns: Sequence[str]) -> None:
        self.values, self.columns = values, list(columns)

    def __getitem__(self, names: list[str]) -> Frame:
        return Frame(self.values[:, [self.columns.index(name) for name in names]], names)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.asarray(self.values, dtype)


@pytest.mark.parametrize("kind", ["arrays", "lists", "frames"])
def test_arrays_are_identified_as_the_bag_of_the_same_numbers(kind, tmp_path):
    run = small_arm.recording(12.0, seed=3)
    (tmp_path / "arm.urdf").write_text(small_arm.URDF)
    write_recording(tmp_path / "run.mcap", run)
    signals: tuple[Any, ...] = (run.time, run.position, run.effort)
    if kind == "lists":
        signals = tuple(one.tolist() for one in signals)
    elif kind == "frames":
        turned = Frame(run.position[:, ::-1], run.joints[::-1]), Frame(run.effort, run.joints)
        signals = (run.time, *turned)
    made = sa.recorded(*signals, arm=tmp_path / "arm.urdf", file=tmp_path / "made.mcap")
    assert made.path == tmp_path / "made.mcap"
    ordered, read = made.recording.in_order(run.joints), sa.read(tmp_path / "run.mcap").recording
    for name in ("time", "position", "effort"):
        np.testing.assert_array_equal(getattr(ordered, name), getattr(read, name))
    if kind == "arrays":
        model = sa.identify(made, friction="coulomb-viscous").identified.model
        for joint, level in zip(small_arm.JOINTS, small_arm.COULOMB, strict=True):
            assert model.value("f_c", joint) == pytest.approx(level, rel=0.1)
        other = small_arm.recording(12.0, seed=4)
        again = sa.recorded(other.time, other.position, other.effort, arm=tmp_path / "arm.urdf")
        assert sa.mismatch(again, reference=made).verdict == "no_mismatch"


def test_unfit_data_are_warned_of_and_have_the_verdict_of_the_command(tmp_path):
    run = small_arm.recording(12.0)
    (tmp_path / "arm.urdf").write_text(small_arm.URDF)
    wrong = sa.recorded(run.time, np.degrees(run.position), run.effort, arm=tmp_path / "arm.urdf")
    with pytest.warns(UserWarning, match="data unfit: .*degrees"):
        result = sa.identify(wrong, out=tmp_path / "out")
    assert result.verdict.level == "unfit" and not result.verdict.usable
    assert sa.load(tmp_path / "out").verdict.headline == result.verdict.headline
    right = sa.recorded(run.time, run.position, run.effort, arm=tmp_path / "arm.urdf")
    assert sa.identify(right).verdict.level == "good"


def test_arrays_that_do_not_fit_are_refused_in_one_line(tmp_path):
    run = small_arm.recording(4.0)
    (tmp_path / "arm.urdf").write_text(small_arm.URDF)
    right = {"time": run.time, "position": run.position, "effort": run.effort}
    wrong: list[tuple[dict[str, Any], str]] = [
        ({"time": 1e3 * run.time}, "time in seconds"),
        ({"time": run.time[::-1]}, "does not increase: 3.995 s in row 0"),
        ({"time": run.time[:-1]}, r"position is of shape \(800, 2\): 799 rows of 2 joints"),
        ({"time": np.where(run.time > 2.0, np.nan, run.time)}, "finite seconds"),
        ({"effort": run.effort[:, :1]}, r"effort is of shape \(800, 1\)"),
        ({"velocity": "fast"}, "velocity is not an array of numbers"),
        (
            {"position": Frame(run.position, ("shoulder", "wrist")), "effort": Frame(run.effort, run.joints)},
            "no column",
        ),
        ({"joints": ("elbow", "elbow")}, "each once"),
    ]
    for change, said in wrong:
        with pytest.raises(UserError, match=said):
            sa.recorded(**{**right, **change}, arm=tmp_path / "arm.urdf")
    with pytest.raises(UserError, match=r"sa\.recorded takes arrays"):
        sa.read(run.position)  # type: ignore[arg-type]


def test_excite_returns_a_trajectory(tmp_path):
    (tmp_path / "arm.urdf").write_text(small_arm.URDF)
    words = {"harmonics": 2, "periods": 1, "ground": "none", "no_stall_margin": True}
    trajectory = sa.excite(write_arm(tmp_path), **words)
    assert trajectory.joints == small_arm.JOINTS and trajectory.duration_s > 5.0
