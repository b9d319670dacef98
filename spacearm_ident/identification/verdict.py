"""Whether an identified model may be used: good, fair, poor, suspect or unfit, and why, per joint and for the whole.

Two questions. How well does the model predict a recording (relative RMS while the joint moves)? And could an arm be
what the model says: friction that resists, bodies that exist, a prediction better than none? A small residual does not
answer the second: wrong signs, units or joint order may fit well with parameters that no arm has. Such a model is
suspect, however well it fits. A model of data that break a convention (`conventions/`) is unfit, whatever else it is:
how well it repeats data with a mistake says nothing for it.

The one place that judges: console, JSON, `validation.json`, report and index all say what `judge_result` returns.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from ..arrays import FloatArray
from ..conventions.finding import UNFIT_MODEL
from ..dynamics.friction_curve import SLOWEST, friction_curve, friction_error, viscosity
from ..estimate.identified import Determination, Estimate, Identified, JointValidation, Trace, Validation
from ..signals.motion import moves_by_position

GOOD, FAIR = 0.10, 0.25
"""Residual RMS over torque RMS of a moving joint up to which its fit is good, or fair; ratio. Ours: a tenth is what
models of recorded arms reach where the torque is well above the noise; one that misses a quarter of the torque predicts
little more than its largest part."""
NO_BETTER_THAN_NOTHING = 1.0
"""The same ratio from which predicting no torque at all would have been as good."""
BEYOND = 3.0
"""Standard errors by which a value must lie beyond what is possible. Three, not two: a joint is asked at hundreds of
speeds, an arm has many joints, and the errors hold for a model that is right."""
DRIVING_SHARE = 0.02
"""Least torque with which friction must drive, as a share of the joint's torque RMS; ratio. Ours: less is within the
error of the best models there are of recorded arms."""
HELD, IMPOSSIBLE = 3.0, 10.0
"""Standard errors by which physical consistency may move a base parameter: beyond the first it is said, beyond the
second the model is suspect. Ours: standard errors are too small where the model leaves something out, commonly by a
factor of three, so that three of them are no contradiction yet and ten are."""
SPEEDS = 50
"""Speeds, evenly apart up to the joint's largest, at which viscosity is asked: it is a parabola of the speed."""
LACKING_P = 0.01
"""Probability under which the F test of the lack of fit is believed."""


class Level(StrEnum):
    """What a verdict says; in the order of `SEVERITY`."""

    GOOD = "good"
    FAIR = "fair"
    POOR = "poor"
    SUSPECT = "suspect"
    UNFIT = "unfit"
    """Of the whole alone: the data are, by the test of their conventions."""
    UNKNOWN = "unknown"


SEVERITY = (Level.UNKNOWN, Level.GOOD, Level.FAIR, Level.POOR, Level.SUSPECT)
"""From least to most: the whole is as bad as its worst joint, and unknown only where all of them are."""


@dataclass(frozen=True)
class JointVerdict:
    """One joint's verdict.

    Attributes:
        level: What it comes to; `unknown` where the validation data hold no motion or no torque of it.
        reasons: Short sentences; none where there is nothing to say but the figure.
    """

    level: Level
    reasons: tuple[str, ...] = ()


@dataclass(frozen=True)
class Verdict:
    """The verdict on a result.

    Attributes:
        level: Of the whole arm: that of its worst joint, or `unfit` where the data are.
        headline: One line, level first.
        reasons: Why, in short sentences that name their joints; empty where a good fit is all there is.
        joints: Joint name -> its own.
    """

    level: Level
    headline: str
    reasons: tuple[str, ...]
    joints: Mapping[str, JointVerdict]

    @property
    def usable(self) -> bool:
        """Whether nothing speaks against using the model."""
        return self.level not in (Level.POOR, Level.SUSPECT, Level.UNFIT)

    @property
    def lines(self) -> tuple[str, ...]:
        """For a terminal: the headline, then a line a reason."""
        return (f"{self.headline}.", *(f"  {reason}." for reason in self.reasons))


