"""Terms of the base model that a mismatch is explained beside: the paper's law, and what chi-square demands beyond it.

Every term of the paper's friction law stays in this base whether or not it predicts better, because an effect competes
with all of them: a column that is missing here would be found as an effect. That is why it is wider than what
`identification.structure` chooses for prediction. A model that has every optional column is set up once; each option
competes by joint refit on the compressed system, its gain being the drop in whitened squares. One that gains more than
`GATE` joins, the largest first, and the others are tried again beside it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import lstsq

from ..arrays import FloatArray
from ..dynamics.friction import ViscousFriction
from ..dynamics.model import Structure, TorqueModel
from ..estimate.identified import Choice
from ..estimate.optional_terms import OptionalTerm
from ..identification.fit import Fit
from ..identification.trials import with_optional_terms
from ..regression.prior import make_prior
from ..regression.regression import Regression
from ..solvers.separable import Solution, system

RESISTS = "quadratic friction that resists in both directions (qd |qd| instead of qd^2)"
GATE = 30.0
"""Chi-square an option must gain. Far above the 5 % point of one parameter, 3.8: the whitening is approximate, and
a column too many costs more on other motions than one too few."""
OFFERED = tuple(term for term in OptionalTerm if term.beyond_law and term.row.in_base)
"""What may join joint by joint, besides the paper's law, all of which is in the base."""


@dataclass(frozen=True)
class _Option:
    """One thing that may join the model: its columns, those it replaces, and how the structure says so."""

    kind: OptionalTerm
    joint: str
    adds: frozenset[str]
    drops: frozenset[str]
    apply: Callable[[Structure], Structure]

    def judged(self, gain: float, accepted: bool) -> Choice:
        """As a decision with its evidence."""
        words = f"{self.kind.row.words} at {self.joint}" if self.joint else RESISTS
        return Choice(words, gain, accepted, self.kind, self.joint)


def choose_base(fit: Fit) -> tuple[Structure, tuple[Choice, ...]]:
    """Add to a fitted model what the data demand.

    Args:
        fit: Its rows, weighted by its residual, and its solution; the constants stay as they are while options are
            compared.

    Returns:
        The structure, and every decision with its evidence.
    """
    regression, solution = fit.regression, fit.solution
    model = regression.model
    pending = _options(model)
    full, matrix, vector = _everything(regression, solution)
    names = [parameter.name for parameter in full.parameters]
    free = {name for name, scale in zip(names, make_prior(full, regression.motions).scale) if scale > 0}
    active = free & {parameter.name for parameter in model.parameters}

    def cost(chosen: set[str], new: frozenset[str] = frozenset()) -> float:
        """Squares left; infinite where a new parameter has a value no such thing could have."""
        columns = [k for k, name in enumerate(names) if name in chosen]
        answer = lstsq(matrix[:, columns], vector, lapack_driver="gelsy")[0]
        for k, value in zip(columns, answer):
            if names[k] in new and not full.parameters[k].lower <= value <= full.parameters[k].upper:
                return float("inf")
        return float(np.sum((matrix[:, columns] @ answer - vector) ** 2))

    structure, current = model.structure, cost(active)
    choices: list[Choice] = []
    while pending:
        gains = [current - cost((active - option.drops) | option.adds, option.adds) for option in pending]
        best = int(np.argmax(gains))
        if gains[best] < GATE:
            choices += [option.judged(gain, False) for option, gain in zip(pending, gains)]
            break
        option = pending.pop(best)
        choices.append(option.judged(gains[best], True))
        active = (active - option.drops) | option.adds
        structure, current = option.apply(structure), current - gains[best]
    return structure, tuple(choices)


def _options(model: TorqueModel) -> list[_Option]:
    joints = model.arm.joint_names
    options = [
        _Option(term, joint, frozenset({f"{term.row.symbol}[{joint}]"}), frozenset(), _joint_adder(term, joint))
        for term in OFFERED
        for joint in joints
    ]
    even, odd = (frozenset(f"{symbol}[{joint}]" for joint in joints) for symbol in ("k_v2", ViscousFriction.ODD))
    quadratic: Structure = {"viscous_friction": {"quadratic": "odd"}}
    return [*options, _Option(OptionalTerm.ODD, "", odd, even, lambda structure: {**structure, **quadratic})]


def _joint_adder(term: OptionalTerm, joint: str) -> Callable[[Structure], Structure]:
    """A change of structure that adds one joint to those that have a term."""
    kind, option = term.row.term.kind, term.row.option

    def apply(structure: Structure) -> Structure:
        options = structure.get(kind, {})
        return {**structure, kind: {**options, option: [*options.get(option, ()), joint]}}

    return apply


def _everything(regression: Regression, solution: Solution) -> tuple[TorqueModel, FloatArray, FloatArray]:
    """The model with every option, and its compressed system under the weights and constants of the fitted one."""
    full = with_optional_terms(regression, solution, OFFERED)
    for rows, known in zip(full.rows, regression.rows):
        rows.set_weight(known.weight)
    matrix, vector = system(full, make_prior(full.model, regression.motions), solution.constants)
    return full.model, matrix, vector
