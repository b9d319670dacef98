"""Packages that only some formats need, and what to install where one is missing."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from spacearm_ident.errors import UserError


def optional(module: str, package: str, what: str) -> Any:
    """A module that is not installed with everything else.

    Args:
        module: As it is imported.
        package: As it is installed.
        what: What needs it, for the error: `reading HDF5`.

    Raises:
        UserError: It is not installed.
    """
    try:
        return import_module(module)
    except ImportError as error:
        raise UserError(f"{what} needs {package}: pip install {package} (or 'spacearm_ident[logs]')") from error
