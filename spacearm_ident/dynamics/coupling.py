"""A motor that several joints drive: wrists whose last motor turns with q_5 + q_6.

The motor's angle is theta = sum_k r_k q_k. Its rotor and its friction act along theta, so each joint k feels r_k
times J_m theta'' + k_v1 theta' + f_c sgn(theta'). (Gautier, Janot and Vandanjon identified the Staubli TX40's
wrist this way.)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ..signals.motion import Motion
from .arm import Arm, Coupling
from .background import Background
from .term import Columns, Parameter, Term, Values


@dataclass(frozen=True)
class CoupledMotor(Term):
    """Rotor inertia, viscous and Coulomb friction of one coupled motor."""

    kind: ClassVar[str] = "coupled_motor"
    words: ClassVar[str] = "coupled motors"
    friction: ClassVar[bool] = True
    pointwise: ClassVar[bool] = True
    coupling: Coupling | None = None

    @classmethod
    def build(cls, arm: Arm, options: Mapping[str, Any]) -> tuple[Term, ...]:
        """One term a coupling of the arm."""
        return tuple(
            cls(
                (
                    Parameter("J_m", coupling.name, "kg m^2", dimension=(0, 0, 1), lower=0.0),
                    Parameter("k_v1", coupling.name, "N m s/rad", dimension=(0, 1, 0), lower=0.0),
                    Parameter("f_c", coupling.name, "N m", lower=0.0),
                ),
                coupling=coupling,
            )
            for coupling in arm.couplings
        )

    def columns(self, motion: Motion, constants: Values, background: Background | None) -> Columns:
        """The motor's three columns in the row of every joint that drives it."""
        assert self.coupling is not None
        ratio = np.zeros(len(motion.joints))
        for joint, value in self.coupling.ratios.items():
            ratio[motion.joints.index(joint)] = value
        speed = motion.velocity @ ratio
        columns = np.stack([motion.acceleration @ ratio, speed, np.sign(speed)], axis=1)
        return {int(row): ([0, 1, 2], ratio[row] * columns) for row in np.flatnonzero(ratio)}
