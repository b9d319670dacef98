"""ROS domains of this process of tests, which none of those that run beside it has.

Runs of pytest on one machine are told apart by process, workers of one run (pytest-xdist) by their number.
"""

import os

USES = ("graph", "driven arm", "workspace", "beside the workspace", "clean")
"""What a process wants a domain for at the same time; the last is one on which nothing of the session stays."""
FIRST, BLOCKS = 30, 14
"""`spacearm demo` takes one below 30, and from 102 on the ports are those that Linux gives to anybody."""


def domain(use: str) -> str:
    """The number, for `ROS_DOMAIN_ID`, of this process's domain for one of `USES`."""
    worker = os.environ.get("PYTEST_XDIST_WORKER", "")
    block = (os.getppid() + int(worker.removeprefix("gw")) if worker else os.getpid()) % BLOCKS
    return str(FIRST + len(USES) * block + USES.index(use))
