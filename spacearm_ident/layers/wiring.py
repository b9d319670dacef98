"""`Wiring`: gains, zeros, a delay and a tilt of the base that a recording has, and motion and torque without them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from ..arrays import FloatArray
from ..dynamics.arm import Arm
from ..dynamics.model import IdentifiedModel
from ..dynamics.regressor import rigid_body_torque
from ..recording.corrections import Corrections, JointCorrection
from ..recording.recording import Recording
from ..signals.motion import Motion

GAIN, ZERO, DELAY, TILT = "gain", "zero", "delay", "tilt"
"""Kinds of what may be off; a column is called `gain[JOINT]`, `zero[JOINT]`, `delay` or `tilt[AXIS]`."""
AXES = ("x", "y", "z")
"""Of the base frame."""


def column_names(joints: Sequence[str]) -> tuple[str, ...]:
    """Names of all columns: gains, zeros, one delay, three axes of a tilt."""
    own = [f"{kind}[{joint}]" for kind in (GAIN, ZERO) for joint in joints]
    return (*own, DELAY, *(f"{TILT}[{axis}]" for axis in AXES))


def kind_and_joint(column: str) -> tuple[str, str]:
    """What a column is of, and the joint (the axis of a tilt); none for the delay."""
    kind, _, joint = column.rstrip("]").partition("[")
    return kind, joint


def gravity_torque(model: IdentifiedModel, position: FloatArray, gravity: FloatArray) -> FloatArray:
    """(N, n) torque of a model's bodies at rest, N m.

    Args:
        model: Model with values.
        position: (N, n) rad or m.
        gravity: (3,) m/s^2, in the base's frame.
    """
    arm = model.model.arm.with_gravity(gravity)
    still = np.zeros_like(position)
    inertials = model.parameters[: 10 * len(arm.joints)].reshape(-1, 10)
    return rigid_body_torque(arm, inertials, position, still, still)


@dataclass(frozen=True)
class Wiring:
    """How a recording differs from what the arm did.

    Attributes:
        gain: (n,) recorded torque over the true one.
        zero_rad: (n,) true position less the recorded one.
        delay_s: How much later than the motion the torque was stamped.
        tilt_rad: (3,) rotation vector, base frame, by which the base stands otherwise than in the simulation.
    """

    gain: FloatArray
    zero_rad: FloatArray
    delay_s: float = 0.0
    tilt_rad: FloatArray = field(default_factory=lambda: np.zeros(3))

    @classmethod
    def right(cls, joints: int) -> Wiring:
        """Nothing is off."""
        return cls(np.ones(joints), np.zeros(joints))

    @classmethod
    def of_columns(cls, joints: Sequence[str], values: Mapping[str, float]) -> Wiring:
        """From `by_column`.

        Args:
            joints: In the arm's order.
            values: Value of every column.
        """
        gains, zeros = (np.array([values[f"{kind}[{joint}]"] for joint in joints]) for kind in (GAIN, ZERO))
        tilt = np.array([values[f"{TILT}[{axis}]"] for axis in AXES])
        return cls(np.exp(gains), zeros, values[DELAY], tilt)

    def by_column(self, joints: Sequence[str]) -> dict[str, float]:
        """Column -> the logarithm of a gain, a zero (rad), the delay (s), a tilt about an axis (rad)."""
        own = (*np.log(self.gain).tolist(), *self.zero_rad.tolist(), float(self.delay_s), *self.tilt_rad.tolist())
        return dict(zip(column_names(joints), own))

    def tilted(self, arm: Arm) -> Arm:
        """The arm under the true gravity."""
        return arm.with_gravity(Rotation.from_rotvec(-self.tilt_rad).apply(arm.gravity))

    def undone(self, motions: Sequence[Motion], model: IdentifiedModel) -> list[Motion]:
        """Motions as they would have been recorded rightly; torque is interpolated at the later times.

        Args:
            motions: As recorded.
            model: Whose bodies' weight the tilt acts on. With the tilted gravity in a fit instead, a first moment of
                the first link would be free to explain any torque along its joint.
        """
        return [self._undone(motion, model) for motion in motions]

    def _undone(self, motion: Motion, model: IdentifiedModel) -> Motion:
        torque = motion.torque
        if self.delay_s:
            time = np.arange(len(torque)) / motion.rate_hz
            torque = np.column_stack([np.interp(time + self.delay_s, time, one) for one in torque.T])
        right = replace(motion, position=motion.position + self.zero_rad)
        return replace(right, torque=torque / self.gain - self.by_tilt(right, model))

    def by_tilt(self, motion: Motion, model: IdentifiedModel) -> FloatArray:
        """(N, n) what the tilt adds to the torque of a model's bodies; zero where the base's motion is known.

        Args:
            motion: N samples.
            model: With the bodies.
        """
        if motion.base is not None:
            return np.zeros_like(motion.torque)
        return self._by_tilt(motion.position, model)

    def _by_tilt(self, position: FloatArray, model: IdentifiedModel) -> FloatArray:
        if not self.tilt_rad.any():
            return np.zeros_like(position)
        arm = model.model.arm
        return gravity_torque(model, position, self.tilted(arm).gravity - arm.gravity)

    def without_tilt(self, recording: Recording, model: IdentifiedModel) -> Recording:
        """A recording, right but for the tilt, with the torque that it would have without (arguments as `undone`)."""
        if recording.base is not None or not self.tilt_rad.any():
            return recording
        order = [recording.joints.index(joint) for joint in model.model.arm.joint_names]
        effort = recording.effort.copy()
        effort[:, order] -= self._by_tilt(recording.position[:, order], model)
        return replace(recording, effort=effort)

    def corrections(self, joints: Sequence[str]) -> Corrections:
        """The same as corrections of a recording."""
        return Corrections(
            {
                name: JointCorrection(
                    position_offset_rad=float(self.zero_rad[k]),
                    effort_scale=float(1.0 / self.gain[k]),
                    effort_delay_s=self.delay_s,
                )
                for k, name in enumerate(joints)
            }
        )
