"""`spacearm node NAME`: start a node where there is no `ros2 run`."""

from __future__ import annotations

import argparse

from ..nodes.main import NODES, start


def add(command: argparse.ArgumentParser) -> None:
    """Add the command's options to its parser."""
    command.description = "Start one of the ROS 2 nodes."
    command.add_argument("name", choices=NODES, help="which node")
    command.add_argument("arguments", nargs=argparse.REMAINDER, help="passed on, such as --ros-args ...")
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Start it."""
    return start(options.name, options.arguments)
