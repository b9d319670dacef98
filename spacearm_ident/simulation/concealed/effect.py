"""`Effect`: one concealed piece of physics and the places where it may act.

A subclass says in `parameters` what numbers it takes and overrides the hooks it needs; `Concealment` calls only
those. Friction acts through `level` (dry friction, a bound) or `torque` (anything smooth the motor works against);
masses and gravity through `alter`; springs, gaps and extra bodies through `build`; drives through `motor`; sensors
through `encoder` and `reported`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from spacearm_ident.arrays import FloatArray, IntArray
from spacearm_ident.simulation.parameters import PlantParameters

if TYPE_CHECKING:
    from spacearm_ident.simulation.closed_loop import Truth
    from spacearm_ident.simulation.concealed.compliant import Structure
    from spacearm_ident.simulation.plant import Plant


@dataclass(frozen=True)
class Parameter:
    """A number of an effect.

    Attributes:
        unit: SI.
        low: Smallest plausible value.
        high: Largest plausible value.
        default: Taken when the file does not give it; None: must be given. NaN: the effect knows by itself.
        size: Length of a vector, 0: one number.
    """

    unit: str
    low: float
    high: float
    default: float | None = None
    size: int = 0


class State:
    """What effects may look at while the plant moves; (n,) each, of the drives.

    Attributes:
        time: s on the recording's clock.
        q: rad.
        qd: rad/s; what friction feels within the step.
        temperature: °C of the housings.
        load: N·m the gears pass on, of the last step; zero unless an effect `needs_load`.
    """

    def __init__(self, n: int) -> None:
        self.time = 0.0
        self.q, self.qd, self.load = np.zeros((3, n))
        self.temperature = np.full(n, 20.0)


class Effect:
    """One effect at some joints; by itself it does nothing.

    Attributes:
        name: As in the file.
        parameters: What it takes; the first is its strength.
        laws: Forms it comes in, the usual first.
        joints_needed: How many joints it takes: None any number, 0 it acts on the whole arm.
        known: Whether its name is one a finder is expected to know.
        needs_load: Whether it looks at `State.load`.
        last: Whether it replaces dry friction and so must come after what changes it.
        joints: Indices of its joints.
        values: Parameters, one array (k,) over the joints (k, size for vectors).
        law: Form taken.
    """

    name: ClassVar[str]
    parameters: ClassVar[dict[str, Parameter]]
    laws: ClassVar[tuple[str, ...]] = ("usual",)
    joints_needed: ClassVar[int | None] = None
    known: ClassVar[bool] = True
    needs_load: ClassVar[bool] = False
    last: ClassVar[bool] = False

    def __init__(self, joints: IntArray, values: dict[str, FloatArray], law: str) -> None:
        self.joints, self.values, self.law = joints, values, law
        self.prepare()

    def one(self, name: str) -> float:
        """A parameter that does not differ from joint to joint."""
        return float(self.values[name].flat[0])

    def spread(self, name: str, n: int, rest: float = 0.0) -> FloatArray:
        """A parameter of the effect over all joints of the arm, (n,).

        Args:
            name: Name of the parameter, one number a joint.
            n: Number of joints of the arm.
            rest: Value at the joints where the effect does not act, in the parameter's unit.
        """
        full = np.full(n, rest)
        full[self.joints] = self.values[name]
        return full

    def added(self, whole: FloatArray, more: FloatArray | float) -> FloatArray:
        """Torque or friction (n,) N·m of all joints with `more` (k,) N·m at the effect's."""
        whole = whole.copy()
        whole[self.joints] += more
        return whole

    def prepare(self) -> None:
        """Called once, at the end of construction."""

    def begin(self, parameters: PlantParameters, plant: Plant) -> None:
        """Called once with the arm as it was before any effect, and the plant at rest."""

    def alter(self, parameters: PlantParameters) -> PlantParameters:
        """The parameters the arm obeys with the effect."""
        return parameters

    def build(self, structure: Structure) -> None:
        """Add bodies, springs or forces to the mechanism."""

    def advance(self, state: State, h: float) -> None:
        """Let the effect's own state pass `h` seconds at the motion of `state`."""

    def level(self, state: State, level: FloatArray) -> FloatArray:
        """The level of dry friction (n,) N·m with the effect."""
        return level

    def torque(self, state: State) -> FloatArray:
        """Torque (n,) N·m the motors must provide for in addition."""
        return np.zeros_like(state.q)

    def encoder(self, position: FloatArray) -> FloatArray:
        """What the encoders show at `position` (..., n) rad."""
        return position

    def motor(self, torque: FloatArray, plant: Plant) -> FloatArray:
        """What the motors give where the drives report `torque` (n,) N·m."""
        return torque

    def reported(self, truth: Truth) -> Truth:
        """The recording's truth as the sensors pass it on."""
        return truth
