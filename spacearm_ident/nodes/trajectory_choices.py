"""What may be chosen by the trajectory node's parameters."""

from __future__ import annotations

from typing import Final

from .choices import Choices

JOINT_COMMAND: Final = "joint_command"
JOINT_TRAJECTORY: Final = "joint_trajectory"
FORWARD_POSITIONS: Final = "forward_positions"
OUTPUT: Final = Choices((JOINT_COMMAND, JOINT_TRAJECTORY, FORWARD_POSITIONS))
BY_DRIVER: Final = "driver"
BY_CONTROLLER: Final = "controller"
BY_TOPIC: Final = "topic"
ENABLED_FROM: Final = Choices((BY_DRIVER, BY_CONTROLLER, BY_TOPIC))
