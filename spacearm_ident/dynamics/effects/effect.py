"""`Effect`: a term for physics that a model may have left out, with its equation, source, experiment and remedy.

An effect is one class in this package: its columns join any fit, its name any file, its words any report. What it
adds to a torque is written here once; the simulated arm conceals the same physics in another writing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from ...arrays import FloatArray
from ...errors import UserError
from ...signals.motion import Motion
from ..arm import Arm
from ..background import Background
from ..term import Columns, Parameter, Term, Values

Options = Mapping[str, Any]
Shown = dict[str, tuple[float, str]]
"""Name -> (value, unit)."""


@dataclass(frozen=True)
class Effect(Term):
    """One effect at one place.

    Subclasses set `kind` (its name in the contract), `words`, `equation`, `source`, `experiment` (what tells it from
    others; ends in `--for PURPOSE)` where `spacearm excite` makes that run), and implement `at` (the effect at one
    place) and `columns`.
    In a model's structure the options are `{"at": [place, ...]}`, one a term.
    """

    equation: ClassVar[str]
    source: ClassVar[str]
    experiment: ClassVar[str] = ""
    remedy: ClassVar[str] = ""
    """What to do about it once it is beyond doubt, in words."""
    in_vacuum: ClassVar[bool] = False
    """Whether an arm in air cannot have it."""
    same_torque: ClassVar[tuple[str, ...]] = ()
    """Kinds with the same torque wherever the joint moves. A finding's confidence is that of all of them together."""
    one_cause: ClassVar[bool] = False
    """Whether several joints show it for one reason (the arm got warm, the clock is late): one finding then."""
    often: ClassVar[float] = 0.5
    """Share of a recording that its events may last: beyond it the model is wrong throughout. An event is an exception;
    but what works carries something half the time."""
    exact: ClassVar[bool] = False
    """Whether nature has its very equation, so that whatever explains more than it has seen something else."""
    one_form: ClassVar[bool] = False
    """Whether its joints have it in one of its forms alone: one spring, one filter, one curve."""
    forms: ClassVar[tuple[Options, ...]] = ({},)
    """What a place may say beside its joint: at every joint each of these is tried."""
    of_all: ClassVar[bool] = False
    """Whether all joints may have it alike."""
    turns: ClassVar[bool] = False
    """Whether only joints that turn have it."""
    imitated_by: ClassVar[str] = ""
    """Commoner kind that can follow it joint by joint; it is that, unless it explains more than these together."""
    weighs: ClassVar[bool] = False
    """Whether its parameters are those of a body: then torque gains that are off are in their intervals."""
    sizes: ClassVar[tuple[str, ...]] = ()
    """Of the values that are shown, those that are the length of a vector: none is negative."""
    follows: ClassVar[str] = ""
    """What it is a function of at its joint, if of one thing alone: `velocity`, `position`, or `friction_position`,
    which is position times the direction of motion."""
    shown_over: ClassVar[tuple[str, ...] | None] = None
    """What its figure may draw the residual over (`report.mismatch_figures.OVER`); empty: time alone; None: what it
    `follows`, or whatever shows it best."""
    bodily: ClassVar[bool] = False
    """Whether it moves the torque of every joint, wherever it sits."""
    depends = True
    """Effects act on what the rest of the model says."""
    place: Options = ()  # type: ignore[assignment]
    point: Values = ()
    """Own parameters around which `columns` are taken, where these depend on them; empty: those of the model."""

    @classmethod
    def build(cls, arm: Arm, options: Mapping[str, Any]) -> tuple[Term, ...]:
        """One term a place."""
        places = options.get("at", ())
        if not isinstance(places, Sequence) or not all(isinstance(place, Mapping) for place in places):
            raise UserError(f"{cls.kind}: its options say where it acts: at: [{{joint: NAME}}, ...]")
        try:
            return _told_apart([cls.at(arm, place) for place in places])
        except (KeyError, ValueError) as error:
            raise UserError(f"{cls.kind}: a place of it is wrong or incomplete: {error}") from error

    @classmethod
    def at(cls, arm: Arm, place: Options) -> Effect:
        """The effect at one place.

        Args:
            arm: The arm.
            place: Names of the joint or joints, and what else says where, as in a model file.

        Raises:
            KeyError, ValueError: The place is incomplete, or not one of this arm.
        """
        raise NotImplementedError

    @classmethod
    def variants(cls, arm: Arm) -> Iterator[Options]:
        """Every place where it could act."""
        places: list[Options] = [{"joints": list(arm.joint_names)}] if cls.of_all else []
        places += [{"joint": joint.name} for joint in arm.joints if joint.revolute or not cls.turns]
        # Each has its own copy of a form: a model file would write a shared list as a reference.
        yield from ({**place, **deepcopy(form)} for place in places for form in cls.forms)

    @property
    def joints(self) -> tuple[str, ...]:
        """Where it is."""
        joint = self.place.get("joint")
        return (joint,) if joint else tuple(self.place.get("joints", ()))

    def around(self, parameters: Values) -> Effect:
        """The same with the columns that hold at some values (k,) of its parameters; itself where none matters."""
        return self

    def _own(self, background: Background) -> Values:
        """(k,) own parameters at which the columns are taken; zero where there are none yet."""
        return self.point or tuple(background.values.get(parameter.name, 0.0) for parameter in self.parameters)

    @property
    def needs_reference(self) -> bool:
        """Whether it changes what a reference has: beside the field's own fit another place is the same torque."""
        return False

    @property
    def needs_temperature(self) -> bool:
        """Whether it cannot be told without recorded temperatures."""
        return False

    @property
    def rarity(self) -> int:
        """How many others one would think of before it at its place, of those that explain as much."""
        return 0

    def within_healthy_range(self, parameters: FloatArray, constants: Values, coulomb: Mapping[str, float]) -> bool:
        """Whether any healthy joint does as much.

        Args:
            parameters: Fitted values, in the order of `self.parameters`.
            constants: Values in the order of `self.constants`.
            coulomb: Joint -> Coulomb friction, N·m.
        """
        return False

    def is_within(self, parameters: FloatArray, coulomb: Mapping[str, float]) -> bool:
        """Whether it takes no more friction away than there is.

        Args:
            parameters: Fitted values, in the order of `self.parameters`.
            coulomb: Joint -> Coulomb friction, N·m.
        """
        return True

    @property
    def per_recording(self) -> tuple[int, ...]:
        """Numbers of the parameters that belong to a recording, not to the arm: another recording has its own."""
        return ()

    def resonance(self, motion: Motion, constants: Values, background: Background) -> tuple[float, float] | None:
        """Lowest and highest frequency, Hz, at which it rings along a motion; None where it does not.

        Args:
            motion: N samples of n joints.
            constants: Values in the order of `self.constants`.
            background: What the rest of the model says of this motion; the arm and its inertials must be known.
        """
        return None

    @property
    def event(self) -> bool:
        """Whether it begins and ends in time.

        Its place may then have a `recording`, the number from 0 of the only one in which it happened.
        """
        return any(constant.begins for constant in self.constants)

    def elsewhere(self, motion: Motion) -> bool:
        """Whether it is an event of another recording than a motion's."""
        return bool(self.place.get("recording", motion.source) != motion.source)

    def window(self, constants: Values) -> tuple[float, float]:
        """Start and end of an event, s.

        Args:
            constants: (c,) values in the order of `self.constants`; the one that begins is followed by a length, s.
        """
        begins = next(k for k, constant in enumerate(self.constants) if constant.begins)
        start, length = constants[begins : begins + 2]
        return float(start), float(start + length)

    def clipped(self, constants: Values, span: tuple[float, float]) -> Values:
        """Constants of an event that begins and ends within what was recorded; of any other effect, as given.

        Args:
            constants: (c,) values in the order of `self.constants`; of what is not recorded a search knows nothing.
            span: Start and end of the recording, s.
        """
        if not self.event:
            return constants
        begins = next(k for k, constant in enumerate(self.constants) if constant.begins)
        begin, end = np.clip(self.window(constants), *span)
        return (*constants[:begins], float(begin), float(end - begin), *constants[begins + 2 :])

    def over(self, arm: Arm, motions: Sequence[Motion]) -> Effect:
        """The same with constants looked for where some motions have been; itself where that does not matter.

        Args:
            arm: The arm.
            motions: At least one.
        """
        return self

    def since(self, reference: Sequence[Motion]) -> Effect:
        """The same as a change from what these motions show; itself where that does not matter.

        Args:
            reference: Motions of the healthy arm, at least one.
        """
        return self

    def prepare(self, motion: Motion, points: Sequence[Values], background: Background | None) -> None:
        """Compute what columns at many values of the constants have in common; it is kept in the background.

        Args:
            motion: N samples.
            points: (c,) values of the constants each.
            background: What the rest of the model says of this motion.
        """

    def lasts(self, motion: Motion, constants: Values) -> slice:
        """Samples of a motion outside which its columns are zero: of an event, those from its start for its length.

        Args:
            motion: N samples.
            constants: (c,) values in the order of `self.constants`.
        """
        if not self.event:
            return slice(0, len(motion.position))
        first, last = (np.array(self.window(constants)) - motion.start_s) * motion.rate_hz
        # A sample more on either side, for rounding.
        return slice(max(int(first) - 1, 0), max(min(int(last) + 2, len(motion.position)), 0))

    def again(self, arm: Arm) -> Effect | None:
        """A further one of the same kind at the same place (another harmonic), once this one is known."""
        return None

    def replaces(self, other: Effect) -> bool:
        """Whether another says the same of the same place in another form, and is no candidate once this is known."""
        return other is self or (self.one_form and type(other) is type(self) and other.joints == self.joints)

    def excludes(self, other: Effect) -> bool:
        """Whether an arm cannot have both: the one that was found first is kept."""
        return False

    def shown(self, values: FloatArray) -> Shown:
        """What a person wants to know of its values: parameters, then constants, in its own order."""
        shown = {}
        for parameter, value in zip(self.parameters, values):
            if not parameter.held:
                shown[parameter.symbol] = (float(value), parameter.unit)
        for constant, value in zip(self.constants, values[len(self.parameters) :]):
            shown[constant.symbol] = (float(value), constant.unit)
        return shown

    def against(self, values: FloatArray) -> str:
        """What in its own values speaks against its name, in words that follow "whose"; empty where nothing does."""
        return ""

    def where(self, values: FloatArray) -> str:
        """Where and when it acts, in words."""
        return self.words


