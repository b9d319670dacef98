"""Temperatures of a drive: a winding heated by copper loss inside a housing heated by friction.

Two lumped masses a joint (the usual two-body motor model): C_w·Ṫ_w = P_copper − (T_w − T_h)/R_wh and
C_h·Ṫ_h = P_friction + (T_w − T_h)/R_wh − (T_h − T_ambient)/R_ha, K/W.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spacearm_ident.arrays import FloatArray
from spacearm_ident.errors import UserError

COLDEST, WARMEST = -150.0, 150.0
"""Surroundings, °C, in which linear laws of friction over temperature are not yet absurd."""
_UPDATE_S = 0.01
"""Heat is summed up and the temperatures moved this often: time constants are minutes."""


@dataclass(frozen=True)
class ThermalParameters:
    """Thermal data, equal for all joints but the copper loss.

    Attributes:
        copper_loss: (n,) or one number: R_winding/(K_t·gear)², W/(N·m)² of output torque.
        winding_heat_capacity: C_w, J/K.
        housing_heat_capacity: C_h, J/K.
        winding_to_housing: R_wh, K/W.
        housing_to_ambient: R_ha, K/W.
        ambient: Temperature around, and of everything at the start, °C; (n,) or one number.
    """

    copper_loss: FloatArray | float = 2e-3
    winding_heat_capacity: float = 120.0
    housing_heat_capacity: float = 1500.0
    winding_to_housing: float = 0.8
    housing_to_ambient: float = 0.6
    ambient: FloatArray | float = 20.0


def surroundings(celsius: float) -> float:
    """A temperature as a user gives it, °C.

    Raises:
        UserError: No arm works there.
    """
    if not COLDEST <= celsius <= WARMEST:
        raise UserError(f"temperature {celsius:g} degC: give one from {COLDEST:g} to {WARMEST:g}")
    return celsius


class Thermal:
    """Thermal state of n joints.

    Attributes:
        winding: (n,) °C.
        housing: (n,) °C.
        capacity: J/K of a housing.
        heating: (n,) W into the housings from elsewhere (sun, heaters); zero unless set.
    """

    def __init__(self, parameters: ThermalParameters, n: int) -> None:
        self._p = parameters
        self.winding = np.full(n, parameters.ambient, dtype=float)
        self.housing = np.full(n, parameters.ambient, dtype=float)
        self.capacity = parameters.housing_heat_capacity
        self.heating = np.zeros(n)
        self._copper_J = np.zeros(n)
        self._friction_J = np.zeros(n)
        self._elapsed_s = 0.0

    def heat(self, torque: FloatArray, friction_power: FloatArray, dt: float) -> None:
        """Advance the thermal state by a time step.

        Args:
            torque: (n,) motor torque on the output side, N·m.
            friction_power: (n,) power lost to joint friction, W.
            dt: Length of the step, s.
        """
        self._copper_J += torque * torque * dt
        self._friction_J += friction_power * dt
        self._elapsed_s += dt
        if self._elapsed_s >= _UPDATE_S:
            self._move()

    def _move(self) -> None:
        p, dt = self._p, self._elapsed_s
        inward = (self.winding - self.housing) / p.winding_to_housing * dt
        outward = (self.housing - p.ambient) / p.housing_to_ambient * dt
        self.winding += (p.copper_loss * self._copper_J - inward) / p.winding_heat_capacity
        self.housing += (self._friction_J + self.heating * dt + inward - outward) / p.housing_heat_capacity
        self._copper_J[:] = 0.0
        self._friction_J[:] = 0.0
        self._elapsed_s = 0.0
