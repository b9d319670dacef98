"""From recordings to evidence: base model, noise, whitened scenes.

Two cut-offs: positions go through one several times as wide as torque and columns do. Friction follows the sign of
the velocity there was, and a velocity low-passed as hard as the torque turns round at another moment.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..dynamics.arm import Arm, FloatArray
from ..dynamics.base_link import placed
from ..dynamics.friction import ViscousFriction
from ..dynamics.model import IdentifiedModel, TorqueModel
from ..errors import UnfitDataError
from ..identification.identified import Choice
from ..identification.identify import Settings, identify
from ..recording.motion import Motion
from ..recording.recording import Recording
from ..recording.signals import prepare
from .base_structure import GATE, RESISTS, choose_base
from .evidence import Evidence, Unseen
from .scene import Scene, Whitener, coarse, fit_whitener, louder

CUTOFF_HZ = 20.0
WIDER = 4.0
"""Positions are filtered this many times as wide."""
ORDER = 6
"""Of the noise's autoregressive model: it covers the length of the low-pass."""
IN_FULL = 0.8
"""Rows that count for less than this share of the others do not say what colour the noise has."""


@dataclass(frozen=True)
class Prepared:
    """What the competition is about.

    Attributes:
        base: Model of the healthy arm (or of the field, where there is no reference).
        evidence: What it leaves over in the field.
        unseen: Recordings that no fit sees; None where there are none.
        plain: What a row counts for by itself, not whitened, joint by joint.
        noise_floor_Nm: (n,) standard deviation of a reduced torque row that a right model would leave.
        cutoff_hz: Bandwidth that was looked at.
        modelled: Whether the reference's torque is a model's, without noise, not a recording's.
    """

    base: IdentifiedModel
    evidence: Evidence
    unseen: Unseen | None
    plain: Sequence[Whitener]
    noise_floor_Nm: FloatArray
    cutoff_hz: float
    modelled: bool = False


def prepare_evidence(
    arm: Arm,
    reference: Sequence[Recording] | IdentifiedModel,
    field: Sequence[Recording],
    validation: Sequence[Recording],
) -> Prepared:
    """Base model, noise and whitened rows.

    Args:
        arm: What is known before.
        reference: Recordings of the healthy arm, or its identified model; empty where there is neither.
        field: Recordings to explain.
        validation: Recordings that no fit is to see.

    Raises:
        UnfitDataError: A recording cannot carry the question.
        UserError: A recording lacks a joint.
    """
    known = reference if isinstance(reference, IdentifiedModel) else None
    healthy = [] if isinstance(reference, IdentifiedModel) else list(reference)
    healthy, field, validation = placed(healthy, arm), placed(field, arm), placed(validation, arm)
    everything = [*healthy, *field, *validation]
    rates = [recording.rate_hz for recording in everything]
    rates += [recording.base.rate_hz for recording in everything if recording.base is not None]
    cutoff = min(CUTOFF_HZ, 0.2 * min(rates))
    choices: tuple[Choice, ...] = ()
    if known is None:
        identified = identify(healthy or field, arm, Settings(cutoff_hz=cutoff, choose=choose_base))
        base, choices = identified.model, identified.choices
    else:
        base = known
    # What is explained is an arm that could be: what least squares puts into impossible parameters is not base.
    base = replace(base, cutoff_hz=cutoff, unbounded=None)

    wide = min(WIDER * cutoff, 0.35 * min(rates))
    referred, examined, judged = (banded(part, arm.joint_names, cutoff, wide) for part in (healthy, field, validation))
    whiteners, plain = _whiteners(base, referred or examined)
    if known is not None:
        # A model pins itself down as a recording of the healthy arm on the same motion would.
        referred = [replace(motion, torque=base.torque(motion)) for motion in examined]

    def gathered(base: IdentifiedModel) -> Evidence:
        return Evidence(base, Scene(base, examined, whiteners), Scene(base, referred, whiteners) if referred else None)

    evidence = gathered(base)
    if healthy and _form_is_open(choices):
        # An arm in vacuum, that lacks the term, may tell.
        other = _resisting(base)
        in_other_form = gathered(other)
        if in_other_form.in_thin_air[1] < evidence.in_thin_air[1] - GATE:
            base, evidence = other, in_other_form
    unseen = Unseen(evidence, Scene(base, judged, whiteners)) if judged else None
    return Prepared(base, evidence, unseen, plain, _floor(whiteners), cutoff, known is not None)


