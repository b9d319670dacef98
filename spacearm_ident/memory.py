"""Memory that this process no longer needs."""

from __future__ import annotations

import ctypes


def give_back() -> None:
    """Return freed memory to the system; nothing where the C library has no `malloc_trim(3)`, which is glibc's.

    Arrays of less than 32 MB come from a heap that shrinks from its end alone.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
