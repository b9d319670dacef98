"""What a joint adds to the rigid body: friction and springs, behind a two-function interface.

The plant knows only `JointLaw`. Dry friction is a *level*, not a torque: at standstill any torque up to
that level holds the joint, and the plant finds which (see `stick_slip`).
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from spacearm_ident.arrays import FloatArray
from spacearm_ident.simulation.parameters import PlantParameters


class JointLaw(Protocol):
    """Friction and drive train of all joints; `q` rad, `qd` rad/s, `temperature` °C, (n,) each."""

    def dry_level(self, q: FloatArray, qd: FloatArray, temperature: FloatArray) -> FloatArray:
        """Largest dry friction torque at this state, (n,) N·m, not negative.

        Args:
            q: (n,) position, rad.
            qd: (n,) velocity, rad/s.
            temperature: (n,) temperature of the housings, °C.
        """

    def smooth_torque(self, q: FloatArray, qd: FloatArray, temperature: FloatArray) -> FloatArray:
        """All other torque the motor must provide against (viscous, spring), (n,) N·m; finite slope.

        Args:
            q: (n,) position, rad.
            qd: (n,) velocity, rad/s.
            temperature: (n,) temperature of the housings, °C.
        """


class StribeckLaw:
    """Friction of the paper (eq. 2) and the linear joint spring k_1·q."""

    def __init__(self, parameters: PlantParameters) -> None:
        p = parameters
        self._coulomb, self._stiction = p.f_c, p.f_b - p.f_c
        self._inverse_speed = 1.0 / p.v_b
        self._k1, self._k2, self._k3, self._spring = p.k_v1, p.k_v2, p.k_v3, p.joint_spring
        self._odd = np.array(p.quadratic) == "odd"
        self._any_odd = bool(self._odd.any())
        self._fastest, self._slowest, self._offset = p.fastest, -p.fastest, p.offset

    def dry_level(self, q: FloatArray, qd: FloatArray, temperature: FloatArray) -> FloatArray:
        """f_c + (f_b − f_c)·exp(−(qd/v_b)²); f_b at standstill."""
        ratio = qd * self._inverse_speed
        return self._coulomb + self._stiction * np.exp(-ratio * ratio)

    def smooth_torque(self, q: FloatArray, qd: FloatArray, temperature: FloatArray) -> FloatArray:
        """k_v1·qd + k_v2·qd² (or qd·|qd|) + k_v3·qd³ + k_1·q + offset; linear in speed beyond `fastest`."""
        speed = np.minimum(np.maximum(qd, self._slowest), self._fastest)
        quadratic = np.where(self._odd, np.abs(speed), speed) if self._any_odd else speed
        viscous = qd * (self._k1 + self._k2 * quadratic + self._k3 * (speed * speed))
        return np.asarray(viscous + self._spring * q + self._offset)
