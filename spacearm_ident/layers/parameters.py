"""Layer 1: which of the simulation's parameters are wrong, as far as torque can tell.

Torque determines combinations of inertials only (base parameters, Gautier 1991). What is reported is the simplest of

- *causes*: a body's mass, its centre, a rotor's inertia; at most `MOST_CAUSES` of them that together account for the
  change of every combination within its error, as far as all such sets agree;
- the *combinations* themselves, each with was -> is, otherwise.

Friction loss, damping and stiffness of a joint are determined one by one. A change is named if it exceeds its error at
`LEVEL` shared by all that are tested (Bonferroni), and if the data, not the prior, say so (`DETERMINED`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from scipy.stats import chi2, norm

from ..arrays import FloatArray
from ..dynamics.arm import Arm
from ..dynamics.base_parameters import base_parameters
from ..dynamics.model import TorqueModel
from ..dynamics.regressor import INERTIAL_SYMBOLS
from ..regression.balanced import pseudo_inverse
from ..simulations import Simulation
from .estimate import Estimate
from .linear import Linear, Prior

LEVEL = 0.05
"""Probability that any unchanged parameter is named."""
DIGITS = 0.01
"""Relative difference from the simulation's value that is none: a file has two digits, a simulator its integration
step. Of 22 parameters named wrongly in 60 blind trials nine were within it."""
DETERMINED = 0.1
"""Largest error of a combination, in standard deviations of its prior, at which the data say what it is: the prior
then moves the estimate by less than one per cent of the distance."""
MOST_CAUSES = 6
"""Causes that are a simple word: two links' mass and centre, and two rotors."""
KEPT = 60
"""Sets of causes of one size that are gone on with: all of one, and the best of more."""
ENOUGH = 0.01
"""Probability below which causes do not account for the change of the combinations."""
OFF = 0.1
"""Prior probability that any one thing is off (as `conventions.ODDS`)."""
MASS_SHARE, CENTRE_M, ROTOR_SHARE = 0.3, 0.03, 0.5
"""Standard deviations of what is off where something is: of a mass and of a rotor inertia, as a share; of a centre."""
LEAST_ROTOR = 0.1
"""kg m^2: a file without rotor inertias says nothing of them; of the real arms in hand most have 0.1 to 1."""
TOOL = (1.0, *3 * (0.1,), *6 * (0.02,))
"""The same of all parameters of the last link, about its joint: a tool of a kilogram at a hand's length."""
IN_NEARLY_ALL = 0.95
"""Probability of the sets of causes that say the same from which it is reported."""
IN_MANY = 0.3
"""The same from which it is said to be possible: three times what is so before any data."""
NEAR = 7.0
"""Difference of the log probability beyond which a set, below a thousandth, is left out."""
INERTIAL_WORDS = ("mass", "mx", "my", "mz", "ixx", "ixy", "iyy", "ixz", "iyz", "izz")
"""What a body's ten parameters are called in a combination; about the origin of its frame."""
OWN = frozenset({"k_v1", "f_c", "k_1"})
"""Symbols of a joint's parameters that torque determines one by one."""


@dataclass(frozen=True)
class Change:
    """A parameter, or a combination, that is not what the simulation has.

    Attributes:
        name: In the simulation's words.
        joints: Where.
        where: In words.
        unit: SI.
        vector: (P,) its coefficients in the unknowns.
        was: In the simulation.
        of_bodies: Whether it is a combination of inertials and rotor inertias.
    """

    name: str
    joints: tuple[str, ...]
    where: str
    unit: str
    vector: FloatArray
    was: float
    of_bodies: bool = False


@dataclass(frozen=True)
class Cause:
    """A simple change of one thing.

    Attributes:
        name: `mass`, `centre_of_mass` or `armature`; `body` where all of the last link may be another, as with a tool.
        body: Name of the body; of the joint where it is a rotor's.
        joint: That carries it.
        unit: SI.
        inertial: (10,) of the body in the simulation, in the frame of the joint.
        directions: (11 n, d) change of all inertials and rotor inertias a unit of each of its d directions.
        spread: (d,) standard deviation of the change along each direction, before the data.
        axes: (d,) of the joint's frame, along which a centre of mass moves.
    """

    @property
    def claim(self) -> tuple[str, str]:
        """What it says is off; how a body's shape goes with its mass is no claim."""
        return self.name, self.body

    name: str
    body: str
    joint: str
    unit: str
    inertial: FloatArray
    directions: FloatArray
    spread: tuple[float, ...]
    axes: tuple[int, ...] = ()


