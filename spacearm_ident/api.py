"""The Python API: `import spacearm_ident as sa`. Thin over the functions that the command line calls.

run = sa.read("log.csv", arm="arm.urdf")
result = sa.identify(run)
result.parameters; result.predict(q, dq, ddq); result.plot(); result.export("mjcf", "arm.xml")
"""

from __future__ import annotations

import contextlib
import io
import os
import tempfile
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .arrays import FloatArray
from .cli.main import parser
from .dynamics.arm import Arm, load_arm
from .errors import UserError
from .estimate.identified import Identified, Validation
from .excitation.trajectory import Trajectory
from .excitation.trajectory_file import load_trajectory
from .export.motion import steady
from .export.write import export_model
from .identification.effort import in_newton_metres
from .identification.verdict import Verdict, judge_result
from .layers.comparison import Comparison
from .mismatch.finding import Explanation
from .recording import Recording, write_recording
from .recording.from_arrays import from_arrays
from .sessions.bags import Options
from .sessions.identification import find_arm, identify_session
from .sessions.mismatch import explain_session
from .sessions.reading import Comparing, Reading
from .sessions.simulation import compare_session

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PathLike = str | os.PathLike[str]

OF_READ = frozenset({"arm", "gravity", "namespace", "mapping", "fixed_base"})
"""Fields of `Options` that say how a recording is read."""
OF_THE_COMMAND = frozenset({"prior", "weighed", "loaded"})
"""Fields of `Options` that name further files; `spacearm identify` reads them."""
IDENTIFY_OPTIONS = frozenset(item.name for item in fields(Options)) - OF_READ - OF_THE_COMMAND
"""Options of `identify`: the other fields of `Options`."""


@dataclass(frozen=True)
class Run:
    """A recording with its arm.

    Attributes:
        recording: Joint signals, SI, effort in N·m on the output side.
        arm: Of the file named, or of the recording's URDF.
        path: Where it was read from.
    """

    recording: Recording
    arm: Arm
    path: Path
    _how: Comparing = field(default_factory=Comparing, repr=False)
    _kept: Any = field(default=None, repr=False)


def read(
    path: PathLike,
    arm: PathLike | None = None,
    mapping: PathLike | None = None,
    *,
    gravity: Sequence[float] | None = None,
    namespace: str | None = None,
    fixed_base: bool = False,
) -> Run:
    """Read a bag or a log.

    Args:
        path: MCAP, rosbag2 folder, `.db3`, `.bag`, or a log as `spacearm import` knows them.
        arm: URDF or arm YAML; None: the bag's `/robot_description`, or the mapping's arm.
        mapping: What the columns of a log are; None: the file beside it, else what is proposed.
        gravity: (3,) m/s^2 in the base frame, instead of the arm's.
        namespace: Of the arm, where a bag holds several.
        fixed_base: Take the base for fixed though a bag holds its motion.

    Raises:
        UserError: It cannot be read, holds several recordings, or its arm is not known.
    """
    if not isinstance(path, (str, os.PathLike)):
        raise UserError(f"read takes the path of a file, not a {type(path).__name__}: sa.recorded takes arrays")
    files = (None if arm is None else Path(arm)), (None if mapping is None else Path(mapping))
    reading = Reading(files[0], namespace, files[1], fixed_base)
    recordings = reading.read([Path(path)], lambda share, what: None)
    if len(recordings) != 1:
        raise UserError(f"{path}: {len(recordings)} recordings; read them one by one")
    found = find_arm(files[0], gravity, recordings)
    how = Comparing(reading, None if gravity is None else tuple(gravity))
    return Run(in_newton_metres(recordings, found)[0], found, Path(path), how)


