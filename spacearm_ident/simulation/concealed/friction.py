"""Concealed friction without memory, and springs: what depends on the present motion, load or temperature."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np

from spacearm_ident.arrays import FloatArray
from spacearm_ident.simulation.concealed.effect import Effect, Parameter, State
from spacearm_ident.simulation.parameters import PlantParameters


class FrictionDrift(Effect):
    """Wear or another preload: the level of friction is not what it was.

    Law `creeping`: it gets there linearly over `over` seconds, with no temperature to show for it.
    """

    name = "friction_drift"
    parameters: ClassVar = {
        "coulomb": Parameter("N m", -4.0, 6.0, 0.0),
        "static": Parameter("N m", -4.0, 6.0, 0.0),
        "viscous": Parameter("N m s/rad", -6.0, 12.0, 0.0),
        "over": Parameter("s", 5.0, 60.0, 25.0),
    }
    laws = ("usual", "creeping")

    def _share(self, state: State) -> float:
        return float(np.clip(state.time / self.one("over"), 0.0, 1.0)) if self.law == "creeping" else 1.0

    def alter(self, parameters: PlantParameters) -> PlantParameters:
        """Coulomb lifts the whole level, `static` only what is above it at standstill."""
        n = len(parameters.joints)
        static = np.maximum(parameters.f_b + self.spread("static", n), 0.0)
        return replace(parameters, f_b=static) if self.law == "usual" else parameters

    def level(self, state: State, level: FloatArray) -> FloatArray:
        """Higher or lower."""
        return self.added(level, self._share(state) * self.values["coulomb"])

    def torque(self, state: State) -> FloatArray:
        """Another viscosity."""
        viscous = self._share(state) * self.values["viscous"]
        return self.added(np.zeros_like(state.q), viscous * state.qd[self.joints])


class LoadFriction(Effect):
    """Gear teeth and bearings rub in proportion to the torque they pass on.

    Law `input`: to that on the motor's side, in which the joint's own dry friction is.
    """

    name = "load_friction"
    parameters: ClassVar = {"mu": Parameter("1", 0.015, 0.15)}
    laws = ("usual", "input")
    needs_load = True

    def level(self, state: State, level: FloatArray) -> FloatArray:
        """μ·|load| on top."""
        load = state.load[self.joints]
        if self.law == "input":
            load = load + level[self.joints] * np.sign(state.qd[self.joints])
        return self.added(level, self.values["mu"] * np.abs(load))


class GearEfficiency(Effect):
    """Of the power that flows through the gear the share η arrives, whichever way it flows.

    Driving, the motor must give load/η; driven by the load, it gets only η·load: always against the motion.
    """

    name = "gear_efficiency"
    parameters: ClassVar = {"efficiency": Parameter("1", 0.82, 0.985)}
    needs_load = True

    def level(self, state: State, level: FloatArray) -> FloatArray:
        """What the gear keeps for itself, as dry friction."""
        load, eta = state.load[self.joints], self.values["efficiency"]
        lost = np.where(load * state.qd[self.joints] > 0.0, 1.0 / eta - 1.0, 1.0 - eta)
        return self.added(level, lost * np.abs(load))


class PositionFriction(Effect):
    """Friction that differs round the joint (a bent bearing ring, an uneven mesh)."""

    name = "position_friction"
    parameters: ClassVar = {
        "amplitude": Parameter("N m", 0.1, 5.0),
        "cycles": Parameter("1/rev", 1.0, 4.0, 1.0),
        "phase": Parameter("rad", -np.pi, np.pi, 0.0),
        "width": Parameter("rad", 0.02, 2.0, np.nan),
    }
    laws = ("usual", "bump")

    def level(self, state: State, level: FloatArray) -> FloatArray:
        """Wave round the joint; law `bump`: a tight spot a cycle, as wide as a quarter wave or as `width` says."""
        angle = self.values["cycles"] * state.q[self.joints] + self.values["phase"]
        sharp = 2.0 / (self.values["cycles"] * self.values["width"]) ** 2
        sharp = np.where(np.isnan(sharp), 4.0, sharp)
        wave = np.sin(angle) if self.law == "usual" else np.exp(sharp * (np.cos(angle) - 1.0))
        return self.added(level, self.values["amplitude"] * wave)


class AsymmetricFriction(Effect):
    """Another friction forward than backward."""

    name = "asymmetric_friction"
    parameters: ClassVar = {
        "coulomb": Parameter("N m", -4.0, 4.0, 0.0),
        "viscous": Parameter("N m s/rad", -8.0, 8.0, 0.0),
    }

    def level(self, state: State, level: FloatArray) -> FloatArray:
        """Half the difference up when it turns forward, down when backward."""
        return self.added(level, self.values["coulomb"] * np.sign(state.qd[self.joints]))

    def torque(self, state: State) -> FloatArray:
        """Viscosity that differs in the same way."""
        return self.added(np.zeros_like(state.q), self.values["viscous"] * np.abs(state.qd[self.joints]))


class Stribeck(Effect):
    """Boundary lubrication at low speed that was not there before.

    Laws: `usual` Gaussian in speed, `lorentz` 1/(1 + (v/v_s)²), `exponential` in |v|.
    """

    name = "stribeck"
    parameters: ClassVar = {"amplitude": Parameter("N m", 0.2, 8.0), "velocity": Parameter("rad/s", 0.02, 0.12, 0.05)}
    laws = ("usual", "lorentz", "exponential")

    def level(self, state: State, level: FloatArray) -> FloatArray:
        """Falls from its full height as the oil film builds up."""
        ratio = np.abs(state.qd[self.joints]) / self.values["velocity"]
        match self.law:
            case "lorentz":
                left = 1.0 / (1.0 + ratio * ratio)
            case "exponential":
                left = np.exp(-ratio)
            case _:
                left = np.exp(-ratio * ratio)
        return self.added(level, self.values["amplitude"] * left)


class VacuumFriction(Effect):
    """Without air and with little grease the higher powers of speed go."""

    name = "vacuum_friction"
    parameters: ClassVar = {"fraction": Parameter("1", 0.2, 1.0, 1.0)}

    def alter(self, parameters: PlantParameters) -> PlantParameters:
        """`fraction` of k_v2 and k_v3 vanishes."""
        left = 1.0 - self.spread("fraction", len(parameters.joints))
        return replace(parameters, k_v2=left * parameters.k_v2, k_v3=left * parameters.k_v3)


class TorqueRipple(Effect):
    """Teeth, poles or cogging: a torque that repeats along the turn, with no loss over a whole one.

    Law `modulated`: once a turn it swells and fades by 60 %.
    """

    name = "torque_ripple"
    parameters: ClassVar = {
        "amplitude": Parameter("N m", 0.1, 6.0),
        "cycles": Parameter("1/rev", 6.0, 100.0),
        "phase": Parameter("rad", -np.pi, np.pi, 0.0),
    }
    laws = ("usual", "modulated")

    def torque(self, state: State) -> FloatArray:
        """Of a potential when plain."""
        q = state.q[self.joints]
        wave = self.values["amplitude"] * np.sin(self.values["cycles"] * q + self.values["phase"])
        if self.law == "modulated":
            wave = wave * (1.0 + 0.6 * np.sin(q + 1.0))
        return self.added(np.zeros_like(state.q), wave)


class HarnessSpring(Effect):
    """A cable loom that is bent by the joint; law `hardening`: stiffer by half at one radian.

    Laws `above` and `below`: it is taut, and pulls, on that side of the centre alone.
    """

    name = "harness_spring"
    parameters: ClassVar = {"stiffness": Parameter("N m/rad", 0.5, 12.0), "centre": Parameter("rad", -1.0, 1.0, 0.0)}
    laws = ("usual", "hardening", "above", "below")

    def torque(self, state: State) -> FloatArray:
        """Back to where it hangs loose."""
        bend = state.q[self.joints] - self.values["centre"]
        if self.law in ("above", "below"):
            bend = np.maximum(bend, 0.0) if self.law == "above" else np.minimum(bend, 0.0)
        torque = self.values["stiffness"] * bend
        if self.law == "hardening":
            torque = torque * (1.0 + 0.5 * bend * bend)
        return self.added(np.zeros_like(state.q), torque)