def judge_result(identified: Identified, validation: Validation, unfit: Sequence[str] = ()) -> Verdict:
    """Judge a result.

    Args:
        identified: The identification.
        validation: How it predicts; at its speeds friction is asked whether it resists.
        unfit: Why the data are unfit, `ConventionReport.unfit`; empty: they are fit, or were not tested. The joints
            are judged by their fit all the same.
    """
    joints = {name: _joint(name, identified, validation) for name in identified.model.model.arm.joint_names}
    for name, impossible in _impossible(identified, validation).items():
        if impossible:
            joints[name] = JointVerdict(Level.SUSPECT, (*joints[name].reasons, *impossible))
    if unfit:
        return Verdict(Level.UNFIT, unfit[0], (*unfit[1:], UNFIT_MODEL), joints)
    contradiction = _contradiction(identified)
    level = max((joint.level for joint in joints.values()), key=SEVERITY.index, default=Level.UNKNOWN)
    level = Level.SUSPECT if identified.consistency_shift > IMPOSSIBLE else level
    told = tuple(f"{name}: {reason}" for name, joint in joints.items() for reason in joint.reasons)
    reasons = (contradiction, *told) if contradiction else told
    return Verdict(level, _headline(level, identified, validation), reasons, joints)


def relative_rms(validation: Validation) -> dict[str, float]:
    """Joint -> residual RMS over torque RMS while it moves, of those that have one."""
    shares = {name: joint.moving.relative_rms for name, joint in validation.joints.items()}
    return {name: share for name, share in shares.items() if math.isfinite(share)}


def _headline(level: Level, identified: Identified, validation: Validation) -> str:
    known = relative_rms(validation)
    if not known and level is not Level.SUSPECT:
        return "No joint could be validated: no torque, or no motion, in the validation data"
    words = f"{level.capitalize()} model" if level is Level.SUSPECT else f"{level.capitalize()} fit"
    if not known:
        return f"{words}; no joint could be validated"
    worst = max(known, key=known.__getitem__)
    every = "Every joint's torque is" if len(known) == len(identified.model.model.arm.joints) else "Torque is"
    said = f"{words}. {every} predicted to within {_percent(known[worst])} (RMS) while it moves, worst at {worst}"
    return said if validation.held_out else f"{said}; on the data of the fit itself: other motion it may predict worse"


def _joint(name: str, identified: Identified, validation: Validation) -> JointVerdict:
    """The verdict by how well the joint is predicted.

    Whether it moves is asked of its positions: where its speed is lost in their noise, it counts as moving nowhere, or
    in few rows that say nothing of the others.
    """
    at_rest = _at_rest(name, identified)
    joint = validation.joints.get(name)
    if joint is None:
        return JointVerdict(Level.UNKNOWN, at_rest or (_why_unknown(joint),))
    number = identified.model.model.arm.joint_names.index(name)
    moves = moves_by_position(validation.traces, number)
    share = joint.moving.relative_rms
    if moves and joint.everything.relative_rms > NO_BETTER_THAN_NOTHING:
        share = joint.everything.relative_rms
    if not math.isfinite(share):
        unresolved = name in identified.joints_unresolved or (moves and joint.moving.rows == 0)
        return JointVerdict(Level.POOR if unresolved else Level.UNKNOWN, at_rest or (_why_unknown(joint, moves),))
    if share > NO_BETTER_THAN_NOTHING:
        words = f"the residual is {_percent(share)} of the torque: predicting zero torque would be more accurate"
        return JointVerdict(Level.SUSPECT, (*at_rest, words))
    if share > FAIR:
        return JointVerdict(Level.POOR, (*at_rest, f"the residual is {_percent(share)} of the torque"))
    return JointVerdict(Level.GOOD if share <= GOOD else Level.FAIR, at_rest)


def _at_rest(name: str, identified: Identified) -> tuple[str, ...]:
    """What is said of a joint that was not seen to move in the data of the fit; nothing of others."""
    if name not in identified.joints_at_rest:
        return ()
    moves = "it moves in the data of the fit, but its speed nowhere stands out of the noise"
    what = moves if name in identified.joints_unresolved else "it does not move in the data of the fit"
    return (f"{what}: its friction cannot be identified, its inertia only in part",)


def _why_unknown(joint: JointValidation | None, moves: bool = False) -> str:
    if joint is None:
        return "it is not in the validation data"
    if joint.moving.rows == 0 and moves:
        return "it moves in the validation data, but its speed nowhere stands out of the noise: nothing validates it"
    if joint.moving.rows == 0:
        return "it does not move in the validation data"
    return "its torque is zero throughout the validation data"


