"""A full set of parameters that a real arm could have, nearest to the data's estimate and to the CAD prior.

Rigid bodies exist exactly for positive definite pseudo-inertias (Wensing, Kim and Slotine 2018, "Linear matrix
inequalities for physically consistent inertial parameter identification"):

    J = [[ tr(I)/2 * 1 - I, m c], [m c', m]] > 0   for every link.

Together with bounds on friction and rotor inertia this is a small convex programme: the compressed least-squares
problem, its objective a few hundred rows whatever the recording's length, solved by Clarabel's interior point.
"""

from __future__ import annotations

import clarabel
import numpy as np
from scipy import sparse
from scipy.linalg import solve_triangular

from ..arrays import FloatArray
from ..dynamics.model import TorqueModel
from ..dynamics.regressor import INERTIAL_SYMBOLS
from ..errors import UserError

MARGIN = 1e-6
"""Smallest eigenvalue asked for, in units in which a link's own mass and size are one."""

ACTIVE = 10.0
"""Multiples of `MARGIN` under which an eigenvalue is on its bound; the programme asks for two."""


def pseudo_inertia(inertial: FloatArray) -> FloatArray:
    """(4, 4) pseudo-inertia of m, mcx, mcy, mcz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz."""
    m, x, y, z, ixx, ixy, iyy, ixz, iyz, izz = inertial
    half = 0.5 * (ixx + iyy + izz)
    return np.array(
        [
            [half - ixx, -ixy, -ixz, x],
            [-ixy, half - iyy, -iyz, y],
            [-ixz, -iyz, half - izz, z],
            [x, y, z, m],
        ]
    )


def link_parameters(model: TorqueModel) -> list[np.ndarray]:
    """For every link, the numbers of its ten inertial parameters."""
    numbers = {parameter.name: k for k, parameter in enumerate(model.parameters)}
    return [
        np.array([numbers[f"{symbol}[{joint}]"] for symbol in INERTIAL_SYMBOLS])
        for joint in model.arm.joint_names
        if f"m[{joint}]" in numbers
    ]


def is_consistent(model: TorqueModel, parameters: FloatArray, scale: FloatArray) -> bool:
    """Whether every link's pseudo-inertia is positive definite and every bound holds.

    Args:
        model: Which parameter is what, and its bounds.
        parameters: (p,) in the order of `model.parameters`, SI.
        scale: (p,) prior scales, for the units of the pseudo-inertia.
    """
    for numbers in link_parameters(model):
        units = _link_units(scale[numbers])
        if np.linalg.eigvalsh(pseudo_inertia(parameters[numbers]) / np.outer(units, units))[0] < MARGIN:
            return False
    return all(parameter.lower <= value <= parameter.upper for parameter, value in zip(model.parameters, parameters))


def active_bounds(model: TorqueModel, parameters: FloatArray, scale: FloatArray) -> FloatArray:
    """Combinations of parameters that physical consistency holds where they are, to first order.

    A body on the edge of what is possible, a rod or a plate, has a pseudo-inertia J that is singular: with V a basis of
    its null space, no change dJ is possible but one with V'dJ V >= 0, and least squares presses against that.

    Args:
        model: Which parameter is what.
        parameters: (p,) physically consistent.
        scale: (p,) prior scales, for the units of J.

    Returns:
        (a, p), a row an entry of V'J V that is held at zero.
    """
    held = []
    for numbers in link_parameters(model):
        units = _link_units(scale[numbers])
        value, vector = np.linalg.eigh(pseudo_inertia(parameters[numbers]) / np.outer(units, units))
        edge = vector[:, value < ACTIVE * MARGIN] / units[:, None]
        each = [edge.T @ pseudo_inertia(unit) @ edge for unit in np.eye(10)]
        for i, j in zip(*np.triu_indices(edge.shape[1])):
            row = np.zeros(len(parameters))
            row[numbers] = [entry[i, j] for entry in each]
            held.append(row)
    return np.array(held).reshape(-1, len(parameters))