def _told_apart(effects: Sequence[Effect]) -> tuple[Effect, ...]:
    """Effects whose parameters and constants have a name each: a second one at a joint has its number in them.

    A model file keeps values by name; two harmonics or two axes at one joint would share one value there.
    """
    taken: set[str] = set()
    named = []
    for effect in effects:
        number, one = 1, effect
        while taken & _names(one):
            number += 1
            one = replace(
                effect,
                parameters=tuple(replace(p, symbol=f"{p.symbol}_{number}") for p in effect.parameters),
                constants=tuple(replace(c, symbol=f"{c.symbol}_{number}") for c in effect.constants),
            )
        taken |= _names(one)
        named.append(one)
    return tuple(named)


def _names(effect: Effect) -> set[str]:
    return {parameter.name for parameter in effect.parameters} | {constant.name for constant in effect.constants}


def own(row: int, *columns: FloatArray) -> Columns:
    """Columns of an effect that acts in one row."""
    return {row: (list(range(len(columns))), np.stack(columns, axis=1))}


def each(columns: Mapping[int, FloatArray]) -> Columns:
    """Columns (N, k) of the same parameters in several rows."""
    return {row: (list(range(array.shape[1])), array) for row, array in columns.items()}


def direction(motion: Motion, row: int) -> FloatArray:
    """(N,) sign of a joint's velocity; zero where that is no more than its noise.

    Args:
        motion: N samples.
        row: Number of the joint.
    """
    velocity = motion.velocity[:, row]
    return np.where(np.abs(velocity) > motion.speed_noise[row], np.sign(velocity), 0.0)


