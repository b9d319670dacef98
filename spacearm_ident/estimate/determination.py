"""What each parameter's value rests on: the data, a combination, a bound, or the prior."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..arrays import FloatArray
from ..dynamics.base_parameters import BaseParameters
from ..dynamics.friction import ViscousFriction
from ..dynamics.model import TorqueModel
from ..dynamics.term import Constant, Parameter
from ..regression.prior import Prior
from ..regression.regression import Regression
from ..solvers.separable import PRESENCE_GATE, Solution, solve_linear
from .consistency import active_bounds
from .identified import Determination, Estimate

KNOWN_SHARE = 0.25
"""A standard error below this share of the prior's scale means that the data, not the prior, decided."""
KNOWN_LOGARITHM = 0.5
"""A constant whose logarithm is less certain than this is not seen by the data."""
BOUND_SHARE = 1e-6
BOUND_DECIDES = 0.25
"""Share of its variance under which bounds that leave a parameter no more have decided it: half the standard error."""
NOT_IN_THE_MODEL = "not in the model: no better prediction of held-out data"
ABSENT = {"k_v2": NOT_IN_THE_MODEL, "k_v3": NOT_IN_THE_MODEL, "f_b": f"equal to f_c, {NOT_IN_THE_MODEL}"}
"""Why a friction parameter is held, by its symbol."""


def judge(
    model: TorqueModel,
    prior: Prior,
    base: BaseParameters,
    parameters: FloatArray,
    constants: FloatArray,
    covariance: FloatArray,
    grids: Sequence[FloatArray],
    at_rest: tuple[str, ...] = (),
    open_ended: frozenset[str] = frozenset(),
) -> tuple[Estimate, ...]:
    """An `Estimate` for every parameter and constant of a model, in its order.

    Args:
        model: Structure.
        prior: What was believed before.
        base: Regrouping into base parameters.
        parameters: (p,) final values.
        constants: (c,) final values.
        covariance: (p + c, p + c).
        grids: Values that each constant was searched over.
        at_rest: Joints that never moved.
        open_ended: Names of the constants that `open_ended` found.
    """
    errors = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    count = len(parameters)
    constant_estimates = tuple(
        _constant(constant, float(value), float(error), grid, constant.joint in at_rest, constant.name in open_ended)
        for constant, value, error, grid in zip(model.constants, constants, errors[count:], grids)
    )
    unseen_constants = {
        estimate.joint for estimate in constant_estimates if estimate.symbol == "v_b" and not estimate.identifiable
    }
    estimates = []
    left = _left_by_bounds(active_bounds(model, parameters, prior.scale), covariance[:count, :count])
    correlation, alone = _correlations(covariance[:count, :count])
    viscous = [term for term in model.terms if isinstance(term, ViscousFriction)]
    multiplied = {parameter.name: term.multiplied(parameter) for term in viscous for parameter in term.parameters}
    for k, parameter in enumerate(model.parameters):
        determination, note = _parameter(parameter, k, base, float(errors[k]), float(prior.scale[k]))
        value = float(parameters[k])
        if determination is Determination.PRIOR and k not in base.unseen and alone[k] < KNOWN_SHARE * prior.scale[k]:
            other = model.parameters[int(np.argmax(np.abs(correlation[k])))]
            determination = Determination.COMBINED
            note = f"this motion shows it only with others, most of all {other.symbol} of {other.joint}"
        if determination is not Determination.FIXED and _at_bound(parameter, value, float(prior.scale[k])):
            determination, note = Determination.BOUND, "pushed against its physical bound"
        if determination is Determination.DATA and left[k] < BOUND_DECIDES:
            determination, note = Determination.BOUND, "held by what a body's inertia can be, more than by the data"
        if parameter.symbol == "f_b" and parameter.joint in unseen_constants and determination is Determination.DATA:
            determination, note = Determination.PRIOR, "its Stribeck velocity is not excited in these data"
        if determination is not Determination.FIXED and (law := multiplied.get(parameter.name)):
            note = f"{law}; {note}" if note else law
        error = float("nan") if determination in (Determination.FIXED, Determination.PRIOR) else float(errors[k])
        if determination is Determination.COMBINED:
            error = float("nan")
        estimates.append(Estimate(parameter.symbol, parameter.joint, parameter.unit, value, error, determination, note))
    return (*estimates, *constant_estimates)


