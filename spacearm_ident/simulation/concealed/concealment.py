"""`Concealment`: effects put together, as the plant, the drives and the sensors need them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from spacearm_ident.arrays import FloatArray
from spacearm_ident.simulation.closed_loop import SETTLE_S, Truth
from spacearm_ident.simulation.concealed.compliant import CompliantMechanism, Structure
from spacearm_ident.simulation.concealed.effect import Effect, State
from spacearm_ident.simulation.joint_law import JointLaw, StribeckLaw
from spacearm_ident.simulation.parameters import PlantParameters
from spacearm_ident.simulation.plant import Plant
from spacearm_ident.simulation.thermal import ThermalParameters

_DIFFERENCE = 1e-5
"""Part of a radian over which the encoder's gain is taken."""


def _using(effects: Sequence[Effect], hook: str) -> list[Effect]:
    """The effects that do something there."""
    return [effect for effect in effects if getattr(type(effect), hook) is not getattr(Effect, hook)]


class ConcealedLaw:
    """Joint law and step observer: the arm's own law as the effects change it."""

    def __init__(self, law: JointLaw, effects: Sequence[Effect], n: int) -> None:
        self._law, self._state = law, State(n)
        self._advances = _using(effects, "advance")
        self._levels = sorted(_using(effects, "level"), key=lambda effect: effect.last)
        self._torques = _using(effects, "torque")
        self._needs_load = any(effect.needs_load for effect in effects)

    def begin(self, plant: Plant, h: float) -> None:
        """Look at the plant, and let bristles and other states move on."""
        state = self._state
        state.time, state.q, state.qd, state.temperature = (
            plant.time,
            plant.position,
            plant.velocity,
            plant.thermal.housing,
        )
        if self._needs_load:
            state.load = plant.load()
        for effect in self._advances:
            effect.advance(state, h)

    def dry_level(self, q: FloatArray, qd: FloatArray, temperature: FloatArray) -> FloatArray:
        """See `JointLaw`."""
        state, level = self._state, self._law.dry_level(q, qd, temperature)
        state.q, state.qd, state.temperature = q, qd, temperature
        for effect in self._levels:
            level = effect.level(state, level)
        return np.maximum(level, 0.0) if self._levels else level

    def smooth_torque(self, q: FloatArray, qd: FloatArray, temperature: FloatArray) -> FloatArray:
        """See `JointLaw`."""
        state, torque = self._state, self._law.smooth_torque(q, qd, temperature)
        state.q, state.qd, state.temperature = q, qd, temperature
        for effect in self._torques:
            torque = torque + effect.torque(state)
        return torque


class Concealment:
    """What an arm obeys beyond its parameters, and what its drives and sensors get wrong; for one run, as it has state.

    Args:
        effects: What to conceal.

    Raises:
        UserError: From `plant`, where the arm cannot carry an effect.
    """

    def __init__(self, effects: Sequence[Effect]) -> None:
        self.effects = tuple(effects)
        self._encoders = _using(effects, "encoder")
        self._motors = _using(effects, "motor")
        self._reports = _using(effects, "reported")

    def plant(self, parameters: PlantParameters, position: FloatArray, thermal: ThermalParameters) -> Plant:
        """The plant with all effects, at rest, its clock at −`SETTLE_S`.

        Args:
            parameters: Of the healthy arm.
            position: (n,) where it rests, rad or m.
            thermal: How its joints warm up.
        """
        healthy = parameters
        for effect in self.effects:
            parameters = effect.alter(parameters)
        structure = Structure(parameters.joints)
        for effect in self.effects:
            effect.build(structure)
        concealed = ConcealedLaw(StribeckLaw(parameters), self.effects, len(parameters.joints))
        plant = Plant(
            parameters,
            position=position,
            law=concealed,
            thermal=thermal,
            mechanism=CompliantMechanism(parameters, structure) if structure else None,
            observer=concealed,
            start_s=-SETTLE_S,
        )
        for effect in self.effects:
            effect.begin(healthy, plant)
        return plant

    def encoder(self, position: FloatArray) -> FloatArray:
        """What the drives take for the position `position` (..., n), rad."""
        for effect in self._encoders:
            position = effect.encoder(position)
        return position

    def motor(self, torque: FloatArray, plant: Plant) -> FloatArray:
        """What the motors give (n,) where their drives mean to give, and report, `torque` (n,) N·m."""
        for effect in self._motors:
            torque = effect.motor(torque, plant)
        return torque

    def reported(self, truth: Truth) -> Truth:
        """Motion and torque as the sensors claim them."""
        if self._encoders:
            ahead, behind = (self.encoder(truth.q + side * _DIFFERENCE) for side in (0.5, -0.5))
            gain = (ahead - behind) / _DIFFERENCE
            truth = replace(truth, q=self.encoder(truth.q), qd=gain * truth.qd)
        for effect in self._reports:
            truth = effect.reported(truth)
        return truth
