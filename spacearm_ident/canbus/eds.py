"""Where the electronic data sheets are, in a checkout and installed."""

from __future__ import annotations

from pathlib import Path

from spacearm_ident.errors import UserError


def eds_path(name: str = "spacearm_drive.eds") -> Path:
    """The EDS `name`: a path as given, or a file of the package's `config` directory.

    Raises:
        UserError: There is no such file.
    """
    given = Path(name)
    if given.is_file():
        return given
    for parent in Path(__file__).resolve().parents:
        for folder in (parent / "config", parent / "share" / "spacearm_ident" / "config"):
            if (folder / name).is_file():
                return folder / name
    raise UserError(f"there is no EDS '{name}': give its path, or a file of the package's config directory")
