"""Entry points of the nodes (`ros2 run spacearm_ident NAME`)."""

from __future__ import annotations

import sys
from collections.abc import Sequence

NODES = ("canopen_driver", "trajectory", "identifier", "recorder", "simulated_arm")


def start(name: str, arguments: Sequence[str]) -> int:
    """Start a node by name; returns its exit code."""
    print(f"{name}: the live nodes are not in this version yet; use 'spacearm identify BAG' offline", file=sys.stderr)
    return 2


def canopen_driver() -> int:
    """Start the driver."""
    return start("canopen_driver", sys.argv[1:])


def trajectory() -> int:
    """Start the trajectory node."""
    return start("trajectory", sys.argv[1:])


def identifier() -> int:
    """Start the identifier."""
    return start("identifier", sys.argv[1:])


def recorder() -> int:
    """Start the recorder."""
    return start("recorder", sys.argv[1:])


def simulated_arm() -> int:
    """Start the simulated arm."""
    return start("simulated_arm", sys.argv[1:])
