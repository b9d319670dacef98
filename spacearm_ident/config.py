"""Where the package's configuration files are: beside a checkout, or in the installed share folder."""

from __future__ import annotations

import sys
import sysconfig
from pathlib import Path

from .errors import UserError


def config_path(name: str) -> Path:
    """The path of a file in config/.

    Raises:
        UserError: It is neither in the checkout nor installed.
    """
    package = Path(__file__).resolve().parent
    roots = [
        package.parent / "config",
        # colcon installs to <prefix>/lib/pythonX.Y/site-packages and <prefix>/share.
        *(parent / "share" / "spacearm_ident" / "config" for parent in package.parents),
        Path(sysconfig.get_path("data")) / "share" / "spacearm_ident" / "config",
        Path(sys.prefix) / "share" / "spacearm_ident" / "config",
    ]
    for root in roots:
        if (root / name).is_file():
            return root / name
    raise UserError(f"the configuration file {name} is not installed: reinstall spacearm_ident")
