"""The parameters of the identifier node, read once at its start."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from ..errors import UserError
from ..sessions.bags import AUTO, Options
from ..solvers.choice import SEPARABLE
from .identifier_choices import ESTIMATE_GRAVITY, FRICTION, SOLVER, TEMPERATURE
from .runtime import LiveNode, require_folder
from .tracking_stream import TrackingChoice

DEFAULT_FOLDER = "identified"
"""Result folder where the parameter `result_directory` is not set; below the working directory."""


@dataclass(frozen=True)
class Replay:
    """A bag to identify at start, bags to validate on (none: hold-out), and whether to end then."""

    bag: Path
    validated: tuple[Path, ...]
    exit_after: bool


@dataclass(frozen=True)
class IdentifierSettings:
    """Decisions of the user.

    Attributes:
        how: How to identify.
        buffer_s: Time for which joint states are kept, s; above 1 kHz as many as at 1 kHz.
        auto: Whether a finished run is identified.
        directory: Result folder.
        row_rate_hz: Of the published residual.
        model: File to begin with.
        replay: What to identify at start.
        reference: The healthy arm, for explanations of every run.
        simulation: A simulation to compare every run with.
        tracking: What to follow on line; None: nothing.
        change_window_s: Length of what is explained behind a change; None: changes are not explained.
    """

    how: Options
    buffer_s: float
    auto: bool
    directory: Path
    row_rate_hz: float
    model: Path | None
    replay: Replay | None
    reference: Path | None
    simulation: Path | None
    tracking: TrackingChoice | None
    change_window_s: float | None


def declare(node: LiveNode) -> IdentifierSettings:
    """Declare the parameters and read them.

    Raises:
        UserError: One cannot be used.
    """
    how = _how(node)
    buffer_s = node.parameter(
        "buffer_s",
        300.0,
        "Time for which joint states are kept, s; above 1 kHz as many as at 1 kHz; the oldest go first",
        low=5.0,
        high=7200.0,
    )
    text = "Bag or model.yaml of the healthy arm, to explain every run; empty: not"
    tracking = _tracking(node)
    reference = node.file_parameter("mismatch_reference", text)
    text = "MJCF, URDF, SDF or model.yaml to compare every run with; empty: not"
    simulation = node.file_parameter("simulation", text)
    if reference is not None and simulation is not None:
        raise UserError("parameters simulation and mismatch_reference: set one of them, leave the other empty")
    return IdentifierSettings(
        how=how,
        buffer_s=buffer_s,
        auto=node.parameter("auto_identify", True, "Identify (then validate) when a run has ended"),
        directory=_result_directory(node),
        row_rate_hz=node.parameter("residual_rate_hz", 50.0, "Rate of /identifier/residuals, Hz", low=0.1, high=1000.0),
        model=node.file_parameter("model", "model.yaml to watch the residual of from the start"),
        replay=_replay(node),
        reference=reference,
        simulation=simulation,
        tracking=tracking,
        change_window_s=_change_window(node, tracking is not None, buffer_s),
    )


def _result_directory(node: LiveNode) -> Path:
    """The result folder; that of a namespace lies below the default one, so that two arms never share a folder."""
    place = node.get_namespace().strip("/")
    text = "Result folder; in a namespace and left at its default: a folder of that name in it"
    chosen = Path(node.parameter("result_directory", DEFAULT_FOLDER, text)).expanduser()
    folder = chosen / place if place and chosen == Path(DEFAULT_FOLDER) else chosen
    # Absolute: what the log names, commands included, is then found from any folder.
    return require_folder("result_directory", folder.absolute())


def _how(node: LiveNode) -> Options:
    text = "Gravity in the base frame, m/s^2, as [0.0, 0.0, -9.81]; nan: the arm's own"
    gravity = _gravity(node.parameter("gravity", [math.nan] * 3, text))
    arm = node.file_parameter("arm", "URDF or arm YAML; empty: of /robot_description")
    friction = node.parameter("friction", AUTO, "Friction law, as spacearm identify --friction", choices=FRICTION)
    text = "Model file whose terms to identify, effects included; instead of friction"
    structure = node.file_parameter("structure", text)
    if structure and friction != AUTO:
        raise UserError(f"parameter structure: it has its own friction law: leave friction at {AUTO}")
    solver = node.parameter("solver", SEPARABLE, "Solver, as spacearm identify --solver", choices=SOLVER)
    seed = node.parameter("seed", 0, "Of the solver's particle swarm", low=0, high=2**32 - 1)
    bandwidth = node.parameter("bandwidth_hz", 0.0, "Low-pass cut-off, Hz; 0: from the data", low=0.0, high=1000.0)
    text = "Friction over temperature: f_c, k_v1, v_b, with commas between; empty: none"
    temperature = TEMPERATURE.chosen(node.parameter("temperature", "", text, choices=TEMPERATURE))
    text = "Estimate gravity: vector, direction; empty: it is the arm's"
    estimated = node.parameter("estimate_gravity", "", text, choices=ESTIMATE_GRAVITY)
    return Options(
        arm=arm,
        gravity=gravity,
        friction=friction,
        cutoff_hz=bandwidth or None,
        structure=structure,
        solver=solver,
        seed=seed,
        temperature=temperature,
        estimate_gravity=estimated,
        prior=node.file_parameter("prior", "Result folder whose model is updated by the run; empty: none"),
    )


def _replay(node: LiveNode) -> Replay | None:
    bag = node.file_parameter("replay", "Bag to identify off line at start, instead of waiting")
    validate = node.file_parameter("replay_validate", "Bag to validate the replay on; empty: hold-out")
    exit_after = node.parameter("exit_after_replay", False, "End when the replay is done")
    return Replay(bag, (validate,) if validate else (), exit_after) if bag else None


def _tracking(node: LiveNode) -> TrackingChoice | None:
    wanted = node.parameter("tracking", True, "Follow the friction levels of a known model on line, report jumps")
    choice = TrackingChoice(
        node.parameter("tracking_payload", False, "Follow a body on the last link as well: where there is a gripper"),
        node.parameter("tracking_temperature", False, "Follow how friction goes with the joint temperatures as well"),
        node.parameter(
            "tracking_memory_s", 60.0, "Moving time after which what was estimated has faded, s", low=5.0, high=3600.0
        ),
    )
    return choice if wanted else None


def _change_window(node: LiveNode, tracking: bool, buffer_s: float) -> float | None:
    wanted = node.parameter(
        "mismatch_on_change",
        False,
        "Explain a change that the tracking has found, against mismatch_reference or else the model in use",
    )
    window_s = node.parameter(
        "mismatch_window_s", 30.0, "Length of the stretch behind a change that is explained, s", low=5.0, high=600.0
    )
    if not wanted:
        return None
    if not tracking:
        raise UserError("parameter mismatch_on_change: without tracking no change is found: set tracking to true")
    if window_s > buffer_s:
        raise UserError(
            f"parameter mismatch_window_s: {window_s:g} s do not fit into the buffer of {buffer_s:g} s: "
            "enlarge buffer_s"
        )
    return window_s


def _gravity(values: list[float]) -> tuple[float, float, float] | None:
    """Three finite numbers, or None for the arm's own."""
    if all(math.isnan(value) for value in values):
        return None
    if len(values) != 3 or not all(math.isfinite(value) for value in values):
        raise UserError(f"parameter gravity: {values} are not three numbers, such as [0.0, 0.0, -9.81]")
    return values[0], values[1], values[2]