def make_consistent(model: TorqueModel, matrix: FloatArray, parameters: FloatArray, scale: FloatArray) -> FloatArray:
    """The physically consistent x nearest to the unconstrained solution: min |matrix (x - parameters)|.

    Args:
        model: Which parameter is what.
        matrix: (r, p) compressed rows, data and prior.
        parameters: (p,) unconstrained solution; parameters of zero scale stay at it.
        scale: (p,) prior scales, for scaling.

    Returns:
        (p,) parameters; `parameters` itself where it is consistent already.

    Raises:
        UserError: The solver found no consistent set (a bound contradicts another).
    """
    if is_consistent(model, parameters, scale):
        return parameters
    free = np.flatnonzero(scale > 0)
    unit = scale[free]
    # In whitened coordinates y = R (x - x_hat) the objective is |y|^2. The prior's rows make R at least one in units
    # of the prior's scale, so R^-1 is at most one: nothing in the programme is badly scaled.
    triangle = np.linalg.qr(matrix[:, free] * unit, mode="r")
    unwhiten = solve_triangular(triangle, np.eye(len(free)))
    rows, sides, cones = _constraints(model, free, unit, scale)
    slack = sides - rows @ (parameters[free] / unit)
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    solver = clarabel.DefaultSolver(
        sparse.eye(len(free), format="csc"),
        np.zeros(len(free)),
        sparse.csc_matrix(rows @ unwhiten),
        slack,
        cones,
        settings,
    )
    outcome = solver.solve()
    if str(outcome.status) not in ("Solved", "AlmostSolved"):
        raise UserError(
            f"no physically consistent set of parameters was found ({outcome.status}): "
            "check the URDF's masses and the sign of the torques"
        )
    consistent = parameters.copy()
    consistent[free] += unwhiten @ np.array(outcome.x) * unit
    for k, parameter in enumerate(model.parameters):
        if scale[k] > 0:
            consistent[k] = np.clip(consistent[k], parameter.lower, parameter.upper)
    return consistent


def _link_units(scale: FloatArray) -> FloatArray:
    """(4,) units that make a link's pseudo-inertia of order one: size and square root of mass."""
    mass = np.sqrt(scale[0])
    return np.array([np.sqrt(scale[4]), np.sqrt(scale[4]), np.sqrt(scale[4]), mass])


def _constraints(
    model: TorqueModel, free: np.ndarray, unit: FloatArray, scale: FloatArray
) -> tuple[FloatArray, FloatArray, list[object]]:
    """Bounds as non-negative rows and pseudo-inertias as semidefinite ones: `sides - rows @ x` lies in the cones."""
    place = {int(number): k for k, number in enumerate(free)}
    bounds, limits = [], []
    for number, k in place.items():
        parameter = model.parameters[number]
        for sign, limit in ((-1.0, parameter.lower), (1.0, parameter.upper)):
            if np.isfinite(limit):
                row = np.zeros(len(free))
                row[k] = sign
                bounds.append(row)
                limits.append(sign * limit / unit[k])
    rows, sides, cones = [np.array(bounds).reshape(-1, len(free))], [np.array(limits)], []
    if bounds:
        cones.append(clarabel.NonnegativeConeT(len(bounds)))
    for numbers in link_parameters(model):
        units = _link_units(scale[numbers])
        block = np.zeros((10, len(free)))
        for position, number in enumerate(numbers):
            basis = np.zeros(10)
            basis[position] = 1.0
            block[:, place[int(number)]] = (
                -_svec(pseudo_inertia(basis) / np.outer(units, units)) * unit[place[int(number)]]
            )
        rows.append(block)
        sides.append(-_svec(2 * MARGIN * np.eye(4)))
        cones.append(clarabel.PSDTriangleConeT(4))
    return np.concatenate(rows), np.concatenate(sides), cones


def _svec(matrix: FloatArray) -> FloatArray:
    """(10,) upper triangle by columns, off-diagonals times sqrt(2), as Clarabel's cone has it."""
    return np.array([matrix[i, j] * (1.0 if i == j else np.sqrt(2.0)) for j in range(4) for i in range(j + 1)])
