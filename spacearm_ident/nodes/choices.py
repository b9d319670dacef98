"""Parameters whose words are from a fixed set: what the nodes take, and `spacearm check --params` before them.

Those of a node are in the module NODE_choices, which does not need ROS.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Choices:
    """The words a parameter may have.

    Attributes:
        words: They.
        optional: Whether it may have none.
        separated: Whether a text may have several, with commas between.
    """

    words: tuple[str, ...]
    optional: bool = False
    separated: bool = False

    def chosen(self, value: str | Sequence[str]) -> tuple[str, ...]:
        """The words in a value: a text, or a list of them."""
        if not isinstance(value, str):
            return tuple(value)
        parts = map(str.strip, value.split(",")) if self.separated else (value,)
        return tuple(filter(None, parts))

    def refusal(self, value: str | Sequence[str]) -> str:
        """Why a value is not taken; empty: it is."""
        chosen = self.chosen(value)
        wrong = next((word for word in chosen if word not in self.words), None)
        if wrong is None and (chosen or self.optional):
            return ""
        return f"no {'' if wrong is None else wrong!r}: {self}"

    def __str__(self) -> str:
        """What may be chosen."""
        return f"one of {', '.join(self.words)}{', or empty' if self.optional else ''}"
