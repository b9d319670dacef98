"""`TorqueModel`: the terms whose sum is the joint torque, and its values once they are known."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from ..arrays import FloatArray
from ..errors import UserError
from ..signals.motion import Motion
from .arm import Arm
from .background import Background
from .coupling import CoupledMotor
from .effects import EFFECTS, Effect
from .friction import StribeckFriction, ViscousFriction
from .regressor import rigid_body_torque
from .rigid_body import JointSpring, RigidBody, RotorInertia, TorqueOffset
from .term import Constant, Parameter, Term, chosen_joints

_KINDS: tuple[type[Term], ...] = (
    RigidBody,
    RotorInertia,
    JointSpring,
    StribeckFriction,
    ViscousFriction,
    CoupledMotor,
    TorqueOffset,
    *EFFECTS.values(),
)
CATALOGUE: dict[str, type[Term]] = {kind.kind: kind for kind in _KINDS}

Structure = dict[str, dict[str, Any]]
"""Term kind -> its options: what a model is made of, before any value is known."""


FRICTION_LAWS: dict[str, Structure] = {
    "paper": {"stribeck_friction": {}, "viscous_friction": {"quadratic": "even"}},
    "paper-odd": {"stribeck_friction": {}, "viscous_friction": {"quadratic": "odd"}},
    "vacuum": {"stribeck_friction": {}, "viscous_friction": {"vacuum": True}},
    "coulomb-viscous": {
        "stribeck_friction": {"stribeck": False, "presliding": False},
        "viscous_friction": {"vacuum": True},
    },
}
"""Named friction laws: the paper's eq. 2 as printed, with qd |qd|, in vacuum (§2.2.2), and the textbook's."""


def structure_of(arm: Arm, friction: str = "paper") -> Structure:
    """The paper's 18 parameters a joint (§2, Table 1) under a named friction law, and the arm's couplings.

    Args:
        arm: Its couplings become terms.
        friction: One of `FRICTION_LAWS`.

    Raises:
        UserError: No friction law of that name.
    """
    if friction not in FRICTION_LAWS:
        raise UserError(f"no friction law {friction!r}: choose one of {', '.join(FRICTION_LAWS)}")
    structure: Structure = {
        "rigid_body": {},
        "rotor_inertia": {},
        "joint_spring": {},
        **FRICTION_LAWS[friction],
    }
    if arm.couplings:
        structure["coupled_motor"] = {}
    return structure


OVER_TEMPERATURE = ("f_c", "k_v1", "v_b")
"""What of friction may follow the joint's temperature (paper §2.2.2 has f_c; k_v1 and v_b are ours)."""


def over_temperature(structure: Structure, arm: Arm, symbols: Sequence[str]) -> Structure:
    """A structure in which friction follows the joints' temperatures.

    f_c and k_v1 get a slope (`temperature_friction`: alpha_c, alpha_v), v_b a ratio over ten kelvin (Q_10).

    Args:
        structure: Without such terms.
        arm: The arm.
        symbols: Some of `OVER_TEMPERATURE`; none leaves the structure as it is.

    Raises:
        UserError: Another symbol, or v_b under a friction law that has none.
    """
    for symbol in symbols:
        if symbol not in OVER_TEMPERATURE:
            raise UserError(f"{symbol!r} over temperature: choose among {', '.join(OVER_TEMPERATURE)}")
    wider = dict(structure)
    linear = [symbol for symbol in OVER_TEMPERATURE[:2] if symbol in symbols]
    if linear:
        places = [{"joint": joint, "of": linear, "rising": True} for joint in arm.joint_names]
        wider["temperature_friction"] = {"at": places}
    if "v_b" in symbols:
        stribeck = wider.get("stribeck_friction", {"stribeck": False})
        if not stribeck.get("stribeck", True):
            raise UserError("v_b over temperature: this friction law has no v_b; take paper, paper-odd or vacuum")
        wider["stribeck_friction"] = {**stribeck, "temperature": True}
    return wider


def temperature_joints(structure: Structure, arm: Arm) -> tuple[str, ...]:
    """The joints whose temperature a structure's terms ask for, in the arm's order.

    Args:
        structure: Terms and options.
        arm: Whose joints they are at.
    """
    asked = set(chosen_joints(arm, structure.get("stribeck_friction", {}).get("temperature")))
    for term in TorqueModel(arm, structure).terms:
        if isinstance(term, Effect) and term.needs_temperature:
            asked.update(term.joints)
    return tuple(joint for joint in arm.joint_names if joint in asked)


_AnyTerm = TypeVar("_AnyTerm", bound=Term)


