"""Judgement of findings: whether they matter on data no fit has seen, and whether they are what they are called."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from scipy.stats import norm

from ..dynamics.effects.effect import Effect
from .competition import GATE
from .finding import Alternative, Finding, joined
from .left_out import LEVEL
from .rejection import CLEARS_UP
from .rivals import UNKNOWN

NAMES = 0.8
"""Share of a residual above the noise on held-out data that a finding must explain to keep its name, unless what it
leaves is within `LAW_LEFT`; and share of an effect's squares at the joints of an unknown law from which it is fitted to
what that leaves. Chosen; the blind trials of docs/mismatch.md were scored with it."""
LAW_LEFT = 1.4
"""Mean square of the held-out residual, over the noise's, up to which a finding keeps its name whatever share it
explains. Chosen; the blind trials of docs/mismatch.md were scored with it."""
ALONE = 0.65
"""Share of a residual above the noise from which a finding keeps its name without a rival above `RIVALLED`. Set on 88
blind trials (`bench/concealed.py`, seed 6): impacts of backlash depend on the smallest deviations, and its law leaves
a third."""
RIVALLED = 0.5
"""Largest score of an alternative, as a share of the finding's own, beside which `ALONE` applies. As `ALONE`."""
REST = "is fitted to what a law without a name leaves"
"""Why an effect is listed beside an unknown finding instead of being one itself."""
WEAKLY = "weakly: "
"""Prefix of a dependence without a name that leaves so much that a law would lose its name."""
SHOWS = 0.5
"""Share of a residual above the noise on held-out data that a finding must explain if it was not accepted first. Less
is negligible beside the first finding, whose law is never exactly that of the catalogue. Chosen."""
FIRST_SHOWS = 0.1
"""The same share for the finding that was accepted first, if `ONLY_SHOWS` does not apply. Chosen."""
ONLY_SHOWS = 0.4
"""The same share for a first finding with a name and with no other at its joints. On a healthy arm of blind trial
seed 7 a delay of 1.6 ms explained 19 %."""
SURE = 5.0
"""Multiple of the gate that an effect must score in the field where the held-out data do not excite it. Chosen."""
LEAST = 0.1
"""Least change of the mean square on held-out data, as a share of the noise's. A finding that lowers it by less at
every joint is an error of the base model, such as friction near a velocity reversal: a delay of 1.3 ms was one on a
healthy arm. A finding that raises it by more at any joint loses its name."""
BEYOND_A_DAY = float(norm.isf(LEVEL)) ** 2
"""Drop of the weighted sum of squares that an effect must bring once the usual difference of friction from day to day
is allowed for (`Evidence.with_days`). Such a difference brings as much with the probability `LEVEL`."""
HARM = 1.02
"""Mean square on held-out data with a finding over that without it, from which the finding is false. Chosen."""


def harms(finding: Finding) -> bool:
    """Whether the residual of held-out data, every row counted alike, is larger with a finding than without."""
    before, after = (sum(rms**2 for rms in by.values()) for by in (finding.before_Nm, finding.after_Nm))
    return not finding.event and after > HARM * before


def shows(number: int, findings: Sequence[Finding], floor: Mapping[str, float]) -> bool:
    """Whether one of the findings explains enough of the held-out data.

    An event in time need not show there, nor a first one that is not excited there.

    Args:
        number: Index of the finding to judge; 0 is the one accepted first.
        findings: All findings, with residuals on held-out data.
        floor: Joint -> noise floor, RMS, N·m.
    """
    finding, first = findings[number], number == 0
    if finding.event:
        return True
    if first and finding.not_excited and finding.gain > SURE * GATE:
        return True
    # What is below the noise to begin with needs no explanation.
    matters = any(
        rms**2 - max(finding.after_Nm[joint], floor[joint]) ** 2 > LEAST * floor[joint] ** 2
        for joint, rms in finding.before_Nm.items()
    )
    beside = {joint for other in findings if other is not finding for joint in other.before_Nm}
    only = finding.effect != UNKNOWN and beside.isdisjoint(finding.before_Nm)
    least = ONLY_SHOWS if only else FIRST_SHOWS
    return matters and finding.explained >= (least if first else SHOWS)


def beyond_healthy(finding: Finding, before: Mapping[str, float], largest: Mapping[str, float]) -> bool:
    """Whether a finding is of a size that parts of the healthy arm's own recordings do not differ by.

    Args:
        finding: An effect. What lasts is judged on the data that no fit has seen; an event, and what those need not
            show, by what it adds in the field.
        before: By joint, RMS of what the healthy model leaves on the held-out data, N·m.
        largest: By joint, RMS that a healthy arm leaves there at most, N·m.
    """
    if finding.event or finding.not_excited:
        return any(rms > largest[joint] for joint, rms in finding.felt_Nm.items())
    return any(min(rms, before[joint]) > largest[joint] for joint, rms in finding.before_Nm.items())


def clears_up(finding: Finding, left: Mapping[str, float], floor: Mapping[str, float]) -> bool:
    """Whether a finding is most of what the field shows at one of its joints and a healthy arm would not.

    The field itself says then of what size it is; the held-out data, whether it is there again (`shows`).

    Args:
        finding: An effect; one without a name or that does not last is none.
        left: Joint -> RMS of what the healthy model leaves of the field, N·m, where that is a mismatch by itself.
        floor: Joint -> what it leaves of the field of a healthy arm, RMS, N·m.
    """
    return (
        not finding.event
        and finding.effect != UNKNOWN
        and any(
            rms**2 > CLEARS_UP * (left[joint] ** 2 - floor[joint] ** 2)
            for joint, rms in finding.felt_Nm.items()
            if joint in left
        )
    )