def _parameter(
    parameter: Parameter, number: int, base: BaseParameters, error: float, scale: float
) -> tuple[Determination, str]:
    if scale == 0.0:
        return Determination.FIXED, ABSENT.get(parameter.symbol, "zero by default")
    if number in base.unseen:
        return Determination.PRIOR, "moves no torque, whatever the motion"
    if not base.alone(number):
        groups = np.flatnonzero(base.regrouping[:, number])
        lead = base.names[int(groups[0])].split(" ")[0]
        more = f" and {len(groups) - 1} more" if len(groups) > 1 else ""
        return Determination.COMBINED, f"in the base parameter of {lead}{more}"
    if error > KNOWN_SHARE * scale:
        return Determination.PRIOR, "this motion does not reveal it"
    return Determination.DATA, ""


def _correlations(covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Correlations (p, p) of different parameters, and each one's standard error (p,) if all others were known."""
    variance = np.diag(covariance)
    size = np.where(variance > 0.0, np.sqrt(np.abs(variance)), 1.0)
    correlation = covariance / np.outer(size, size)
    precision = np.diag(np.linalg.pinv(correlation, rcond=1e-10, hermitian=True))
    alone = size / np.sqrt(np.maximum(precision, 1.0))
    return correlation - np.diag(np.diag(correlation)), alone


def _left_by_bounds(held: FloatArray, covariance: FloatArray) -> FloatArray:
    """(p,) share of each parameter's variance that is left where combinations (a, p) of them cannot move."""
    variance = np.maximum(np.diag(covariance), 1e-300)
    if not len(held):
        return np.ones(len(variance))
    size = np.sqrt(variance)
    across = held * size @ (covariance / np.outer(size, size))
    taken = np.linalg.pinv(across @ (held * size).T, rcond=1e-10, hermitian=True)
    return np.asarray(1.0 - np.einsum("ak,ab,bk->k", across, taken, across))


def _at_bound(parameter: Parameter, value: float, scale: float) -> bool:
    """Whether a value lies on one of its bounds, to the precision of the interior-point solver."""
    close = BOUND_SHARE * max(scale, abs(value))
    return value - parameter.lower <= close or parameter.upper - value <= close


def open_ended(regression: Regression, prior: Prior, solution: Solution) -> frozenset[str]:
    """Names of the constants that the data do not tell from an end of their range.

    A standard error is a slope, and says little of a constant whose effect fades: of a Stribeck velocity near the
    slowest speed that is resolved, only the area of its peak is seen, and any smaller one with a higher peak fits as
    well. So the profile decides: with everything else fitted again, either end must cost `PRESENCE_GATE` squares
    (profile likelihood; Raue et al. 2009).

    Args:
        regression: Weighted rows, and the range of each constant.
        prior: Of the parameters.
        solution: Optimum on these rows, with its cost; constants that are zero are not examined.
    """
    found = set()
    for k, (constant, grid) in enumerate(zip(regression.model.constants, regression.grids)):
        if solution.constants[k] <= 0.0:
            continue
        for end in (grid[grid > 0][0], grid[-1]):
            trial = solution.constants.copy()
            trial[k] = end
            if solve_linear(regression, prior, trial)[1] - solution.cost < PRESENCE_GATE:
                found.add(constant.name)
    return frozenset(found)


def _constant(
    constant: Constant, value: float, error: float, grid: FloatArray, at_rest: bool, unbounded: bool
) -> Estimate:
    """A constant on the edge of its grid, or of which the data hardly notice a change, is not seen."""

    def estimate(standard_error: float, determination: Determination, note: str) -> Estimate:
        return Estimate(constant.symbol, constant.joint, constant.unit, value, standard_error, determination, note)

    nan = float("nan")
    positive = grid[grid > 0]
    if constant.grid[-1] <= 0:
        return estimate(nan, Determination.FIXED, NOT_IN_THE_MODEL)
    if at_rest:
        return estimate(nan, Determination.PRIOR, "the joint never moves")
    if value <= 0:
        words = "the data ask for none"
        if constant.speed and (not len(positive) or positive[0] > constant.grid[1]):
            words += f", and cannot see one below {positive[0] if len(positive) else constant.grid[-1]:.2g} rad/s"
        return estimate(nan, Determination.BOUND, words)
    if value <= positive[0] * 1.0001 or value >= positive[-1] / 1.0001:
        edge = "lower" if value <= positive[0] * 1.0001 else "upper"
        return estimate(nan, Determination.BOUND, f"at the {edge} end of its range: the data cannot see it")
    if unbounded:
        return estimate(nan, Determination.BOUND, "the data do not distinguish it from an end of its range")
    if error > KNOWN_LOGARITHM * value or error == 0.0:
        return estimate(error or nan, Determination.PRIOR, "this motion hardly reveals it")
    return estimate(error, Determination.DATA, "")