def determined(linear: Linear, found: Estimate, prior: Prior, simulation: Simulation) -> list[Change]:
    """Parameters and combinations that the data, not the prior, say something of; changed or not.

    Args:
        linear: The problem that was solved.
        found: Its solution.
        prior: What it was solved with.
        simulation: What to compare with.
    """
    own = np.flatnonzero(prior.free)
    spread = pseudo_inverse(prior.precision[np.ix_(own, own)])

    def known(one: Change) -> bool:
        free = one.vector[own]
        before = float(np.sqrt(max(float(free @ spread @ free), 0.0)))
        return bool(free.any()) and found.error(one.vector) < DETERMINED * before

    return [one for one in (*_own(linear, simulation), *combinations(linear, simulation)) if known(one)]


def changes(known: Sequence[Change], found: Estimate) -> tuple[tuple[Change, ...], tuple[tuple[Change, float], ...]]:
    """Parameters that differ from the simulation's beyond their errors and its digits, and those that do not.

    Args:
        known: What the data determine.
        found: The estimate.

    Returns:
        What differs; and what does not, with the size from which it would have been named.
    """
    bound = float(norm.ppf(1 - LEVEL / 2 / max(len(known), 1)))
    sized = [(one, max(bound * found.error(one.vector), DIGITS * abs(one.was))) for one in known]
    off = [abs(found.of(one.vector) - one.was) for one in known]
    return (
        tuple(one for (one, size), change in zip(sized, off) if change > size),
        tuple((one, size) for (one, size), change in zip(sized, off) if change <= size),
    )


def _own(linear: Linear, simulation: Simulation) -> list[Change]:
    """Damping, friction and stiffness, joint by joint."""
    was, found = simulation.values, []
    for number, parameter in enumerate(linear.model.model.parameters):
        if parameter.symbol in OWN and parameter.name in was and not parameter.held:
            vector = np.zeros(linear.count)
            vector[number] = 1.0
            word = simulation.word(parameter.symbol)
            found.append(Change(word, (parameter.joint,), parameter.joint, parameter.unit, vector, was[parameter.name]))
    return found


def bodies_and_rotors(arm: Arm) -> TorqueModel:
    """The terms whose parameters torque shows in combinations only: 10 n inertials, then n rotor inertias."""
    return TorqueModel(arm, {"rigid_body": {}, "rotor_inertia": {}})


def places_of(linear: Linear) -> list[int]:
    """(11 n,) numbers of inertials and rotor inertias among the unknowns."""
    names = list(linear.names)
    return [names.index(parameter.name) for parameter in bodies_and_rotors(linear.model.model.arm).parameters]


def combinations(linear: Linear, simulation: Simulation) -> list[Change]:
    """The combinations of inertials and rotor inertias that torque determines.

    Args:
        linear: Whose unknowns they are of.
        simulation: Whose values and words they have.
    """
    model, places, values = bodies_and_rotors(linear.model.model.arm), places_of(linear), simulation.values
    was = np.array([values.get(parameter.name, 0.0) for parameter in model.parameters])
    base, found = base_parameters(model), []
    for lead, row in zip(base.independent, base.regrouping):
        parameter = model.parameters[lead]
        vector = np.zeros(linear.count)
        vector[places] = row
        alone = int(np.count_nonzero(row)) == 1
        found.append(
            Change(
                _leading_word(parameter.symbol, simulation),
                (parameter.joint,),
                where_words(parameter.symbol, parameter.joint, simulation, alone),
                parameter.unit,
                vector,
                float(row @ was),
                of_bodies=True,
            )
        )
    return found


def _leading_word(symbol: str, simulation: Simulation) -> str:
    if symbol in INERTIAL_SYMBOLS:
        return {"m": "mass", "mc": "first_moment", "I": "inertia"}[symbol.rstrip("xyz")] + (
            f"_{symbol[len(symbol.rstrip('xyz')) :]}" if symbol != "m" else ""
        )
    return simulation.word(symbol)


def where_words(symbol: str, joint: str, simulation: Simulation, alone: bool) -> str:
    """What a combination is of, for a person.

    Args:
        symbol: Of its leading parameter.
        joint: Of the same.
        simulation: Whose words are used.
        alone: Whether nothing else is in it.
    """
    body = simulation.body(joint)
    if symbol not in INERTIAL_SYMBOLS:
        return joint
    axis = symbol[len(symbol.rstrip("xyz")) :]
    what = {
        "m": f"mass of {body}",
        "mc": f"first moment of {body} along its {axis} axis",
        "I": f"inertia of {body} ({axis}, about {joint})",
    }[symbol.rstrip("xyz")]
    return what if alone else f"{what}, with the indistinguishable part of the outer links"


