"""Where each followed parameter sits in the filters, how large it is, and in which ways it may jump.

Without a payload every joint has a filter of its own (n of them, k unknowns each); a payload acts on all joints, and
then there is one filter with n k + s unknowns. Unknowns are departures from the identified values.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from .changes import Hypothesis
from .rows import ALPHA, LEVELS, LOAD, Rows, TrackedModel

HELD = 1e-3
"""A load torque is held at zero to this share of the joint's friction until a change lets go of it."""
ALPHA_SHARE = 0.02
"""Coulomb friction may well change by this share of itself a kelvin."""
LEAST_SHARE = 0.05
"""A joint's friction is not taken to be smaller than this share of the largest."""
LEVEL, PAYLOAD = "friction level", "payload"
UNITS = {"k_v1": "N m s/rad", ALPHA: "N m/K", PAYLOAD: "kg"}


@dataclass(frozen=True)
class TrackedValue:
    """One followed parameter.

    Attributes:
        symbol, joint, unit: What it is.
        value: As followed.
        standard_error: With what a drift of the present pace puts between it and the truth.
        identified: Where it was identified.
        informed: Whether rows have told of it: its error is below half of what it was before any.
    """

    symbol: str
    joint: str
    unit: str
    value: float
    standard_error: float
    identified: float
    informed: bool

    @property
    def name(self) -> str:
        """`f_c[joint_1]`."""
        return f"{self.symbol}[{self.joint}]"


