"""The paper's arm behind the simulated drives, in real time: plant, inner loops and current sensors.

The drives give a demand once a step (they have interpolated the set-points with 0x60C2); the inner loops run
several times within it. A reported torque is the mean of what the motor gave a servo cycle before and after
the moment the position is of, so both belong to the same SYNC: a torque of the interval before would be a
delay, which identification answers with a biased viscosity.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike
from scipy.signal import lfilter

from spacearm_ident.arrays import BoolArray, FloatArray
from spacearm_ident.dynamics.arm import Arm
from spacearm_ident.simulation.closed_loop import SensorNoise, plant_of
from spacearm_ident.simulation.concealed.concealment import Concealment
from spacearm_ident.simulation.joint_law import JointLaw
from spacearm_ident.simulation.plant import PlantParameters
from spacearm_ident.simulation.servo import DriveData, Servo, ServoTuning
from spacearm_ident.simulation.thermal import ThermalParameters

PEAK = 1.2
"""What the drives can give, as a multiple of the arm's torque limit: the limit is the arm's, not the motor's."""
BRAKE = 2.0
"""Holding torque of a closed brake, same unit."""
FEEDFORWARD = 4.0
"""How fast the velocity feedforward may change, as a multiple of the arm's acceleration limit: a set-point that a
busy machine delivers a millisecond late must not hit the gears."""
LOOP_HZ = 1000.0
"""Of the inner loops and the physics: twenty-five times the bandwidth of the velocity loop. At 2 and at 4 kHz, which
cost twice and four times as much, the torque differs from inverse dynamics by as much as here (0.02 to 0.5 % RMS);
with joints at rest, which are the dearest, the whole arm may not need more of a core than a busy machine has."""
_TEMPERATURE_STEPS = 100
_NOISE_STEPS = 100


class BrakedLaw:
    """A joint law with holding brakes: a closed brake is dry friction.

    Attributes:
        extra: (n,) N·m of the brakes now.
    """

    def __init__(self, law: JointLaw, joints: int) -> None:
        self._law = law
        self.extra = np.zeros(joints)

    def dry_level(self, q: FloatArray, qd: FloatArray, temperature: FloatArray) -> FloatArray:
        """Dry friction of the joint and its brake, (n,) N·m."""
        return self._law.dry_level(q, qd, temperature) + self.extra

    def smooth_torque(self, q: FloatArray, qd: FloatArray, temperature: FloatArray) -> FloatArray:
        """As without brake, (n,) N·m."""
        return self._law.smooth_torque(q, qd, temperature)


