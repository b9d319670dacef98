"""`RunSet`: the recordings of one comparison, each by what it is for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from ..dynamics.model import IdentifiedModel
from ..recording.recording import Recording

Runs = Sequence[Recording]


@dataclass(frozen=True)
class RunSet:
    """What is compared with what.

    Attributes:
        field: Recordings to explain; at least one.
        reference: Recordings of the healthy arm, or its identified model; empty: the field's own fit is the base.
        validation: Recordings to judge on, which no fit sees; empty: the last third of each field recording.
    """

    field: Runs
    reference: Runs | IdentifiedModel = ()
    validation: Runs = ()

    @property
    def known(self) -> IdentifiedModel | None:
        """The healthy arm's model, where that is the reference."""
        return self.reference if isinstance(self.reference, IdentifiedModel) else None

    @property
    def healthy(self) -> list[Recording]:
        """Recordings of the healthy arm; empty where there are none."""
        return [] if isinstance(self.reference, IdentifiedModel) else list(self.reference)

    @property
    def every(self) -> list[Recording]:
        """All recordings: those to explain, the healthy arm's, those to judge on."""
        return [*self.field, *self.healthy, *self.validation]

    def each(self, change: Callable[[Runs], Runs]) -> RunSet:
        """The same with other recordings in place of each part's; a model stays."""
        reference = self.reference if self.known is not None else change(self.healthy)
        return replace(self, field=change(self.field), reference=reference, validation=change(self.validation))
