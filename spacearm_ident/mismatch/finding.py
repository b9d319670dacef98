"""What an analysis of a mismatch found. Plain results, no computation."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..arrays import FloatArray
from ..dynamics.model import IdentifiedModel

MISMATCH, NO_MISMATCH, DATA_UNFIT = "mismatch", "no_mismatch", "data_unfit"


@dataclass(frozen=True)
class Quantity:
    """A value with its 95 % interval, which is infinite where the data do not determine the value."""

    value: float
    unit: str
    low: float
    high: float

    @property
    def known(self) -> bool:
        """Whether the data determine it at all."""
        return not (self.low == -math.inf and self.high == math.inf)


@dataclass(frozen=True)
class Alternative:
    """Another explanation, and why it is not the first.

    Attributes:
        effect: Its name.
        joints: Where.
        score: Its score as a share of the finding's.
        why_not: In words.
    """

    effect: str
    joints: tuple[str, ...]
    score: float
    why_not: str


@dataclass(frozen=True)
class Finding:
    """One effect.

    Attributes:
        effect: Name, or `unknown`.
        joints: Where it acts (all that it moves torque at, where it has no joint of its own).
        where: In words.
        equation, source: What it is.
        parameters: Values.
        confidence: That the name is right, 0..1: its weight among the explanations that were compared; with a healthy
            reference times how often such findings were right in blind trials (`reliability`).
        alternatives: Other explanations, best first.
        gain, held_out_gain: Drop in chi-square on the fitted and on the held-out data.
        visibility: Share of its energy that the base model cannot take over.
        before_Nm, after_Nm: By joint, RMS of the residual without and with it, on held-out data.
        explained: Share of the residual's variance above the noise floor that it removes there; NaN where untestable.
        beside_Nm: By joint, `after_Nm` less what swings near the effect's own resonance: an encoder's noise makes a
            link ring there, in the model alone.
        against: What its own values say against its name, in words that follow "whose".
        not_excited: Whether the held-out data do not excite it, by its own law.
        felt_Nm: By joint, RMS of what it adds to the torque in the field where it acts.
        event: Whether it has a name, and begins and ends in time; the RMS are those of the field then, while it lasts.
        experiment: What would separate it from what it is confused with.
        windows: Of what begins and ends in time: number of the field recording, begin and end in it, s.
        unchecked: Where and when it was, in words, if the held-out data have nothing of it.
        remedy: What to do about it, in words, where it leaves no doubt.
        driver: The other joint whose motion it follows, where it has no name and that is what it follows.
    """

    effect: str
    joints: tuple[str, ...]
    where: str
    equation: str
    source: str
    parameters: dict[str, Quantity]
    confidence: float
    alternatives: tuple[Alternative, ...]
    gain: float
    held_out_gain: float
    visibility: float
    before_Nm: dict[str, float]
    after_Nm: dict[str, float]
    explained: float
    beside_Nm: dict[str, float] = field(default_factory=dict)
    against: str = ""
    not_excited: bool = False
    felt_Nm: dict[str, float] = field(default_factory=dict)
    event: bool = False
    experiment: str = ""
    windows: tuple[tuple[int, float, float], ...] = ()
    unchecked: str = ""
    remedy: str = ""
    driver: str = ""


def joined(findings: Sequence[Finding], joints: Sequence[str]) -> Finding:
    """Findings of one effect at several joints, or at several times, as one; the first is the largest.

    Args:
        findings: Of the same effect.
        joints: All of the arm's, for their order.
    """
    largest = findings[0]
    if len(findings) == 1:
        return largest
    where = {joint for finding in findings for joint in finding.joints}
    weights = [finding.gain + max(finding.held_out_gain, 0.0) for finding in findings]
    known = [(w, f.explained) for w, f in zip(weights, findings) if math.isfinite(f.explained)]
    return replace(
        largest,
        joints=tuple(joint for joint in joints if joint in where),
        where="; ".join(dict.fromkeys(finding.where for finding in findings)),
        parameters=_told_apart(findings),
        confidence=max(finding.confidence for finding in findings),
        gain=sum(finding.gain for finding in findings),
        held_out_gain=sum(finding.held_out_gain for finding in findings),
        before_Nm=_largest(finding.before_Nm for finding in findings),
        after_Nm=_largest(finding.after_Nm for finding in findings),
        beside_Nm=_largest(finding.beside_Nm for finding in findings),
        felt_Nm=_largest(finding.felt_Nm for finding in findings),
        explained=sum(w * e for w, e in known) / sum(w for w, _ in known) if known else float("nan"),
        # What lasts beside what happened once is in the held-out data.
        windows=tuple(one for f in findings for one in f.windows) if all(f.windows for f in findings) else (),
    )


def _largest(parts: Iterable[Mapping[str, float]]) -> dict[str, float]:
    """By joint, the largest of the parts that have it."""
    largest = dict[str, float]()
    for part in parts:
        for joint, rms in part.items():
            largest[joint] = max(rms, largest.get(joint, 0.0))
    return largest


def _told_apart(findings: Sequence[Finding]) -> dict[str, Quantity]:
    """Parameters of findings by name and joint: a second one at a joint has its number in the name."""
    parameters, seen = dict[str, Quantity](), dict[str, int]()
    for finding in findings:
        joint = finding.joints[0]
        seen[joint] = seen.get(joint, 0) + 1
        number = f"_{seen[joint]}" if seen[joint] > 1 else ""
        parameters |= {f"{name}{number}[{joint}]": quantity for name, quantity in finding.parameters.items()}
    return parameters


@dataclass(frozen=True)
class Unexplained:
    """What is left of a joint's residual."""

    joints: tuple[str, ...]
    where: str
    fraction: float


