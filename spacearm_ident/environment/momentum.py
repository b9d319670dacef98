"""The body that carries a free-floating arm, from the balance of momentum.

Nothing holds a free base: the wrench that the dynamics of base and arm together would need at the base link is zero
(Dubowsky and Papadopoulos 1993; Yoshida 1994 for the momentum that this is the derivative of),

    Y_b(o, e, f) phi_b + Y_a(o, e, f, q, qd, qdd) phi_a = 0,

six rows a sample, linear in the ten parameters phi_b of the base. With the arm's phi_a from its torques, which fix the
scale, phi_b follows. The columns are made of noisy accelerations, and least squares would pull phi_b towards zero
(errors in variables); so the instruments are the columns of the motion that the momentum of the identified bodies,
conserved from rest, makes of the joints' motion (instrumental variables as in Janot et al. 2014): no noise of the
base's sensor is in them. Standard errors hold for correlated residuals (Newey and West 1987, Parzen's kernel) and
include what is not known of the arm. Whatever can be shifted between base and first link without a trace is known only
in a combination, and said to be.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..dynamics.arm import Arm
from ..dynamics.base_link import base_inertial, base_link
from ..dynamics.base_parameters import ORDER, BaseParameters, random_base, regroup
from ..dynamics.model import IdentifiedModel
from ..dynamics.regressor import BASE_LINK, BASE_ROWS, INERTIAL_SYMBOLS, rigid_body_blocks
from ..dynamics.rigid_body import INERTIAL_UNITS
from ..dynamics.term import Parameter
from ..estimate.determination import KNOWN_SHARE
from ..estimate.identified import BaseBody, Determination, Estimate
from ..signals.base_motion import BaseMotion
from ..signals.motion import Motion

ROUNDS = 2
"""Of instruments made with the last estimate."""
VAGUE = 100.0
"""Standard deviation of the base's mass before the data, times its CAD mass or the arm's, a metre from its frame."""
HAC_S = 0.3
"""Lag up to which residuals may be correlated, s: a period and a half of the narrowest bandwidth."""
SMOOTH_S = 0.25
HELD_SHARE = 0.3
"""A base whose slow force or moment is by more than this share not of the arm's making is not free."""


@dataclass(frozen=True)
class _Balance:
    """Rows of one motion at thinned-out samples, force and moment: (6, parameters, M)."""

    rate_hz: float
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    base: FloatArray
    arm: FloatArray


@dataclass(frozen=True)
class _Fit:
    """phi_b, its own covariance, what it follows of the arm's parameters, and residual over what the arm causes."""

    values: FloatArray
    own: FloatArray
    follows: FloatArray
    left: float


def base_body(
    motions: Sequence[Motion], identified: IdentifiedModel, covariance: FloatArray
) -> tuple[BaseBody | None, list[str]]:
    """The base's inertial parameters, where its motion was recorded and it is free.

    Args:
        motions: Those of the fit.
        identified: The arm.
        covariance: Of its parameters (and constants).

    Returns:
        The body, or None; and what is to be said of it.
    """
    model = identified.model
    carried = [motion for motion in motions if motion.base is not None]
    first = model.first_inertial
    if not carried or first is None:
        return None, []
    mine = slice(first, first + 10 * len(model.arm.joints))
    arm = identified.parameters[mine]
    fit = _fit([_balance(model.arm, motion) for motion in carried], model.arm, arm)
    size = _size(fit.values)
    if fit.left > HELD_SHARE or size is None:
        return None, [
            f"nothing is said of the base's own inertia: {fit.left:.0%} of the force or moment on it is not the arm's "
            "(wheels, thrusters, a support), or its motion is too small for its sensor"
        ]
    spread = covariance[mine, mine]
    joint = np.block(
        [
            [fit.follows @ spread @ fit.follows.T + fit.own, -fit.follows @ spread],
            [-spread @ fit.follows.T, spread],
        ]
    )
    body = _body(model.arm, np.concatenate([fit.values, arm]), joint, size)
    known = sum(estimate.identifiable for estimate in body.estimates)
    total = next((item for item in body.combined if item.symbol.startswith("m[")), None)
    mass = "" if total is None else f"; {total.symbol} = {total.value:.4g} ± {total.standard_error:.2g} kg"
    return body, [f"momentum balance: {known} of the base's 10 parameters determined by themselves{mass}"]


