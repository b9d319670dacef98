"""How hostile input must end, and how much of it is drawn."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
from collections.abc import Callable

from hypothesis import HealthCheck, settings

from spacearm_ident.errors import LONGEST, UserError

FUZZ = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture])
SAME = os.environ.get("HYPOTHESIS_PROFILE", "same") == "same"
EXAMPLES = settings(FUZZ, max_examples=60 if SAME else 1500)
FEW = settings(FUZZ, max_examples=15 if SAME else 300)
"""For what reads a data sheet every time."""


def ends_well(read: Callable[[], object]) -> object | None:
    """What is read, or None where it is refused as it should be; anything else that is raised fails the test."""
    try:
        return read()
    except UserError as error:
        text = str(error)
        assert text and text.isprintable() and len(text) <= LONGEST + 10, text
        return None


def in_child(code: str, gigabytes: float = 1.5, seconds: float = 120.0) -> str:
    """Run code in a process that may hold only so much memory; its last line on stdout."""
    limit = f"import resource; resource.setrlimit(resource.RLIMIT_AS, ({int(gigabytes * 2**30)},) * 2)\n"
    run = subprocess.run(
        [sys.executable, "-c", limit + textwrap.dedent(code)], capture_output=True, text=True, timeout=seconds
    )
    assert run.returncode == 0, run.stderr[-2000:]
    return run.stdout.strip().splitlines()[-1]
