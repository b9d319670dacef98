"""Concealed physics that a finder is not expected to know by name: the right answer is `unknown`."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from spacearm_ident.arrays import FloatArray
from spacearm_ident.simulation.concealed.compliant import Base, Structure
from spacearm_ident.simulation.concealed.effect import Effect, Parameter, State
from spacearm_ident.simulation.parameters import PlantParameters

if TYPE_CHECKING:
    from spacearm_ident.simulation.closed_loop import Truth


class PumpDisturbance(Effect):
    """A pump or a reaction wheel shakes the joint in its own rhythm, whatever the arm does."""

    name = "pump_disturbance"
    known = False
    parameters: ClassVar = {
        "amplitude": Parameter("N m", 0.1, 6.0),
        "frequency": Parameter("Hz", 0.6, 7.0, 2.3),
        "phase": Parameter("rad", -np.pi, np.pi, 0.0),
    }

    def torque(self, state: State) -> FloatArray:
        """Periodic in time."""
        angle = 2 * np.pi * self.values["frequency"] * state.time + self.values["phase"]
        return self.added(np.zeros_like(state.q), self.values["amplitude"] * np.sin(angle))


class PositionProduct(Effect):
    """A cable across two joints that is taut only when both are bent: torque ∝ q_i·q_j at the first of them."""

    name = "position_product"
    known = False
    parameters: ClassVar = {"stiffness": Parameter("N m/rad2", 1.0, 40.0)}
    joints_needed = 2

    def torque(self, state: State) -> FloatArray:
        """At the first joint."""
        torque = np.zeros_like(state.q)
        first, second = self.joints
        torque[first] = self.values["stiffness"][0] * state.q[first] * state.q[second]
        return torque


class CurrentDeadZone(Effect):
    """A current sensor that shows nothing of small currents, the less the slower the joint turns."""

    name = "current_dead_zone"
    known = False
    parameters: ClassVar = {"width": Parameter("N m", 0.3, 20.0), "velocity": Parameter("rad/s", 0.05, 1.0, 0.4)}

    def reported(self, truth: Truth) -> Truth:
        """Drawn towards zero by at most the width."""
        torque = truth.torque.copy()
        real = torque[:, self.joints]
        width = self.values["width"] * np.exp(-np.abs(truth.qd[:, self.joints]) / self.values["velocity"])
        torque[:, self.joints] = np.sign(real) * np.maximum(np.abs(real) - width, 0.0)
        return replace(truth, torque=torque)


class LooseBolt(Effect):
    """Something rubs now and then: for 0.1 to 0.8 s, on average every `every` seconds, by up to `amplitude`."""

    name = "loose_bolt"
    known = False
    parameters: ClassVar = {
        "amplitude": Parameter("N m", 0.5, 12.0),
        "every": Parameter("s", 0.5, 5.0, 1.5),
        "seed": Parameter("1", 0.0, 1e6, 0.0),
    }
    joints_needed = 1

    def prepare(self) -> None:
        """When, how long and how hard."""
        rng = np.random.default_rng(int(self.one("seed")))
        self._starts = np.cumsum(rng.exponential(self.one("every"), 4000))
        self._lengths = rng.uniform(0.1, 0.8, 4000)
        self._heights = self.one("amplitude") * rng.uniform(0.4, 1.0, 4000)

    def level(self, state: State, level: FloatArray) -> FloatArray:
        """More friction while it rubs."""
        last = int(np.searchsorted(self._starts, state.time)) - 1
        if last < 0 or state.time > self._starts[last] + self._lengths[last]:
            return level
        return self.added(level, self._heights[last])


class SoftBase(Effect):
    """The arm stands on a plate on springs that rocks: `stiffness` about the two horizontal axes."""

    name = "soft_base"
    known = False
    parameters: ClassVar = {
        "stiffness": Parameter("N m/rad", 4e3, 2e5),
        "damping": Parameter("N m s/rad", 10.0, 400.0, 80.0),
        "mass": Parameter("kg", 10.0, 200.0, 40.0),
    }
    joints_needed = 0

    def build(self, structure: Structure) -> None:
        """A base on springs, stiff in all other directions."""
        soft, damping, mass = self.one("stiffness"), self.one("damping"), self.one("mass")
        inertia = 0.06 * mass
        stiffness = np.array([4e6, 4e6, 4e6, soft, soft, 1e6])
        friction = np.array([8e3, 8e3, 8e3, damping, damping, 4e2])
        structure.base = Base(mass, inertia, np.array([0.0, 0.0, -0.05]), stiffness, friction)


class LinkGyroscope(Effect):
    """A fast wheel inside the link, along the x axis of its frame: turning the link costs a torque square to both."""

    name = "link_gyroscope"
    known = False
    parameters: ClassVar = {"momentum": Parameter("N m s", 0.2, 20.0)}
    joints_needed = 1

    def build(self, structure: Structure) -> None:
        """A constant angular momentum in the link's frame."""
        structure.wheels[int(self.joints[0])] = np.array([self.one("momentum"), 0.0, 0.0])


class RestingFriction(Effect):
    """Oil squeezed out at every stop: after a reversal friction is higher and recovers over `recovery` seconds."""

    name = "resting_friction"
    known = False
    parameters: ClassVar = {"amplitude": Parameter("N m", 0.2, 8.0), "recovery": Parameter("s", 0.15, 1.5, 0.5)}

    def begin(self, parameters: PlantParameters, plant: object) -> None:
        """At rest since long."""
        k = len(self.joints)
        self._since, self._side = np.zeros(k), np.zeros(k)

    def advance(self, state: State, h: float) -> None:
        """Time since the last reversal of each joint."""
        side = np.sign(state.qd[self.joints])
        turned = (side != 0) & (side != self._side)
        self._since = np.where(turned, 0.0, self._since + h)
        self._side = np.where(side != 0, side, self._side)

    def level(self, state: State, level: FloatArray) -> FloatArray:
        """The dry film, as long as it lasts."""
        return self.added(level, self.values["amplitude"] * np.exp(-self._since / self.values["recovery"]))
