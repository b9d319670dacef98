"""`Background`: what the rest of a model says of a motion, for the terms that depend on it.

Friction that grows with the load, an elastic gear, a delay act on the torque that the rest of the model causes. They
take it from the model, never from the measurement, whose noise would be in the columns then (errors in variables).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from ..arrays import FloatArray
from .arm import Arm


@dataclass(frozen=True)
class Background:
    """Torques of a model along one motion, each computed when first asked for.

    Attributes:
        arm: Whose it is.
        inertials: (n, 10) inertial parameters of the links in Pinocchio's order.
        values: Parameters and constants of the model by name, such as `k_v1[joint_1]`.
        kept: Results of further computations on this motion, by what they are of.
        grids: Those at all points of a law's grid, for all joints, which are large and of use to one kind of effect.
    """

    arm: Arm | None
    inertials: FloatArray | None
    values: Mapping[str, float]
    _load: Callable[[], FloatArray]
    _torque: Callable[[], FloatArray]
    _high_orders: Callable[[], FloatArray]
    kept: dict[object, Any] = field(default_factory=dict)
    grids: dict[object, Any] = field(default_factory=dict)

    @classmethod
    def known(cls, load: FloatArray) -> Background:
        """One of which only the load (N, n) is known, N·m."""
        return cls(None, None, {}, lambda: load, lambda: load, lambda: np.zeros_like(load))

    @cached_property
    def load(self) -> FloatArray:
        """(N, n) torque of the rigid bodies, the load on the gears, N·m."""
        return self._load()

    @cached_property
    def torque(self) -> FloatArray:
        """(N, n) torque of the whole model without its effects, N·m."""
        return self._torque()

    @property
    def whole(self) -> FloatArray:
        """(N, n) `torque`, or as a later fit has it, with what that found beside the model, N·m."""
        return np.asarray(self.keep("whole", lambda: self.torque))

    def with_whole(self, torque: FloatArray) -> None:
        """Take it (N, n) to be this, from a fit that knows it better."""
        self.kept["whole"] = torque

    @property
    def high_orders(self) -> FloatArray:
        """(N, n) torque of the friction terms of second and third order, whichever form they have, N·m."""
        return np.asarray(self.keep("high_orders", self._high_orders))

    def with_high_orders(self, torque: FloatArray) -> None:
        """Take them (N, n) to be others, from a fit that knows them better."""
        self.kept["high_orders"] = torque

    def keep(self, what: object, compute: Callable[[], Any]) -> Any:
        """The result of a computation on this motion, done once."""
        if what not in self.kept:
            self.kept[what] = compute()
        return self.kept[what]