def in_own_units(term: _AnyTerm, arm: Arm) -> _AnyTerm:
    """A term whose parameters and constants at joints that slide are in metres and newtons; else itself.

    Args:
        term: With the units of joints that turn.
        arm: Whose joints there are.
    """
    sliding = {joint.name for joint in arm.joints if not joint.revolute}
    if sliding.isdisjoint([*(item.joint for item in term.parameters), *(item.joint for item in term.constants)]):
        return term
    return replace(
        term,
        parameters=tuple(replace(p, unit=_sliding_unit(p)) if p.joint in sliding else p for p in term.parameters),
        constants=tuple(replace(c, unit=_sliding_unit(c)) if c.joint in sliding else c for c in term.constants),
    )


def _sliding_unit(item: Parameter | Constant) -> str:
    """The unit at a joint that slides, from that at one that turns; inertials of a link are the same."""
    if item.symbol == "J_m":
        return item.unit.replace("kg m^2", "kg")
    return item.unit.replace("N m", "N").replace("rad", "m")


@dataclass(frozen=True)
class TorqueModel:
    """An arm and its terms; parameters and constants are numbered through in the order of the terms."""

    arm: Arm
    structure: Structure

    @cached_property
    def terms(self) -> tuple[Term, ...]:
        """The terms, built from the catalogue.

        Raises:
            UserError: A kind the catalogue does not have.
        """
        unknown = set(self.structure) - set(CATALOGUE)
        if unknown:
            raise UserError(f"unknown term {sorted(unknown)[0]!r}: this version has {', '.join(CATALOGUE)}")
        built = (term for kind, options in self.structure.items() for term in CATALOGUE[kind].build(self.arm, options))
        return tuple(in_own_units(term, self.arm) for term in built)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """All linear parameters."""
        return tuple(parameter for term in self.terms for parameter in term.parameters)

    @cached_property
    def constants(self) -> tuple[Constant, ...]:
        """All nonlinear constants."""
        return tuple(constant for term in self.terms for constant in term.constants)

    @property
    def unknowns(self) -> tuple[Parameter | Constant, ...]:
        """Parameters, then constants."""
        return (*self.parameters, *self.constants)

    @property
    def first_inertial(self) -> int | None:
        """Number of the first link's mass; None without rigid links."""
        return next((first for term, first, _ in self.numbered() if isinstance(term, RigidBody)), None)

    def numbered(self) -> Iterator[tuple[Term, int, int]]:
        """Each term with the numbers of its first parameter and first constant."""
        parameter = constant = 0
        for term in self.terms:
            yield term, parameter, constant
            parameter += len(term.parameters)
            constant += len(term.constants)

    def torque(
        self,
        motion: Motion,
        parameters: FloatArray,
        constants: FloatArray,
        kinds: Sequence[str] | None = None,
    ) -> FloatArray:
        """Torque of the model, or of some of its terms.

        Args:
            motion: N samples.
            parameters: (p,) in the order of `self.parameters`.
            constants: (c,) in the order of `self.constants`.
            kinds: Only the terms of these kinds.

        Returns:
            (N, n) N·m.
        """
        background = self.background(motion, parameters, constants)
        total = np.zeros_like(motion.position)
        for term, first, first_constant in self.numbered():
            if kinds is not None and term.kind not in kinds:
                continue
            values = constants[first_constant : first_constant + len(term.constants)]
            own = parameters[first : first + len(term.parameters)]
            for part in motion.pieces() if term.pointwise else (slice(0, len(total)),):
                total[part] += term.torque(motion[part], values, background, own)
        return total

    def background(self, motion: Motion, parameters: FloatArray, constants: FloatArray) -> Background:
        """What terms may need to know of the others along a motion; computed only where one asks.

        Args:
            motion: N samples of n joints.
            parameters: (p,) in the order of `self.parameters`.
            constants: (c,) in the order of `self.constants`.
        """
        count = 10 * len(self.arm.joints)
        first = self.first_inertial
        inertials = None if first is None else parameters[first : first + count].reshape(-1, 10)
        healthy = tuple(kind for kind in self.structure if kind not in EFFECTS)
        return Background(
            self.arm,
            inertials,
            {item.name: float(value) for item, value in zip(self.parameters, parameters)},
            lambda: self._load(motion, inertials),
            lambda: self.torque(motion, parameters, constants, healthy),
            lambda: self.high_orders(motion, parameters),
        )

    def high_orders(self, motion: Motion, parameters: FloatArray) -> FloatArray:
        """(N, n) torque of the friction terms of second and third order, N·m.

        Args:
            motion: At full rate.
            parameters: (p,) of the model.
        """
        kept = np.where(self.of_high_order, parameters, 0.0)
        return self.torque(motion, kept, np.zeros(len(self.constants)), (ViscousFriction.kind,))

    @cached_property
    def of_high_order(self) -> np.ndarray:
        """(p,) which parameters are friction of second or third order in speed."""
        return np.array([ViscousFriction.high_order(parameter) for parameter in self.parameters])

    def _load(self, motion: Motion, inertials: FloatArray | None) -> FloatArray:
        """(N, n) torque of the rigid bodies along a motion, N·m."""
        load = np.zeros(motion.position.shape)
        if inertials is not None:
            for part in motion.pieces():
                piece = motion[part]
                state = piece.position, piece.velocity, piece.acceleration
                load[part] = rigid_body_torque(self.arm, inertials, *state, piece.base)
        return load

    @cached_property
    def friction_kinds(self) -> tuple[str, ...]:
        """Kinds of the terms that are friction."""
        return tuple(dict.fromkeys(term.kind for term in self.terms if term.friction))

    def with_gravity(self, gravity: FloatArray) -> TorqueModel:
        """The same structure in another field of gravity (3,), m/s², base frame."""
        return TorqueModel(self.arm.with_gravity(gravity), self.structure)

    @property
    def depends(self) -> bool:
        """Whether a term needs to know of the others."""
        return any(term.depends for term in self.terms)


