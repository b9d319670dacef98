"""The simulated arm's mechanics: rigid bodies, rotors, friction with true standstill, temperatures.

A step is drift-kick-drift: half a step of motion at the old velocity, all torques evaluated there (so
second order in smooth motion), the velocity kick with dry friction solved implicitly (`stick_slip`), half a
step at the new velocity. The Stribeck level is taken at the predicted mid-step speed and is bounded by f_b,
so a falling slope of thousands of N·m·s/rad makes a joint break away within a step or two instead of making
the numbers explode.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from spacearm_ident.arrays import FloatArray
from spacearm_ident.simulation.joint_law import JointLaw, StribeckLaw
from spacearm_ident.simulation.mechanism import RigidMechanism, rigid_body_model
from spacearm_ident.simulation.parameters import PlantParameters
from spacearm_ident.simulation.stick_slip import solve_stick_slip
from spacearm_ident.simulation.thermal import Thermal, ThermalParameters

if TYPE_CHECKING:
    from spacearm_ident.simulation.concealed.compliant import CompliantMechanism
    from spacearm_ident.simulation.concealed.concealment import ConcealedLaw

__all__ = ["Plant", "PlantParameters", "rigid_body_model"]


class Plant:
    """The arm as it moves; `step` it with motor torques.

    Attributes:
        parameters: What it obeys.
        thermal: Its thermal state.
        law: Friction and drive train of the joints.
        mechanism: What carries the joints.
        configuration: Of the mechanism: the joints' positions, and what else it has.
        speed: (m,) of the mechanism's degrees of freedom.
        time: s on the recording's clock; the internal step begins here.
        longest_step_s: Longer steps are divided.
    """

    def __init__(
        self,
        parameters: PlantParameters,
        *,
        position: ArrayLike | None = None,
        velocity: ArrayLike | None = None,
        law: JointLaw | None = None,
        thermal: ThermalParameters | None = None,
        longest_step_s: float = 2.5e-4,
        mechanism: CompliantMechanism | None = None,
        observer: ConcealedLaw | None = None,
        start_s: float = 0.0,
    ) -> None:
        """Start at `position` (zero unless given) and `velocity` (at rest unless given).

        Args:
            parameters: What the arm obeys.
            position: (n,) rad.
            velocity: (n,) rad/s.
            law: Friction and drive train in place of `StribeckLaw(parameters)`.
            thermal: Thermal data in place of the defaults.
            longest_step_s: Longer steps are divided.
            mechanism: What carries the joints, in place of rigid links on a fixed base.
            observer: Told before every internal step, for what has a state of its own (bristles, an oil temperature).
            start_s: Where `time` begins.

        Raises:
            UserError: Parameters and robot description do not fit.
        """
        n = len(parameters.joints)
        self.parameters = parameters
        self.time = start_s
        self.mechanism = RigidMechanism(parameters) if mechanism is None else mechanism
        self._drives = self.mechanism.drives
        m = self.mechanism.size
        self.configuration = self.mechanism.start(np.zeros(n) if position is None else np.array(position, float))
        self.speed = np.zeros(m)
        if velocity is not None:
            self.velocity = np.array(velocity, dtype=float)
        self._acceleration = np.zeros(m)
        self._still = np.zeros(m)
        self._friction_power = np.zeros(n)
        self.law: JointLaw = StribeckLaw(parameters) if law is None else law
        self._observer = observer
        self.thermal = Thermal(ThermalParameters() if thermal is None else thermal, n)
        self.longest_step_s = longest_step_s

    @property
    def position(self) -> FloatArray:
        """(n,) rad of the drives. A new array each step, safe to keep."""
        return self.mechanism.position(self.configuration)

    @property
    def velocity(self) -> FloatArray:
        """(n,) rad/s of the drives; exactly zero at joints that stick."""
        return self.speed if self._drives is None else self.speed[self._drives]

    @velocity.setter
    def velocity(self, value: FloatArray) -> None:
        self.speed = self._spread(value)

    @property
    def housing_temperature(self) -> FloatArray:
        """(n,) °C, what a joint's temperature sensor and its lubricant feel."""
        return self.thermal.housing.copy()

    @property
    def winding_temperature(self) -> FloatArray:
        """(n,) °C, of the motor windings."""
        return self.thermal.winding.copy()

    def inertia(self) -> FloatArray:
        """Joint-space inertia at the present posture, rotors included, (n, n) kg·m²."""
        return self.mechanism.joint_inertia(self.configuration)

    def load(self) -> FloatArray:
        """(n,) N·m the gears pass on to the links in the motion of the last step."""
        return self.mechanism.load(self.configuration, self.speed, self._acceleration)

    def base(self) -> FloatArray | None:
        """(13,) pose and twist of a base that moves, see `RigidMechanism.base`; None where it is fixed."""
        return self.mechanism.base(self.configuration, self.speed)

    def step(self, torque: FloatArray, dt: float) -> None:
        """Let `dt` seconds pass with the motors' output-side torque (n,) N·m held."""
        parts = max(1, math.ceil(dt / self.longest_step_s - 1e-9))
        h = dt / parts
        for _ in range(parts):
            self._step(torque, h)
        self.thermal.heat(torque, self._friction_power, dt)

    def _spread(self, values: FloatArray) -> FloatArray:
        """Values of the drives (n,) as values of all coordinates (m,), zero elsewhere."""
        if self._drives is None:
            return values
        spread = np.zeros(self.mechanism.size)
        spread[self._drives] = values
        return spread

    def _step(self, torque: FloatArray, h: float) -> None:
        if self._observer is not None:
            self._observer.begin(self, h)
        mechanism, law, warm, v = self.mechanism, self.law, self.thermal.housing, self.speed
        mechanism.time = self.time
        self.time += h
        if not np.count_nonzero(v):
            if self._holds(torque):
                return
            predicted = v
        else:
            predicted = v + 0.5 * h * self._acceleration
            # A prediction across zero would put the level on the wrong side of the Stribeck peak.
            predicted = np.where(v * predicted > 0.0, predicted, v)
        configuration = mechanism.moved(self.configuration, v, 0.5 * h)
        q = mechanism.position(configuration)
        turning = predicted if self._drives is None else predicted[self._drives]
        smooth = law.smooth_torque(q, turning, warm)
        level = law.dry_level(q, turning, warm)
        after = self._after(configuration, v, predicted, self._spread(torque - smooth), self._spread(level), h)
        self._acceleration = (after - v) / h
        self.speed = after
        self.configuration = mechanism.moved(configuration, after, 0.5 * h)
        # Springs store what they take; over a motion that cancels, and it is small beside friction.
        self._friction_power = (smooth + level * np.sign(turning)) * turning

    def _holds(self, torque: FloatArray) -> bool:
        """Whether static friction holds the whole arm, which is at rest."""
        still, warm = self._still, self.thermal.housing
        q = self.mechanism.position(self.configuration)
        no_speed = still[: len(q)]
        load = self.mechanism.bias(self.configuration, still)
        excess = np.abs(self._spread(torque - self.law.smooth_torque(q, no_speed, warm)) - load)
        if np.count_nonzero(excess > self._spread(self.law.dry_level(q, no_speed, warm))):
            return False
        self._acceleration = still
        self._friction_power = no_speed
        return True

    def _after(
        self,
        configuration: FloatArray,
        v: FloatArray,
        predicted: FloatArray,
        driving: FloatArray,
        level: FloatArray,
        h: float,
    ) -> FloatArray:
        """The new velocity: every joint moves on (nearly always), or some stick, break away or turn round."""
        joints = len(v)
        if np.count_nonzero(v) == joints or np.count_nonzero((v != 0.0) | (level == 0.0)) == joints:
            friction = level * np.sign(v)
            after = v + h * self.mechanism.acceleration(configuration, predicted, driving - friction)
            onward = after * v > 0.0
            # A joint without dry friction may reverse within the step.
            if np.count_nonzero(onward) == joints or np.count_nonzero(onward | (level == 0.0)) == joints:
                return after
        load = self.mechanism.bias(configuration, predicted)
        inertia = self.mechanism.inertia(configuration)
        momentum = inertia @ v + h * (driving - load)
        return solve_stick_slip(inertia, momentum, h * level, v)