@dataclass(frozen=True)
class Detectable:
    """The smallest size of something not found that would have been.

    Attributes:
        name: Effect, or what of a simulation agrees.
        joints: Where.
        size: Smallest change of `quantity`; infinite where none that it can have would have been seen.
        unit: Its unit.
        quantity: The value of the effect that it is the size of.
    """

    name: str
    joints: tuple[str, ...]
    size: float
    unit: str
    quantity: str = ""

    @property
    def visible(self) -> bool:
        """Whether there is such a size."""
        return math.isfinite(self.size)


@dataclass(frozen=True)
class Trace:
    """Signals of one motion for figures, rows of the bandwidth looked at, columns in the order of the arm.

    Attributes:
        time: (M,) s.
        position, velocity: (M, n).
        before, after: (M, n) residual of the base model alone, and with every finding, N·m; NaN where no row counts.
    """

    time: FloatArray
    position: FloatArray
    velocity: FloatArray
    before: FloatArray
    after: FloatArray


@dataclass(frozen=True)
class Happened:
    """An event in a recording that no fit sees.

    Attributes:
        kind: Of the effect.
        recording: Number among all recordings, those that are fitted first (`Motion.source`).
        begin_s, end_s: Time in the recording, with a margin.
    """

    kind: str
    recording: int
    begin_s: float
    end_s: float

    @property
    def words(self) -> str:
        """Its time, and what it is."""
        return f"{self.begin_s:.1f} s to {self.end_s:.1f} s ({self.kind})"


@dataclass(frozen=True)
class Explanation:
    """The whole answer.

    Attributes:
        verdict: `mismatch`, `no_mismatch` or `data_unfit`.
        joints: Names of the arm's joints.
        noise_floor_Nm: (n,) RMS that a healthy arm leaves there: noise, and what parts of the reference differ by.
        detectable_Nm: (n,) RMS residual above which a joint is called a mismatch even if nothing explains it.
        before_Nm, after_Nm: (n,) RMS residual before and after.
        findings: Largest first.
        happened: Events of the recordings judged on, during which nothing is judged.
        unexplained: What is left.
        next_experiment: What would separate what these data cannot.
        next_effect, next_joints: Which effect, or purpose of an experiment, and at which joints, that is about.
        next_motion: What the excitation file written for it does, in words; empty: there is none.
        next_cautions: Where that leaves what was recorded, in words.
        already_there: Effects that the reference shows as well, in words.
        reasons: Why data are unfit, or what else a reader should know.
        model: Base model with the effects; None where nothing was found.
        traces: For figures.
        judged_on: In words, what the residuals are on.
        cutoff_hz: Bandwidth that was looked at; NaN where the data are unfit.
        would_have_seen: Of effects that were not found, the smallest size that would have been.
    """

    verdict: str
    joints: tuple[str, ...]
    noise_floor_Nm: FloatArray
    detectable_Nm: FloatArray
    before_Nm: FloatArray
    after_Nm: FloatArray
    findings: tuple[Finding, ...] = ()
    happened: tuple[Happened, ...] = ()
    unexplained: tuple[Unexplained, ...] = ()
    next_experiment: str | None = None
    next_effect: str = ""
    next_joints: tuple[str, ...] = ()
    next_motion: str = ""
    next_cautions: tuple[str, ...] = ()
    already_there: tuple[str, ...] = ()
    reasons: tuple[str, ...] = ()
    model: IdentifiedModel | None = None
    traces: tuple[Trace, ...] = ()
    judged_on: str = ""
    cutoff_hz: float = float("nan")
    would_have_seen: tuple[Detectable, ...] = ()

    @property
    def compared(self) -> tuple[str, ...]:
        """Joints whose residual says something: whose noise is known, and that move where it is judged."""
        known = np.isfinite(self.noise_floor_Nm) & np.isfinite(self.before_Nm)
        return tuple(joint for joint, is_known in zip(self.joints, known) if is_known)

    @property
    def unchecked(self) -> bool:
        """Whether the held-out residuals would read as an all-clear, though they have nothing of what was found."""
        above = any(bool(np.any(rms > self.detectable_Nm)) for rms in (self.before_Nm, self.after_Nm))
        return bool(self.findings) and all(finding.unchecked for finding in self.findings) and not above

    @property
    def headline(self) -> str:
        """The verdict in one line."""
        names = [f"{f.effect} at {', '.join(f.joints)} (confidence {f.confidence:.2f})" for f in self.findings]
        return ": ".join([self.verdict.replace("_", " "), *filter(None, ["; ".join(names or self.reasons)])])


def unfit(joints: tuple[str, ...], reasons: tuple[str, ...]) -> Explanation:
    """The answer where the data cannot carry the question.

    Args:
        joints: Names of the arm's joints, whose figures are all NaN.
        reasons: Why the data are unfit and what to record, a sentence each.
    """
    nothing = np.full(len(joints), np.nan)
    return Explanation(DATA_UNFIT, joints, nothing, nothing, nothing, nothing, reasons=reasons)