@dataclass(frozen=True)
class Unbounded:
    """Least squares without the bounds of physical consistency, where that predicts held-out torque better.

    Attributes:
        parameters: (p,) values that no arm need be able to have.
        share: (n,) how far each joint's prediction goes from the possible parameters to these, 0 to 1.
    """

    parameters: FloatArray
    share: FloatArray


@dataclass(frozen=True)
class Plain:
    """A plain model (`identification/plain.py`), where it is part of what predicts held-out torque best.

    Attributes:
        model: Rigid bodies, rotor inertia, Coulomb and viscous friction, offset, and the arm's couplings.
        parameters: (p,) values of `model.parameters`, by least squares without physical bounds.
        constants: (c,) values of `model.constants`: presliding distances.
        share: (n,) share of each joint's prediction, 0 to 1.
    """

    model: TorqueModel
    parameters: FloatArray
    constants: FloatArray
    share: FloatArray


@dataclass(frozen=True)
class OwnRecordings:
    """What a model leaves of the recordings it was identified from (`identification/own_recordings.py`).

    A part is a whole recording, or one of several parts of the only one; f of them were left out of a fit in turn.

    Attributes:
        recordings: How many there were.
        acceleration: (n,) RMS while a joint moves, rad/s² (m/s²).
        rows: (f, n) so many rows of full weight a part is worth.
        left_out_Nm: (f, n) RMS that the fit without a part leaves of it, N·m; 0 where a joint has no rows.
        fitted_Nm: (f, n) RMS that the fit to all leaves of it, N·m.
        parameters: (f, p) of the fits, physically consistent.
        density: (n,) power density of what is left out, as far as it would move a fit, (N·m)²·s; None in older files.
    """

    recordings: int
    acceleration: FloatArray
    rows: FloatArray
    left_out_Nm: FloatArray
    fitted_Nm: FloatArray
    parameters: FloatArray
    density: FloatArray | None = None


