"""Commands of the contract whose body has not been built yet: they are known, and say so in one line."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from typing import Any

from ..errors import UserError


@dataclass(frozen=True)
class Later:
    """A command that only says that it is not there yet."""

    name: str
    help: str

    def add(self, commands: Any) -> None:
        """Add the command to a parser."""
        command = commands.add_parser(self.name, help=f"{self.help} (not in this version)")
        command.add_argument("rest", nargs=argparse.REMAINDER, help=argparse.SUPPRESS)
        command.set_defaults(run=self.run)

    def run(self, options: argparse.Namespace) -> int:
        """Say so.

        Raises:
            UserError: Always.
        """
        raise UserError(f"'{self.name}' is not in this version yet: update spacearm_ident")


EXCITE = Later("excite", "optimise an excitation trajectory")
