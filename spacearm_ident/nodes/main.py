"""Entry points of the nodes (`ros2 run spacearm_ident NAME`, or `spacearm node NAME`).

Each node is the module of its name in this package, with a `main(arguments) -> int`. It is imported when it
is started, and only then is ROS 2 needed.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Sequence

from .ending import heed_signals

RESTARTS = 3
"""Default of the trajectory node's `restarts`: a machine that breaks off a run four times is not fit for it."""
NODES = ("canopen_driver", "trajectory", "identifier", "recorder", "simulated_arm")

_HELP = """Parameters: --ros-args -p NAME:=VALUE ..., or --ros-args --params-file FILE (see config/spacearm.yaml);
while it runs, `ros2 param list /{name}` and `ros2 param describe /{name} PARAMETER` say what they mean."""


def start(name: str, arguments: Sequence[str]) -> int:
    """Start a node by name; returns its exit code (2 where it cannot start, with the reason on stderr).

    Args:
        name: One of `NODES`, a module of this package.
        arguments: Of the command line, ROS arguments included; with `-h` or `--help` the node's help is printed
            instead.
    """
    try:
        heed_signals()  # before the imports, which take most of a second
        node = importlib.import_module(f"{__package__}.{name}")
        if {"-h", "--help"} & set(arguments):
            print(f"{node.__doc__}\n{_HELP.format(name=name)}")
            return 0
        return int(node.main(arguments))
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        print(
            f"{name}: the Python package {package!r} is missing; source a ROS 2 Jazzy setup file, or install "
            "spacearm_ident with its extra 'ros' (offline commands such as 'spacearm identify' need no ROS)",
            file=sys.stderr,
        )
        return 2


def _script(name: str) -> Callable[[], int]:
    """What the console script of a node calls (setup.py)."""
    return lambda: start(name, sys.argv[1:])


canopen_driver, trajectory, identifier, recorder, simulated_arm = map(_script, NODES)