@dataclass(frozen=True)
class IdentifiedModel:
    """A torque model with values: everything needed to predict torque again.

    Attributes:
        model: Structure.
        parameters: (p,) values of `model.parameters`; identified ones are physically consistent.
        constants: (c,) values of `model.constants`.
        cutoff_hz: Bandwidth it was identified in, Hz; None where it was not identified.
        provenance: Where it comes from (sources with checksums, versions, configuration).
        unbounded: Unbounded parameters blended into predicted torque; None: none. Bodies are those of `parameters`.
        plain: A plain model blended into predicted torque; None: none.
        own: What it leaves of its own recordings; None: not known.
    """

    model: TorqueModel
    parameters: FloatArray
    constants: FloatArray
    cutoff_hz: float | None = None
    provenance: Mapping[str, Any] | None = None
    unbounded: Unbounded | None = None
    plain: Plain | None = None
    own: OwnRecordings | None = None

    @property
    def possible(self) -> IdentifiedModel:
        """The physically consistent model alone, with nothing blended into its torque: an arm that could be."""
        return replace(self, unbounded=None, plain=None)

    def torque(self, motion: Motion, kinds: Sequence[str] | None = None) -> FloatArray:
        """(N, n) predicted torque at full rate, N·m."""
        possible = self.model.torque(motion, self.parameters, self.constants, kinds)
        total = possible
        if self.unbounded is not None:
            free = self.model.torque(motion, self.unbounded.parameters, self.constants, kinds)
            total = total + self.unbounded.share * (free - possible)
        if self.plain is not None:
            plain = self.plain.model.torque(motion, self.plain.parameters, self.plain.constants, kinds)
            total = total + self.plain.share * (plain - possible)
        return total

    def with_gravity(self, gravity: FloatArray) -> IdentifiedModel:
        """The same in another field of gravity (3,), m/s², base frame."""
        plain = self.plain
        if plain is not None:
            plain = replace(plain, model=plain.model.with_gravity(gravity))
        return replace(self, model=self.model.with_gravity(gravity), plain=plain)

    def moved_to(self, parameters: FloatArray, constants: FloatArray) -> IdentifiedModel:
        """The same with other values of `parameters` (p,) and `constants` (c,).

        What is blended into the torque moves by as much, as far as it has the term; `departure_share` of it counts.
        """
        departure = parameters - self.parameters
        unbounded, plain, own = self.unbounded, self.plain, self.own
        if unbounded is not None:
            unbounded = replace(unbounded, parameters=unbounded.parameters + departure)
        if plain is not None:
            moves = dict(zip(_names(self.model), departure))
            theirs = np.array([moves.get(name, 0.0) for name in _names(plain.model)])
            plain = replace(plain, parameters=plain.parameters + theirs)
        if own is not None:
            own = replace(own, parameters=own.parameters + departure)
        return replace(self, parameters=parameters, constants=constants, unbounded=unbounded, plain=plain, own=own)

    @property
    def departure_share(self) -> FloatArray:
        """(n, p) how much of a departure of a parameter `moved_to` takes to each joint's torque, 0 to 1.

        Where the plain model has a share, f_c is near rest another column there than beside Stribeck friction.
        """
        share = np.ones((len(self.model.arm.joints), len(self.parameters)))
        if self.plain is not None:
            plain = self.plain.model
            theirs = {name for name, one in zip(_names(plain), plain.parameters) if not one.held}
            lacking = np.array([name not in theirs for name in _names(self.model)])
            share[:, lacking] = self.constant_share[:, None]
        return share

    @property
    def constant_share(self) -> FloatArray:
        """(n,) the same of a constant's departure: a plain model has its own."""
        return np.ones(len(self.model.arm.joints)) if self.plain is None else 1.0 - self.plain.share

    @cached_property
    def by_term(self) -> Mapping[tuple[str, str], float]:
        """Every parameter and constant by the kind of its term and its name.

        By its name alone it would not do: friction and an effect of friction may each have a distance `d_s[joint_1]`.
        """
        values: dict[tuple[str, str], float] = {}
        for term, first, first_constant in self.model.numbered():
            names = [item.name for item in term.parameters] + [item.name for item in term.constants]
            own = self.parameters[first : first + len(term.parameters)]
            searched = self.constants[first_constant : first_constant + len(term.constants)]
            values |= {(term.kind, name): float(v) for name, v in zip(names, (*own, *searched))}
        return values

    def carried_to(self, model: TorqueModel) -> IdentifiedModel:
        """Another model with the values of what both have; the rest of it is zero.

        Unbounded parameters are carried as well; a plain model is one of its own and stays.

        Args:
            model: Of the same arm, with other terms.
        """
        known = self.by_term
        constants = [known.get((term.kind, item.name), 0.0) for term in model.terms for item in term.constants]
        unbounded = self.unbounded
        if unbounded is not None:
            unbounded = replace(unbounded, parameters=self._carried(unbounded.parameters, model))
        return replace(
            self,
            model=model,
            parameters=self._carried(self.parameters, model),
            constants=np.array(constants),
            unbounded=unbounded,
            own=None,
        )

    def _carried(self, parameters: FloatArray, model: TorqueModel) -> FloatArray:
        """(q,) parameters of another model: values (p,) of what this one has, zero for the rest."""
        known = dict(zip(_names(self.model), parameters.tolist()))
        return np.array([known.get(name, 0.0) for name in _names(model)])

    def value(self, symbol: str, joint: str) -> float:
        """A parameter or constant by name.

        Args:
            symbol: As `f_c`.
            joint: Its name.

        Raises:
            KeyError: The model has none of that name.
        """
        name = f"{symbol}[{joint}]"
        for item, value in zip(self.model.unknowns, (*self.parameters, *self.constants)):
            if item.name == name:
                return float(value)
        raise KeyError(name)


def _names(model: TorqueModel) -> list[tuple[str, str]]:
    """(p,) parameters by the kind of their term and their name."""
    return [(term.kind, item.name) for term in model.terms for item in term.parameters]
