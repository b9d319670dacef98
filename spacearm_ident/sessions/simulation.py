"""A comparison with a simulation: its file and bags in, layers and their result folder out.

The one pass behind `spacearm mismatch --simulation` and the identifier node.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..dynamics.arm import Arm
from ..dynamics.model import IdentifiedModel
from ..errors import UserError
from ..export.mended import mend
from ..identification.effort import in_newton_metres
from ..identification.identify import Progress, Settings, identify
from ..layers.compare import compare
from ..layers.comparison import Comparison
from ..layers.discrete import Mistake, find_mistakes
from ..layers.item import CONVENTIONS, PARAMETERS, Item, Mended, Strayed
from ..recording import Recording
from ..report.folder import refuse_to_replace
from ..report.layers_folder import write_comparison
from ..results.urdf import identified_urdf
from ..signals.motion import Motion
from ..signals.prepare import prepare
from ..simulations import SIMULATION_SUFFIXES, Simulation, read_simulation
from ..simulations.names import affixes, renamed, renamed_model
from ..simulations.noise_free import noise_free
from ..simulations.simulation import simulated_structure, without
from .identification import corrected, find_arm, within
from .reading import Comparing, Reading


@dataclass(frozen=True)
class SimulationSession:
    """What came out: the comparison, the mended file, the page to open, all recordings, and the simulation."""

    comparison: Comparison
    mended: Mended | None
    page: Path
    recordings: tuple[Recording, ...]
    simulation: Simulation


def compare_session(
    simulation: Sequence[Path],
    bags: Sequence[Path],
    judged: Sequence[Path],
    directory: Path,
    comparing: Comparing,
    *,
    command: str | None = None,
    progress: Progress | None = None,
) -> SimulationSession:
    """Read, compare, write the result folder.

    Args:
        simulation: One file of a simulation, or bags that a simulator wrote.
        bags: Recordings of the arm.
        judged: Recordings to judge on; none: the last third of each of `bags` is held out.
        directory: Result folder.
        comparing: How; its arm is for bags of a simulator that describe none, and for logs (without it, a simulation
            that is a URDF is their arm); its gravity instead of the simulation's.
        command: How to do it again; kept with the result.
        progress: Called with a share done in 0..1 and what is being done.

    Raises:
        UserError: A file cannot be read or does not fit, or the folder cannot be written.
    """
    report = progress or (lambda share, what: None)
    described = next((path for path in simulation if path.suffix.lower() == ".urdf"), None)
    reading, at_first = replace(comparing.reading, otherwise=described), within(report, 0.0, 0.05)
    for path in simulation:
        refuse_to_replace(path, directory)
    fitted, held = (reading.read(paths, at_first) for paths in (bags, judged))
    read = _simulation(simulation, comparing, [*fitted, *held], at_first)
    names = _names(read, [*fitted, *held])
    read = _of_recordings(_under_recorded_names(read, names), [*fitted, *held])
    fitted, held = (corrected(in_newton_metres(runs, read.arm), read.arm) for runs in (fitted, held))
    undoing = find_mistakes(fitted, read)
    if not np.allclose(undoing.arm.gravity, read.arm.gravity):
        read = _under(read, undoing.arm)
    right = [[undoing.corrections.applied(recording) for recording in runs] for runs in (fitted, held)]
    comparison = compare(read, right[0], right[1], comparing.excluded, within(report, 0.1, 0.9))
    comparison = _with_mistakes(comparison, undoing.mistakes)
    mended = None
    if comparison.model is not None and len(simulation) == 1:
        motions, _ = prepare(right[1] or right[0], read.arm.joint_names, comparison.cutoff_hz)
        motions = comparison.wiring.undone(motions, comparison.model)
        try:
            mended = _mended(read, simulation[0], comparison.model, motions, names)
        except UserError as error:
            # The comparison stands by itself.
            comparison = _noted(comparison, f"there is no corrected file: {error}")
        comparison = comparison.of_file(mended)
    page = write_comparison(comparison, read, mended, fitted, held, directory, command)
    return SimulationSession(comparison, mended, page, (*fitted, *held), read)


def is_simulation(path: Path) -> bool:
    """Whether a path is a simulation's file, not a bag."""
    return path.suffix.lower() in SIMULATION_SUFFIXES


def written_by_simulator(paths: Sequence[Path], reading: Reading) -> bool:
    """Whether the bags of a healthy arm come from a simulator: the torque of the first has no noise.

    Args:
        paths: Bags, of which the first is read; none, or a simulation's own file: false.
        reading: How they are read.

    Raises:
        UserError: It cannot be read.
        UnfitDataError: It is sampled too slowly.
    """
    if not paths or is_simulation(paths[0]):
        return False
    return noise_free(reading.read(paths[:1], lambda share, what: None)[0])


