"""What the identifier has done by its worker: an identification, or the explanation of a mismatch.

A job is what an offline command does, in words that cross to another process; it says which command.
"""

from __future__ import annotations

import shlex
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from ..estimate.identified import Identified
from ..identification.identify import Progress
from ..layers.comparison import Comparison
from ..mismatch.finding import Explanation
from ..sessions.bags import Options, arm_words, identify_bags
from ..sessions.identification import Session, within
from ..sessions.mismatch import explain_session
from ..sessions.reading import Comparing, Reading
from ..sessions.simulation import compare_session
from .message_buffer import Capture, write_captures


@dataclass(frozen=True)
class Done:
    """An identification, and what was found in the recordings, a line each."""

    session: Session
    findings: tuple[str, ...]


@dataclass(frozen=True)
class Explained:
    """A mismatch explained (or none), and the page to open."""

    explanation: Explanation
    page: Path


@dataclass(frozen=True)
class Compared:
    """An arm compared with a simulation of it, and the page to open."""

    comparison: Comparison
    page: Path


class Job(Protocol):
    """Something to do."""

    @property
    def command(self) -> str:
        """The offline command that does the same."""

    @property
    def bags(self) -> tuple[Path, ...]:
        """The bags it is about, each once."""

    @property
    def name(self) -> str:
        """What it is, a noun."""

    def perform(self, progress: Progress) -> Done | Explained | Compared:
        """Do it.

        Raises:
            UserError: The data or the folder do not allow it.
        """


@dataclass(frozen=True)
class IdentifyJob:
    """An identification; what `spacearm identify` does, from the same bags.

    Attributes:
        fitted, validated: Bags; `validated` may be empty (hold-out) or `fitted` again (no hold-out).
        directory: Result folder.
        options: How.
        captures: Written to `bag` before anything else.
        bag: Where to.
        known: Identification of `fitted`, where there is one.
    """

    fitted: tuple[Path, ...]
    validated: tuple[Path, ...]
    directory: Path
    options: Options = field(default_factory=Options)
    captures: tuple[Capture, ...] = ()
    bag: Path | None = None
    known: Identified | None = None

    name = "identification"

    @property
    def command(self) -> str:
        """The offline command that does the same."""
        words = ["spacearm", "identify", *map(str, self.fitted)]
        if self.validated:
            words += ["--validate", *map(str, self.validated)]
        words += self.options.words()
        return shlex.join([*words, "--out", str(self.directory)])

    @property
    def bags(self) -> tuple[Path, ...]:
        """Fitted, then validated."""
        return tuple(dict.fromkeys((*self.fitted, *self.validated)))

    @property
    def holds_nothing_out(self) -> bool:
        """Whether the fit sees all of its bags."""
        return self.validated == self.fitted

    def perform(self, progress: Progress) -> Done:
        """Write the captures, identify or validate, write the result.

        Raises:
            UserError: As `identify_bags`.
        """
        if self.bag is not None:
            progress(0.0, "writing the recording")
            write_captures(self.bag, self.captures)
        done = identify_bags(
            self.fitted,
            self.validated,
            self.directory,
            self.options,
            command=self.command,
            known=self.known,
            progress=within(progress, 0.05, 1.0),
        )
        return Done(*done)


@dataclass(frozen=True)
class ExplainJob:
    """The explanation of a mismatch; what `spacearm mismatch` does, from the same bags.

    Attributes:
        field: Bags to explain.
        judged: Bags to judge on; empty: the last third of `field`.
        reference: Bags of the healthy arm, or one model file.
        directory: Result folder.
        arm, gravity: As `Comparing`.
        captures: Written to `bag` before anything else.
        bag: Where to.
    """

    field: tuple[Path, ...]
    judged: tuple[Path, ...]
    reference: tuple[Path, ...]
    directory: Path
    arm: Path | None = None
    gravity: tuple[float, float, float] | None = None
    captures: tuple[Capture, ...] = ()
    bag: Path | None = None

    name = "mismatch"

    @property
    def command(self) -> str:
        """The offline command that does the same."""
        words = ["spacearm", "mismatch", *map(str, self.field), "--reference", *map(str, self.reference)]
        if self.judged:
            words += ["--validate", *map(str, self.judged)]
        words += arm_words(self.arm, self.gravity)
        return shlex.join([*words, "--out", str(self.directory)])

    @property
    def bags(self) -> tuple[Path, ...]:
        """Explained, then judged on."""
        return (*self.field, *self.judged)

    def perform(self, progress: Progress) -> Explained:
        """Write the captures, explain, write the result.

        Raises:
            UserError: As `explain_session`.
        """
        if self.bag is not None:
            progress(0.0, "writing the recording")
            write_captures(self.bag, self.captures)
        session = explain_session(
            self.field,
            self.reference,
            self.judged,
            self.directory,
            Comparing(Reading(self.arm), self.gravity),
            command=self.command,
            progress=progress,
        )
        return Explained(session.explanation, session.page)


@dataclass(frozen=True)
class CompareJob:
    """The comparison with a simulation; what `spacearm mismatch --simulation` does, from the same bags.

    Attributes:
        field: Bags of the arm.
        judged: Bags to judge on; empty: the last third of `field`.
        simulation: The simulation's file, or a bag that a simulator wrote.
        directory: Result folder.
        arm, gravity: As `Comparing`.
    """

    field: tuple[Path, ...]
    judged: tuple[Path, ...]
    simulation: Path
    directory: Path
    arm: Path | None = None
    gravity: tuple[float, float, float] | None = None

    name = "mismatch"

    @property
    def command(self) -> str:
        """The offline command that does the same."""
        words = ["spacearm", "mismatch", *map(str, self.field), "--simulation", str(self.simulation)]
        if self.judged:
            words += ["--validate", *map(str, self.judged)]
        words += arm_words(self.arm, self.gravity)
        return shlex.join([*words, "--out", str(self.directory)])

    @property
    def bags(self) -> tuple[Path, ...]:
        """Compared, then judged on."""
        return (*self.field, *self.judged)

    def perform(self, progress: Progress) -> Compared:
        """Compare, write the result.

        Raises:
            UserError: As `compare_session`.
        """
        session = compare_session(
            (self.simulation,),
            self.field,
            self.judged,
            self.directory,
            Comparing(Reading(self.arm), self.gravity),
            command=self.command,
            progress=progress,
        )
        return Compared(session.comparison, session.page)