def doubted(finding: Finding, floor: Mapping[str, float]) -> Finding:
    """A finding whose law is clearly not its own, or not quite, as an unknown one that is like it; else the finding.

    A dependence without a name that leaves so much is said to be weak.

    Args:
        finding: The finding, with residuals on held-out data.
        floor: Joint -> noise floor, RMS, N·m.
    """
    if finding.effect == UNKNOWN:
        weak = _leaves_much(finding, floor) and not finding.windows
        return replace(finding, where=f"{WEAKLY}{finding.where}") if weak else finding
    worse = spoiled(finding, floor)
    if worse:
        why_not = f"leaves more than before at {' and '.join(worse)}"
        return _as_unknown(finding, why_not, f"which {why_not}")
    sole = finding.explained > ALONE and all(other.score < RIVALLED for other in finding.alternatives)
    if sole or not _leaves_much(finding, floor):
        return finding
    left = times_noise(finding, floor)
    why_not = f"explains {finding.explained:.0%}, and leaves {left:.1f} times the noise"
    return _as_unknown(finding, why_not, f"which leaves {left:.1f} times the noise")


def _leaves_much(finding: Finding, floor: Mapping[str, float]) -> bool:
    return finding.explained < NAMES and times_noise(finding, floor) ** 2 > LAW_LEFT


def of_one_law(findings: Sequence[Finding], floor: Mapping[str, float]) -> tuple[Finding, ...]:
    """Findings without those that are part of another one's law, which has no name.

    What clearly is not the law of the largest residual at a joint leaves a rest of any shape: effects that are fitted
    to the rest are not there. Two findings without a name at the same joints are one.

    Args:
        findings: Largest first, each as `doubted` has it.
        floor: Joint -> noise floor, RMS, N·m.
    """
    kept: list[Finding] = []
    for finding in findings:
        for k, larger in enumerate(kept):
            if larger.effect != UNKNOWN:
                continue
            if finding.effect == UNKNOWN and set(finding.joints) == set(larger.joints):
                kept[k] = joined([larger, finding], finding.joints)
                break
            if finding.effect != UNKNOWN and _is_of_the_rest(finding, larger, floor):
                share = finding.gain / larger.gain if larger.gain > 0.0 else 0.0
                like = Alternative(finding.effect, finding.joints, share, REST)
                kept[k] = replace(larger, alternatives=(*larger.alternatives, like))
                break
        else:
            kept.append(finding)
    return tuple(kept)


def _is_of_the_rest(finding: Finding, larger: Finding, floor: Mapping[str, float]) -> bool:
    """Whether nearly all that an effect adds, in noise, is at joints of which another's law leaves much."""
    felt = {joint: (rms / floor[joint]) ** 2 for joint, rms in finding.felt_Nm.items() if floor[joint] > 0.0}
    there = sum(square for joint, square in felt.items() if joint in larger.joints)
    return _leaves_much(larger, floor) and there > NAMES * sum(felt.values())


def spoiled(finding: Finding, floor: Mapping[str, float]) -> tuple[str, ...]:
    """Joints at which more is left of the held-out data with a finding than without it, beyond the noise.

    Args:
        finding: The finding, with residuals on held-out data; those need not have an event, which spoils none.
        floor: Joint -> noise floor, RMS, N·m.
    """
    if finding.event:
        return ()
    return tuple(
        joint
        for joint, rms in (finding.beside_Nm or finding.after_Nm).items()
        if rms**2 - max(finding.before_Nm[joint], floor[joint]) ** 2 > LEAST * floor[joint] ** 2
    )


def times_noise(finding: Finding, floor: Mapping[str, float]) -> float:
    """What is left beside a finding on held-out data, over the noise, RMS; joints count by how much they feel of it.

    Args:
        finding: The finding; where nothing is known of what it adds, its joints count alike.
        floor: Joint -> noise floor, RMS, N·m.
    """
    left = {joint: rms for joint, rms in (finding.beside_Nm or finding.after_Nm).items() if floor[joint] > 0.0}
    weights = {joint: (finding.felt_Nm.get(joint, 0.0) / floor[joint]) ** 2 for joint in left}
    if not any(weights.values()):
        weights = dict.fromkeys(left, 1.0)
    if not left:
        return 0.0
    square = sum(weights[joint] * (rms / floor[joint]) ** 2 for joint, rms in left.items())
    return math.sqrt(square / sum(weights.values()))


def contradicted(finding: Finding, effect: Effect, beside: Sequence[Effect]) -> Finding:
    """Relabel a finding as unknown where its values, or a free function of its quantity, contradict its name.

    Args:
        finding: The finding; `against` holds what its own values contradict.
        effect: Its effect.
        beside: Effects accepted together with it, among them free functions (`UNKNOWN`).

    Returns:
        The finding as an unknown one, or `finding` itself.
    """

    def freer(other: Effect) -> bool:
        own = other.joints == effect.joints and "with" not in other.place
        return other.kind == UNKNOWN and own and other.place["of"] == effect.follows

    if finding.against:
        return _as_unknown(finding, f"its {finding.against}", f"whose {finding.against}")
    if not any(freer(other) for other in beside):
        return finding
    return _as_unknown(finding, "its law is another", f"with another law of the {effect.follows.replace('_', ' and ')}")


def _as_unknown(finding: Finding, why_not: str, but: str) -> Finding:
    """The finding as an unknown one that is like what it was called."""
    like = Alternative(finding.effect, finding.joints, finding.explained, why_not)
    return replace(
        finding,
        effect=UNKNOWN,
        where=f"most like {finding.effect} ({finding.where}), {but}",
        equation="",
        source="",
        parameters={},
        alternatives=(like, *finding.alternatives),
    )
