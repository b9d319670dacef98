"""Play between the teeth of a gear: the link flies from flank to flank.

    M d'' + C d' + G d = load - push,     push = K x + c d' where x, what d is beyond half the gap, is not zero.

How long a flight lasts follows from the small load about its zero, so that everything in it counts: the gravity
gradient, noise, and which part of the inertia is before the gear. At a joint on a fixed base no motion tells the
rotor's inertia from the link's; here the link is alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from ...arrays import FloatArray
from ...signals.motion import Motion
from ..arm import Arm
from ..background import Background
from ..term import Constant, Values
from .compliance import Compliance, FloatArrays, Swing, grid_for, own_signals
from .effect import Effect, Options, known_joint, share_of
from .linearised import Sensitivity, by_position, least_inertia

CONTACT_HZ = 60.0
"""Gear teeth in contact are no stiffer than makes the link swing at this frequency: above what is looked at."""
STEPS = 3
"""A sample: a swing at `CONTACT_HZ` then advances by half a radian."""
CONTACT_DAMPING = 0.7
"""More than teeth have (0.03 to 0.17; Kasuba and Evans 1981): while a gap is not quite right, nor are its bounces."""
LEAST_CONTACT_DAMPING, MOST_CONTACT_DAMPING = 0.03, 1.0
TEETH = (0.95, 1.0, 1.05)
"""Gaps, times the gap: no two teeth are alike, and where a small error decides how a bounce goes on, their mean is
nearer than any of them."""
GAP_GRID = tuple(float(b) for b in np.geomspace(8e-5, 0.02, 26))
"""rad, dense: when the teeth meet again follows from how far apart they are."""
CONTACT_GRID = (4e3, 3.5e4, 3e5)
"""N·m/rad: from the smallest strain-wave gears to spur gears; a larger arm's are stiffer (`grid_for`)."""
CALM = 1.5
"""The load that lets teeth part and meet is looked at in so many times the bandwidth. Below, the jolt of a neighbour's
reversal is lost, after which the link flies; above, accelerations are encoder noise, which opens the gap too early. At
0.75, 1.5 and 3 times a gap of an arm in MuJoCo, all else known, leaves 0.27, 0.19 and 0.17 N·m of 0.76."""
ROTORS, ROTOR_REACH = 0.4, (-0.5, 0.75)
"""Share of a first link's least inertia that a model may have taken from its rotor."""


def gap(
    links: Sequence[Sensitivity], width: FloatArray, stiffness: FloatArray, damping_ratio: FloatArray
) -> FloatArrays:
    """D (N, n, p) rad and d'' of n links between two stops.

    Args:
        links: What swings.
        width: (p,) rad from stop to stop.
        stiffness: (p,) of what is in contact, N·m/rad.
        damping_ratio: (p,) of critical, in contact.
    """
    inertia, coriolis, gradient, load = own_signals(links)
    most = (2 * np.pi * CONTACT_HZ) ** 2 * inertia
    stiff = np.minimum(stiffness, most)
    # For a real link that changes nothing: one without inertia, as fitted models may have, would fall for ever.
    gradient, fast = np.clip(gradient, -0.5 * most, 0.5 * most), 0.5 * np.sqrt(most * inertia)
    coriolis = np.clip(coriolis, -fast, fast)
    damping = 2 * damping_ratio * np.sqrt(stiff * inertia)
    h = 1 / (STEPS * links[0].rate_hz)
    # In steps: of u = h d', so that a step is two sums.
    signals = [x / inertia for x in (h * h * load, h * h * gradient, h * coriolis, h * h * stiff, h * damping)]
    halves = 0.5 * np.multiply.outer(TEETH, width)
    with np.errstate(over="ignore", invalid="ignore"):
        if stiff[0].size == 1:
            columns = [signal.ravel() for signal in signals]
            flights = [_rattle_alone(half, *columns) for half in halves.ravel().tolist()]
            deflection, gain = np.mean(flights, axis=0)[..., None, None]
        else:
            flight = _rattle(halves[:, None], *signals)
            deflection, gain = (np.stack([at.mean(axis=0) for at in signal]) for signal in zip(*flight))
        return _held_by_its_stops(deflection, gain / h**2)


def _held_by_its_stops(deflection: FloatArray, acceleration: FloatArray) -> FloatArrays:
    """D and d'' (N, n, p); zero where a link leaves its stops by half a turn, as one may that they cannot hold.

    Such a swing says nothing of a gap: without any torque it explains nothing, and no comparison is lost in infinities.
    """
    held = (np.abs(deflection) < np.pi).all(axis=0)
    return np.where(held, deflection, 0.0), np.where(held, acceleration, 0.0)


