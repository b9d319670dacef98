"""Tasks for other processes, in a module that they import quickly."""

from __future__ import annotations

import os
import signal
from pathlib import Path


def perform(task: str) -> str:
    """In capitals; `kill` kills its process."""
    if task == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    return task.upper()


def dies_once(marker: str) -> str:
    """Killed the first time, as by someone from outside."""
    if not Path(marker).exists():
        Path(marker).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return "alive"


def variable(name: str) -> str | None:
    """Of the environment."""
    return os.environ.get(name)
