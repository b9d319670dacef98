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
from ..dynamics.model import IdentifiedModel
from ..identification.identify import Settings, identify
from ..recording.motion import Motion
from ..recording.recording import Recording
from ..recording.signals import prepare
from .evidence import Evidence, Unseen
from .scene import Scene, Whitener, coarse, fit_whitener, loudness

CUTOFF_HZ = 20.0
WIDER = 4.0
"""Positions are filtered this many times as wide."""
ORDER = 6
"""Of the noise's autoregressive model: it covers the length of the low-pass."""


@dataclass(frozen=True)
class Prepared:
    """What the competition is about.

    Attributes:
        base: Model of the healthy arm (or of the field, where there is no reference).
        evidence: What it leaves over in the field.
        unseen: Recordings that no fit sees; None where there are none.
        noise_floor_Nm: (n,) standard deviation of a reduced torque row that a right model would leave.
        cutoff_hz: Bandwidth that was looked at.
        modelled: Whether the reference's torque is a model's, without noise, not a recording's.
    """

    base: IdentifiedModel
    evidence: Evidence
    unseen: Unseen | None
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
    healthy = [] if known is not None else list(reference)  # type: ignore[arg-type]
    healthy, field, validation = placed(healthy, arm), placed(field, arm), placed(validation, arm)
    everything = [*healthy, *field, *validation]
    rates = [recording.rate_hz for recording in everything]
    rates += [recording.base.rate_hz for recording in everything if recording.base is not None]
    cutoff = min(CUTOFF_HZ, 0.2 * min(rates))
    base = known or identify(healthy or field, arm, Settings(cutoff_hz=cutoff)).model
    base = replace(base, cutoff_hz=cutoff)

    def motions(recordings: Sequence[Recording]) -> list[Motion]:
        if not recordings:
            return []
        wide = min(WIDER * cutoff, 0.35 * min(rates))
        return [coarse(m, cutoff) for m in prepare(recordings, arm.joint_names, wide, average=False)[0]]

    referred, examined, judged = motions(healthy), motions(field), motions(validation)
    whiteners = _whiteners(base, referred or examined)
    if known is not None:
        # A model pins itself down as a recording of the healthy arm on the same motion would.
        referred = [replace(motion, torque=known.torque(motion)) for motion in examined]
    scene = Scene(base, examined, whiteners)
    evidence = Evidence(base, scene, Scene(base, referred, whiteners) if referred else None)
    unseen = Unseen(evidence, Scene(base, judged, whiteners)) if judged else None
    return Prepared(base, evidence, unseen, _floor(whiteners), cutoff, known is not None)


def _whiteners(base: IdentifiedModel, motions: Sequence[Motion]) -> list[Whitener]:
    """The noise of every joint, from what is left of the reference itself."""
    joints = range(len(base.model.arm.joints))
    scale = [max(float(np.sqrt(np.mean([np.mean(m.torque_rows[:, j] ** 2) for m in motions]))), 1e-6) for j in joints]
    whiteners = [Whitener(np.zeros(0), 0.01 * size) for size in scale]
    for order in (ORDER, ORDER):
        scene = Scene(base, motions, whiteners)
        residual = Evidence(base, scene, None).residual
        if order and not whiteners[0].order:
            whiteners = [_coloured(scene, residual, j, 1e-6 * scale[j]) for j in joints]
        else:
            whiteners = [replace(w, loud=loudness(scene, residual, j)) for j, w in enumerate(whiteners)]
    return whiteners


def _coloured(scene: Scene, residual: FloatArray, joint: int, floor: float) -> Whitener:
    """One joint's autoregressive model from its unwhitened residual."""
    series = []
    for m, motion in enumerate(scene.motions):
        whole = np.zeros(len(motion.torque_rows))
        slot = scene.slot(joint, m)
        whole[scene.place[slot]] = residual[slot] * scene.whiteners[joint].sigma_Nm
        series.append(whole)
    return fit_whitener(series, [sound[:, joint] for sound in scene.sound], ORDER, floor)


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
