"""The simulated arm's mechanics: rigid bodies, rotors, friction with true standstill, temperatures.

A step is drift-kick-drift: half a step of motion at the old velocity, all torques evaluated there (so
second order in smooth motion), the velocity kick with dry friction solved implicitly (`stick_slip`), half a
step at the new velocity. The Stribeck level is taken at the predicted mid-step speed and is bounded by f_b,
so a falling slope of thousands of N·m·s/rad makes a joint break away within a step or two instead of making
the numbers explode.
"""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from spacearm_ident.errors import UserError
from spacearm_ident.simulation.joint_law import JointLaw, StribeckLaw
from spacearm_ident.simulation.parameters import PlantParameters
from spacearm_ident.simulation.stick_slip import solve_stick_slip
from spacearm_ident.simulation.thermal import Thermal, ThermalParameters

FloatArray = NDArray[np.float64]

__all__ = ["Plant", "PlantParameters", "rigid_body_model"]


def rigid_body_model(parameters: PlantParameters) -> pin.Model:
    """Pinocchio model with the parameters' inertias, rotor inertias (armature) and gravity.

    Raises:
        UserError: The description cannot be parsed, or its moving joints are not those of the parameters.
    """
    try:
        model = pin.buildModelFromXML(parameters.urdf)
    except (ValueError, RuntimeError) as error:
        raise UserError(f"the robot description cannot be parsed ({error}); correct the URDF") from error
    names = tuple(model.names)[1:]
    if names != parameters.joints:
        raise UserError(
            f"the description's moving joints are {', '.join(names)}, "
            f"the model's {', '.join(parameters.joints)}; name the same joints in the same order, base to tip"
        )
    if model.nq != model.nv:
        raise UserError("the simulated arm takes revolute and prismatic joints; make continuous ones revolute")
    for index, values in enumerate(parameters.rigid_body, start=1):
        model.inertias[index] = pin.Inertia.FromDynamicParameters(values)
    model.armature = parameters.rotor_inertia.copy()
    model.gravity.linear = parameters.gravity
    return model


class Plant:
    """The arm as it moves; `step` it with motor torques.

    Attributes:
        position: (n,) rad. A new array each step, safe to keep.
        velocity: (n,) rad/s; exactly zero at joints that stick.
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
    ) -> None:
        """Start at `position` (zero unless given) and `velocity` (at rest unless given).

        Args:
            parameters: What the arm obeys.
            position: (n,) rad.
            velocity: (n,) rad/s.
            law: Friction and drive train in place of `StribeckLaw(parameters)`.
            thermal: Thermal data in place of the defaults.
            longest_step_s: Longer steps are divided.

        Raises:
            UserError: Parameters and robot description do not fit.
        """
        n = len(parameters.joints)
        self.parameters = parameters
        self.position = np.zeros(n) if position is None else np.array(position, dtype=float)
        self.velocity = np.zeros(n) if velocity is None else np.array(velocity, dtype=float)
        self._acceleration = np.zeros(n)
        self._friction_power = np.zeros(n)
        self._still = np.zeros(n)
        self._law = StribeckLaw(parameters) if law is None else law
        self._thermal = Thermal(ThermalParameters() if thermal is None else thermal, n)
        self._model = rigid_body_model(parameters)
        self._data = self._model.createData()
        self._longest_step_s = longest_step_s

    @property
    def housing_temperature(self) -> FloatArray:
        """(n,) °C, what a joint's temperature sensor and its lubricant feel."""
        return self._thermal.housing.copy()

    @property
    def winding_temperature(self) -> FloatArray:
        """(n,) °C, of the motor windings."""
        return self._thermal.winding.copy()

    def inertia(self) -> FloatArray:
        """Joint-space inertia at the present posture, rotors included, (n, n) kg·m²."""
        return np.array(pin.crba(self._model, self._data, self.position))

    def step(self, torque: FloatArray, dt: float) -> None:
        """Let `dt` seconds pass with the motors' output-side torque (n,) N·m held."""
        parts = max(1, math.ceil(dt / self._longest_step_s - 1e-9))
        h = dt / parts
        for _ in range(parts):
            self._step(torque, h)
        self._thermal.heat(torque, self._friction_power, dt)

    def _step(self, torque: FloatArray, h: float) -> None:
        v, law, warm = self.velocity, self._law, self._thermal.housing
        if not v.any():
            if self._holds(torque):
                return
            predicted = v
        else:
            predicted = v + 0.5 * h * self._acceleration
            # A prediction across zero would put the level on the wrong side of the Stribeck peak.
            predicted = np.where(v * predicted > 0.0, predicted, v)
        q = self.position + 0.5 * h * v
        smooth = law.smooth_torque(q, predicted, warm)
        level = law.dry_level(q, predicted, warm)
        after = self._slide(q, v, predicted, torque - smooth, level, h)
        if after is None:
            after = self._stick_or_slip(q, v, predicted, torque - smooth, level, h)
        self._acceleration = (after - v) / h
        self.velocity = after
        self.position = q + 0.5 * h * after
        # Springs store what they take; over a motion that cancels, and it is small beside friction.
        self._friction_power = (smooth + level * np.sign(predicted)) * predicted

    def _holds(self, torque: FloatArray) -> bool:
        """Whether static friction holds the whole arm, which is at rest."""
        q, still, warm = self.position, self._still, self._thermal.housing
        load = pin.nonLinearEffects(self._model, self._data, q, still)
        excess = np.abs(torque - load - self._law.smooth_torque(q, still, warm))
        if (excess > self._law.dry_level(q, still, warm)).any():
            return False
        self._acceleration = still
        self._friction_power = still
        return True

    def _slide(
        self,
        q: FloatArray,
        v: FloatArray,
        predicted: FloatArray,
        driving: FloatArray,
        level: FloatArray,
        h: float,
    ) -> FloatArray | None:
        """The new velocity if every joint moves and keeps its direction (nearly always), else None."""
        if not v.all():
            return None
        after = v + h * pin.aba(self._model, self._data, q, predicted, driving - level * np.sign(v))
        return after if (after * v > 0.0).all() else None

    def _stick_or_slip(
        self,
        q: FloatArray,
        v: FloatArray,
        predicted: FloatArray,
        driving: FloatArray,
        level: FloatArray,
        h: float,
    ) -> FloatArray:
        """The new velocity with joints sticking, breaking away or turning round."""
        load = pin.nonLinearEffects(self._model, self._data, q, predicted)
        inertia = pin.crba(self._model, self._data, q)
        momentum = inertia @ v + h * (driving - load)
        return solve_stick_slip(inertia, momentum, h * level, v)
