"""`Item` and `Layer`: what a comparison of a simulation with an arm found. Plain results, no computation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from ..arrays import FloatArray

CONVENTIONS, PARAMETERS, PHYSICS, REST = "conventions", "parameters", "physics", "rest"
"""The layers, in the order in which an engineer would look."""


@dataclass(frozen=True)
class Item:
    """One thing that the simulation has wrong, or does not have.

    Attributes:
        name: Stable short name: a mistake of convention, a parameter in the simulation's words, an effect.
        joints: Where.
        where: The same in words.
        was: In the simulation; NaN where it has nothing of the kind.
        value: In the arm.
        low, high: 95 % interval of `value`.
        unit: Of all of them.
        share: Of the simulation's residual variance above the noise, on held-out data, that is back without it.
        replicated: Whether another recording, or another part, says the same; None: there is none to ask.
        combination: Parameter of the simulation -> coefficient, where it is a combination of several.
        equivalents: Other effects with the same torque wherever the joints move.
    """

    name: str
    joints: tuple[str, ...]
    where: str
    was: float
    value: float
    low: float
    high: float
    unit: str
    share: float = float("nan")
    replicated: bool | None = None
    combination: Mapping[str, float] = field(default_factory=dict)
    equivalents: tuple[str, ...] = ()

    @property
    def title(self) -> str:
        """Its name and its equivalents', for a person."""
        return " or ".join(name.replace("_", " ") for name in (self.name, *self.equivalents))


@dataclass(frozen=True)
class Layer:
    """What a layer removes.

    Attributes:
        name: One of the four.
        before_Nm, after_Nm: (n,) RMS of the residual on held-out recordings without and with it.
        items: What it consists of, the largest share first.
        notes: What a reader should know of it, a sentence each.
    """

    name: str
    before_Nm: FloatArray
    after_Nm: FloatArray
    items: tuple[Item, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Mended:
    """A simulation's file with new values.

    Attributes:
        name: File name to write it under.
        text: Its contents.
        lost: What of the model the format does not hold, in words.
        cost_Nm: Joint -> RMS that its nearest parameters leave of the model's torque, where the joint moves.
        torque_Nm: Joint -> RMS of the model's torque there.
        excess: (n,) RMS of what the file leaves of the arm's torque over what the model leaves, by joint of the arm.
        closed_loop: The file as it was, and mended, run along what the arm did; None where the format has no engine.
    """

    name: str
    text: str
    lost: tuple[str, ...]
    cost_Nm: Mapping[str, float]
    torque_Nm: Mapping[str, float]
    excess: FloatArray | None = None
    closed_loop: tuple[Strayed, Strayed] | None = None


@dataclass(frozen=True)
class Strayed:
    """A simulation in closed loop along what the arm did (`export/closed_loop.py`).

    Attributes:
        position: Joint -> RMS distance from the recorded position, rad or m; infinite where the run is unstable.
        feedback_Nm: Joint -> RMS of the torque that the feedback adds, N m; likewise.
    """

    position: Mapping[str, float]
    feedback_Nm: Mapping[str, float]
