"""Which joints are said to have no effort while joint states come in."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2 (or its wheels: pip install spacearm_ident[ros])")

from spacearm_ident.nodes.joint_samples import EffortWatch
from spacearm_ident.recording import cdr

NAMES = ("shoulder", "elbow", "finger_joint", "other_arm")


def states(lacking: tuple[str, ...], moving: tuple[str, ...], low: float = 0.0, high: float = 0.3) -> list[bytes]:
    """Fifty messages in which some joints move from `low` to `high`, and some have no effort."""
    position = np.linspace(low, high, 50)[:, None] * np.array([name in moving for name in NAMES])
    effort = np.where([name in lacking for name in NAMES], np.nan, np.ones((50, len(NAMES))))
    return cdr.encode_joint_states(list(range(1, 51)), NAMES, position, None, effort)


def test_a_joint_of_the_arm_that_moves_without_effort_is_named():
    watch = EffortWatch()
    watch.look(states(NAMES[1:], NAMES), NAMES[:3])
    assert watch.moving == ("elbow",) and watch.absent == ()  # not the gripper's, nor another arm's
    watch.look(states((), NAMES), NAMES[:3])
    assert watch.moving == ()


def test_a_joint_that_stands_still_without_effort_is_sound():
    watch = EffortWatch()
    watch.look(states(("elbow",), ("shoulder",)), NAMES[:2])
    assert watch.moving == () and watch.absent == ()


def test_motion_adds_up_over_looks_and_begins_anew_with_a_run():
    watch = EffortWatch()
    for low in (0.0, 0.015):
        watch.look(states(("elbow",), NAMES, low, low + 0.015), NAMES[:2])
    assert watch.moving == ("elbow",)
    watch.forget()
    watch.look(states(("elbow",), NAMES, 0.03, 0.04), NAMES[:2])
    assert watch.moving == ()


def test_no_effort_of_any_joint_is_told_apart():
    watch = EffortWatch()
    watch.look(states(NAMES, NAMES), ())
    assert watch.absent == NAMES and watch.moving == ()
