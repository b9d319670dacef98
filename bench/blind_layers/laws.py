"""Physics that the true arm has and the simulation has not.

Each law is a dictionary with `effect` (a name of contracts.md, section 4, or `absent:KIND` where the catalogue has no
name), `joint` (index) and its numbers. Friction laws set the level of MuJoCo's own friction loss, so sticking is
MuJoCo's; the others add torque. Sources:

* `stribeck`: F(v) = Fc + dF exp(-(v/vs)²). Armstrong-Hélouvry, Dupont, Canudas de Wit (1994), Automatica 30(7).
* `asymmetric_friction`: Fc (1 + a sign v). Armstrong-Hélouvry (1991), Control of Machines with Friction.
* `load_friction`: Fc + mu |load|, load = torque after the rotor's inertia. Hamon, Gautier, Garrec (2010), IROS.
* `temperature_friction`: Fc and damping fall with heat. Bittencourt and Axelsson (2014), IEEE/ASME T-Mech 19(4).
* `position_friction`: Fc (1 + a sin(q + p)), eccentric gear or bearing. Popović and Goldenberg (1998), IEEE T-RA 14(1).
* `presliding_hysteresis`: LuGre with Fs = Fc. Canudas de Wit et al. (1995), IEEE T-AC 40(3), eq. 2 to 4.
* `torque_ripple`: A sin(c q + p), c cycles a joint revolution. Tuttle and Seering (1996), IEEE T-RA 12(3); cogging of
  the motor has the same form.
* `harness_spring`: -k (q - q0), a cable in the wrist or along the arm.
* `joint_elasticity`: a spring between rotor and link. Spong (1987), J. Dyn. Sys. Meas. Control 109.
* `backlash`: the same with a dead zone. Nordin and Gutman (2002), Automatica 38(10).
* `external_contact`: a force at the last link during a time window.
* `current_offset`: a constant in the measured effort; it moves nothing.
* `absent:pump`: a torque periodic in time; `absent:hose`: an Ornstein-Uhlenbeck torque, correlation of 1 s;
  `absent:detent`: A x exp((1 - x²)/2), x = (q - q0)/w, a magnet that the joint passes.
"""

from __future__ import annotations

from typing import Any

import numpy as np

Law = dict[str, Any]

FRICTION = ("stribeck", "asymmetric_friction", "load_friction", "temperature_friction", "position_friction")
"""Effects that change the level of friction."""

ELASTIC = ("joint_elasticity", "backlash")
"""Effects that need a second degree of freedom."""

REFERENCE_C = 30.0
"""Temperature at which the table's friction holds, °C."""

ZERO_SPEED = 2e-3
"""Speed over which a sign changes in laws that need one, rad/s."""


def friction_level(law: Law, level: float, q: float, v: float, load: float, celsius: float) -> float:
    """Coulomb level under one friction law, N m.

    Args:
        law: one of `FRICTION`.
        level: level before it, N m.
        q: rad.
        v: rad/s.
        load: torque through the gear, N m.
        celsius: joint temperature, °C.
    """
    effect = law["effect"]
    if effect == "stribeck":
        return level + law["height"] * float(np.exp(-((v / law["speed"]) ** 2)))
    if effect == "asymmetric_friction":
        return level * (1.0 + law["share"] * float(np.tanh(v / ZERO_SPEED)))
    if effect == "load_friction":
        return level + law["mu"] * abs(load)
    if effect == "temperature_friction":
        return level * max(0.2, 1.0 - law["coulomb_per_C"] * (celsius - REFERENCE_C))
    return level * (1.0 + law["share"] * float(np.sin(q + law["phase"])))


def damping_level(law: Law, damping: float, celsius: float) -> float:
    """Viscous friction under `temperature_friction`, N m s/rad.

    Args:
        law: the law.
        damping: at `REFERENCE_C`, N m s/rad.
        celsius: joint temperature, °C.
    """
    return damping * float(np.exp(-law["viscous_per_C"] * (celsius - REFERENCE_C)))


def lugre(law: Law, z: float, v: float, step: float) -> tuple[float, float]:
    """Bristle deflection after one step, and the friction torque that acts on the joint.

    The state equation dz/dt = v - |v| sigma z / Fc is linear in z at constant v and is integrated exactly.

    Args:
        law: `level` Fc N m, `sigma` N m/rad, `micro` N m s/rad.
        z: deflection, rad.
        v: rad/s.
        step: s.

    Returns:
        z (rad) and torque (N m).
    """
    rate = abs(v) * law["sigma"] / law["level"]
    steady = law["level"] / law["sigma"] * (1.0 if v > 0 else -1.0)
    z_new = steady + (z - steady) * float(np.exp(-rate * step)) if rate > 0 else z
    return z_new, -(law["sigma"] * z_new + law["micro"] * (z_new - z) / step)


def added_torque(law: Law, q: float, t: float, hidden: float) -> float:
    """Torque of a law that only adds, N m.

    Args:
        law: ripple, spring or an absent kind.
        q: rad.
        t: s.
        hidden: value of the Ornstein-Uhlenbeck process, N m.
    """
    effect = law["effect"]
    if effect == "torque_ripple":
        return law["amplitude"] * float(np.sin(law["cycles"] * q + law["phase"]))
    if effect == "harness_spring":
        return -law["stiffness"] * (q - law["rest"])
    if effect == "absent:pump":
        return law["amplitude"] * float(np.sin(2 * np.pi * law["hertz"] * t + law["phase_run"]))
    if effect == "absent:hose":
        return hidden
    if effect == "absent:detent":
        x = (q - law["rest"]) / law["width"]
        return law["amplitude"] * x * float(np.exp((1 - x * x) / 2))
    return 0.0
