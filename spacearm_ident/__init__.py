"""Identify the dynamics of a manipulator from its recordings, and explain what the model leaves out.

    import spacearm_ident as sa

    run = sa.read("log.csv", arm="arm.urdf")
    result = sa.identify(run)

`read`, `recorded`, `identify`, `mismatch`, `compare`, `excite` and `load` come from `api`, and it with all they need
when one is first used.
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .api import Result, Run, compare, excite, identify, load, mismatch, read, recorded

__version__ = "0.1.0"
__all__ = ["Result", "Run", "__version__", "compare", "excite", "identify", "load", "mismatch", "read", "recorded"]


def __getattr__(name: str) -> Any:
    """The Python API, imported when it is asked for: a node that starts needs none of it."""
    if name in __all__:
        from . import api

        return getattr(api, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """For completion: functions that are not imported yet are there, too."""
    return sorted({*globals(), *__all__})


class _CallableModule(ModuleType):
    """The subpackage `mismatch`, which is called as `api.mismatch` besides being imported from."""

    def __call__(self, *words: Any, **options: Any) -> Any:
        """`api.mismatch`, whose arguments, result and errors these are."""
        return __getattr__("mismatch")(*words, **options)


class _Package(ModuleType):
    """This package, where `mismatch` is a subpackage and a function of the API.

    Python sets a subpackage as an attribute when it is first imported, whoever imports it, and no longer asks
    `__getattr__` for the name. The subpackage becomes callable at that moment. It cannot do so by itself: `mismatch` is
    below `api`, and imports only go down.
    """

    def __setattr__(self, name: str, value: Any) -> None:
        if name == "mismatch" and type(value) is ModuleType:
            value.__class__ = _CallableModule
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