def _balance(arm: Arm, motion: Motion) -> _Balance:
    """Four samples a period of the bandwidth: the signals are low-passed already, and nothing here jumps."""
    assert motion.base is not None
    some = slice(None, None, max(1, int(motion.rate_hz / (4 * motion.cutoff_hz))))
    states = (motion.position[some], motion.velocity[some], motion.acceleration[some])
    columns = _columns(arm, *states, motion.base.mapped(lambda signal: signal[some]))
    return _Balance(motion.rate_hz / (some.step or 1), *states, columns[:, :10], columns[:, 10:])


def _columns(arm: Arm, q: FloatArray, qd: FloatArray, qdd: FloatArray, base: BaseMotion) -> FloatArray:
    """(6, 10 + 10 n, M) columns of the base rows, the base link's first."""
    blocks = rigid_body_blocks(arm, q, qd, qdd, base, base_rows=True)
    links = (BASE_LINK, *range(len(arm.joints)))
    return np.stack([np.concatenate([blocks[row, link] for link in links]) for row in BASE_ROWS])


def _fit(balances: Sequence[_Balance], arm: Arm, known: FloatArray) -> _Fit:
    """Least squares, then instrumental variables, rows weighted by their residuals."""
    cad = base_inertial(arm)
    mass = VAGUE * max(cad[0], float(arm_mass) if (arm_mass := known[::10].sum()) > 0 else 1.0)
    prior = np.eye(10) / mass**2
    caused = [-np.einsum("kpt,p->kt", rows.arm, known) for rows in balances]
    weight = 1.0 / _rms(caused)
    instruments = [rows.base for rows in balances]
    values = cad
    for number in range(ROUNDS + 1):
        if number:
            whole = np.concatenate([values, known])
            instruments = [_predicted(arm, rows, whole) for rows in balances]
        hessian, target = prior.copy(), prior @ cad
        for made, rows, force in zip(instruments, balances, caused):
            weighted = made * weight[:, None, None] ** 2
            hessian += np.einsum("kit,kjt->ij", weighted, rows.base)
            target += np.einsum("kit,kt->i", weighted, force)
        values = np.linalg.solve(hessian, target)
        left = [force - np.einsum("kpt,p->kt", rows.base, values) for rows, force in zip(balances, caused)]
        used, weight = weight, 1.0 / np.maximum(_rms(left), 1e-9 * _rms(caused))
    meat, follows = prior.copy(), np.zeros((10, len(known)))
    for made, rows, rest in zip(instruments, balances, left):
        weighted = made * used[:, None, None] ** 2
        meat += _long_run(np.einsum("kit,kt->ti", weighted, rest), max(1, int(HAC_S * rows.rate_hz)))
        follows += np.einsum("kit,kjt->ij", weighted, rows.arm)
    inverse = np.linalg.inv(hessian)
    return _Fit(values, inverse @ meat @ inverse.T, inverse @ follows, _share_left(balances, left, caused))


def _predicted(arm: Arm, rows: _Balance, inertials: FloatArray) -> FloatArray:
    """(6, 10, M) the base's columns of the motion that conserved momentum, zero at rest, makes of the joints'."""
    q, qd, qdd = rows.position, rows.velocity, rows.acceleration
    samples, none = len(q), np.zeros_like(q)
    still = np.zeros((samples, 3))

    def wrench(velocity: FloatArray, acceleration: FloatArray, base: BaseMotion) -> FloatArray:
        return np.asarray(np.einsum("kpt,p->tk", _columns(arm, q, velocity, acceleration, base), inertials))

    unit = np.eye(3)[:, None, :] * np.ones((samples, 1))
    moved = [BaseMotion(still, still, axis) for axis in unit] + [BaseMotion(still, axis, still) for axis in unit]
    inertia = np.stack([wrench(none, none, base) for base in moved], axis=2)
    momentum = wrench(none, qd, BaseMotion(still, still, still))
    rate: FloatArray = np.asarray(-np.linalg.solve(inertia, momentum[..., None])[:, 3:, 0], dtype=float)
    bias = wrench(qd, qdd, BaseMotion(rate, still, still))
    answer: FloatArray = np.asarray(-np.linalg.solve(inertia, bias[..., None])[..., 0], dtype=float)
    return _columns(arm, q, qd, qdd, BaseMotion(rate, answer[:, 3:], answer[:, :3]))[:, :10]


