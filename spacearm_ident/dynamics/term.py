"""`Term`: one physical contribution to the joint torques, and all the solver ever learns of it.

tau = sum over terms of columns(motion; constants) @ parameters. The parameters enter linearly; the few constants
that do not (a Stribeck velocity, a presliding distance) are what a solver has to search. Rigid body, friction,
couplings and every effect found later are all terms: a new one is a class here, and fit, file and report know it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from ..arrays import FloatArray
from ..errors import UserError
from ..signals.motion import Motion
from .arm import Arm
from .background import Background

Columns = dict[int, tuple[list[int], FloatArray]]
"""Joint row -> (indices into the term's parameters, their columns (N, k), N·m per unit of the parameter)."""

Values = Sequence[float] | FloatArray
"""Constants of a term, in its order."""


@dataclass(frozen=True)
class Parameter:
    """A quantity the torque is linear in.

    Attributes:
        symbol: As in the literature: `m`, `f_c`, `J_m`, ...
        joint: The joint (or coupling) it belongs to.
        unit: SI.
        prior: What is believed before the data (CAD value, or 0).
        scale: How far from the prior it may well be (one standard deviation); None: whatever would make its
            torque as large as the joint's whole torque, from `dimension`.
        dimension: Powers of position, velocity and acceleration that multiply it in the torque.
        anchor: Symbol of the parameter of the same term and joint that the prior is relative to: a static friction
            that no data show is believed equal to the Coulomb friction, not zero.
        lower, upper: Physical bounds.
        held: Whether it is held at its prior, not estimated.
    """

    symbol: str
    joint: str
    unit: str
    prior: float = 0.0
    scale: float | None = None
    dimension: tuple[int, int, int] = (0, 0, 0)
    anchor: str | None = None
    lower: float = -np.inf
    upper: float = np.inf
    held: bool = False

    def __post_init__(self) -> None:
        if self.scale is not None and not self.scale > 0.0:
            raise ValueError(f"{self.name}: a scale is positive; what is not estimated is held")

    @property
    def name(self) -> str:
        """Unique name in a model: `f_c[joint_1]`."""
        return f"{self.symbol}[{self.joint}]"


@dataclass(frozen=True)
class Constant:
    """A quantity the torque is not linear in, searched over `grid`, then refined between its bounds.

    `grid[0] == 0` stands for "not there"; a constant that ends on the first or last value is at a bound. One that
    is a `speed` cannot be seen below the speeds that the motion and its bandwidth resolve; one that is a `position` is
    looked for where the joint has been. One with a `reach` (lowest, highest) is refined all over that, where the rest
    is almost right already. One that `begins` is the time in a recording when an event does.
    """

    symbol: str
    joint: str
    unit: str
    grid: tuple[float, ...]
    speed: bool = False
    position: bool = False
    reach: tuple[float, float] | None = None
    begins: bool = False

    @property
    def name(self) -> str:
        """Unique name in a model: `v_b[joint_1]`."""
        return f"{self.symbol}[{self.joint}]"

    @property
    def bounds(self) -> tuple[float, float]:
        """Lowest and highest value that is looked at."""
        return self.reach or (self.grid[0], self.grid[-1])


@dataclass(frozen=True)
class Term(ABC):
    """One contribution to the joint torques of an arm.

    Subclasses set `kind` (its name in model files), `words` (what a report calls it), whether it is `friction`,
    `parameters` and `constants`, and compute `columns`. One is `pointwise` if its columns at a sample depend on
    nothing but that sample: they can then be computed a few samples at a time.
    `options` are the choices that shape it, as a model file keeps them.
    """

    kind: ClassVar[str]
    words: ClassVar[str]
    friction: ClassVar[bool] = False
    pointwise: ClassVar[bool] = False
    parameters: tuple[Parameter, ...]
    constants: tuple[Constant, ...] = ()
    options: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    @abstractmethod
    def build(cls, arm: Arm, options: Mapping[str, Any]) -> tuple[Term, ...]:
        """The terms of this kind for an arm: one, or one a joint where constants are searched joint by joint.

        Args:
            arm: The arm.
            options: Of this kind, as in a model file.
        """

    @property
    def depends(self) -> bool:
        """Whether its columns need the background, what the rest of the model says of a motion."""
        return False

    def plausible(self, parameters: FloatArray, constants: Values) -> bool:
        """Whether these values, in the term's own order, are physically possible; a search skips those that are not.

        Args:
            parameters: (k,) values.
            constants: (c,) values.
        """
        return True

    @abstractmethod
    def columns(self, motion: Motion, constants: Values, background: Background | None) -> Columns:
        """The columns at full rate.

        Args:
            motion: N samples of n joints.
            constants: Values in the order of `self.constants`.
            background: What the rest of the model says of this motion as last estimated; None where not yet known.
        """

    def torque(
        self, motion: Motion, constants: Values, background: Background | None, parameters: FloatArray
    ) -> FloatArray:
        """(N, n) torque of the term, N·m.

        Args:
            motion: N samples of n joints.
            constants: Values in the order of `self.constants`.
            background: What the rest of the model says of this motion as last estimated; None where not yet known.
            parameters: Values in the order of `self.parameters`.
        """
        total = np.zeros_like(motion.position)
        for row, (indices, columns) in self.columns(motion, constants, background).items():
            total[:, row] += columns @ parameters[indices]
        return total


def chosen_joints(arm: Arm, choice: Any) -> tuple[str, ...]:
    """The joints that an option names; true stands for all, false or nothing for none.

    Args:
        arm: Whose joints there are.
        choice: True, a sequence of names, or nothing.

    Raises:
        UserError: The arm does not have one of them.
    """
    if choice is True:
        return arm.joint_names
    names = tuple(choice or ())
    for name in names:
        if name not in arm.joint_names:
            raise UserError(
                f"an option of the model names the joint {name!r}: the arm has {', '.join(arm.joint_names)}"
            )
    return names
