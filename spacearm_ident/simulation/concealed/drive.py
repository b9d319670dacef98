"""Concealed faults of drives: what they report is not what their motors give."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np

from spacearm_ident.arrays import FloatArray
from spacearm_ident.simulation.concealed.effect import Effect, Parameter

if TYPE_CHECKING:
    from spacearm_ident.simulation.plant import Plant


class TorqueConstant(Effect):
    """The motor gives `scale` times what its data sheet says.

    Law `warming`: and loses `slope` of it per kelvin of its winding above 20 °C (magnets weaken).
    """

    name = "torque_constant"
    parameters: ClassVar = {"scale": Parameter("1", 0.85, 1.15), "slope": Parameter("1/K", -3e-3, -5e-4, -1.5e-3)}
    laws = ("usual", "warming")

    def motor(self, torque: FloatArray, plant: Plant) -> FloatArray:
        """The current is right, the constant is not."""
        scale = self.values["scale"]
        if self.law == "warming":
            scale = scale * (1.0 + self.values["slope"] * (plant.winding_temperature[self.joints] - 20.0))
        torque = torque.copy()
        torque[self.joints] *= scale
        return torque


class MotorSaturation(Effect):
    """Iron saturates: torque grows less than current, T·tanh(current torque/T) with T = `torque`.

    Law `knee`: exact up to half of T, then with 60 % of the slope.
    """

    name = "motor_saturation"
    parameters: ClassVar = {"torque": Parameter("N m", 10.0, 600.0)}
    laws = ("usual", "knee")

    def motor(self, torque: FloatArray, plant: Plant) -> FloatArray:
        """What the saturated motor gives."""
        asked, full = torque[self.joints], self.values["torque"]
        if self.law == "knee":
            given = asked - 0.4 * np.sign(asked) * np.maximum(np.abs(asked) - 0.5 * full, 0.0)
        else:
            given = full * np.tanh(asked / full)
        torque = torque.copy()
        torque[self.joints] = given
        return torque


class CurrentOffset(Effect):
    """The current sensor shows `offset` when there is none; the drive regulates what it shows."""

    name = "current_offset"
    parameters: ClassVar = {"offset": Parameter("N m", -8.0, 8.0)}

    def motor(self, torque: FloatArray, plant: Plant) -> FloatArray:
        """Less by the offset."""
        return self.added(torque, -self.values["offset"])