def combination_of(change: Change, linear: Linear, simulation: Simulation) -> dict[str, float]:
    """Coefficients by the simulation's own names, such as `link2.mass` and `joint2.armature`.

    Args:
        change: The combination.
        linear: Whose unknowns its vector counts.
        simulation: Whose names are used.
    """
    named = {}
    symbols = dict(zip(INERTIAL_SYMBOLS, INERTIAL_WORDS))
    own = {"J_m": "armature", "k_v1": "damping", "f_c": "frictionloss", "k_1": "stiffness"}
    for number in np.flatnonzero(change.vector[: len(linear.model.model.parameters)]):
        parameter = linear.model.model.parameters[number]
        if parameter.symbol in symbols:
            key = f"{simulation.body(parameter.joint)}.{symbols[parameter.symbol]}"
        else:
            key = f"{parameter.joint}.{own.get(parameter.symbol, parameter.symbol)}"
        named[key] = float(change.vector[number])
    return named


def causes(simulation: Simulation) -> list[Cause]:
    """Simple changes: masses with their bodies' shape, centres of mass, rotor inertias."""
    names = simulation.arm.joint_names
    n = len(names)
    found = []
    for part in simulation.all_parts:
        own = slice(10 * names.index(part.joint), 10 * names.index(part.joint) + 10)
        dense, point, centre = np.zeros((11 * n, 1)), np.zeros((11 * n, 1)), np.zeros((11 * n, 3))
        # A body of other density has another inertia; one whose mass alone was mistyped keeps that about its centre.
        dense[own, 0] = part.inertial / part.inertial[0]
        point[own, 0] = _point(part.inertial[1:4] / part.inertial[0])
        centre[own] = np.column_stack([_moved(part.inertial, axis) for axis in range(3)])
        found += [
            Cause("mass", part.name, part.joint, "kg", part.inertial, shape, (MASS_SHARE * float(part.inertial[0]),))
            for shape in (dense, point)
        ]
        found += [
            Cause(
                "centre_of_mass",
                part.name,
                part.joint,
                "m",
                part.inertial,
                centre[:, list(axes)],
                len(axes) * (CENTRE_M,),
                axes,
            )
            for axes in ((0,), (1,), (2,), (0, 1, 2))
        ]
    last = [part for part in simulation.all_parts if part.joint == names[-1]]
    whole = np.zeros((11 * n, 10))
    whole[10 * n - 10 : 10 * n] = np.eye(10)
    found += [Cause("body", part.name, part.joint, "kg", part.inertial, whole, TOOL, (0, 1, 2)) for part in last[:1]]
    for k, joint in enumerate(names):
        rotor = np.zeros((11 * n, 1))
        rotor[10 * n + k, 0] = 1.0
        spread = (max(ROTOR_SHARE * simulation.values.get(f"J_m[{joint}]", 0.0), LEAST_ROTOR),)
        found.append(Cause("armature", joint, joint, "kg m^2", np.zeros(10), rotor, spread))
    return found


def _point(place: FloatArray) -> FloatArray:
    """(10,) parameters of one kilogram at a place (3,)."""
    return np.array(pin.Inertia(1.0, place, np.zeros((3, 3))).toDynamicParameters())


def _moved(inertial: FloatArray, axis: int) -> FloatArray:
    """(10,) derivative of a body's parameters by its centre of mass along an axis (parallel-axis theorem)."""
    mass, centre = inertial[0], inertial[1:4] / inertial[0]
    unit = np.eye(3)[axis]
    tensor = mass * (2 * (centre @ unit) * np.eye(3) - np.outer(centre, unit) - np.outer(unit, centre))
    return np.array(
        [0.0, *(mass * unit), tensor[0, 0], tensor[0, 1], tensor[1, 1], tensor[0, 2], tensor[1, 2], tensor[2, 2]]
    )


@dataclass(frozen=True)
class Reported:
    """One number of a cause, for a person.

    Attributes:
        name: Of the quantity.
        where: In words.
        key: Of the parameter in a combination; empty where it is none.
        unit: SI.
        was: In the simulation.
        now: In the arm.
        error: Standard error.
    """

    name: str
    where: str
    key: str
    unit: str
    was: float
    now: float
    error: float


