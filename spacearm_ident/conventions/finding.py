"""`Finding` and `ConventionReport`: what a check of recordings says, for a person and for a program."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

from ..recording.corrections import Corrections

SCHEMA = "spacearm_ident/conventions/1"
DECISIVE = 50.0
"""Log odds from which `identify` calls data unfit for an inferred mistake; `check` names it from less. From
`bench/conventions.py`: the largest of 28 sound recordings is 41 (a UR5 with friction and CAD errors of its own)."""

INFERRED = "signs, units, order, zeros and gravity"
"""What the arm's dynamics decide."""
UNFIT_MODEL = "do not use the model: its figures only say how well it repeats the unfit data"
"""Said of a model of unfit data, in place of a verdict on its fit."""


class Untested(StrEnum):
    """Why what the arm's dynamics decide was not looked for in a recording."""

    TWO_SOURCES = "two sources"
    TWO_ZEROS = "positions have two zeros"
    MOVING_BASE = "the base moves: give --fixed-base where it does not"
    UNMODELLED_JOINTS = "joints move that carry the arm or belong to it"
    CLOCK = "the clock"
    POSITION_UNIT = "the unit of the positions"


class Level(StrEnum):
    """What a finding means for an identification."""

    UNFIT = "unfit"
    """A model made of these data is not to be believed."""
    NOTE = "note"
    """Worth knowing; the data can be used."""


@dataclass(frozen=True)
class Alternative:
    """Another cause that explains the same data nearly as well."""

    kind: str
    joints: tuple[str, ...]
    probability: float


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong, or worth knowing.

    Attributes:
        kind: Stable short name.
        level: What it means.
        joints: Where; empty: the whole recording.
        statement: What was found, one sentence.
        remedy: What to do about it.
        probability: Of this cause, 0 to 1; 1 where it is read off and not inferred.
        log_odds: Log-likelihood ratio against nothing being wrong, with priors; None where it is read off.
        values: Numbers behind it, by name.
        alternatives: Other causes the data cannot exclude.
        recordings: Names of the recordings it was found in.
        corrections: What undoes it in the recordings; none where that is not known, or not in the recordings.
    """

    kind: str
    level: Level
    joints: tuple[str, ...]
    statement: str
    remedy: str
    probability: float = 1.0
    log_odds: float | None = None
    values: Mapping[str, Any] = field(default_factory=dict)
    alternatives: tuple[Alternative, ...] = ()
    recordings: tuple[str, ...] = ()
    corrections: Corrections = field(default_factory=Corrections)

    def as_dict(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "kind": self.kind,
            "level": str(self.level),
            "joints": list(self.joints),
            "statement": self.statement,
            "remedy": self.remedy,
            "probability": round(self.probability, 4),
            "log_odds": None if self.log_odds is None else round(self.log_odds, 1),
            "values": dict(self.values),
            "alternatives": [
                {"kind": one.kind, "joints": list(one.joints), "probability": round(one.probability, 4)}
                for one in self.alternatives
            ],
            "recordings": list(self.recordings),
        }


@dataclass(frozen=True)
class ConventionReport:
    """What a check of one or more recordings found.

    Attributes:
        findings: The gravest first.
        undecided: What these data cannot decide, a clause each.
        recordings: Names of what was checked.
        untested: Names of those in which only what is read off was looked for.
    """

    findings: tuple[Finding, ...]
    undecided: tuple[str, ...]
    recordings: tuple[str, ...]
    untested: tuple[str, ...] = ()

    @property
    def certain(self) -> bool:
        """Whether a mistake is read off, or inferred beyond what sound recordings of other arms have shown."""
        return any(
            finding.level is Level.UNFIT and (finding.log_odds is None or finding.log_odds >= DECISIVE)
            for finding in self.findings
        )

    @property
    def fit(self) -> bool:
        """Whether the data may be identified from."""
        return not any(finding.level is Level.UNFIT for finding in self.findings)

    @property
    def verdict(self) -> str:
        """One line."""
        wrong = [finding for finding in self.findings if finding.level is Level.UNFIT]
        if wrong:
            kinds = ", ".join(dict.fromkeys(finding.kind.replace("_", " ") for finding in wrong))
            return f"data unfit: {kinds}; a model identified from them would be wrong"
        notes = f", {len(self.findings)} {'notes' if len(self.findings) > 1 else 'note'}" if self.findings else ""
        if self.untested and len(self.untested) == len(self.recordings):
            return f"data not tested: {INFERRED} are not decided by these data{notes}"
        if self.untested:
            return f"data fit where tested{notes}; {INFERRED} not tested in {', '.join(self.untested)}"
        return f"data fit{notes or ': no mistake of convention found'}"

    @property
    def unfit(self) -> tuple[str, ...]:
        """Why the data are unfit: the verdict, then a line a finding that makes them so; empty where they are fit."""
        wrong = [self._line(finding) for finding in self.findings if finding.level is Level.UNFIT]
        return (self.verdict, *wrong) if wrong else ()

    def lines(self) -> list[str]:
        """For a person: the verdict, then a line a finding with what to do."""
        lines = [self.verdict, *map(self._line, self.findings)]
        if self.undecided:
            lines.append(f"not decided by these data: {'; '.join(self.undecided)}")
        return lines

    def _line(self, finding: Finding) -> str:
        where = f" [{', '.join(finding.recordings)}]" if len(self.recordings) > 1 and finding.recordings else ""
        sure = "" if finding.log_odds is None else f" ({sureness(finding)})"
        return f"{finding.level}: {finding.kind}{where}: {finding.statement}{sure} -> {finding.remedy}"

    def as_dict(self) -> dict[str, Any]:
        """Plain data, for validation.json and `--json`."""
        return {
            "schema": SCHEMA,
            "fit": self.fit,
            "verdict": self.verdict,
            "findings": [finding.as_dict() for finding in self.findings],
            "undecided": list(self.undecided),
            "untested": list(self.untested),
            "recordings": list(self.recordings),
        }


def _percent(probability: float) -> str:
    """A probability that is never printed as certain."""
    return "> 99.9 %" if probability > 0.999 else f"{probability:.1%}"


def sureness(finding: Finding) -> str:
    """The probability of an inferred finding, in words."""
    words = f"probability {_percent(finding.probability)}, log odds {finding.log_odds:.0f}"
    if finding.alternatives:
        others = ", ".join(
            f"{one.kind.replace('_', ' ')}{' of ' + ', '.join(one.joints) if one.joints else ''} {one.probability:.0%}"
            for one in finding.alternatives
        )
        words += f"; not excluded: {others}"
    return words


def merged(reports: Sequence[ConventionReport]) -> ConventionReport:
    """Reports of several recordings as one: the same finding in several of them is said once."""
    found: dict[tuple[str, Level, tuple[str, ...]], Finding] = {}
    for report in reports:
        for finding in report.findings:
            key = finding.kind, finding.level, finding.joints
            if key in found:
                names = (*found[key].recordings, *finding.recordings)
                found[key] = replace(found[key], recordings=tuple(dict.fromkeys(names)))
            else:
                found[key] = finding
    ordered = sorted(found.values(), key=lambda one: one.level is not Level.UNFIT)
    common = [set(report.undecided) for report in reports]
    undecided = [text for text in reports[0].undecided if all(text in one for one in common)] if reports else []
    names = tuple(name for report in reports for name in report.recordings)
    untested = tuple(name for report in reports for name in report.untested)
    return ConventionReport(tuple(ordered), tuple(undecided), names, untested)