def recorded(
    time: Any,
    position: Any,
    effort: Any,
    *,
    arm: PathLike,
    joints: Sequence[str] | None = None,
    velocity: Any = None,
    temperature: Any = None,
    gravity: Sequence[float] | None = None,
    file: PathLike | None = None,
) -> Run:
    """Take arrays or DataFrames for a recording: they are written to a bag, and that is read as any other.

    Args:
        time: (N,) s, increasing.
        position: (N, n) rad, m for sliding joints.
        effort: (N, n) N·m on the output side (N), or in the unit that the arm YAML declares.
        arm: URDF or arm YAML.
        joints: Names of the n columns; None: those of `position`, a DataFrame, else the arm's joints in its order.
        velocity: (N, n) rad/s; None: the position is differentiated.
        temperature: (N, n) °C; None: not recorded.
        gravity: (3,) m/s^2 in the base frame, instead of the arm's.
        file: The bag to write, `NAME.mcap`; None: a temporary one, there as long as the run is.

    Raises:
        UserError: Shapes or names do not fit, time does not increase, or the arm is not known.
    """
    if joints is None and not hasattr(position, "columns"):
        joints = load_arm(Path(arm)).joint_names
    recording = from_arrays(time, position, effort, joints, velocity, temperature)
    kept = tempfile.TemporaryDirectory(prefix="spacearm_") if file is None else None
    path = Path(file) if file is not None else Path(kept.name) / "arrays.mcap" if kept else Path()
    write_recording(path, recording)
    return replace(read(path, arm, gravity=gravity), _kept=kept)


@dataclass(frozen=True)
class Result:
    """An identified arm.

    Attributes:
        identified: Estimates, covariance, model.
        validation: How well it predicts.
        folder: Where model.yaml and report.html are.
        unfit: Why the data are unfit, a clause each; empty where they are fit.
    """

    identified: Identified
    validation: Validation
    folder: Path
    unfit: tuple[str, ...] = ()
    _kept: Any = field(default=None, repr=False)

    @property
    def verdict(self) -> Verdict:
        """What the command says first: level, headline and reasons."""
        return judge_result(self.identified, self.validation, self.unfit)

    @property
    def parameters(self) -> Any:
        """Symbol, joint, value, unit, standard error and what determined it: a DataFrame, or dicts without pandas."""
        rows = [
            {
                "symbol": one.symbol,
                "joint": one.joint,
                "value": one.value,
                "unit": one.unit,
                "standard_error": one.standard_error,
                "determination": one.determination.value,
            }
            for one in self.identified.estimates
        ]
        try:
            import pandas
        except ImportError:
            return rows
        return pandas.DataFrame(rows).set_index(["symbol", "joint"])

    def predict(self, q: Any, dq: Any, ddq: Any, rate_hz: float | None = None) -> FloatArray:
        """Joint torque, N·m on the output side.

        Args:
            q: (n,) or (N, n) rad, joints in the arm's order.
            dq: The same, rad/s.
            ddq: The same, rad/s^2.
            rate_hz: Rows a second of one motion, for friction that remembers; None: each row by itself.

        Returns:
            (n,) or (N, n).

        Raises:
            UserError: The shapes are not these.
        """
        arm = self.identified.model.model.arm
        rows = [np.atleast_2d(np.asarray(values, dtype=np.float64)) for values in (q, dq, ddq)]
        if any(row.shape != rows[0].shape or row.shape[1] != len(arm.joints) for row in rows):
            raise UserError(f"q, dq and ddq need one shape, ({len(arm.joints)},) or (N, {len(arm.joints)})")
        torque = self.identified.model.torque(steady(arm.joint_names, rows[0], rows[1], rows[2], rate_hz))
        return torque if np.ndim(q) == 2 else np.asarray(torque[0])

    def plot(self) -> Figure:
        """Measured and predicted torque of every joint over the time it was validated on."""
        from matplotlib.figure import Figure

        names = self.identified.model.model.arm.joint_names
        figure = Figure(figsize=(8.0, 1.8 * len(names)), layout="constrained")
        axes = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
        for k, (one, joint) in enumerate(zip(axes, names, strict=True)):
            for trace in self.validation.traces:
                one.plot(trace.time, trace.measured[:, k], color="0.6", linewidth=0.8)
                one.plot(trace.time, trace.predicted[:, k], color="C0", linewidth=0.8)
            one.set_ylabel(f"{joint}\nN m", fontsize=8)
        axes[-1].set_xlabel("s (grey: measured, blue: predicted)")
        return figure

    def export(self, form: str, out: PathLike) -> dict[str, float]:
        """Write the model in a format of `spacearm export`; returns what that costs at each joint, N·m RMS."""
        fit, _ = export_model(self.identified.model, self.validation, form, Path(out), self.folder.name)
        return dict(fit.cost_Nm)


