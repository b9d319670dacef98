"""What to do with findings: the experiment that settles a doubt, a remedy where there is none, what was not checked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ..dynamics.effects import EFFECTS
from ..recording.recording import Recording
from .finding import Alternative, Finding
from .rivals import UNKNOWN

CLOSE = 0.7
"""Another explanation with this share of the score cannot be told apart."""


def next_experiment(findings: Sequence[Finding], in_air: bool) -> tuple[str | None, str, tuple[str, ...]]:
    """The experiment that would separate what these data cannot, for the largest finding that leaves a doubt.

    Args:
        findings: Largest first.
        in_air: Whether the arm is on the ground, as far as its gravity tells: there nobody needs a motion to exclude
            vacuum.

    Returns:
        In words; for which effect, or purpose of an experiment (empty where no motion that can be planned is meant);
        and at which joints.
    """
    for finding in findings:
        if finding.effect == UNKNOWN:
            return _of_unknown(finding)
        close = _close(finding, in_air)
        if close:
            words = f"{finding.experiment}: separates {finding.effect} from {close[0].effect}"
            # Of an event that is the motion that was recorded, and no other.
            return words, "" if finding.event else finding.effect, finding.joints
    return None, "", ()


def _close(finding: Finding, in_air: bool) -> list[Alternative]:
    """Other effects that these data do not tell from a finding."""
    return [
        other
        for other in finding.alternatives
        if other.score > CLOSE
        and other.effect not in (UNKNOWN, finding.effect)
        and not (in_air and other.effect in EFFECTS and EFFECTS[other.effect].in_vacuum)
    ]


def _of_unknown(finding: Finding) -> tuple[str, str, tuple[str, ...]]:
    joint = finding.joints[0]
    if finding.windows:
        words = (
            f"the same motion again: what comes back at the same place of {joint} is the arm's, what does not is not"
        )
        return words, "", (joint,)
    if finding.driver:
        words = (
            f"move {joint} slowly in both directions with {finding.driver} held at several positions over its recorded "
            f"range, then {finding.driver} with {joint} held; the same with other joints in its place: what it depends "
            "on will show"
        )
        return words, "", (joint, finding.driver)
    words = (
        f"move {joint} alone at two constant speeds over its range, in both directions: what it depends on will show"
    )
    return words, "ripple", (joint,)


def sure_of_remedy(finding: Finding, in_air: bool) -> Finding:
    """A finding without what to do about it where it has no name, or another explanation is as good.

    Args:
        finding: As named.
        in_air: As of `next_experiment`.
    """
    if finding.effect not in EFFECTS or _close(finding, in_air):
        return replace(finding, remedy="")
    return finding


def outside_held_out(findings: Sequence[Finding], field: Sequence[Recording], judged_on: str) -> tuple[Finding, ...]:
    """Findings, those that happened once with the words that say where, and that no held-out data have them.

    An event belongs to its recording: even where another was held out, that has none of this one.

    Args:
        findings: As judged.
        field: Recordings that were explained, by number.
        judged_on: What is held out, in words.
    """
    return tuple(
        replace(finding, unchecked=_outside(finding, field, judged_on)) if finding.windows else finding
        for finding in findings
    )


def _outside(finding: Finding, field: Sequence[Recording], judged_on: str) -> str:
    times, goes_on = list[str](), False
    for number, begin, end in sorted(finding.windows):
        # Of what is held out of the same recording an event says nothing, though its window may reach into it.
        last = float(field[number].time[-1])
        goes_on |= end > last
        times.append(f"{_name(field[number])} from {begin:.1f} to {min(end, last):.1f} s")
    if goes_on:
        return f"it is in {'; '.join(times)}, the end of what is fitted: not checked on what is held out ({judged_on})"
    return f"it is in {'; '.join(times)}, outside what is held out ({judged_on}): not checked on unseen data"


def _name(recording: Recording) -> str:
    return Path(recording.sources[0].path).name if recording.sources else "the field recording"
