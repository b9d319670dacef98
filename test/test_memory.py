"""Freed memory goes back to the system although what lies between it is kept."""

import ctypes
import os
import subprocess
import sys

import pytest

FREED_BETWEEN_KEPT = """
import ctypes
from spacearm_ident.memory import give_back

def resident():
    with open("/proc/self/statm") as numbers:
        return int(numbers.read().split()[1])

blocks = [ctypes.create_string_buffer(2000) for _ in range(50_000)]
kept = blocks[::50]
del blocks
before = resident()
give_back()
print(before, resident())
"""


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "malloc_trim"), reason="this C library has no malloc_trim")
def test_memory_freed_between_what_is_kept_is_returned() -> None:
    done = subprocess.run([sys.executable, "-c", FREED_BETWEEN_KEPT], capture_output=True, text=True, check=True)
    before, after = map(int, done.stdout.split())
    pages = 50_000 * 2000 / os.sysconf("SC_PAGESIZE")
    assert before - after > 0.8 * pages
