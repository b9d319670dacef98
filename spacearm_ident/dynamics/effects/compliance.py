"""What gives way like a spring between motor and link: elastic gears, flexible links, a soft base.

The motor's encoder says q; the link is at q - d, because the gear (or the link, or the base) has given way by d under
the torque it carries. d follows from the link side alone, driven by the rigid arm's load along the recording:

    M d'' + (c + C) d' + s(d) + G d = load,     s(d) = K d (1 + (d / d_2)^2).

Recorded torque then differs from the rigid model's by -(M[:, a] d'' + C[:, a] d' + G[:, a] d) (Spong 1987, linearised
about the recorded motion).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, ClassVar

import numpy as np
from scipy.interpolate import make_interp_spline

from ...arrays import FloatArray
from ...signals.motion import Motion
from ..arm import Arm
from ..background import Background
from ..term import Columns, Constant, Values
from .effect import Effect, Options, each, known_axis, known_joint, nothing, share_of
from .linearised import COARSE_HZ, Sensitivity, by_position, by_virtual_joint, next_joint

DAMPING_RATIO = 0.05
LEAST_DAMPING, MOST_DAMPING = 0.003, 0.15
"""Of critical: of bare steel, and of gears full of grease."""
PREWARPED = 1.0
"""rad that a link swings in half a step up to which its frequency is kept: beyond, it is far above what is seen."""
LEAST_INERTIA = 1e-6
"""kg m^2: what is fitted may be less than nothing."""
HALFWAY = 0.5
SHORTEST_M = 0.02
"""A shorter link is a block, not a beam."""
ALONG = 0.1
"""A joint's axis this near its link's length (sine) turns the link; it cannot bend it."""
STIFFNESS_GRID = tuple(float(k) for k in np.geomspace(400.0, 120e3, 20))
"""N m/rad, of an arm of `GRID_SIZE`; `grid_for` has that of another."""
GRID_SIZE = 70.0
"""kg m^2, `Arm.size`: the paper's arm has 72, a UR10e 76, a Panda 12, an AIRBOT 2."""
MOUNT = 5.0
"""Times as stiff is a mount: it carries the whole arm."""
DOUBLES_GRID = tuple(float(d) for d in np.geomspace(8e-4, 5e-3, 5))
"""rad: strain-wave gears double their torque over the linear one's within a few thousandths (Tuttle 1992)."""
HORIZONTAL = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
"""Of the base frame."""

NEVER = np.array([np.inf])
FloatArrays = tuple[FloatArray, FloatArray]
Swing = Callable[..., FloatArrays]
"""Links, and the constants of p springs or gaps, to d and d'' (N, n, p)."""