def reported_of(cause: Cause, values: FloatArray, errors: FloatArray, simulation: Simulation) -> list[Reported]:
    """What a cause says: a mass, a rotor inertia, a centre of mass axis by axis; of a whole body mass and centre.

    Args:
        cause: The cause.
        values: (d,) its change along its directions.
        errors: (d,) standard errors of the same.
        simulation: What it is a change of.
    """
    if cause.name == "armature":
        was = simulation.values.get(f"J_m[{cause.joint}]", 0.0)
        now, error = was + float(values[0]), float(errors[0])
        return [Reported(simulation.word("J_m"), cause.joint, f"{cause.joint}.armature", "kg m^2", was, now, error)]
    mass, found = float(cause.inertial[0]), list[Reported]()
    centre = cause.inertial[1:4] / mass
    if cause.name in ("mass", "body"):
        now, error = mass + float(values[0]), float(errors[0])
        found.append(Reported("mass", f"mass of {cause.body}", f"{cause.body}.mass", "kg", mass, now, error))
    if cause.name == "centre_of_mass":
        moved, spread = centre[list(cause.axes)] + values, errors
    elif cause.name == "body":
        # The mass's error moves the centre as well: as if the two were independent.
        moved = (cause.inertial[1:4] + values[1:4]) / (mass + values[0])
        spread = np.hypot(errors[1:4], moved * errors[0]) / (mass + values[0])
    else:
        return found
    for axis, place, error in zip(cause.axes, moved, spread):
        where = f"centre of mass of {cause.body} along {'xyz'[axis]}"
        found.append(
            Reported(f"centre_of_mass_{'xyz'[axis]}", where, "", "m", float(centre[axis]), float(place), float(error))
        )
    return found


@dataclass(frozen=True)
class Explained:
    """A number that accounts, with others, for the change of all combinations.

    Attributes:
        reported: It, its value and error over all sets of causes that do.
        cause: Whose it is, in the best of them.
        values: (d,) change of that cause along its directions.
    """

    reported: Reported
    cause: Cause
    values: FloatArray


def few_causes(
    known: Sequence[Change], linear: Linear, found: Estimate, simulation: Simulation
) -> tuple[tuple[Explained, ...], tuple[str, ...]]:
    """The causes by which alone the simulation's inertials differ; none where they are too many for a simple word.

    Of sets of causes that leave what chance leaves of the change (chi-square) each has a probability (Hoeting et al.
    1999, Bayesian model averaging). What nearly all of them say is reported, with the spread between them in its error:
    torque does not tell a tool from a heavier hand.

    Args:
        known: What the data determine.
        linear: The problem that was solved.
        found: Its solution.
        simulation: What to compare with.

    Returns:
        What is reported; and in words what else may be off, where sets differ in that.
    """
    base = [one for one in known if one.of_bodies]
    if not base:
        return (), ()
    rows = np.stack([one.vector for one in base])
    delta = rows @ found.values - np.array([one.was for one in base])
    errors = np.array([found.error(one.vector) for one in base])
    posterior = rows @ found.covariance @ rows.T
    wider = errors / np.sqrt(np.maximum(np.diag(posterior), 1e-300))
    # Few blocks and groups say how large the errors are, not how they go together.
    covariance = posterior * np.outer(wider, wider)
    whiten = np.linalg.pinv(np.linalg.cholesky(covariance + 1e-12 * np.diag(np.diag(covariance))))
    target = whiten @ delta
    if chi2.sf(float(target @ target), len(target)) > ENOUGH:
        return (), ()
    offered = [(one, whiten @ rows[:, places_of(linear)] @ one.directions) for one in causes(simulation)]
    return _in_nearly_all(_sufficient(target, offered, simulation), simulation)


@dataclass(frozen=True)
class _Fitted:
    """A set of causes with values (d,) and errors (d,) of each, its log probability, and the squares that it leaves."""

    causes: tuple[Cause, ...]
    values: tuple[FloatArray, ...]
    errors: tuple[FloatArray, ...]
    log_probability: float
    squares: float


def _fitted(target: FloatArray, chosen: Sequence[tuple[Cause, FloatArray]]) -> _Fitted:
    """Bayesian linear regression with the causes' own priors (Bishop 2006, eqs 3.50 to 3.54 and 3.86)."""
    matrix = np.concatenate([columns for _, columns in chosen], axis=1)
    spread = np.array([sd for cause, _ in chosen for sd in cause.spread])
    scaled = matrix * spread
    precision = np.eye(len(spread)) + scaled.T @ scaled
    inverse = np.linalg.inv(precision)
    slope = scaled.T @ target
    values, errors = spread * (inverse @ slope), spread * np.sqrt(np.diag(inverse))
    left = target - matrix @ values
    # Relative to no cause at all.
    log_probability = 0.5 * float(slope @ inverse @ slope) - 0.5 * float(np.linalg.slogdet(precision)[1])
    ends = np.cumsum([columns.shape[1] for _, columns in chosen])[:-1]
    return _Fitted(
        tuple(one for one, _ in chosen),
        tuple(np.split(values, ends)),
        tuple(np.split(errors, ends)),
        log_probability + len(chosen) * float(np.log(OFF / (1.0 - OFF))),
        float(left @ left),
    )


