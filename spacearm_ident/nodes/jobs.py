"""What the identifier has done by its worker: an identification, or the explanation of a mismatch.

A job is what an offline command does, in words that cross to another process; it says which command.
"""

from __future__ import annotations

import shlex
from dataclasses import dataclass, field
from pathlib import Path

from ..estimate.identified import Identified
from ..identification.identify import Progress
from ..layers.comparison import Comparison
from ..mismatch.finding import Explanation
from ..sessions.bags import Options, arm_words, identify_bags
from ..sessions.identification import Session, within
from ..sessions.reading import Comparing, Reading
from .message_buffer import Capture, write_captures

WRITING = "writing the recording"
"""A job's first step: before it is over, its bag is not whole."""


@dataclass(frozen=True)
class Done:
    """An identification, and what was found in the recordings, a line each."""

    session: Session
    findings: tuple[str, ...]


@dataclass(frozen=True)
class Compared:
    """Recordings compared with a healthy arm or with a simulation: what came out, and the page to open."""

    outcome: Explanation | Comparison
    page: Path


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
            progress(0.0, WRITING)
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
class MismatchJob:
    """A comparison; what `spacearm mismatch` does, from the same bags.

    Attributes:
        field: Bags to explain.
        judged: Bags to judge on; empty: the last third of `field`.
        against: Bags of the healthy arm, or one model file; of a simulation its file, or bags that it wrote.
        directory: Result folder.
        arm, gravity: As `Comparing`.
        captures: Written to `bag` before anything else.
        bag: Where to.
        simulated: Whether it is a simulation that the bags are compared with, layer by layer.
    """

    field: tuple[Path, ...]
    judged: tuple[Path, ...]
    against: tuple[Path, ...]
    directory: Path
    arm: Path | None = None
    gravity: tuple[float, float, float] | None = None
    captures: tuple[Capture, ...] = ()
    bag: Path | None = None
    simulated: bool = False

    name = "mismatch"

    @property
    def command(self) -> str:
        """The offline command that does the same."""
        option = "--simulation" if self.simulated else "--reference"
        words = ["spacearm", "mismatch", *map(str, self.field), option, *map(str, self.against)]
        if self.judged:
            words += ["--validate", *map(str, self.judged)]
        words += arm_words(self.arm, self.gravity)
        return shlex.join([*words, "--out", str(self.directory)])

    @property
    def bags(self) -> tuple[Path, ...]:
        """Explained, then judged on."""
        return (*self.field, *self.judged)

    def perform(self, progress: Progress) -> Compared:
        """Write the captures, compare, write the result.

        Raises:
            UserError: As `explain_session` or `compare_session`.
        """
        # Imported here: the node, which only names the job, and a worker that identifies start without matplotlib.
        from ..sessions.mismatch import explain_session
        from ..sessions.simulation import compare_session

        if self.bag is not None:
            progress(0.0, WRITING)
            write_captures(self.bag, self.captures)
        how = Comparing(Reading(self.arm), self.gravity)
        places = (self.judged, self.directory, how)
        if self.simulated:
            layers = compare_session(self.against, self.field, *places, command=self.command, progress=progress)
            return Compared(layers.comparison, layers.page)
        session = explain_session(self.field, self.against, *places, command=self.command, progress=progress)
        return Compared(session.explanation, session.page)


Job = IdentifyJob | MismatchJob
"""What a worker does (`perform`): its `name` is a noun, its `command` the offline one that does the same."""