def _rattle(
    half: FloatArray,
    load: FloatArray,
    gradient: FloatArray,
    coriolis: FloatArray,
    stiffness: FloatArray,
    damping: FloatArray,
) -> list[FloatArrays]:
    """D, and what u grows by, after every `STEPS` steps between stops at +-half, from where the load holds it.

    Args:
        half: (..., p) rad.
        load: (N, n, 1) h^2 load / M.
        gradient: (N, n, 1) h^2 G / M.
        coriolis: (N, n, 1) h C / M.
        stiffness: (N, n, p) h^2 K / M.
        damping: (N, n, p) h c / M.
    """
    d = _held(half, load[0], gradient[0], stiffness[0])
    u = 0.0 * d
    flight = []
    for f, g, c, k, e in zip(load, gradient, coriolis, stiffness, damping):
        for _ in range(STEPS):
            beyond = d - np.minimum(np.maximum(d, -half), half)
            push = k * beyond + e * u
            # Teeth push, they do not pull.
            gain = f - g * d - c * u - push * (push * beyond > 0.0)
            u = u + gain
            d = d + u
        flight.append((d, gain))
    return flight


def _rattle_alone(
    half: float,
    load: FloatArray,
    gradient: FloatArray,
    coriolis: FloatArray,
    stiffness: FloatArray,
    damping: FloatArray,
) -> tuple[list[float], list[float]]:
    """The same of one gap, all (N,): plain numbers, and branches in place of products with nothing, are far faster."""
    d, u = float(_held(half, load[0], gradient[0], stiffness[0])), 0.0
    held, pull, drag, reach = stiffness * half, stiffness + gradient, damping + coriolis, damping / stiffness
    along = zip(*(x.tolist() for x in (load, gradient, coriolis, held, pull, drag, reach)))
    low, steps, deflections, gains = -half, range(STEPS), [], []
    for f, g, c, at, g_in, c_in, r in along:
        for _ in steps:
            if d > half and d - half + r * u > 0.0:
                gain = f + at - g_in * d - c_in * u
            elif d < low and d + half + r * u < 0.0:
                gain = f - at - g_in * d - c_in * u
            else:
                gain = f - g * d - c * u
            u += gain
            d += u
        deflections.append(d)
        gains.append(gain)
    return deflections, gains


def _held(half: Any, load: Any, gradient: Any, stiffness: Any) -> Any:
    """Rad, where the first load holds it."""
    return (load + stiffness * half * np.sign(load)) / (stiffness + gradient)


@dataclass(frozen=True)
class Backlash(Compliance):
    """Play between the teeth of the gear."""

    at_once: ClassVar[bool] = True
    kind: ClassVar[str] = "backlash"
    words: ClassVar[str] = "play in the gear"
    equation: ClassVar[str] = "-(M d'' + C d' + G d), d free within the gap, on a spring beyond"
    source: ClassVar[str] = "Nordin and Gutman 2002"
    experiment: ClassVar[str] = "slow reversals of the load (not only of the speed): gravity from either side"
    remedy: ClassVar[str] = (
        "look at the gear and the coupling of motor and link: play grows; until then use the model that has it"
    )

    @classmethod
    def at(cls, arm: Arm, place: Options) -> Effect:
        """At one joint."""
        joint = known_joint(arm, place)
        share = share_of(joint)
        width = Constant("gap", joint, "rad", GAP_GRID)
        # The softest is stiff already where a small link hits.
        contact = grid_for(arm, CONTACT_GRID)[-len(CONTACT_GRID) :]
        stiffness = Constant("stiffness", joint, "N m/rad", contact)
        reach = (LEAST_CONTACT_DAMPING, MOST_CONTACT_DAMPING)
        damping = Constant("damping_ratio", joint, "1", (CONTACT_DAMPING,), reach=reach)
        if arm.joints[arm.joint_names.index(joint)].parent >= 0:
            return cls((share,), (width, stiffness, damping), place=place)
        rotor = Constant("rotor_share", joint, "1", (0.0, ROTORS), reach=ROTOR_REACH)
        return cls((share,), (width, stiffness, damping, rotor), place=place)

    @property
    def of_link(self) -> int:
        """The rotor's share, where it is not known."""
        return len(self.constants) - 3

    def own_link(self, motion: Motion, constants: Values, background: Background, joint: int) -> Sensitivity:
        """Without what is the rotor's, under a load without the noise of accelerations."""
        link, rotor = by_position(motion, background, joint), sum(constants[3:]) * least_inertia(background, joint)
        inertia, load = link.inertia.copy(), link.load - rotor * motion.acceleration[:, joint]
        inertia[:, joint] -= rotor
        calm = motion.smoothed(load[:, None], CALM * motion.cutoff_hz)[:, 0]
        return replace(link, inertia=inertia, own_inertia=link.own_inertia - rotor, load=calm)

    def resonance(self, motion: Motion, constants: Values, background: Background) -> tuple[float, float] | None:
        """None: how fast teeth bounce depends on how hard they meet."""
        return None

    @property
    def swing(self) -> Swing:
        """A gap."""
        return gap
