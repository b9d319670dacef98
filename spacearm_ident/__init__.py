"""Identify the dynamics of a manipulator from its recordings, and explain what the model leaves out.

    import spacearm_ident as sa

    run = sa.read("log.csv", arm="arm.urdf")
    result = sa.identify(run)

`read`, `identify`, `mismatch`, `excite` and `load` come from `api`, and it with all they need when one is first used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .api import Result, Run, excite, identify, load, mismatch, read

__version__ = "0.1.0"
__all__ = ["Result", "Run", "__version__", "excite", "identify", "load", "mismatch", "read"]


def __getattr__(name: str) -> Any:
    """The Python API, imported when it is asked for: a node that starts needs none of it."""
    if name in __all__:
        from . import api

        return getattr(api, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
