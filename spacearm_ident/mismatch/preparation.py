"""From recordings to evidence: base model, noise, whitened scenes.

The base has the paper's whole friction law, whose every column competes with the effects, and its noise is an
autoregressive process (`noise.coloured`). That is right where the base is: its residual is then noise, correlated no
longer than the low-pass makes it, and as small in held-out parts of the reference as in fitted ones. Where it is not,
or clearly predicts held-out parts worse, the residual is what the model lacks: then the structure is the one that
`identify` chooses, by prediction of held-out parts, and rows are weighted, not whitened (`noise.weighted`).

Two cut-offs: positions go through one up to several times as wide as torque and columns do. Friction follows the sign
of the velocity there was, and a velocity low-passed as hard as the torque reverses at another moment. Where encoders
are coarse the sign would be lost in their noise, so it is no wider than they allow (`reversal_cutoff_hz`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..arrays import FloatArray
from ..dynamics.arm import Arm
from ..dynamics.base_link import placed
from ..dynamics.friction import ViscousFriction
from ..dynamics.model import IdentifiedModel, Structure, TorqueModel
from ..estimate.identified import Choice
from ..estimate.optional_terms import OptionalTerm
from ..identification.fit import Fit
from ..identification.identify import Settings, identify
from ..identification.structure import choose_structure
from ..noise.between import day_share
from ..recording.recording import Recording
from ..regression.held_out import LEVEL, bound, t_of_all
from ..signals.motion import Motion
from ..signals.prepare import prepare, reversal_cutoff_hz
from .base_structure import GATE, choose_base
from .candidate import Candidate
from .evidence import Evidence
from .held_out import HeldOut
from .left_out import LeftOfOwn, LeftOut
from .noise import Noise, NoiseModel, coloured, in_field, of_field, weighted
from .residuals import Residuals
from .run_set import RunSet
from .scene import Scene, Whitener, coarse

CUTOFF_HZ = 20.0
WIDER = 4.0
"""Positions are filtered at most this many times as wide."""
MODEL_ERROR = 2.6
"""Variance inflation (`_WithNoise.inflation`) from which the residual is taken as model error, not noise. 1.1 to 2.1 on
eight simulated arms; 3.3 to 80 on eighteen of the nineteen fits to real arms of bench/real_arms.py, 1.3 on the other
(tx40, two thirds of 20 s), which whitening predicts as well."""
COST = 0.25
"""Mean logarithm of the ratio of held-out variances from which the first base and whitening are given up below
`MODEL_ERROR` too, if the difference is clear by t as well: friction that the paper's law lacks at low speeds alone
leaves a residual as short as noise (inflation 1.1), and a smaller structure predicts better. Of six simulated arms it
was 0.06 and 0.13 at the two where t is clear, and -0.02 to 0.33 at the others."""
QUIETER = 0.8
"""Ratio of a joint's noise beside the effects that were found to what it was taken for before, below which the search
goes on with the smaller: chi-square of anything else there is half as much again."""

ChooseStructure = Callable[[Fit], tuple[Structure, tuple[Choice, ...]]]
"""Chooses a structure from a fit of the paper's, as `Settings.choose`."""


