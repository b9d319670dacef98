"""What a fit of a body on the last link shows to be no payload: another gravity, a model of another arm, nothing.

A wrong gravity, a base that moves unseen and a model that already holds a payload leave torques of which some pass for
a body, of any mass and either sign. Gravity is asked first, by the likelihood of the same fit in others: the torque of
all links but the last is known, and no payload makes up for it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..conventions.change import gravities
from ..conventions.physical import SURE_BODY
from ..conventions.words import gravity_statement
from ..dynamics.arm import Arm
from ..errors import UnfitDataError, UserError
from ..identification.verdict import FAIR, IMPOSSIBLE
from ..signals.motion import Motion

NEGATIVE = IMPOSSIBLE
"""Standard errors by which a mass must be below zero to contradict the model; fewer its own errors explain, which are
not in those of the mass."""
SURE_GRAVITY = float(np.log(1000.0))
"""Gain in log-likelihood from which another gravity is a fact: odds of a thousand. Right gravity has the largest
likelihood; on the recordings beside the checkout any other loses hundreds."""
STRANGE = 10.0
"""Residual over that of the model's own recordings from which a recording is of an arm that the model does not know,
where it is a poor fit as well; ratio. Of another day, payload and friction fitted, it is 7 at most at the joints of the
arms recorded beside the checkout (Rokae, joint 5); with a base of 300 kg that moves unseen it is 60 to 700."""
WEIGHTLESS = 1.0
"""Mean specific force of a moving base under which nothing on it has weight, m/s^2: below the Moon's 1.6, and more than
the reaction of an arm averages."""


@dataclass(frozen=True)
class BodyFit:
    """A body on the last link, and friction that may have changed, fitted to what a model leaves of the torque.

    Attributes:
        values: (10 + 2 n,) m, m c and inertia about the centre, then Coulomb and viscous friction of each joint.
        covariance: (10 + 2 n, 10 + 2 n) of them.
        before_Nm, after_Nm: (n,) RMS of the rows in motion without and with it, N·m.
        torque_Nm: (n,) RMS of the torque recorded in these rows, N·m.
        own_Nm: (n,) RMS that the model leaves of its own recordings, N·m; NaN where that is not known.
        worth: (n,) independent rows; 0 of a joint that was left out.
    """

    values: FloatArray
    covariance: FloatArray
    before_Nm: FloatArray
    after_Nm: FloatArray
    torque_Nm: FloatArray
    own_Nm: FloatArray
    worth: FloatArray

    @property
    def mass(self) -> float:
        """kg; of either sign."""
        return float(self.values[0])

    @property
    def mass_error(self) -> float:
        """Its standard error, kg."""
        return float(np.sqrt(self.covariance[0, 0]))

    @property
    def share_left(self) -> FloatArray:
        """(n,) residual over torque, RMS; 0 of a joint that was left out."""
        share = self.after_Nm / np.maximum(self.torque_Nm, np.finfo(float).tiny)
        return np.asarray(np.where(self.worth > 0.0, share, 0.0))

    def gain(self, other: BodyFit) -> float:
        """Log-likelihood by which another fit to the same rows is better."""
        used = self.worth > 0.0
        before, after = (np.maximum(one.after_Nm[used], np.finfo(float).tiny) for one in (self, other))
        return float(self.worth[used] @ np.log(before / after))


def refuse_other_gravity(
    arm: Arm, motions: Sequence[Motion], fit: BodyFit, under: Callable[[FloatArray], BodyFit]
) -> None:
    """Refuse a gravity that is not that of the recordings.

    Args:
        arm: With the gravity assumed.
        motions: Of the fit. Where an accelerometer moves with each base, gravity is in none of them.
        fit: Under the gravity assumed.
        under: The fit under another gravity (3,), m/s^2.

    Raises:
        UserError: Another gravity explains the torque better beyond doubt; the message names it.
    """
    if not _assumes_gravity(motions):
        return
    others = gravities(arm)
    gains = [fit.gain(under(gravity)) for gravity in others]
    best = int(np.argmax(gains))
    if gains[best] > SURE_GRAVITY:
        wanted = " ".join(f"{value:.4g}" for value in others[best])
        nearly = ", or, between the axes, what it is there" if others[best].any() else ""
        raise UserError(f"{gravity_statement(arm, others[best])} -> --gravity {wanted}{nearly}")


def refuse_no_body(arm: Arm, motions: Sequence[Motion], fit: BodyFit) -> None:
    """Refuse a fit that is no payload.

    Args:
        arm: The arm.
        motions: Of the fit.
        fit: In the gravity of the recordings.

    Raises:
        UserError: The mass is negative beyond what errors explain: the model is wrong for these recordings.
        UnfitDataError: It is not above zero by `SURE_BODY` standard errors.
    """
    found = f"mass {fit.mass:.4f} ± {fit.mass_error:.4f} kg (standard error)"
    if fit.mass < -NEGATIVE * fit.mass_error:
        raise UserError(
            f"the model does not fit these recordings: {found}, which no body has; {_causes(arm, motions)}. Update the "
            "model by a recording without payload (spacearm identify --prior), and weigh with that one"
        )
    if fit.mass > SURE_BODY * fit.mass_error:
        return
    if left := _poor(arm, fit):
        raise UnfitDataError(f"no payload detected, and none excluded: {found}, but {left}; {_causes(arm, motions)}")
    how = "with larger angular accelerations" if _weightless(arm, motions) else "through larger angles against gravity"
    raise UnfitDataError(f"no payload detected: {found}; attach one, or move the last joints {how} for ten seconds")


def caveats(arm: Arm, motions: Sequence[Motion], fit: BodyFit) -> list[str]:
    """What a payload found rests on, and what speaks against it, a sentence each.

    Args:
        arm: The arm.
        motions: Of the fit.
        fit: With a mass that is one.
    """
    said = []
    if any(motion.base is not None for motion in motions):
        said.append(
            "a model identified with its base fixed has the CAD's values for what only a moving base reveals of the "
            "first links; a recording of the moving base without payload updates it (spacearm identify --prior)"
        )
    if any(motion.base is None for motion in motions) and not arm.gravity.any():
        said.append(
            "no gravity and no base motion recorded: the base is taken as fixed; on a free one mass and centre are "
            "wrong, record /base_imu"
        )
    if left := _poor(arm, fit):
        said.append(f"with this payload {left}; {_causes(arm, motions)}")
    return said


def _poor(arm: Arm, fit: BodyFit) -> str:
    """That torque is left which a payload does not explain, at the worst joint; empty where the fit is not poor."""
    share = np.where(fit.after_Nm > STRANGE * fit.own_Nm, fit.share_left, 0.0)
    worst = int(np.argmax(share))
    if not share[worst] > FAIR:
        return ""
    return f"the model leaves {share[worst]:.0%} of the torque of {arm.joint_names[worst]} (RMS)"


def _causes(arm: Arm, motions: Sequence[Motion]) -> str:
    """What a model that does not fit may lack, as far as the recordings leave it open."""
    causes = ["the model may be of another arm or day, or have a payload in it"]
    if any(motion.base is None for motion in motions):
        causes.append("the base may have moved without /base_imu in the recording")
    if _assumes_gravity(motions) and arm.gravity.any():
        stated = " ".join(f"{value:.3g}" for value in arm.gravity)
        causes.append(f"the base may be tilted, gravity not {stated} m/s^2 (--gravity)")
    return ", ".join(causes[:-1]) + f", or {causes[-1]}" if len(causes) > 1 else causes[0]


def _assumes_gravity(motions: Sequence[Motion]) -> bool:
    """Whether the arm's gravity enters: not where an accelerometer measures the specific force of the base."""
    return any(motion.base is None or motion.base.attitude is not None for motion in motions)


def _weightless(arm: Arm, motions: Sequence[Motion]) -> bool:
    """Whether nothing held has weight in any motion."""
    forces = (-arm.gravity if one.base is None else one.base.force(arm.gravity).mean(axis=0) for one in motions)
    return all(float(np.linalg.norm(force)) < WEIGHTLESS for force in forces)