@dataclass(frozen=True)
class Compliance(Effect):
    """Something gives way by d(t)."""

    at_once: ClassVar[bool] = False
    """Whether `prepare` computes the grid at all joints together, which costs the same as at one."""

    @property
    def parts(self) -> tuple[Compliance, ...]:
        """What gives way on its own; what one part's swing does to another is of second order and left out."""
        return (self,)

    @property
    def of_link(self) -> int:
        """So many constants, the last ones, are not the spring's but of what swings on it."""
        return 0

    def own_link(self, motion: Motion, constants: Values, background: Background, joint: int) -> Sensitivity:
        """Sensitivity of the joint torques to a small motion about a joint's own axis.

        Args:
            motion: N samples of n joints.
            constants: Values in the order of `self.constants`.
            background: What the rest of the model says of this motion; the arm and its inertials must be known.
            joint: Number of the joint, in the arm's order.
        """
        return by_position(motion, background, joint)

    def sensitivity(self, motion: Motion, constants: Values, background: Background) -> Sensitivity:
        """About the axis that gives way: the joint's own; others say which."""
        return self.own_link(motion, constants, background, motion.joints.index(self.place["joint"]))

    @property
    def swing(self) -> Swing:
        """Law of what gives way: a spring; others say which."""
        return spring

    def prepare(self, motion: Motion, points: Sequence[Values], background: Background | None) -> None:
        """The whole grid, at all joints at once, where `at_once` says that they have the same."""
        if background is None or background.arm is None or not self.at_once:
            return
        for constants in points:
            if self._is_on_grid(constants) and (key := self._of_grid(motion, constants)) not in background.grids:
                background.grids[key] = self._grid(motion, constants, background)

    def deflection(self, motion: Motion, constants: Values, background: Background) -> FloatArrays:
        """(N,) d and d'' of what gives way; others say what is different."""
        if not self.at_once or not self._is_on_grid(constants):
            swung = np.array([constants[: len(constants) - self.of_link]]).T
            deflection, acceleration = self.swing([self.sensitivity(motion, constants, background)], *swung)
            return deflection[:, 0, 0], acceleration[:, 0, 0]
        key, row = self._of_grid(motion, constants), motion.joints.index(self.place["joint"])
        if key in background.grids:
            at = np.s_[:, key[2].index(row), self._points.index(tuple(constants[: key[1]]))]
            deflection, acceleration = (of_grid[at] for of_grid in background.grids[key])
        else:
            alone = self._rounded(motion, constants, background, [row], [constants[: key[1]]])
            deflection, acceleration = (of_one[:, 0, 0] for of_one in alone)
        return deflection.astype(float), acceleration.astype(float)

    def _is_on_grid(self, constants: Values) -> bool:
        return all(value in constant.grid for value, constant in zip(constants, self.constants))

    def _of_grid(self, motion: Motion, constants: Values) -> tuple[str, int, tuple[int, ...], tuple[float, ...]]:
        """What one grid has in common: law, how many constants of it, joints, and what is not the law's."""
        swung = len(constants) - self.of_link
        of_link = tuple(value for value in constants[swung:] if value)
        # What only this link has is no other's concern.
        joints = [motion.joints.index(self.place["joint"])] if of_link else range(len(motion.joints))
        return self.swing.__name__, swung, tuple(joints), of_link

    @property
    def _points(self) -> list[tuple[float, ...]]:
        """Of the law's grid."""
        return list(product(*(constant.grid for constant in self.constants[: len(self.constants) - self.of_link])))

    def _grid(self, motion: Motion, constants: Values, background: Background) -> list[FloatArray]:
        """(N, n, p) d and d'' of some joints' links at all points."""
        joints = self._of_grid(motion, constants)[2]
        return self._rounded(motion, constants, background, joints, self._points)

    def _rounded(
        self,
        motion: Motion,
        constants: Values,
        background: Background,
        joints: Sequence[int],
        points: Sequence[Values],
    ) -> list[FloatArray]:
        """(N, n, p) d and d'' of some joints' links at some points, in single precision, for a grid is large."""
        links = [self.own_link(motion, constants, background, joint) for joint in joints]
        return [one.astype(np.float32) for one in self.swing(links, *np.array(points).T)]

    def tangent(self, motion: Motion, constants: Values, background: Background) -> FloatArray:
        """(N,) stiffness that a small swing about where it is feels, N·m/rad; others say what is different."""
        return np.full(len(motion.position), constants[0])

    def resonance(self, motion: Motion, constants: Values, background: Background) -> tuple[float, float] | None:
        """Of the link on its spring, with the motor held."""
        frequencies = []
        for part in self.parts:
            sensitivity = part.sensitivity(motion, constants, background)
            stiffness = np.maximum(part.tangent(motion, constants, background) + sensitivity.own_gradient, 0.0)
            frequencies.append(np.sqrt(stiffness / np.maximum(sensitivity.own_inertia, LEAST_INERTIA)) / (2 * np.pi))
        return float(np.min(frequencies)), float(np.max(frequencies))

    def columns(self, motion: Motion, constants: Values, background: Background | None) -> Columns:
        """What the rows of all joints differ by."""
        if background is None or background.arm is None:
            return nothing(motion, range(len(motion.joints)), 1)
        given_way = [
            part.sensitivity(motion, constants, background).torque(*part.deflection(motion, constants, background))
            for part in self.parts
        ]
        torque = -np.sum(given_way, axis=0)
        return each({row: torque[:, [row]] for row in range(torque.shape[1])})