def share_of(place: str) -> Parameter:
    """The parameter of an effect that is linear in nothing it has: how much of it there is; all, and not estimated."""
    return Parameter("share", place, "1", prior=1.0, held=True)


def nothing(motion: Motion, rows: Sequence[int], count: int) -> Columns:
    """Zero columns of an effect before anything is known of the rest of the model.

    Args:
        motion: N samples.
        rows: Numbers of the joints whose rows the effect acts in.
        count: Number of columns: the effect's parameters.
    """
    return {row: (list(range(count)), np.zeros((len(motion.position), count))) for row in rows}


def known_joint(arm: Arm, place: Options) -> str:
    """The joint of a place.

    Args:
        arm: The arm.
        place: With the name of a joint.

    Raises:
        ValueError: The arm does not have it.
    """
    joint = place["joint"]
    if joint not in arm.joint_names:
        raise ValueError(f"the arm has no joint {joint!r}")
    return str(joint)


def known_joints(arm: Arm, place: Options) -> str:
    """The name that parameters of an effect at some joints alike go by: that of its one joint, or `all`.

    Args:
        arm: The arm.
        place: With the name of a joint, or names of several.

    Raises:
        ValueError: The arm does not have one of them, or none is named.
    """
    if "joint" in place:
        return known_joint(arm, place)
    for joint in place["joints"]:
        known_joint(arm, {"joint": joint})
    if not place["joints"]:
        raise ValueError("joints is empty")
    return "all"


def known_axis(place: Options) -> None:
    """Check the axis of a place.

    Raises:
        ValueError: It is not three numbers, or no direction.
    """
    axis = np.array(place["axis"], dtype=float)
    if axis.shape != (3,) or not np.any(axis):
        raise ValueError("axis is three numbers, not all zero")