class Layout:
    """Order of the unknowns of a `TrackedModel`: J filters of p, n joints with k own and s shared ones each.

    Attributes:
        scale: (n, k) size of each joint's own parameters, in their units.
        shared_scale: (s,) of the shared ones.
    """

    def __init__(self, tracked: TrackedModel) -> None:
        self._tracked = tracked
        self._joints, self._count = len(tracked.joints), len(tracked.symbols)
        self.coupled = bool(tracked.shared)
        self.scale = self._scales()
        parameters = tracked.model.model.parameters
        self.shared_scale = np.array([parameters[k].scale or 1.0 for k in tracked.shared])

    def _value(self, joint: int, symbol: str) -> float:
        number = self._tracked.own[joint][self._tracked.symbols.index(symbol)]
        return float(self._tracked.model.parameters[number]) if number >= 0 else 0.0

    def _scales(self) -> FloatArray:
        coulomb = np.array([abs(self._value(joint, "f_c")) for joint in range(self._joints)])
        coulomb = np.maximum(coulomb, LEAST_SHARE * coulomb.max()) if coulomb.any() else np.ones(self._joints)
        static = np.array([abs(self._value(joint, "f_b")) for joint in range(self._joints)])
        viscous = np.array([abs(self._value(joint, "k_v1")) for joint in range(self._joints)])
        sizes = {
            "f_c": coulomb,
            "f_b": np.maximum(static, coulomb),
            "k_v1": np.maximum(viscous, LEAST_SHARE * coulomb),
            ALPHA: ALPHA_SHARE * coulomb,
            LOAD: coulomb,
        }
        return np.stack([sizes[symbol] for symbol in self._tracked.symbols], axis=1)

    def start_spread(self, share: float) -> FloatArray:
        """(J, p) standard deviations before any data."""
        own = share * self.scale
        if LOAD in self._tracked.symbols:
            own[:, self._tracked.symbols.index(LOAD)] *= HELD / share
        return self._gathered(own, self.shared_scale)

    def _gathered(self, own: FloatArray, shared: FloatArray) -> FloatArray:
        """(n, k) and (s,) as (J, p)."""
        return np.concatenate([own.ravel(), shared])[None] if self.coupled else own

    def spread_out(self, unknowns: FloatArray) -> FloatArray:
        """(J, p) as (n, k + s): for each joint its own and the shared."""
        if not self.coupled:
            return unknowns
        own = unknowns[0, : self._joints * self._count].reshape(self._joints, self._count)
        shared = unknowns[0, self._joints * self._count :]
        return np.column_stack([own, np.tile(shared, (self._joints, 1))])

    def rows(self, rows: Rows) -> FloatArray:
        """(M, n, k + s) columns, own and shared."""
        return np.concatenate([rows.own, rows.shared], axis=2)

    def blocks(
        self, phi: FloatArray, target: FloatArray, late: Mapping[int, tuple[FloatArray, FloatArray]]
    ) -> tuple[FloatArray, FloatArray]:
        """Weighted rows by filter.

        Args:
            phi: (M, n, k + s).
            target: (M, n).
            late: Joint -> further rows (L, k + s) and (L,) of it.

        Returns:
            (J, r, p) and (J, r).
        """
        longest = max((len(side) for _, side in late.values()), default=0)
        whole = np.concatenate([phi, np.zeros((longest, *phi.shape[1:]))])
        sides = np.concatenate([target, np.zeros((longest, self._joints))])
        for joint, (matrix, side) in late.items():
            whole[len(phi) : len(phi) + len(side), joint] = matrix
            sides[len(phi) : len(phi) + len(side), joint] = side
        if not self.coupled:
            return whole.transpose(1, 0, 2), sides.T
        width = self._joints * self._count
        wide = np.zeros((len(whole), self._joints, width + whole.shape[2] - self._count))
        for joint in range(self._joints):
            wide[:, joint, joint * self._count : (joint + 1) * self._count] = whole[:, joint, : self._count]
        wide[:, :, width:] = whole[:, :, self._count :]
        return wide.reshape(1, -1, wide.shape[2]), sides.reshape(1, -1)

    def of_blocks(self, heard: np.ndarray) -> np.ndarray:
        """(J,) whether a filter has rows, from whether joints (n,) have."""
        return np.array([heard.any()]) if self.coupled else heard

    def block(self, joint: int) -> int:
        """The filter of a joint."""
        return 0 if self.coupled else joint

    def _basis(self, joint: int, symbols: tuple[str, ...]) -> FloatArray:
        """(p, 1) the direction in which own parameters of a joint move alike."""
        own = np.zeros((self._joints, self._count))
        own[joint, [self._tracked.symbols.index(symbol) for symbol in symbols]] = 1.0
        whole = self._gathered(own, np.zeros(len(self.shared_scale)))
        return np.asarray(whole[self.block(joint)][:, None])

    def hypotheses(self) -> list[Hypothesis]:
        """Every way to change."""
        constants = {
            item.name: value for item, value in zip(self._tracked.model.model.constants, self._tracked.model.constants)
        }
        ways = []
        for joint, name in enumerate(self._tracked.joints):
            peaked = constants.get(f"v_b[{name}]", 0.0) > 0.0
            moves: dict[str, tuple[str, ...]] = {"f_c": ("f_c",), "k_v1": ("k_v1",)}
            if peaked:
                moves |= {LEVEL: ("f_c", "f_b"), "f_b": ("f_b",)}
            if not self.coupled:
                moves[LOAD] = (LOAD,)
            for what, symbols in moves.items():
                size = self.scale[joint, [self._tracked.symbols.index(symbols[0])]]
                ways.append(Hypothesis(what, joint, self.block(joint), self._basis(joint, symbols), size))
        if self.coupled:
            basis = np.eye(self._joints * self._count + len(self.shared_scale))[:, self._joints * self._count :]
            ways.append(Hypothesis(PAYLOAD, self._joints - 1, 0, basis, self.shared_scale))
        return ways

    def loosened(self, hypotheses: Iterable[Hypothesis]) -> FloatArray:
        """(J, p) by how much what is known before a change is given up, for a change that is one of `hypotheses`.

        Which level of a joint changed is not sure at once; that it was that joint is. Nor is it before the next
        reversal whether it was friction or a load: what then is not given up, would be found to change again and again.
        """
        own, shared = np.zeros_like(self.scale), np.zeros_like(self.shared_scale)
        for hypothesis in hypotheses:
            if hypothesis.what == PAYLOAD:
                shared = self.shared_scale
                continue
            concerned = (LOAD,) if hypothesis.what == LOAD else LEVELS
            which = [self._tracked.symbols.index(symbol) for symbol in concerned]
            own[hypothesis.joint, which] = self.scale[hypothesis.joint, which]
        return self._gathered(own, shared)

    def values(self, value: FloatArray, error: FloatArray, informed: np.ndarray) -> tuple[TrackedValue, ...]:
        """The followed parameters with their values.

        Args:
            value: (J, p) departures from the identified values, in the parameters' units.
            error: (J, p) their standard errors.
            informed: (J, p) whether rows have told of each.
        """
        parts = [self.spread_out(array) for array in (value, error, informed)]
        model, tracked = self._tracked.model, self._tracked
        places = [
            (number, joint, place)
            for joint, numbers in enumerate(tracked.own)
            for place, number in enumerate(numbers)
            if number >= 0
        ]
        places += [(number, 0, self._count + k) for k, number in enumerate(tracked.shared)]
        result = []
        for number, joint, place in places:
            parameter, known = model.model.parameters[number], float(model.parameters[number])
            departure, spread, told = (part[joint, place] for part in parts)
            value_now = known + float(departure), float(spread), known, bool(told)
            result.append(TrackedValue(parameter.symbol, parameter.joint, parameter.unit, *value_now))
        return tuple(result)
