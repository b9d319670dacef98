"""A run as the text of a `trajectory_msgs/msg/JointTrajectory`, for `ros2 topic pub`.

That tool takes a message as one YAML document: as an argument, and from standard input with `--stdin` (Jazzy) or from
a file with `--yaml-file` (later releases). Lists in one line keep the text small.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from spacearm_ident.documents import write_whole
from spacearm_ident.errors import UserError, one_line
from spacearm_ident.excitation.trajectory import Trajectory

PATH_RATE_HZ = 50.0
"""Points a second of a path a controller interpolates between, with velocities and accelerations: its quintics are then
off by h⁶/46080 of the sixth derivative, 6e-9 rad for a sine of 1 rad at 2 Hz."""
SETTLE_S = 0.5
"""Time the controller has to come from where it holds the arm to where the path begins: it may hold it some
milliradians beside, and a quintic over this time asks 5.8/T² = 23 rad/s² for a radian, 0.02 rad/s² for one of these."""
_DIGITS = 9


def joint_trajectory_yaml(run: Trajectory, rate_hz: float = PATH_RATE_HZ) -> str:
    """The message as YAML.

    Args:
        run: From rest to rest.
        rate_hz: Points a second.
    """
    times = np.arange(math.ceil(run.duration_s * rate_hz) + 1) / rate_hz
    motion = run.evaluate(np.minimum(times, run.duration_s))
    lines = [f"joint_names: [{', '.join(map(_name, run.joints))}]", "points:"]
    for row, time_s in enumerate(times.tolist()):
        nanoseconds = round(1e9 * (time_s + SETTLE_S))
        lines += [
            f"- positions: {_list(motion.q[row].tolist())}",
            f"  velocities: {_list(motion.qd[row].tolist())}",
            f"  accelerations: {_list(motion.qdd[row].tolist())}",
            f"  time_from_start: {{sec: {nanoseconds // 10**9}, nanosec: {nanoseconds % 10**9}}}",
        ]
    return "\n".join(lines) + "\n"


def save_joint_trajectory(run: Trajectory, path: Path, origin: Sequence[str] = ()) -> None:
    """Write the message to a file.

    Args:
        run: From rest to rest.
        path: Where to; a file that is there is replaced, whole or not at all.
        origin: How it was made: lines of comment at its head.

    Raises:
        UserError: The file cannot be written.
    """
    head = "".join(f"# {one_line(line)}\n" for line in origin)
    try:
        write_whole(path, head + joint_trajectory_yaml(run))
    except OSError as error:
        raise UserError(f"{path}: cannot be written ({error}); choose another place") from error


def _name(joint: str) -> str:
    return "'" + joint.replace("'", "''") + "'"


def _list(values: list[float]) -> str:
    # Always with a point: the tool does not take a whole number for a double in a list.
    return "[" + ", ".join(repr(float(round(value, _DIGITS)) + 0.0) for value in values) + "]"
