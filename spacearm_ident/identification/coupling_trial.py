"""Whether a motor that turns with the last two joints would explain a wrist that fits badly.

Six-joint arms of several makers drive the last joint through the one before it: the last motor turns with q_5 + q_6, or
q_5 - q_6 (`dynamics/coupling.py`). Without that coupling both joints fit badly, and nothing in the figures says why. So
where they do, the model with Coulomb and viscous friction alone is fitted with neither and with either coupling, a few
tenths of a second each, and compared on the held-out data.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from ..dynamics.arm import Arm, Coupling
from ..dynamics.model import structure_of
from ..errors import UserError
from ..estimate.identified import JointValidation, Validation
from ..recording.recording import Recording
from .identify import Settings, identify
from .validation import validate
from .verdict import GOOD

PLAIN_LAW = "coulomb-viscous"
SIGNS = (1.0, -1.0)
"""Ratios of the last joint tried, that of the one before it being 1; motor turns a joint turn on the output side."""
BETTER = 0.7
"""Mean ratio of the two joints' held-out residuals, with over without, under which a coupling counts as the remedy.
Ours: the recording of a TX40 has 0.22 with the right sign and 0.43 with the wrong one (2026-11-24); a term that is not
there leaves it near 1."""
WORSE = 1.05
"""The same ratio that neither joint may exceed."""


@dataclass(frozen=True)
class CouplingTrial:
    """What a coupling of the last two joints brought on held-out data.

    Attributes:
        joints: The two joints.
        sign: Ratio of the last one in the better trial.
        before, after: Residual RMS over torque RMS of either while it moves, without and with the coupling; ratio.
        helps: Whether it is the remedy.
    """

    joints: tuple[str, str]
    sign: float
    before: tuple[float, float]
    after: tuple[float, float]
    helps: bool

    @property
    def line(self) -> str:
        """The line for an arm YAML."""
        first, last = self.joints
        return f"couplings: [{{name: motor_of_{last}, ratios: {{{first}: 1.0, {last}: {self.sign:.1f}}}}}]"

    @property
    def words(self) -> str:
        """What was tried and what it brought, for a person."""
        first, last = self.joints
        change = (
            f"residual of {first} {self.before[0]:.0%} -> {self.after[0]:.0%}, of {last} {self.before[1]:.0%} -> "
            f"{self.after[1]:.0%} of the torque (held-out data, moving, plain friction law)"
        )
        if self.helps:
            remedy = f"add to the arm YAML: {self.line}"
            return f"tried: a coupling of the last motor with {first} and {last}: {change}; {remedy}"
        return f"tried, no improvement: a coupling of the last motor with {first} and {last}: {change}"

    def as_dict(self) -> dict[str, object]:
        """For programs."""
        return {
            "joints": list(self.joints),
            "relative_rms_before": list(self.before),
            "relative_rms_after": list(self.after),
            "helps": self.helps,
            "yaml": self.line if self.helps else None,
        }


def try_coupling(
    fitted: Sequence[Recording], held_out: Sequence[Recording], arm: Arm, validation: Validation, settings: Settings
) -> CouplingTrial | None:
    """Try couplings of the last two joints where one of them fits badly.

    Args:
        fitted: Recordings of the fit.
        held_out: Recordings that the fit does not use.
        arm: The arm; one that has couplings, or whose last two joints do not both turn, is left as it is.
        validation: How the model without the coupling predicts.
        settings: Cut-off and gravity of the fit.

    Returns:
        The better trial; None where there is nothing to try.
    """
    if len(arm.joints) < 3 or arm.couplings or not all(joint.revolute for joint in arm.joints[-2:]):
        return None
    first, last = arm.joint_names[-2:]
    shares = [validation.joints[name].moving.relative_rms for name in (first, last) if name in validation.joints]
    if not any(share > GOOD for share in shares):
        return None

    def judged(with_arm: Arm) -> tuple[JointValidation, JointValidation]:
        plain = Settings(settings.cutoff_hz, structure_of(with_arm, PLAIN_LAW), gravity=settings.gravity)
        figures = validate(identify(fitted, with_arm, plain).model, held_out, "held out", held_out=True).joints
        return figures[first], figures[last]

    try:
        without = judged(arm)
        trials = {
            sign: judged(replace(arm, couplings=(Coupling(f"motor_of_{last}", {first: 1.0, last: sign}),)))
            for sign in SIGNS
        }
    except UserError:  # what cannot be fitted plainly has other troubles, and they were said
        return None
    ratios = {sign: [new.moving.rmse / old.moving.rmse for new, old in zip(t, without)] for sign, t in trials.items()}
    sign = min(ratios, key=lambda key: sum(ratios[key]))
    before, after = (tuple(joint.moving.relative_rms for joint in found) for found in (without, trials[sign]))
    helps = sum(ratios[sign]) / 2 < BETTER and max(ratios[sign]) < WORSE
    return CouplingTrial((first, last), sign, (before[0], before[1]), (after[0], after[1]), helps)