def banded(recordings: Sequence[Recording], joints: Sequence[str], cutoff_hz: float, wide_hz: float) -> list[Motion]:
    """Recordings as motions: torque and columns are to go through one low-pass, positions before it up to `wide_hz`.

    Accelerations go through no other. Their noise would be less; but so would the jolt that a neighbour's reversal
    gives a joint, which the torque shows in full: by a tenth, or eleven standard deviations.

    Raises:
        UnfitDataError: There are too few samples, or they do not last.
    """
    motions = prepare(recordings, joints, wide_hz, average=False)[0] if recordings else []
    return [coarse(motion, cutoff_hz) for motion in motions]


def _form_is_open(choices: Sequence[Choice]) -> bool:
    """Whether the healthy arm's friction may as well be odd in its quadratic term as even."""
    return any(choice.term == RESISTS and not choice.accepted and choice.gain > -GATE for choice in choices)


def _resisting(base: IdentifiedModel) -> IdentifiedModel:
    """The base with quadratic friction that resists in both directions, unknown yet."""
    structure = {**base.model.structure, ViscousFriction.kind: {"quadratic": "odd"}}
    quadratic = np.array([parameter.symbol == "k_v2" for parameter in base.model.parameters])
    parameters = np.where(quadratic, 0.0, base.parameters)
    return replace(base, model=TorqueModel(base.model.arm, structure), parameters=parameters)


def _whiteners(base: IdentifiedModel, motions: Sequence[Motion]) -> tuple[list[Whitener], list[Whitener]]:
    """The noise of every joint, from what is left of the reference itself; and without its colour.

    Raises:
        UnfitDataError: No joint moves for long enough.
    """
    joints = range(len(base.model.arm.joints))
    scale = [max(float(np.sqrt(np.mean([np.mean(m.torque_rows[:, j] ** 2) for m in motions]))), 1e-6) for j in joints]
    # Which rows to believe less, the colour of the others' noise, and by how much less in that colour.
    plain = _louder(base, motions, [Whitener(np.zeros(0), 0.01 * size) for size in scale], 3)
    scene = Scene(base, motions, plain)
    residual = Evidence(base, scene, None).residual
    coloured = [_coloured(scene, residual, j, 1e-6 * scale[j]) for j in joints]
    if not any(np.isfinite(whitener.sigma_Nm) for whitener in coloured):
        raise UnfitDataError("no joint moves for half a second in one direction: record a longer run")
    return _louder(base, motions, coloured, 2), plain


def _louder(base: IdentifiedModel, motions: Sequence[Motion], whiteners: list[Whitener], times: int) -> list[Whitener]:
    """What rows count for, found by fitting the base with it again and again."""
    for _ in range(times):
        scene = Scene(base, motions, whiteners)
        whiteners = louder(whiteners, scene, Evidence(base, scene, None).residual)
    return whiteners


def _coloured(scene: Scene, residual: FloatArray, joint: int, floor: float) -> Whitener:
    """One joint's autoregressive model from its residual, which is not whitened yet, where rows count in full."""
    series, counts = [], []
    for m, motion in enumerate(scene.motions):
        slot = scene.slot(joint, m)
        whole, weight = np.zeros((2, len(motion.torque_rows)))
        whole[scene.place[slot]] = residual[slot] / scene.weight[slot] * scene.whiteners[joint].sigma_Nm
        weight[scene.place[slot]] = scene.weight[slot]
        series.append(whole)
        counts.append(weight > IN_FULL * scene.weight[scene.joint == joint].max(initial=0.0))
    return fit_whitener(series, counts, ORDER, floor)


def _floor(whiteners: Sequence[Whitener]) -> FloatArray:
    """(n,) standard deviation of the noise that the whiteners describe, N·m."""
    floors = []
    for whitener in whiteners:
        response = np.ones(512, dtype=complex)
        frequency = np.linspace(0, np.pi, 512)
        for lag, coefficient in enumerate(whitener.coefficients, start=1):
            response -= coefficient * np.exp(-1j * lag * frequency)
        floors.append(whitener.sigma_Nm * float(np.sqrt(np.mean(1.0 / np.maximum(np.abs(response), 0.02) ** 2))))
    return np.array(floors)