def grid_for(arm: Arm, grid: tuple[float, ...]) -> tuple[float, ...]:
    """A grid of stiffnesses, by its own steps further down for an arm of less than `GRID_SIZE`, and up for one of more.

    What swings, swings at sqrt(K / M): alike of all arms are the frequencies that their bandwidth shows. A spring that
    is soft for its arm holds nothing up; one that is stiff does no harm.

    Args:
        arm: Its CAD inertials say its size; without any the grid is as it was.
        grid: N·m/rad, at even ratios.
    """
    ratio, times = grid[1] / grid[0], arm.size / GRID_SIZE
    steps = int(abs(np.log(times)) / np.log(ratio)) if times > 0.0 else 0
    further = [ratio**k for k in range(1, steps + 1)]
    if times < 1.0:
        return (*(grid[0] / far for far in reversed(further)), *grid)
    return (*grid, *(grid[-1] * far for far in further))[steps:]


def springs(arm: Arm, name: str, stiffer: float = 1.0) -> tuple[Constant, Constant]:
    """Stiffness, and the damping ratio, which says how long a swing lasts and is refined once the stiffness is near.

    Args:
        arm: Whose size says where a stiffness is looked for.
        name: Of the joint, or what else gives way.
        stiffer: Times as stiff as a joint may be.
    """
    grid, reach = tuple(stiffer * k for k in grid_for(arm, STIFFNESS_GRID)), (LEAST_DAMPING, MOST_DAMPING)
    stiffness = Constant("stiffness", name, "N m/rad", grid)
    return stiffness, Constant("damping_ratio", name, "1", (DAMPING_RATIO,), reach=reach)


def spring(
    links: Sequence[Sensitivity], stiffness: FloatArray, damping_ratio: FloatArray, doubles_at: FloatArray = NEVER
) -> FloatArrays:
    """D (N, n, p) rad and d'' of n links on springs, by Newmark's average-acceleration method (1959; always stable).

    That swings late by (omega h)^2 / 12; a link as much lighter (`PREWARPED`) swings at its own frequency.

    Args:
        links: What swings.
        stiffness: (p,) of a spring that is not wound up, N·m/rad.
        damping_ratio: (p,) of critical.
        doubles_at: (p,) rad at which its torque is twice K d: K d (1 + (d / d_2)^2).
    """
    step = max(1, int(links[0].rate_hz / COARSE_HZ))
    inertia, coriolis, gradient, load = own_signals(links, step)
    h = step / links[0].rate_hz
    rate, damping = stiffness + gradient, 2 * damping_ratio * np.sqrt(stiffness * inertia) + coriolis
    swung = np.clip(0.5 * h * np.sqrt(np.maximum(rate, 0.0) / inertia), 1e-6, PREWARPED)
    lighter = (swung / np.tan(swung)) ** 2
    load = np.broadcast_to(load, rate.shape)
    deflection, acceleration = _swing(lighter * inertia, damping, rate, stiffness / doubles_at**2, load, h)
    return _finer(deflection, step, len(links[0].load)), _finer(lighter * acceleration, step, len(links[0].load))


def own_signals(links: Sequence[Sensitivity], step: int = 1) -> Iterator[FloatArray]:
    """What n springs feel about their own axes, over the samples of a motion.

    Args:
        links: Sensitivity of the torque to each spring's deflection d.
        step: Every so many samples are taken.

    Yields:
        (N, n, 1) inertia, kg m² (kg of a rail), at least `LEAST_INERTIA`; then what d' and d cost, N·m s/rad and
        N·m/rad; then load, N·m.
    """
    inertia, *others = zip(*((link.own_inertia, link.own_coriolis, link.own_gradient, link.load) for link in links))
    for signals in ([np.maximum(own, LEAST_INERTIA) for own in inertia], *others):
        yield np.stack([signal[::step] for signal in signals], axis=1)[:, :, None]


