"""`Comparison`: what comparing a simulation with an arm found. Plain results, no computation."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray
from ..dynamics.model import IdentifiedModel
from ..mismatch.finding import Detectable, Explanation
from .conventions import Suspicion
from .item import CONVENTIONS, PARAMETERS, PHYSICS, Layer, Mended
from .wiring import Wiring


@dataclass(frozen=True)
class Trace:
    """Torque of one held-out motion, for figures: rows of the bandwidth looked at, N m, NaN where no row counts.

    Attributes:
        time: (M,) s.
        measured, simulated, mended: (M, n).
    """

    time: FloatArray
    measured: FloatArray
    simulated: FloatArray
    mended: FloatArray


COUNTED = {CONVENTIONS: "convention", PARAMETERS: "parameter", PHYSICS: "physical effect"}
"""Layer -> what one of its items is."""


WORTH_SAYING = 0.01
"""Share of a joint's torque: so much less of a residual is said of a joint."""


@dataclass(frozen=True)
class Comparison:
    """The whole answer.

    Attributes:
        joints: Names.
        layers: The four, in order.
        before_Nm, after_Nm: (n,) residual RMS on held-out recordings of the simulation as it is, and with all layers.
        torque_Nm: (n,) RMS of the measured torque there.
        noise_Nm: (n,) noise floor: what is left that nothing tried explains, at most.
        ceiling_Nm: (n,) what a flexible function of the same inputs leaves beside the simulation's own terms, refitted.
        mended_Nm: (n,) the same of the corrected file as it is read again (`of_file`); until there is one, of `model`.
        model: The mended simulation with the physics it lacked.
        wiring: What recordings are off by, beside `model`.
        suspected: What else may be off.
        explanation: The search for physics, with its cards.
        traces: For figures.
        unconfirmed: Names of what was found and the held-out recordings by themselves do not show; not among items.
        would_have_seen: Of what was looked at and not named, the smallest size that would have been.
        judged_on: In words, what the residuals are on.
        cutoff_hz: Bandwidth that was looked at.
        reasons: Why the data are unfit; empty where they are not.
    """

    joints: tuple[str, ...]
    layers: tuple[Layer, ...]
    before_Nm: FloatArray
    after_Nm: FloatArray
    torque_Nm: FloatArray
    noise_Nm: FloatArray
    ceiling_Nm: FloatArray
    mended_Nm: FloatArray
    model: IdentifiedModel | None
    wiring: Wiring
    suspected: tuple[Suspicion, ...]
    explanation: Explanation | None
    traces: tuple[Trace, ...] = ()
    unconfirmed: tuple[str, ...] = ()
    would_have_seen: tuple[Detectable, ...] = ()
    judged_on: str = ""
    cutoff_hz: float = float("nan")
    reasons: tuple[str, ...] = ()

    @property
    def fit(self) -> bool:
        """Whether the data can carry the question."""
        return not self.reasons

    @property
    def headline(self) -> str:
        """The answer in one line."""
        if not self.fit:
            return f"data unfit: {'; '.join(self.reasons)}"
        counted = [
            f"{len(layer.items)} {COUNTED[layer.name]}{'s' if len(layer.items) > 1 else ''}"
            for layer in self.layers[:3]
            if layer.items
        ]
        what = ", ".join(counted) or "no significant difference"
        return f"simulation compared with the arm: {what}; residual {self.residual_words}"

    @property
    def residual_words(self) -> str:
        """Residual over torque, without and with all layers: of the median joint, and of the one most of which goes."""
        with np.errstate(invalid="ignore", divide="ignore"):
            before, after = self.before_Nm / self.torque_Nm, self.after_Nm / self.torque_Nm
        words = f"{np.nanmedian(before):.1%} -> {np.nanmedian(after):.1%} of the torque (median joint)"
        gone = np.where(np.isfinite(before - after), before - after, -np.inf)
        most = int(np.argmax(gone))
        if len(self.joints) == 1 or gone[most] < WORTH_SAYING:
            return words
        return f"{words}, {before[most]:.1%} -> {after[most]:.1%} at {self.joints[most]}"

    @property
    def file_is_better(self) -> bool:
        """Whether the corrected file leaves less than the simulation did: mean over the joints of the log ratio."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return bool(np.nanmean(np.log(self.mended_Nm / self.before_Nm)) < 0.0)

    def of_file(self, mended: Mended | None) -> Comparison:
        """With what a corrected file leaves in place of what the model does, where the file cannot hold all of it."""
        if mended is None or mended.excess is None:
            return self
        return replace(self, mended_Nm=self.mended_Nm * mended.excess)
