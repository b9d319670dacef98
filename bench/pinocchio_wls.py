"""Weighted least squares with Pinocchio and numpy, as one writes it oneself: a contestant of `peers.py`."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from scipy.signal import butter, decimate, sosfiltfilt

from spacearm_ident.arrays import FloatArray
from spacearm_ident.dynamics.arm import Arm
from spacearm_ident.recording import Recording
from spacearm_ident.signals.motion import Motion


class Pinocchio:
    """A fitted model: Coulomb and viscous friction, rotor inertia and offset by joint beside the rigid body."""

    def __init__(self, arm: Arm, recordings: list[Recording], cutoff_hz: float) -> None:
        self.model = pin.buildModelFromXML(arm.urdf)
        matrices, sides = zip(*(self._rows(recording.in_order(arm.joint_names), cutoff_hz) for recording in recordings))
        matrix, side = np.concatenate(matrices), np.concatenate(sides)
        weight = np.ones(side.shape[1])
        for _ in range(2):
            scaled = (matrix * weight[:, None]).reshape(-1, matrix.shape[2])
            self.parameters = np.linalg.lstsq(scaled, (side * weight).ravel(), rcond=1e-8)[0]
            weight = 1.0 / np.std(side - matrix @ self.parameters, axis=0)

    def _rows(self, recording: Recording, cutoff_hz: float) -> tuple[FloatArray, FloatArray]:
        """Columns and torque, low-passed alike, thinned out, without the filter's edges."""
        sos = butter(4, cutoff_hz, fs=recording.rate_hz, output="sos")
        position = sosfiltfilt(sos, recording.position, axis=0)
        velocity = np.gradient(position, 1.0 / recording.rate_hz, axis=0)
        matrix = self.columns(position, velocity, np.gradient(velocity, 1.0 / recording.rate_hz, axis=0))
        step = int(recording.rate_hz / (4 * cutoff_hz))
        inner = slice(int(0.5 * recording.rate_hz / step), -int(0.5 * recording.rate_hz / step))
        thin = [decimate(signal, step, ftype="fir", axis=0)[inner] for signal in (matrix, recording.effort)]
        return thin[0], thin[1]

    def columns(self, position: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
        """(N, n, 14 n) rigid-body, Coulomb, viscous, rotor and offset columns."""
        data, joints = self.model.createData(), position.shape[1]
        whole = np.zeros((len(position), joints, 14 * joints))
        for row, state in zip(whole, zip(position, velocity, acceleration)):
            row[:, : 10 * joints] = pin.computeJointTorqueRegressor(self.model, data, *state)
        own = np.arange(joints)
        for k, signal in enumerate((np.sign(velocity), velocity, acceleration, np.ones_like(velocity))):
            whole[:, own, (10 + k) * joints + own] = signal
        return whole

    def torque(self, motion: Motion) -> FloatArray:
        """(N, n) predicted torque."""
        return np.asarray(self.columns(motion.position, motion.velocity, motion.acceleration) @ self.parameters)
