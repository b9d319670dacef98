"""Concealed friction that remembers: bristles, oil that warms, gears that two joints share."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np

from spacearm_ident.arrays import FloatArray
from spacearm_ident.simulation.concealed.effect import Effect, Parameter, State
from spacearm_ident.simulation.parameters import PlantParameters

if TYPE_CHECKING:
    from spacearm_ident.simulation.plant import Plant

REFERENCE_TEMPERATURE = 20.0


class PreslidingHysteresis(Effect):
    """Contacts bend like bristles before they slip: dry friction builds up over a distance, not at once.

    Laws: `usual` LuGre (Canudas de Wit et al., IEEE TAC 40 (1995) 419), dz/dt = v − |v|/(level/σ)·z with a little
    damping of the bristles; `maxwell` eight springs in parallel that slip one after the other (Al-Bender et al.,
    IEEE TAC 50 (2005) 1883). `distance`: full friction is reached after about so much travel.
    """

    name = "presliding_hysteresis"
    parameters: ClassVar = {"distance": Parameter("rad", 8e-4, 0.02), "damping": Parameter("s", 0.0, 2e-3, 5e-4)}
    laws = ("usual", "maxwell")
    last = True
    _ELEMENTS = 8

    def prepare(self) -> None:
        """At first all bristles are straight."""
        k = len(self.joints)
        # Yield after (i/8 of the distance); equal stiffness, so the curve bends over as it does on a machine.
        shares = np.arange(1, self._ELEMENTS + 1) / self._ELEMENTS
        self._yield = self.values["distance"][:, None] * shares
        self._height = shares / shares.sum()
        self._bend = np.zeros((k, self._ELEMENTS))
        self._z = np.zeros(k)
        self._rate = np.zeros(k)
        self._level = np.ones(k)

    def level(self, state: State, level: FloatArray) -> FloatArray:
        """Taken over: the bristles carry it."""
        self._level = np.maximum(level[self.joints], 1e-9)
        level = level.copy()
        level[self.joints] = 0.0
        return level

    def advance(self, state: State, h: float) -> None:
        """Bend and slip; exact for the speed held over the step."""
        v = state.qd[self.joints]
        if self.law == "maxwell":
            self._bend = np.clip(self._bend + (h * v)[:, None], -self._yield, self._yield)
            return
        # In units of the present slip length: z → ±1 over `distance` / 3, 95 % there after `distance`.
        slip = self.values["distance"] / 3.0
        sign = np.sign(v)
        self._z = np.where(v == 0.0, self._z, sign + (self._z - sign) * np.exp(-np.abs(v) * h / slip))
        self._rate = (v - np.abs(v) * self._z) / slip

    def torque(self, state: State) -> FloatArray:
        """What the bent bristles hold against."""
        if self.law == "maxwell":
            share = (self._bend / self._yield) @ self._height
        else:
            share = self._z + self.values["damping"] * self._rate
        return self.added(np.zeros_like(state.q), self._level * share)


class TemperatureFriction(Effect):
    """Friction falls as the lubricant warms: f_c by `coulomb_slope`, k_v1 by `viscous_slope` per kelvin from `neutral`.

    The housings start at `start` (unless given, as warm as the surroundings) and are heated by `rise` within the time
    constant `time_constant`. Law `lagged`: the lubricant follows the housing's sensor only after `lag` seconds.
    """

    name = "temperature_friction"
    parameters: ClassVar = {
        "coulomb_slope": Parameter("1/K", -0.012, -0.0015),
        "viscous_slope": Parameter("1/K", -0.02, -0.003, -0.01),
        "neutral": Parameter("degC", -20.0, 80.0, REFERENCE_TEMPERATURE),
        "start": Parameter("degC", -20.0, 25.0, np.nan),
        "rise": Parameter("K", 5.0, 40.0, 20.0),
        "time_constant": Parameter("s", 8.0, 60.0, 15.0),
        "lag": Parameter("s", 3.0, 20.0, 6.0),
    }
    laws = ("usual", "lagged")

    def begin(self, parameters: PlantParameters, plant: Plant) -> None:
        """Bring the joints to their temperature and remember the viscosity it acts on."""
        start, thermal = self.values["start"], plant.thermal
        for body in (thermal.housing, thermal.winding):
            body[self.joints] = np.where(np.isnan(start), body[self.joints], start)
        self._thermal = thermal
        self._oil = thermal.housing[self.joints].copy()
        self._viscous = parameters.k_v1[self.joints]
        self._dry = parameters.f_c[self.joints]

    def advance(self, state: State, h: float) -> None:
        """Heat on, and let the oil follow."""
        since = np.maximum(state.time, 0.0)
        pace = self.values["rise"] / self.values["time_constant"] * np.exp(-since / self.values["time_constant"])
        self._thermal.heating[self.joints] = self._thermal.capacity * pace * (state.time >= 0.0)
        housing = state.temperature[self.joints]
        if self.law == "lagged":
            self._oil = self._oil + h / self.values["lag"] * (housing - self._oil)
        else:
            self._oil = housing

    def _warmth(self) -> FloatArray:
        return self._oil - self.values["neutral"]

    def level(self, state: State, level: FloatArray) -> FloatArray:
        """The dry part."""
        return self.added(level, self._dry * self.values["coulomb_slope"] * self._warmth())

    def torque(self, state: State) -> FloatArray:
        """The viscous part; never below nothing."""
        factor = np.maximum(self.values["viscous_slope"] * self._warmth(), -0.95)
        return self.added(np.zeros_like(state.q), self._viscous * factor * state.qd[self.joints])


class WristCoupling(Effect):
    """A gear stage that two joints share: it turns with the first joint plus `ratio` times the second.

    Its friction opposes that common motion and so reaches both joints. Joints: [the one, the other]. Law `moved`: that
    friction had been the other's own.
    """

    name = "wrist_coupling"
    laws = ("usual", "moved")
    parameters: ClassVar = {
        "coulomb": Parameter("N m", 0.2, 5.0),
        "viscous": Parameter("N m s/rad", 0.0, 8.0, 0.0),
        "ratio": Parameter("1", -1.0, 1.0, 1.0),
    }
    joints_needed = 2
    _SLIP = 5e-4
    """rad over which the stage winds up before it slips."""

    def prepare(self) -> None:
        """Not wound up."""
        self._wound = 0.0
        self._along = np.array([1.0, self.one("ratio")])

    def advance(self, state: State, h: float) -> None:
        """Wind up, at most to slipping."""
        move = h * float(self._along @ state.qd[self.joints])
        self._wound = min(max(self._wound + move, -self._SLIP), self._SLIP)

    def torque(self, state: State) -> FloatArray:
        """On both."""
        speed = float(self._along @ state.qd[self.joints])
        force = self.one("coulomb") * self._wound / self._SLIP + self.one("viscous") * speed
        torque = self.added(np.zeros_like(state.q), force * self._along)
        if self.law == "moved":
            torque[self.joints[1]] -= self.one("viscous") * state.qd[self.joints[1]]
        return torque

    def level(self, state: State, level: FloatArray) -> FloatArray:
        """What the other has of its own."""
        level = level.copy()
        if self.law == "moved":
            level[self.joints[1]] -= self.one("coulomb")
        return level
