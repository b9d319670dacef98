"""A small arm in MuJoCo for tests: its MJCF, and recordings of it along a smooth motion by inverse dynamics."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from spacearm_ident.recording import Recording
from spacearm_ident.signals.motion import Motion

JOINTS = ("base_turn", "shoulder", "elbow")
LENGTHS = (0.3, 0.25)


def mujoco_or_skip() -> ModuleType:
    """MuJoCo, or the test is skipped."""
    return pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'spacearm_ident[mujoco]'")


def inverse_in_mujoco(path: Path, motion: Motion) -> np.ndarray:
    """(N, n) torque that MuJoCo's inverse dynamics asks of the motors."""
    mujoco = mujoco_or_skip()
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
    torque = np.empty_like(motion.position)
    for k in range(len(torque)):
        data.qpos[:], data.qvel[:], data.qacc[:] = motion.position[k], motion.velocity[k], motion.acceleration[k]
        mujoco.mj_inverse(model, data)
        torque[k] = data.qfrc_inverse
    return torque


def mjcf(**changes: float) -> str:
    """The arm's MJCF; `upper_mass`, `fore_mass`, `fore_y`, `damping`, `friction`, `armature` may be changed."""
    value = {
        **{"upper_mass": 3.0, "fore_mass": 1.8, "fore_y": 0.01, "damping": 0.6, "friction": 0.8, "armature": 0.05},
        **changes,
    }
    joint = f'damping="{value["damping"]}" frictionloss="{value["friction"]}" armature="{value["armature"]}"'
    return f"""<mujoco model="three">
  <compiler angle="radian"/>
  <option timestep="0.001"/>
  <worldbody>
    <body name="post" pos="0 0 0.2">
      <inertial pos="0 0 0.05" mass="4" diaginertia="0.02 0.02 0.015"/>
      <joint name="base_turn" axis="0 0 1" {joint}/>
      <body name="upper" pos="0 0.05 0.1" quat="0.7071067811865476 0.7071067811865476 0 0">
        <inertial pos="0.14 0.01 0.02" mass="{value["upper_mass"]}" fullinertia="0.006 0.03 0.03 0.001 0 0.0005"/>
        <joint name="shoulder" axis="0 0 1" pos="0 0 0.01" ref="0.2" {joint}/>
        <body name="fore" pos="{LENGTHS[0]} 0 -0.03">
          <inertial pos="0.1 {value["fore_y"]} 0.01" mass="{value["fore_mass"]}" diaginertia="0.002 0.012 0.012"/>
          <joint name="elbow" axis="0 0 1" {joint}/>
          <body name="hand" pos="{LENGTHS[1]} 0 0" euler="0.3 0.2 0">
            <inertial pos="0 0 0.03" mass="0.4" diaginertia="0.0004 0.0004 0.0002"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def inverse(text: str, position: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray) -> np.ndarray:
    """(N, n) torque by MuJoCo's recursive Newton-Euler, armature, damping and Coulomb friction sgn(q')."""
    mujoco = mujoco_or_skip()
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    data, torque = mujoco.MjData(model), np.empty_like(position)
    for row, state in enumerate(zip(position, velocity, acceleration)):
        data.qpos[:], data.qvel[:], data.qacc[:] = state
        mujoco.mj_inverse(model, data)
        torque[row] = data.qfrc_inverse
    return np.asarray(torque + np.array(model.dof_frictionloss) * np.sign(velocity))


def recorded(text: str, seed: int = 0, seconds: float = 24.0, noise_Nm: float = 0.02) -> Recording:
    """A recording of the arm along a sum of sines, with white noise on its torque."""
    rng, rate_hz = np.random.default_rng(seed), 200.0
    time = np.arange(int(seconds * rate_hz)) / rate_hz
    position, velocity, acceleration = np.zeros((3, len(time), 3))
    for joint in range(3):
        for harmonic in range(1, 6):
            omega = 2 * np.pi * 0.12 * harmonic
            size, phase = rng.uniform(0.2, 0.5) / harmonic**0.7, rng.uniform(0, 2 * np.pi)
            position[:, joint] += size * np.sin(omega * time + phase)
            velocity[:, joint] += size * omega * np.cos(omega * time + phase)
            acceleration[:, joint] -= size * omega**2 * np.sin(omega * time + phase)
    torque = inverse(text, position, velocity, acceleration) + noise_Nm * rng.normal(size=position.shape)
    return Recording(
        time=time, joints=JOINTS, position=position, velocity=velocity, effort=torque, segments=(slice(0, len(time)),)
    )


def pushed(
    recording: Recording, text: str, force_N: tuple[float, float, float], begin_s: float, end_s: float
) -> Recording:
    """The recording with a force on the hand that comes and goes as a raised cosine: the motors give -J^T F more."""
    mujoco = mujoco_or_skip()
    model = mujoco.MjModel.from_xml_string(text)
    data, across = mujoco.MjData(model), np.zeros((3, model.nv))
    hand, effort = model.body("hand").id, recording.effort.copy()
    for row in np.flatnonzero((recording.time > begin_s) & (recording.time < end_s)):
        data.qpos[:] = recording.position[row]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_jacBody(model, data, across, None, hand)
        rises = 0.5 - 0.5 * np.cos(2 * np.pi * (recording.time[row] - begin_s) / (end_s - begin_s))
        effort[row] -= rises * across.T @ np.array(force_N)
    return replace(recording, effort=effort)