@dataclass(frozen=True)
class Prepared:
    """What the competition is about.

    Attributes:
        base: Model of the healthy arm (or of the field, where there is no reference).
        evidence: What it leaves over in the field.
        held_out: Recordings that no fit sees; None where there are none.
        plain: What a row counts for by itself, not whitened, joint by joint.
        noise_floor_Nm: (n,) standard deviation of a reduced torque row that a right model would leave.
        cutoff_hz: Bandwidth that was looked at.
        modelled: Whether the reference's torque is a model's, without noise, not a recording's.
        own: Where it is, what the model leaves of its own recordings; None where its file does not say.
        weighted: Whether the residual is what the base lacks, not noise (`noise.weighted`).
        days: Standard deviation of the field's friction from the reference's, of that from recording to recording.
    """

    base: IdentifiedModel
    evidence: Evidence
    held_out: HeldOut | None
    plain: Sequence[Whitener]
    noise_floor_Nm: FloatArray
    cutoff_hz: float
    modelled: bool = False
    own: LeftOfOwn | None = None
    weighted: bool = False
    days: float = 0.0

    def beside(self, effects: Sequence[Candidate]) -> Prepared | None:
        """The same with the noise that is left beside effects, where the field's own residual is what says it.

        None where that is no smaller at any joint (`QUIETER`). Near a reversal it may be as large as before: rows there
        then count for less.
        """
        field = self.evidence.field
        weights, floor = in_field(self.base, field, self.evidence.residual_beside(effects))
        with np.errstate(invalid="ignore"):
            ratio = np.fmin(floor / self.noise_floor_Nm, 1.0)
        if not np.nanmin(ratio) < QUIETER:
            return None
        whiteners = [replace(own, sigma_Nm=float(own.sigma_Nm * r)) for own, r in zip(weights, ratio)]
        plain = [replace(own, inflation=other.inflation) for own, other in zip(self.plain, weights)]
        evidence = Evidence(self.base, Scene(self.base, field.motions, whiteners, field.backgrounds), None)
        held_out = None
        if self.held_out is not None:
            held = self.held_out.scene
            held_out = HeldOut(evidence, Scene(self.base, held.motions, whiteners, held.backgrounds))
        floor = self.noise_floor_Nm * ratio
        return replace(self, evidence=evidence, held_out=held_out, plain=plain, noise_floor_Nm=floor)


def prepare_evidence(
    arm: Arm,
    runs: RunSet,
    choose: ChooseStructure = choose_base,
) -> Prepared:
    """Base model, noise and whitened rows.

    Args:
        arm: What is known before.
        runs: What is compared with what; without recordings to judge on nothing is held out.
        choose: Chooses the structure of the base from a fit of the paper's.

    Raises:
        UnfitDataError: A recording cannot carry the question.
        UserError: A recording lacks a joint.
    """
    runs = runs.each(lambda part: placed(part, arm))
    known, healthy, field = runs.known, runs.healthy, runs.field
    cutoff = cut_off_hz(runs.every)
    wide = position_cut_off_hz(runs.every, arm.joint_names, cutoff)
    referred, examined = (banded(part, arm.joint_names, cutoff, wide) for part in (healthy, field))
    judged = banded(runs.validation, arm.joint_names, cutoff, wide, first=len(field))
    if known is None:
        # A coupled motor of the healthy arm is base; where the field alone says what the arm is, it is a finding.
        start = _identified(healthy or field, arm, cutoff, choose, couple=bool(healthy))
        found = _with_noise(start, referred or examined, coloured if healthy else of_field)
        if healthy:
            found = _suited(found, _identified(healthy, arm, cutoff, choose_structure, couple=True), referred)
    else:
        found = _known(_possible(known, cutoff), examined)
    base, noise = found.start.base, found.noise
    if known is not None:
        # A model pins itself down as a recording of the healthy arm on the same motion would.
        referred = [replace(motion, torque=base.torque(motion)) for motion in examined]

    def gathered(base: IdentifiedModel) -> Evidence:
        scene = Scene(base, examined, noise.whiteners)
        other = Scene(base, referred, noise.whiteners) if referred else None
        return Evidence(base, scene, other)

    evidence = gathered(base)
    if healthy and _form_is_open(found.start.choices):
        # An arm in vacuum, that lacks the term, may tell.
        other = _resisting(base)
        in_other_form = gathered(other)
        if in_other_form.in_vacuum[1] < evidence.in_vacuum[1] - GATE:
            base, evidence = other, in_other_form
    held_out = HeldOut(evidence, Scene(base, judged, noise.whiteners)) if judged else None
    days = _days(known.own.recordings if known is not None and known.own is not None else len(healthy), evidence)
    floor = noise.floor_Nm
    modelled = known is not None
    return Prepared(base, evidence, held_out, noise.plain, floor, cutoff, modelled, found.own, found.weighted, days)