def _impossible(identified: Identified, validation: Validation) -> dict[str, list[str]]:
    """Joint -> what no joint could have, at the speeds of the validation data."""
    traces = [trace for trace in validation.traces if len(trace.time)]
    found: dict[str, list[str]] = {}
    for joint, name in enumerate(identified.model.model.arm.joint_names):
        moving = np.concatenate([trace.velocity[trace.moving[:, joint], joint] for trace in traces] or [np.empty(0)])
        if len(moving):
            words = (_negative_viscosity(joint, identified, moving), _driving(joint, identified, moving, traces))
            found[name] = [reason for reason in words if reason]
    return found


def _negative_viscosity(joint: int, identified: Identified, moving: FloatArray) -> str:
    """Viscous friction below zero at a speed up to the joint's largest; empty where there is none.

    At every one: a negative k_v1 that k_v2 or k_v3 outweigh at the largest speed is no viscosity either.
    """
    top = float(np.abs(moving).max())
    # At the first, next to standstill, it is k_v1 alone.
    speeds = np.linspace(SLOWEST, 1.0, SPEEDS) * top
    known = viscosity(identified.model, joint, speeds, identified.covariance)
    if known is None:
        return ""
    slopes, errors = known
    beyond = np.flatnonzero(slopes + BEYOND * errors < 0.0)
    if not len(beyond):
        return ""
    units = identified.model.model.arm.joints[joint].units
    throughout = beyond[-1] == SPEEDS - 1
    at = int(beyond[-1] if throughout else np.argmin(slopes + BEYOND * errors))
    value = f"viscous friction is negative: {slopes[at]:.3g} ± {errors[at]:.2g} {units.effort} s/{units.position}"
    if throughout:
        return f"{value} up to its largest speed"
    return (
        f"{value} at {speeds[at] if at else 0.0:.2g} {units.velocity}, outweighed at {top:.2g}: k_v1 to k_v3 may "
        "stand for Stribeck friction that is not in the model; compare --friction paper"
    )


def _driving(joint: int, identified: Identified, moving: FloatArray, traces: Sequence[Trace]) -> str:
    """Sentence on the velocity in the data at which friction drives the joint most; empty where it always resists."""
    where = np.mean(np.concatenate([trace.position for trace in traces]), axis=0)
    top = float(np.abs(moving).max())
    velocity, torque = friction_curve(identified.model, joint, top, where)
    error = friction_error(identified.model, joint, top, where, identified.covariance)
    size = float(np.sqrt(np.mean(np.concatenate([trace.measured[:, joint] for trace in traces]) ** 2)))
    excess = -torque * np.sign(velocity) - np.maximum(BEYOND * error, DRIVING_SHARE * size)
    excess[(velocity < moving.min()) | (velocity > moving.max())] = -np.inf
    worst, units = int(np.argmax(excess)), identified.model.model.arm.joints[joint].units
    if not excess[worst] > 0.0:
        return ""
    return (
        f"friction drives the joint instead of resisting: {abs(torque[worst]):.3g} ± {error[worst]:.2g} {units.effort} "
        f"along the motion at {velocity[worst]:.3g} {units.velocity}"
    )


def _contradiction(identified: Identified) -> str:
    """What the data say of the bodies against what bodies can be; empty where they agree."""
    shift = identified.consistency_shift
    if not shift > HELD:
        return ""
    words = f"The bound of physical consistency moved a base parameter by {shift:.2g} of its standard errors: "
    if shift <= IMPOSSIBLE:
        return words + "masses and inertias lie at the bound, and their standard errors are too small"
    held = [f"J_m of {item.joint}" for item in identified.estimates if _at_zero(item)]
    if held:
        words += f"only the bound keeps masses and inertias possible ({', '.join(held)} at zero); "
    else:
        words += "only the bound keeps masses and inertias possible; "
    return words + "check the signs and constants of the torques, the gravity vector and the kinematics"


def _at_zero(item: Estimate) -> bool:
    return item.symbol == "J_m" and item.determination is Determination.BOUND


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if share >= 0.1 else f"{100 * share:.2g} %"