def _swing(
    inertia: FloatArray, damping: FloatArray, rate: FloatArray, cubic: FloatArray, load: FloatArray, h: float
) -> FloatArrays:
    """D (N, ...) and d'' at steps of h seconds: M d'' + c d' + rate d + cubic d^3 = load, from where it stands."""
    ahead, half = 0.25 * h**2, 0.5 * h
    signals = [load, rate, damping, np.maximum(inertia + 0.5 * h * damping + ahead * rate, LEAST_INERTIA)]
    one, hard = load[0].size == 1, bool(np.any(cubic))
    columns = [signal.ravel().tolist() for signal in signals] if one else signals
    bend = cubic.item() if one else cubic
    sinh, arcsinh = (math.sinh, math.asinh) if one else (np.sinh, np.arcsinh)

    def root(slope: Any, force: Any) -> Any:
        """Of slope x + bend x^3 = force."""
        unit = (slope / (3.0 * bend)) ** 0.5
        return 2.0 * unit * sinh(arcsinh(1.5 * force / (slope * unit)) / 3.0)

    first, held = columns[0][0], columns[1][0]
    d, v, a = root(abs(held), first) if hard else first / held, 0.0, 0.0
    deflection, acceleration = [], []
    for force, stiff, damp, divide in zip(*columns):
        guess_d, guess_v = d + h * v + ahead * a, v + half * a
        pull = force - damp * guess_v - stiff * guess_d
        a = (root(divide / ahead, pull + divide / ahead * guess_d) - guess_d) / ahead if hard else pull / divide
        d, v = guess_d + ahead * a, guess_v + half * a
        deflection.append(d)
        acceleration.append(a)
    return np.reshape(deflection, load.shape), np.reshape(acceleration, load.shape)


def _finer(signal: FloatArray, step: int, samples: int) -> FloatArray:
    """From every `step`-th sample to all, with straight lines between them."""
    if step == 1:
        return signal
    coarse = step * np.arange(len(signal))
    return np.asarray(make_interp_spline(coarse, signal, k=1)(np.minimum(np.arange(samples), coarse[-1])))


@dataclass(frozen=True)
class JointElasticity(Compliance):
    """The gear is a spring between motor and link."""

    at_once: ClassVar[bool] = True
    kind: ClassVar[str] = "joint_elasticity"
    one_form: ClassVar[bool] = True
    words: ClassVar[str] = "the gear gives way like a spring"
    equation: ClassVar[str] = "-(M d'' + C d' + G d), M d'' + C d' + G d + K d (1 + (d/d_2)^2) = tau_load"
    source: ClassVar[str] = "Spong 1987; hardening: Tuttle 1992"
    experiment: ClassVar[str] = "a chirp past the resonance of one joint at a time (spacearm excite --for elasticity)"
    remedy: ClassVar[str] = (
        "keep the motion below its resonance, or use the model that has it; if it is new, look at the gear"
    )
    forms: ClassVar[tuple[Options, ...]] = ({}, {"hardens": True})

    @classmethod
    def at(cls, arm: Arm, place: Options) -> Effect:
        """At one joint."""
        joint = known_joint(arm, place)
        share = share_of(joint)
        if not place.get("hardens"):
            return cls((share,), springs(arm, joint), place=place)
        doubles_at = Constant("doubles_at", joint, "rad", DOUBLES_GRID)
        return cls((share,), (*springs(arm, joint), doubles_at), place=place)

    def tangent(self, motion: Motion, constants: Values, background: Background) -> FloatArray:
        """The stiffer the further it is wound up."""
        if not self.place.get("hardens"):
            return super().tangent(motion, constants, background)
        deflection, _ = self.deflection(motion, constants, background)
        return np.asarray(constants[0] * (1.0 + 3.0 * (deflection / constants[2]) ** 2))

    def where(self, values: FloatArray) -> str:
        """Whether it hardens."""
        return f"{self.words} that hardens" if self.place.get("hardens") else self.words