def _rms(signals: Sequence[FloatArray]) -> FloatArray:
    """(6,) one for the three forces, one for the three moments."""
    squares = np.concatenate(signals, axis=1) ** 2
    return np.repeat(np.sqrt([squares[:3].mean(), squares[3:].mean()]), 3) + 1e-300


def _share_left(balances: Sequence[_Balance], left: Sequence[FloatArray], caused: Sequence[FloatArray]) -> float:
    """The larger of the shares of slow force and slow moment that are not the arm's."""

    def slow(signals: Sequence[FloatArray]) -> FloatArray:
        means = []
        for rows, signal in zip(balances, signals):
            block = max(1, int(SMOOTH_S * rows.rate_hz))
            count = signal.shape[1] // block
            means.append(signal[:, : count * block].reshape(6, count, block).mean(axis=2))
        return _rms(means)

    return float((slow(left) / slow(caused)).max())


def _long_run(scores: FloatArray, lags: int) -> FloatArray:
    """Covariance of the sum of correlated scores (M, p); Parzen's kernel keeps it positive."""
    total = scores.T @ scores
    for lag in range(1, min(lags, len(scores) - 1)):
        share = lag / lags
        kernel = 1 - 6 * share**2 + 6 * share**3 if share <= 0.5 else 2 * (1 - share) ** 3
        product = scores[lag:].T @ scores[:-lag]
        total += kernel * (product + product.T)
    return total


def _size(values: FloatArray) -> FloatArray | None:
    """(10,) what a parameter of so heavy and large a body may well be; None of one that there cannot be."""
    mass, trace = values[0], values[4] + values[6] + values[9]
    if mass <= 0 or trace <= 0:
        return None
    return np.repeat([mass, np.sqrt(mass * trace / 2), trace / 2], (1, 3, 6))


def _parameters(arm: Arm) -> list[Parameter]:
    """The inertial parameters of the base and of all links."""
    name = base_link(arm.urdf)
    names = (f"{name} link" if name in arm.joint_names else name, *arm.joint_names)
    return [Parameter(symbol, name, unit) for name in names for symbol, unit in zip(INERTIAL_SYMBOLS, INERTIAL_UNITS)]


def _regrouped(arm: Arm) -> BaseParameters:
    """What any motion can reveal of base and arm together, the base's parameters leading."""
    joints = len(arm.joints)
    samples = 12 * (joints + 1)
    rng = np.random.default_rng(0)
    q, qd, qdd = rng.uniform(-2.0, 2.0, (3, samples, joints))
    blocks = rigid_body_blocks(arm, q, qd, qdd, random_base(rng, samples), base_rows=True)
    whole = np.zeros((joints + 6, samples, 10 * (joints + 1)))
    for (row, link), block in blocks.items():
        whole[row + 6, :, 10 * (link + 1) : 10 * (link + 2)] = block.T
    order = [10 * link + INERTIAL_SYMBOLS.index(symbol) for link in range(joints + 1) for symbol in ORDER]
    return regroup(whole.reshape(-1, 10 * (joints + 1)), _parameters(arm), order)


def _body(arm: Arm, values: FloatArray, covariance: FloatArray, size: FloatArray) -> BaseBody:
    """Estimates of the base by itself and in its combinations."""
    base, parameters = _regrouped(arm), _parameters(arm)
    combined_errors = np.sqrt(np.maximum(np.diag(base.regrouping @ covariance @ base.regrouping.T), 0.0))
    errors = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    estimates, combined = [], []
    for k in range(10):
        parameter, value, error = parameters[k], float(values[k]), float(errors[k])
        rests, note = Determination.DATA, ""
        if not base.alone(k):
            name = base.names[int(np.flatnonzero(base.regrouping[:, k])[0])].split(" ")[0]
            rests, note, error = Determination.COMBINED, f"in the base parameter of {name}", float("nan")
        elif error > KNOWN_SHARE * size[k]:
            rests, note, error = Determination.PRIOR, "this motion does not reveal it", float("nan")
        estimates.append(Estimate(parameter.symbol, parameter.joint, parameter.unit, value, error, rests, note))
    for number, lead_number in enumerate(base.independent):
        if lead_number < 10:
            lead = parameters[lead_number]
            value, error = float(base.regrouping[number] @ values), float(combined_errors[number])
            combined.append(Estimate(base.names[number], lead.joint, lead.unit, value, error, Determination.DATA))
    return BaseBody(tuple(estimates), tuple(combined))