def _sufficient(
    target: FloatArray, offered: Sequence[tuple[Cause, FloatArray]], simulation: Simulation
) -> list[_Fitted]:
    """Sets of at most `MOST_CAUSES` that leave what chance leaves and could be, the most probable first.

    Sets grow by one cause at a time, the best `KEPT` of them.
    """
    claims = [cause.claim for cause, _ in offered]
    sets: list[tuple[int, ...]] = [()]
    enough: list[_Fitted] = []
    for _ in range(MOST_CAUSES):
        grown = {tuple(sorted((*one, k))) for one in sets for k in range(len(offered)) if _apart(claims, one, k)}
        scored = [(_fitted(target, [offered[k] for k in one]), one) for one in sorted(grown)]
        scored.sort(key=lambda each: -each[0].log_probability)
        enough += [fit for fit, _ in scored if chi2.sf(fit.squares, max(len(target) - _width(fit), 1)) > ENOUGH]
        sets = [one for _, one in scored[:KEPT]]
    enough.sort(key=lambda fit: -fit.log_probability)
    near = [fit for fit in enough if fit.log_probability > enough[0].log_probability - NEAR]
    return [fit for fit in near if _possible(simulation, fit) and _ordinary(fit)]


def _width(fit: _Fitted) -> int:
    return sum(len(values) for values in fit.values)


def _in_nearly_all(sets: Sequence[_Fitted], simulation: Simulation) -> tuple[tuple[Explained, ...], tuple[str, ...]]:
    """What nearly all of these say, averaged; and the words of what a good share of them say."""
    if not sets:
        return (), ()
    weights = np.exp(np.array([one.log_probability for one in sets]) - sets[0].log_probability)
    weights /= weights.sum()
    said: dict[str, list[tuple[float, Reported, Cause, FloatArray]]] = {}
    for weight, one in zip(weights, sets):
        for cause, values, errors in zip(one.causes, one.values, one.errors):
            for reported in reported_of(cause, values, errors, simulation):
                said.setdefault(reported.where, []).append((float(weight), reported, cause, values))
    explained, others = [], []
    for where, every in said.items():
        share = sum(weight for weight, *_ in every)
        if share > IN_NEARLY_ALL:
            values, errors = (
                np.array([getattr(reported, name) for _, reported, *_ in every]) for name in ("now", "error")
            )
            own = np.array([weight for weight, *_ in every]) / share
            now = float(own @ values)
            error = float(np.sqrt(own @ (errors**2 + (values - now) ** 2)))
            _, reported, cause, change = every[0]
            explained.append(Explained(replace(reported, now=now, error=error), cause, change))
        elif share > IN_MANY:
            others.append(where)
    return tuple(explained), tuple(others)


def _ordinary(fit: _Fitted) -> bool:
    """Whether things are off by as much as things are off: bodies of a tenth of their mass stand for something else."""
    squares = sum(float(np.sum((own / cause.spread) ** 2)) for cause, own in zip(fit.causes, fit.values))
    return bool(chi2.sf(squares, _width(fit)) > LEVEL)


def _possible(simulation: Simulation, fit: _Fitted) -> bool:
    """Whether bodies changed like this have mass, centres within reach of the arm's own size, and rotors inertia.

    A mass that may as well be none is no cause but a place where much ends up: a torque constant, most often.
    """
    reach = max(float(np.linalg.norm(joint.translation)) for joint in simulation.arm.joints)
    beyond = float(norm.ppf(1 - LEVEL / 2))
    for cause, change, errors in zip(fit.causes, fit.values, fit.errors):
        mass = float(cause.inertial[0])
        if cause.name in ("mass", "body") and mass + change[0] <= beyond * errors[0]:
            return False
        if cause.name == "armature" and simulation.values.get(f"J_m[{cause.joint}]", 0.0) + change[0] < 0.0:
            return False
        if cause.name == "body":
            moved = (cause.inertial[1:4] + change[1:4]) / (mass + change[0])
        else:
            moved = change if cause.name == "centre_of_mass" else np.zeros(3)
        if float(np.linalg.norm(moved)) > reach:
            return False
    return True


def _apart(claims: Sequence[tuple[str, str]], chosen: Sequence[int], other: int) -> bool:
    """Whether another cause claims what none of those chosen does; all of a body is its mass and its centre."""
    name, body = claims[other]
    same = [claims[k][0] for k in chosen if claims[k][1] == body]
    return name not in same and "body" not in same and not (same and name == "body")