def _square_to(length: FloatArray, axis: FloatArray) -> list[tuple[float, ...]]:
    """Two directions square to a link's length: as near the joint's axis as can be, and across both."""
    along = length / np.linalg.norm(length)
    near = axis - (axis @ along) * along
    if np.linalg.norm(near) < ALONG:
        near = np.cross(along, np.eye(3)[int(np.argmin(np.abs(along)))])
    near /= np.linalg.norm(near)
    return [tuple(float(np.round(x, 9)) for x in direction) for direction in (near, np.cross(along, near))]


@dataclass(frozen=True)
class LinkFlexibility(Compliance):
    """A link bends: a sprung hinge halfway to the next joint, where a beam under a moment at its end has its bend."""

    kind: ClassVar[str] = "link_flexibility"
    words: ClassVar[str] = "the link bends"
    equation: ClassVar[str] = "-(M d'' + C d' + G d) about a hinge square to the link's length"
    source: ClassVar[str] = "lumped first mode; De Luca and Siciliano 1991"
    experiment: ClassVar[str] = "a chirp past the resonance of one joint at a time (spacearm excite --for elasticity)"
    remedy: ClassVar[str] = (
        "keep the motion below its resonance, or use the model that has it; if it is new, look at the link's joints"
    )

    @classmethod
    def variants(cls, arm: Arm) -> Iterator[Options]:
        """Each link that another follows, about two axes."""
        for number, joint in enumerate(arm.joints):
            length = next_joint(arm, number)
            if np.linalg.norm(length) > SHORTEST_M:
                for axis in _square_to(length, joint.axis):
                    yield {"joint": joint.name, "axis": list(axis), "along": HALFWAY}

    @classmethod
    def at(cls, arm: Arm, place: Options) -> Effect:
        """The link of one joint, about `axis` in its frame, `along` of the way to the next joint (0: at its root)."""
        known_axis(place)
        if not 0.0 <= float(place.get("along", 0.0)) <= 1.0:
            raise ValueError("along is a share of the way to the next joint, 0 to 1")
        joint = known_joint(arm, place)
        share = share_of(joint)
        return cls((share,), springs(arm, joint), place=place)

    def sensitivity(self, motion: Motion, constants: Values, background: Background) -> Sensitivity:
        """About a hinge in the link."""
        link, along = motion.joints.index(self.place["joint"]), float(self.place.get("along", 0.0))
        return by_virtual_joint(motion, background, link, tuple(self.place["axis"]), along)


@dataclass(frozen=True)
class BaseFlexibility(Compliance):
    """The arm stands on something soft."""

    kind: ClassVar[str] = "base_flexibility"
    bodily: ClassVar[bool] = True
    words: ClassVar[str] = "the base rocks"
    equation: ClassVar[str] = "-(M d'' + C d' + G d) about a horizontal axis at the base, or about both alike"
    source: ClassVar[str] = "lumped first mode of the mounting"
    experiment: ClassVar[str] = "a step of joint 1 with the arm stretched: an accelerometer at the base sees it rock"
    remedy: ClassVar[str] = "tighten the base's mount, or keep the motion below its resonance"

    @classmethod
    def variants(cls, arm: Arm) -> Iterator[Options]:
        """About either horizontal axis, or about both, as a mount that is as soft all round."""
        yield {}
        for axis in HORIZONTAL:
            yield {"axis": list(axis)}

    @classmethod
    def at(cls, arm: Arm, place: Options) -> Effect:
        """About `axis` in the base frame, or about both horizontal ones alike where none is named."""
        if "axis" in place:
            known_axis(place)
        share = share_of("base")
        return cls((share,), springs(arm, "base", MOUNT), place=place)

    @property
    def parts(self) -> tuple[Compliance, ...]:
        """One for each axis."""
        if "axis" in self.place:
            return (self,)
        return tuple(replace(self, place={"axis": list(axis)}) for axis in HORIZONTAL)

    def sensitivity(self, motion: Motion, constants: Values, background: Background) -> Sensitivity:
        """About a hinge at the base."""
        return by_virtual_joint(motion, background, -1, tuple(self.place["axis"]))