@dataclass(frozen=True)
class _Start:
    """A base model, and what was decided about its structure."""

    base: IdentifiedModel
    choices: tuple[Choice, ...]


@dataclass(frozen=True)
class _WithNoise:
    """A base with a model of its noise, fitted to motions; of a model that is known, what it leaves of its own."""

    start: _Start
    noise: Noise
    motions: Sequence[Motion]
    weighted: bool = False
    own: LeftOfOwn | None = None

    @property
    def inflation(self) -> float:
        """How many times the variance of a predicted row exceeds what white noise of the same RMS would give it.

        The residual's autocorrelation time over the low-pass's own, times the mean square of held-out parts over that
        of fitted ones; the median joint's. One where the base is right and well determined.
        """
        return self.inflation_of(self.left_out.rms_Nm)

    def inflation_of(self, left_out_Nm: FloatArray) -> float:
        """The same where this RMS (n,) is left of held-out parts."""
        optimism = np.divide(left_out_Nm, self.noise.floor_Nm) ** 2
        return float(np.nanmedian(self.noise.correlation * optimism))

    @cached_property
    def left_out(self) -> LeftOut:
        """How well both predict parts of the motions that a fit left out."""
        alone = Evidence(self.start.base, Scene(self.start.base, self.motions, self.noise.whiteners), None)
        return LeftOut(alone, Residuals(alone, alone.field, self.noise.plain))


def _identified(
    recordings: Sequence[Recording],
    arm: Arm,
    cutoff_hz: float,
    choose: ChooseStructure,
    couple: bool,
) -> _Start:
    settings = Settings(cutoff_hz=cutoff_hz, choose=choose, blend=False, couple=couple)
    identified = identify(recordings, arm, settings)
    return _Start(_possible(identified.model, cutoff_hz), identified.choices)


def _possible(model: IdentifiedModel, cutoff_hz: float) -> IdentifiedModel:
    """The model as an arm that could be: what least squares puts into impossible parameters is not base."""
    return replace(model.possible, cutoff_hz=cutoff_hz)


def _with_noise(start: _Start, motions: Sequence[Motion], model: NoiseModel) -> _WithNoise:
    return _WithNoise(start, model(start.base, motions), motions)


def _known(model: IdentifiedModel, motions: Sequence[Motion]) -> _WithNoise:
    """A model that is the reference, and the field's noise; weights where its own recordings have shown model error."""
    start = _Start(model, ())
    as_noise = _with_noise(start, motions, coloured)
    if model.own is None:
        return as_noise
    as_error = _with_noise(start, motions, weighted)
    own = LeftOfOwn(model.own, as_error.noise.floor_Nm)
    if as_error.inflation_of(own.rms_Nm) < MODEL_ERROR:
        return replace(as_noise, own=LeftOfOwn(model.own, as_noise.noise.floor_Nm))
    return replace(as_error, noise=_at_least(as_error.noise, own.rms_Nm), weighted=True, own=own)


def _suited(found: _WithNoise, by_prediction: _Start, motions: Sequence[Motion]) -> _WithNoise:
    """Base and noise: the first where its residual is noise; else the structure that predicts best, and weights."""
    as_error = _with_noise(found.start, motions, weighted)
    if not as_error.left_out.known:
        return found
    other = _with_noise(by_prediction, motions, weighted)
    if as_error.inflation < MODEL_ERROR and not _predicts_better(other.left_out, found.left_out):
        return found
    # The noise is as large as what is left of parts that a fit left out, where that is more.
    return replace(other, weighted=True, noise=_at_least(other.noise, other.left_out.rms_Nm))


def _predicts_better(other: LeftOut, first: LeftOut) -> bool:
    """Whether held-out parts of the reference are predicted better by other than the first base, beyond chance."""
    with np.errstate(divide="ignore", invalid="ignore"):
        cost = np.nanmean(2.0 * np.log(first.rms_Nm / other.rms_Nm))
    return bool(t_of_all(first.squares, other.squares) > bound(LEVEL, len(first.squares)) and cost > COST)