class LiveArm:
    """The physics behind the drives: motors, inner loops and arm of n joints; output side, SI.

    Attributes:
        plant: The arm as it moves.
        position: (n,) rad; true but for what is hidden in the encoders.
        velocity: (n,) rad/s, true.
        torque: (n,) N·m that the drives believe to produce: measured current × nominal torque constant × gear ratio,
            noise included; zero without power. Where the true constant differs, only the physics knows.
        temperature: (n,) °C of the windings.
    """

    def __init__(
        self,
        parameters: PlantParameters,
        arm: Arm,
        *,
        position: ArrayLike | None = None,
        noise: SensorNoise | None = None,
        seed: int = 0,
        ambient: float = 20.0,
        hidden: Concealment | None = None,
    ) -> None:
        """Start at rest with the brakes closed.

        Args:
            parameters: What the arm obeys.
            arm: Gear ratios, torque constants and torque limits.
            position: (n,) rad where it starts; zero unless given.
            noise: Sensors; of the current only, for the encoder's resolution is the drive's.
            seed: Of the noise.
            ambient: Temperature of the surroundings, and of the arm at the start, °C.
            hidden: Physics that the parameters do not tell of, but for what only a finished recording can show
                (`reported`).

        Raises:
            UserError: Parameters and robot description do not fit.
        """
        n = len(parameters.joints)
        self._noise = SensorNoise() if noise is None else noise
        tuning = ServoTuning(rate_hz=LOOP_HZ)
        limit = np.array([joint.effort_limit for joint in arm.joints])
        drives = _drives(arm, PEAK * limit)
        thermal = ThermalParameters(drives.copper_loss, ambient=ambient)
        start = np.zeros(n) if position is None else np.array(position, dtype=float)
        self.plant = plant_of(parameters, start, thermal, hidden)
        self.plant.longest_step_s = 1.0 / tuning.rate_hz
        # A brake is outside of all that may be hidden in the joint.
        self.plant.law = self._law = BrakedLaw(self.plant.law, n)
        self._hidden = hidden
        self._servo = Servo(np.diag(self.plant.inertia()), drives, tuning, self.plant.position)
        self._holding = BRAKE * np.where(np.isfinite(limit), limit, 1e3)
        self._scale = np.where(np.isfinite(limit), limit, 0.0)
        self._slew = FEEDFORWARD * np.array([joint.acceleration_limit for joint in arm.joints])
        self._rate = np.zeros(n)
        self._rng = np.random.default_rng(seed)
        self._coloured = np.zeros((1, n))
        self._errors: Iterator[FloatArray] = iter(())
        self._motor = np.zeros(n)
        self._target = self.plant.position
        self._was_enabled = np.zeros(n, dtype=bool)
        self._steps = 0
        self.position = self.plant.position
        self.velocity = self.plant.velocity
        self.torque = np.zeros(n)
        self.temperature = self.plant.winding_temperature

    def step(self, target: FloatArray, enabled: BoolArray, brake: BoolArray, dt: float) -> None:
        """Let `dt` seconds pass.

        Args:
            target: (n,) rad, what the position loops shall follow.
            enabled: (n,) whether the loop is closed; without it the motor has no current.
            brake: (n,) whether the holding brake is closed.
            dt: Seconds.
        """
        plant, servo, hidden = self.plant, self._servo, self._hidden
        self._law.extra = brake * self._holding
        start = np.where(self._was_enabled, self._target, target)
        move, parts = target - start, max(1, round(dt / servo.dt))
        change = np.minimum(np.maximum(move / dt - self._rate, -self._slew * dt), self._slew * dt)
        # What is multiplied by it is zero without power; quicker than a choice, as all here of so few numbers.
        powered = enabled.astype(float)
        rate_before = powered * self._rate
        rate = self._rate = powered * (self._rate + change)
        before = self._motor
        self._motor = powered * self._motor
        for part in range(1, parts + 1):
            before = self._motor
            plant.step(before if hidden is None else hidden.motor(before, plant), dt / parts)
            share = part / parts
            # The feedforward ramps, too: a staircase of it would show as a sawtooth of the torque, of which one
            # sample a step always sees the same tooth; a twentieth of the inertia would be missing.
            wanted = servo.torque(self._seen(), start + share * move, rate_before + share * (rate - rate_before))
            self._motor = powered * wanted
        self._target, self._was_enabled = target.copy(), enabled.copy()
        self.position, self.velocity = self._seen(), plant.velocity
        self.torque = powered * (0.5 * (before + self._motor) + self._sensor_error(dt))
        self._steps += 1
        if self._steps % _TEMPERATURE_STEPS == 0:
            self.temperature = plant.winding_temperature

    def _seen(self) -> FloatArray:
        """What the encoders show, (n,) rad."""
        position = self.plant.position
        return position if self._hidden is None else self._hidden.encoder(position)

    def _sensor_error(self, dt: float) -> FloatArray:
        """Error of the torque from current in the next step of `dt` seconds, (n,) N·m."""
        error = next(self._errors, None)
        if error is None:
            self._errors = iter(self._sensor_errors(dt))
            error = next(self._errors)
        return error

    def _sensor_errors(self, dt: float) -> FloatArray:
        """White and coloured noise of the torque from current in `_NOISE_STEPS` steps to come, (steps, n) N·m."""
        noise = self._noise
        keep = np.exp(-dt / noise.effort_correlation_s)
        white, drive = np.moveaxis(self._rng.standard_normal((_NOISE_STEPS, 2, len(self._scale))), 1, 0)
        share = np.sqrt(1.0 - keep * keep)
        coloured, _ = lfilter([share], [1.0, -keep], drive, axis=0, zi=keep * self._coloured)
        self._coloured = coloured[-1:]
        errors: FloatArray = self._scale * (noise.effort_white * white + noise.effort_coloured * coloured)
        return errors


def _drives(arm: Arm, torque_limit: FloatArray) -> DriveData:
    """What servo and windings know of the drives; torque limits (n,) N·m on the output side."""
    return DriveData.plain(
        len(arm.joints),
        gear_ratio=[joint.gear_ratio for joint in arm.joints],
        torque_constant=[joint.torque_constant for joint in arm.joints],
        torque_limit=torque_limit,
    )