def identify(
    runs: Run | PathLike | Sequence[Run | PathLike],
    validate: Run | PathLike | Sequence[Run | PathLike] = (),
    *,
    out: PathLike | None = None,
    **options: Any,
) -> Result:
    """Identify an arm, as `spacearm identify`.

    Args:
        runs: To fit, of one arm: runs, or paths, which `read` is called with.
        validate: To validate on; none: the last third of the last run is held out.
        out: Result folder; None: a temporary one, there as long as the result is.
        options: Fields of `spacearm_ident.sessions.bags.Options`, such as `friction="paper"`; not those that say how a
            recording is read (`OF_READ`), nor `prior`, `weighed` and `loaded`, which `spacearm identify` has.

    Returns:
        The result; of data that break a convention (an axis reversed, degrees) with a `UserWarning` that says so.

    Raises:
        UnfitDataError: The data cannot carry it.
        UserError: The runs do not fit the arm, or an option is wrong.
    """
    fitted, judges = ([_run(one) for one in _several(some)] for some in (runs, validate))
    if not fitted:
        raise UserError("nothing to identify from: give a run, as sa.read returns it")
    for name in options:
        if name in OF_READ:
            raise UserError(f"identify takes no {name!r}: it is decided when the run is read (sa.read)")
        if name in OF_THE_COMMAND:
            raise UserError(f"identify takes no {name!r}: use the command 'spacearm identify --{name}'")
        if name not in IDENTIFY_OPTIONS:
            raise UserError(f"no option {name!r} of identify: it has {', '.join(sorted(IDENTIFY_OPTIONS))}")
    arm = fitted[0].arm
    kept = tempfile.TemporaryDirectory(prefix="spacearm_") if out is None else None
    folder = Path(out) if out is not None else Path(kept.name) / "result" if kept else Path()
    session = identify_session(
        [run.recording for run in fitted],
        [run.recording for run in judges],
        arm,
        replace(Options(), **options).settings(arm),
        folder,
    )
    result = Result(session.identified, session.validation, folder, tuple(session.conventions.unfit), kept)
    if result.unfit:
        warnings.warn("\n".join(result.verdict.lines), stacklevel=2)
    return result


def mismatch(
    field_runs: Run | PathLike | Sequence[Run | PathLike],
    reference: Run | PathLike | Sequence[Run | PathLike] = (),
    validate: Run | PathLike | Sequence[Run | PathLike] = (),
    *,
    out: PathLike | None = None,
    arm: PathLike | None = None,
    without: Sequence[str] = (),
) -> Explanation:
    """Explain what an arm does that its model or its healthy self does not, as `spacearm mismatch`.

    Args:
        field_runs: To explain: runs, or paths of bags and logs.
        reference: Of the healthy arm, or one model.yaml; none: the arm's own fit.
        validate: To judge on; none: the last third of each of `field_runs`.
        out: Result folder; None: nothing stays on disk.
        arm: URDF or arm YAML; None: what the runs were read with, else the reference model's, or of the bags.
        without: Names of effects to leave out.

    Raises:
        UserError: As `spacearm mismatch`.
    """
    how = _comparing([*_several(field_runs), *_several(reference), *_several(validate)], arm, without)
    with _place(out, "mismatch") as folder:
        session = explain_session(_paths(field_runs), _paths(reference), _paths(validate), folder, how)
    return session.explanation


