"""How friction turns round, against made reversals of which the law is known."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from spacearm_ident.mismatch.reversals import IN_TIME, OVER_DISTANCE, in_time, learnt, over_distance

RATE, NOISE = 250.0, 2e-3
TIME = np.arange(0.0, 20.0, 1 / RATE)
LEVEL = 5.0


def moved(speed):
    """A joint at this speed (N,), and another that never moves."""
    velocity = np.stack([speed, 0.0 * speed], axis=1)
    return SimpleNamespace(
        joints=("hip", "knee"),
        velocity=velocity,
        rate_hz=RATE,
        speed_noise=np.full(2, NOISE),
        cyclic=False,
        torque=np.zeros_like(velocity),
    )


def sticking(seconds):
    """It swings one way for a second, stands that long, and swings the other way."""
    since, swings = TIME % (1.0 + seconds), np.floor(TIME / (1.0 + seconds))
    return np.where(since < 1.0, 0.3 * np.sin(np.pi * since), 0.0) * (-1.0) ** swings


@pytest.mark.parametrize("power", [1.0, 2.0])
def test_while_a_joint_stands_friction_goes_from_what_it_was_to_what_moves_it_on(power):
    """With a power of the time; before the first motion and after the last it stays."""
    speed = np.array([0, -1, -1, 0, 0, 0, 0, 1, 1, 0, 0, 1, 0], float)
    friction = 3.0 * np.sign(speed)
    turned = in_time(power)(moved(speed), 0, friction)
    np.testing.assert_allclose(turned[2:8], -3.0 + 6.0 * (np.arange(6) / 5) ** power)
    np.testing.assert_array_equal(turned[[0, 1, 8, 9, 10, 11, 12]], [-3.0, -3.0, 3.0, 3.0, 3.0, 3.0, 3.0])
    np.testing.assert_array_equal(friction, 3.0 * np.sign(speed), "what was given")


def creeping(distance):
    """A slow sine, below the noise of its speed for long around its ends, and friction that builds up over there."""
    position = 0.02 * np.sin(0.6 * TIME)
    speed = np.gradient(position) * RATE
    state, friction = 0.0, []
    for step in np.diff(position, prepend=position[0]):
        state += (np.sign(step) - state) * -np.expm1(-abs(step) / distance)
        friction.append(LEVEL * state)
    return moved(speed), np.array(friction)


@pytest.mark.parametrize("distance", [5e-5, 2e-4])
def test_where_it_gives_way_friction_builds_up_over_a_distance_that_no_speed_shows(distance):
    motion, true = creeping(distance)
    jumps = LEVEL * np.sign(motion.velocity[:, 0]) * (np.abs(motion.velocity[:, 0]) > NOISE)
    turned = over_distance(distance)(motion, 0, jumps)
    settled = TIME > 3.0
    assert np.abs(turned - true)[settled].max() < 0.12 * LEVEL < 0.5 * np.abs(jumps - true)[settled].max()


@pytest.mark.parametrize("way", [IN_TIME[0], IN_TIME[2], OVER_DISTANCE[4], OVER_DISTANCE[9]])
def test_the_way_is_learnt_from_what_was_measured_around_reversals(way):
    """Of a joint that sticks, or gives way over some distance; noise and the rest of the torque do not matter."""
    motion = moved(sticking(0.3)) if way in IN_TIME else creeping(1e-4)[0]
    speed = motion.velocity[:, 0]
    jumps = np.stack([LEVEL * np.sign(speed) * (np.abs(speed) > NOISE), 0.0 * speed], axis=1)
    load = np.stack([40.0 * np.sin(TIME), 0.0 * TIME], axis=1)
    friction = way(motion, 0, jumps[:, 0])
    noise = 0.3 * np.random.default_rng(1).standard_normal(len(TIME))
    motion.torque = load + np.stack([friction + noise, 0.0 * TIME], axis=1)
    ways = learnt([motion, motion], [(load, jumps), (load, jumps)])
    assert ways[0] is way
