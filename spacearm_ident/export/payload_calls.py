"""What is held, as the controllers of arms want it told: URScript, KUKA's load data, Franka's `setLoad`."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from ..arrays import FloatArray
from .frames import principal
from .payload import Held

GAIN_CAVEAT = (
    "mass and inertia are proportional to the torque gains (N m per unit of effort): a gain 5 % too high makes both "
    "5 % too large; the centre does not change. Verify the gains with a known weight where the mass must be exact"
)
"""Stated with every payload: torque from motor currents has no absolute scale of its own."""


def urscript(held: Held) -> str:
    """`set_target_payload(m, cog, inertia)`: kg, m, kg m^2 about the centre along the flange's axes."""
    centre = ", ".join(f"{value:.4f}" for value in held.centre)
    if held.inertia is None:
        return f"set_target_payload({held.mass:.3f}, [{centre}])"
    elements = held.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    return f"set_target_payload({held.mass:.3f}, [{centre}], [{', '.join(f'{value:.6f}' for value in elements)}])"


def kuka(held: Held) -> str:
    """`$LOAD`: kg, centre in mm, principal moments in kg m^2 along axes that A, B, C (deg, about z, y, x) turn to."""
    x, y, z = 1e3 * held.centre
    moments, (a, b, c) = _turned(held.inertia) if held.inertia is not None else (np.zeros(3), np.zeros(3))
    return (
        f"$LOAD = {{M {held.mass:.3f}, CM {{X {x:.1f}, Y {y:.1f}, Z {z:.1f}, A {a:.2f}, B {b:.2f}, C {c:.2f}}}, "
        f"J {{X {moments[0]:.6f}, Y {moments[1]:.6f}, Z {moments[2]:.6f}}}}}"
    )


def franka(held: Held) -> str:
    """Franka's `setLoad(mass, F_x_Cload, load_inertia)` of libfranka: inertia about the centre, column by column."""
    inertia = np.zeros((3, 3)) if held.inertia is None else held.inertia
    numbers = ", ".join(f"{value:.6f}" for value in inertia.ravel(order="F"))
    centre = ", ".join(f"{value:.4f}" for value in held.centre)
    return f"robot.setLoad({held.mass:.3f}, {{{{{centre}}}}}, {{{{{numbers}}}}});"


def _turned(inertia: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Principal moments (3,), and A, B, C (3,) in degrees: turns about z, y', x'' onto their axes."""
    moments, axes = principal(inertia)
    return moments, np.asarray(Rotation.from_matrix(axes).as_euler("ZYX", degrees=True))


CALLS = {"URScript": urscript, "KUKA": kuka, "Franka": franka}
"""Whose call -> its text."""