def _at_least(noise: Noise, rms_Nm: FloatArray) -> Noise:
    """The noise, made as large as this (n,), where it is less; NaN says nothing."""
    ratio = np.fmax(np.divide(rms_Nm, noise.floor_Nm), 1.0)
    whiteners = [replace(own, sigma_Nm=own.sigma_Nm * float(r)) for own, r in zip(noise.whiteners, ratio)]
    return replace(noise, whiteners=whiteners, floor_Nm=noise.floor_Nm * ratio)


def cut_off_hz(recordings: Sequence[Recording]) -> float:
    """Cut-off of torque and columns that all recordings' rates allow."""
    return min(CUTOFF_HZ, 0.2 * _slowest_hz(recordings))


def position_cut_off_hz(recordings: Sequence[Recording], joints: Sequence[str], cutoff_hz: float) -> float:
    """Cut-off of positions beside one of torque and columns (`reversal_cutoff_hz`).

    Args:
        recordings: All that are worked with.
        joints: Their order.
        cutoff_hz: Of torque and columns.

    Raises:
        UnfitDataError: There are too few samples, or they do not last.
    """
    widest = min(WIDER * cutoff_hz, 0.35 * _slowest_hz(recordings))
    return reversal_cutoff_hz(recordings, joints, cutoff_hz, widest)


def _slowest_hz(recordings: Sequence[Recording]) -> float:
    """Lowest sampling rate, of a base's motion too."""
    bases = [recording.base.rate_hz for recording in recordings if recording.base is not None]
    return min([recording.rate_hz for recording in recordings] + bases)


def banded(
    recordings: Sequence[Recording], joints: Sequence[str], cutoff_hz: float, wide_hz: float, first: int = 0
) -> list[Motion]:
    """Recordings as motions: torque and columns are to go through one low-pass, positions before it up to `wide_hz`.

    Accelerations go through no other. Their noise would be less; but so would the jolt that a neighbour's reversal
    gives a joint, which the torque shows in full: by a tenth, or eleven standard deviations.

    Args:
        recordings: To convert.
        joints: Their order.
        cutoff_hz: Of torque and columns.
        wide_hz: Of positions.
        first: Number of the first of them among all that are worked with: an event belongs to one (`Effect.event`).

    Raises:
        UnfitDataError: There are too few samples, or they do not last.
    """
    motions = prepare(recordings, joints, wide_hz, average=False)[0] if recordings else []
    return [replace(coarse(motion, cutoff_hz), source=first + motion.source) for motion in motions]


def _days(healthy: int, evidence: Evidence) -> float:
    """Standard deviation of the field's friction from the reference's, of the ordinary one between recordings.

    It differs as the joints are warmer or colder: where their temperatures were recorded, what that does is not
    ordinary but an effect to be found. None without a recorded reference either.
    """
    known = evidence.reference is not None and evidence.reference.temperatures_known
    if not healthy or (known and evidence.field.temperatures_known):
        return 0.0
    return float(np.sqrt(day_share(healthy)))


def _form_is_open(choices: Sequence[Choice]) -> bool:
    """Whether the healthy arm's friction may as well be odd in its quadratic term as even."""
    return any(
        choice.kind is OptionalTerm.ODD and not choice.joint and not choice.accepted and choice.gain > -GATE
        for choice in choices
    )


def _resisting(base: IdentifiedModel) -> IdentifiedModel:
    """The base with quadratic friction that resists in both directions, unknown yet."""
    structure = {**base.model.structure, ViscousFriction.kind: {"quadratic": "odd"}}
    quadratic = np.array([parameter.symbol == "k_v2" for parameter in base.model.parameters])
    parameters = np.where(quadratic, 0.0, base.parameters)
    return replace(base, model=TorqueModel(base.model.arm, structure), parameters=parameters)
