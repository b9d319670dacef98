"""Entry points of the nodes (`ros2 run spacearm_ident NAME`, or `spacearm node NAME`).

Each node is the module of its name in this package, with a `main(arguments) -> int`. It is imported when it
is started, and only then is ROS 2 needed.
"""

from __future__ import annotations

import importlib
import importlib.util
import sys
from collections.abc import Sequence

from .ending import heed_signals

RESTARTS = 3
"""Default of the trajectory node's `restarts`: a machine that breaks off a run four times is not fit for it."""
NODES = ("canopen_driver", "trajectory", "identifier", "recorder", "simulated_arm")

_HELP = """Parameters: --ros-args -p NAME:=VALUE ..., or --ros-args --params-file FILE (see config/spacearm.yaml);
while it runs, `ros2 param list /{name}` and `ros2 param describe /{name} PARAMETER` say what they mean."""


def start(name: str, arguments: Sequence[str]) -> int:
    """Start a node by name; returns its exit code (2 where it cannot start, with the reason on stderr)."""
    module = f"{__package__}.{name}"
    if importlib.util.find_spec(module) is None:
        print(f"{name}: this node is not in this version yet; use 'spacearm identify BAG' offline", file=sys.stderr)
        return 2
    try:
        heed_signals()  # before the imports, which take most of a second
        node = importlib.import_module(module)
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