def compare(
    simulation: Run | PathLike | Sequence[Run | PathLike],
    field_runs: Run | PathLike | Sequence[Run | PathLike],
    validate: Run | PathLike | Sequence[Run | PathLike] = (),
    *,
    out: PathLike | None = None,
    arm: PathLike | None = None,
    without: Sequence[str] = (),
) -> Comparison:
    """Compare an arm with a simulation of it, layer by layer, as `spacearm mismatch --simulation`.

    Args:
        simulation: MJCF, URDF, SDF or model.yaml, or runs or bags that a simulator wrote.
        field_runs: Of the arm: runs, or paths of bags and logs.
        validate: To judge on; none: the last third of each of `field_runs`.
        out: Result folder, with the corrected file; None: nothing stays on disk.
        arm: URDF or arm YAML of the arm; None: what the runs were read with, else the simulation's, or of the bags.
        without: Names of effects to leave out.

    Raises:
        UserError: As `spacearm mismatch --simulation`.
    """
    how = _comparing([*_several(field_runs), *_several(validate)], arm, without)
    with _place(out, "compare") as folder:
        session = compare_session(_paths(simulation), _paths(field_runs), _paths(validate), folder, how)
    return session.comparison


@contextlib.contextmanager
def _place(out: PathLike | None, name: str) -> Iterator[Path]:
    """Where to write: `out`, or where that is None a temporary place, which does not outlast its use."""
    with tempfile.TemporaryDirectory(prefix="spacearm_") as scratch:
        yield Path(scratch) / name if out is None else Path(out)


def _run(one: Run | PathLike) -> Run:
    return one if isinstance(one, Run) else read(one)


def _comparing(runs: Sequence[Run | PathLike], arm: PathLike | None, without: Sequence[str]) -> Comparing:
    """How recordings are compared: as the first of them that was read."""
    how = next((one._how for one in runs if isinstance(one, Run)), Comparing())
    if arm is not None:
        how = replace(how, reading=replace(how.reading, arm=Path(arm)))
    return replace(how, excluded=tuple([without] if isinstance(without, str) else without))


def _several(runs: Run | PathLike | Sequence[Run | PathLike]) -> list[Run | PathLike]:
    return [runs] if isinstance(runs, (Run, str, os.PathLike)) else list(runs)


def _paths(runs: Run | PathLike | Sequence[Run | PathLike]) -> list[Path]:
    return [one.path if isinstance(one, Run) else Path(one) for one in _several(runs)]


def excite(arm: PathLike, out: PathLike | None = None, **options: Any) -> Trajectory:
    """Optimise an excitation trajectory, as `spacearm excite`.

    Args:
        arm: URDF or arm YAML.
        out: Where its YAML goes; None: nowhere.
        options: Options of the command with underscores: `seed=1`, `harmonics=5`, `fundamental=0.2`.

    Raises:
        UserError: An option is wrong, or no motion keeps the limits.
    """
    with _place(out, "trajectory.yaml") as file:
        words = ["excite", "--arm", str(arm), "--out", str(file), "--quiet", "--json"]
        for name, value in options.items():
            several = value if isinstance(value, (list, tuple)) else [value]
            words += [f"--{name.replace('_', '-')}", *([] if value is True else map(str, several))]
        said = io.StringIO()
        try:
            with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(said):
                parsed = parser(("excite",)).parse_args(words)
                parsed.command_line = "sa.excite"
                parsed.run(parsed)
        except SystemExit as error:
            raise UserError(f"excite: {said.getvalue().strip().splitlines()[-1]}") from error
        return load_trajectory(file)


def load(folder: PathLike) -> Result:
    """A result folder of `spacearm identify`.

    Raises:
        UserError: It is none.
    """
    from .results.store import load_result

    result = load_result(Path(folder))
    return Result(result.identified, result.validation, Path(folder), result.unfit)