def _simulation(
    paths: Sequence[Path],
    comparing: Comparing,
    recordings: Sequence[Recording],
    progress: Progress,
) -> Simulation:
    """The simulation that a file describes, or that wrote some bags."""
    gravity = comparing.gravity
    files = [path for path in paths if is_simulation(path)]
    if files and len(paths) > 1:
        raise UserError("give one file of the simulation, or bags that it wrote, not both")
    if files:
        joints = dict.fromkeys(joint for recording in recordings for joint in recording.joints)
        read = read_simulation(files[0], tuple(joints))
        return read if gravity is None else _under(read, read.arm.with_gravity(np.array(gravity, dtype=float)))
    written = comparing.reading.read(paths, progress)
    known = find_arm(comparing.reading.arm, gravity, [*written, *recordings])
    found = identify(written, known, Settings(structure=simulated_structure()))
    model = found.model.possible
    return Simulation(model, "bag", ", ".join(path.name for path in paths))


def _under(simulation: Simulation, arm: Arm) -> Simulation:
    """The simulation under another gravity."""
    model = replace(simulation.model.model, arm=arm)
    return replace(simulation, model=replace(simulation.model, model=model))


def _names(simulation: Simulation, recordings: Sequence[Recording]) -> dict[str, str]:
    """Joint of the simulation -> its name in the recordings, where these are others by one prefix or suffix.

    Raises:
        UserError: Several prefixes or suffixes would do.
    """
    recorded = tuple(dict.fromkeys(joint for recording in recordings for joint in recording.joints))
    found = affixes(simulation.arm.joint_names, recorded)
    if len(found) > 1:
        raise UserError(
            f"the recordings' joints {', '.join(recorded)} may be those of the simulation without "
            f"{', or '.join(one.words for one in found)}: give them the simulation's names, or keep one arm in its file"
        )
    return {one.own(joint): joint for one in found for joint in recorded}


def _under_recorded_names(simulation: Simulation, names: Mapping[str, str]) -> Simulation:
    """The simulation with the recordings' names of its joints, and a note where they are others."""
    if not names:
        return simulation
    pairs = ", ".join(f"{own} is {recorded}" for own, recorded in names.items())
    note = f"joint names differ by a prefix or suffix and are taken as the same, here the recordings': {pairs}"
    found = renamed(simulation, names)
    return replace(found, notes=(*found.notes, note))


def _mended(
    simulation: Simulation, path: Path, model: IdentifiedModel, motions: Sequence[Motion], names: Mapping[str, str]
) -> Mended | None:
    """The simulation's file with a model's values under its own joint names; figures are by the recordings' names."""
    own = {recorded: joint for joint, recorded in names.items()}
    theirs = [replace(motion, joints=tuple(own.get(joint, joint) for joint in motion.joints)) for motion in motions]
    mended = mend(renamed(simulation, own), path, renamed_model(model, own), theirs)
    if mended is None:
        return None

    def recorded(values: Mapping[str, float]) -> dict[str, float]:
        return {names.get(joint, joint): value for joint, value in values.items()}

    runs = mended.closed_loop
    strayed = runs and [Strayed(recorded(one.position), recorded(one.feedback_Nm)) for one in runs]
    return replace(
        mended,
        cost_Nm=recorded(mended.cost_Nm),
        torque_Nm=recorded(mended.torque_Nm),
        closed_loop=None if strayed is None else (strayed[0], strayed[1]),
    )


def _of_recordings(simulation: Simulation, recordings: Sequence[Recording]) -> Simulation:
    """The simulation of the joints that all recordings have.

    Raises:
        UserError: They share none, or a recording has joints that the simulation lacks in place of some of its own.
    """
    names = simulation.arm.joint_names
    lacking = [name for name in names if any(name not in recording.joints for recording in recordings)]
    strange = sorted({joint for recording in recordings for joint in recording.joints} - set(names))
    if len(lacking) == len(names) or (lacking and strange):
        raise UserError(
            f"the simulation's joints are {', '.join(names)}, the recordings' {', '.join(recordings[0].joints)}: "
            "give them the same names, or names that differ by one prefix or suffix"
            + "".join(f" ({note})" for note in simulation.notes)
        )
    return without(_with_own_bodies(simulation) if lacking else simulation, lacking)


def _with_own_bodies(simulation: Simulation) -> Simulation:
    """The simulation with its model's inertials in the arm's description, from which bodies are put together.

    The description of a file that simulates has them; beside an identified model stands the one that it began with.
    """
    if simulation.format not in ("model", "bag"):
        return simulation
    arm = replace(simulation.arm, urdf=identified_urdf(simulation.model), described="")
    return replace(simulation, model=replace(simulation.model, model=replace(simulation.model.model, arm=arm)))


def _noted(comparison: Comparison, note: str) -> Comparison:
    """With a note in the layer of parameters."""
    layers = [
        replace(layer, notes=(*layer.notes, note)) if layer.name == PARAMETERS else layer for layer in comparison.layers
    ]
    return replace(comparison, layers=tuple(layers))


def _with_mistakes(comparison: Comparison, mistakes: Sequence[Mistake]) -> Comparison:
    """With the mistakes of convention that were undone before, as items of the first layer."""
    if not mistakes or not comparison.layers:
        return comparison
    nothing = float("nan")
    items = tuple(
        Item(one.name, one.joints, one.words, nothing, nothing, nothing, nothing, "", nothing, True) for one in mistakes
    )
    first = comparison.layers[0]
    assert first.name == CONVENTIONS
    return replace(comparison, layers=(replace(first, items=(*items, *first.items)), *comparison.layers[1:]))
