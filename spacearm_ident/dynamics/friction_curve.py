"""Friction over velocity, as an identified model has it: each joint swept alone, steadily, in one pose."""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray
from ..signals.motion import Motion
from .friction import ViscousFriction
from .model import IdentifiedModel

SLOWEST = 1e-4
"""Smallest speed of the curve, as a share of its largest."""
STEADY_HZ = 1e-9
"""A sample rate so low that any presliding distance is long travelled between two samples: steady friction."""


def friction_curve(
    identified: IdentifiedModel, joint: int, top_speed: float, pose: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Steady friction torque of one joint.

    Args:
        identified: The model.
        joint: Its index.
        top_speed: Largest speed of the sweep, rad/s.
        pose: (n,) position it is taken in, rad: friction that grows with the load depends on it.

    Returns:
        (K,) velocities from -top_speed to top_speed without zero, and (K,) N·m.
    """
    motion = _sweep(identified, joint, top_speed, pose)
    return motion.velocity[:, joint], identified.torque(motion, identified.model.friction_kinds)[:, joint]


def friction_error(
    identified: IdentifiedModel, joint: int, top_speed: float, pose: FloatArray, covariance: FloatArray
) -> FloatArray:
    """(K,) standard error of `friction_curve`, N·m, for given constants (v_b, d_s).

    Args:
        identified: The model.
        joint: Its index.
        top_speed: Largest speed of the sweep, rad/s.
        pose: (n,) position it is taken in, rad.
        covariance: (p + c, p + c) of parameters and constants, or of more.
    """
    numbers, rows = _columns(identified, _sweep(identified, joint, top_speed, pose), joint)
    return _errors(rows, covariance[np.ix_(numbers, numbers)])


def viscosity(
    identified: IdentifiedModel, joint: int, speeds: FloatArray, covariance: FloatArray
) -> tuple[FloatArray, FloatArray] | None:
    """Slopes of one joint's viscous friction between -speed and speed: k_v1 + k_v3 speed^2, even terms cancel.

    Args:
        identified: The model.
        joint: Its index.
        speeds: (K,) of the joint, above zero, rad/s.
        covariance: (p + c, p + c) of parameters and constants, or of more.

    Returns:
        The slopes (K,) and their standard errors (K,), N·m s/rad; None where the model has no viscous friction there.
    """
    still = np.zeros(len(identified.model.arm.joint_names))
    motion = _steady(identified, joint, np.concatenate([-speeds, speeds]), still)
    numbers, rows = _columns(identified, motion, joint, ViscousFriction.kind)
    if not numbers:
        return None
    slopes = (rows[len(speeds) :] - rows[: len(speeds)]) / (2.0 * speeds[:, None])
    return slopes @ identified.parameters[numbers], _errors(slopes, covariance[np.ix_(numbers, numbers)])


def friction_terms(identified: IdentifiedModel, joint: str) -> frozenset[str]:
    """Names of what one joint's friction is made of: two models that have the same have the same law there.

    Args:
        identified: The model.
        joint: Its name.
    """
    found: set[str] = set()
    for term, _, first_constant in identified.model.numbered():
        if not term.friction:
            continue
        values = identified.constants[first_constant : first_constant + len(term.constants)]
        found |= {item.symbol for item, value in zip(term.constants, values) if item.joint == joint and value > 0.0}
        for parameter in term.parameters:
            # Without a Stribeck velocity f_b moves no torque: v_b says whether there is one.
            if parameter.joint == joint and not parameter.held and parameter.symbol != "f_b":
                odd = isinstance(term, ViscousFriction) and term.is_odd(parameter)
                found.add(ViscousFriction.ODD if odd else parameter.symbol)
    return frozenset(found)


def fastest_seen(identified: IdentifiedModel, joint: str) -> float | None:
    """Largest speed of a joint in the data, rad/s (m/s); None where the model does not say.

    Args:
        identified: A model whose viscous friction may state the largest speed at which its terms were identified.
        joint: Name of the joint.
    """
    speed = identified.model.structure.get(ViscousFriction.kind, {}).get("fastest", {}).get(joint)
    return None if speed is None else float(speed)


def friction_levels(
    identified: IdentifiedModel, joint: int, speeds: FloatArray, covariance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Half of what one joint's steady friction differs by in its two directions, at several speeds.

    Args:
        identified: The model.
        joint: Its index; the arm is in its zero position.
        speeds: (K,) of the joint, above zero, rad/s.
        covariance: (p + c, p + c) of parameters and constants, or of more.

    Returns:
        (K,) torques and their (K, K) covariance for given constants, N·m and (N·m)².
    """
    still = np.zeros(len(identified.model.arm.joint_names))
    motion = _steady(identified, joint, np.concatenate([-speeds, speeds]), still)
    numbers, rows = _columns(identified, motion, joint)
    levels = (rows[len(speeds) :] - rows[: len(speeds)]) / 2.0
    return levels @ identified.parameters[numbers], levels @ covariance[np.ix_(numbers, numbers)] @ levels.T


def _columns(
    identified: IdentifiedModel, motion: Motion, joint: int, kind: str | None = None
) -> tuple[list[int], FloatArray]:
    """Numbers (k) and columns (N, k) of the parameters of friction, or of one kind of it, that act on a joint."""
    model = identified.model
    background = model.background(motion, identified.parameters, identified.constants)
    numbers: list[int] = []
    columns = [np.empty((len(motion.position), 0))]
    for term, first, first_constant in model.numbered():
        if term.friction if kind is None else term.kind == kind:
            constants = identified.constants[first_constant : first_constant + len(term.constants)]
            indices, found = term.columns(motion, constants, background).get(joint, ([], columns[0]))
            numbers += [first + index for index in indices]
            columns.append(found)
    return numbers, np.concatenate(columns, axis=1)


def _errors(rows: FloatArray, covariance: FloatArray) -> FloatArray:
    """(N,) standard error of rows (N, k) times parameters."""
    return np.asarray(np.sqrt(np.maximum(np.einsum("ki,ij,kj->k", rows, covariance, rows), 0.0)))


def _sweep(identified: IdentifiedModel, joint: int, top_speed: float, pose: FloatArray) -> Motion:
    speeds = np.unique(np.concatenate([np.geomspace(SLOWEST, 1.0, 120), np.linspace(0.01, 1.0, 80)])) * top_speed
    return _steady(identified, joint, np.concatenate([-speeds[::-1], speeds]), pose)


def _steady(identified: IdentifiedModel, joint: int, speeds: FloatArray, pose: FloatArray) -> Motion:
    """One joint at each of some speeds (K,), rad/s, the others still, without acceleration."""
    position = np.tile(pose, (len(speeds), 1))
    velocity = np.zeros_like(position)
    velocity[:, joint] = speeds
    joints = identified.model.arm.joint_names
    return Motion.free_of_noise(joints, STEADY_HZ, position, velocity, np.zeros_like(position))
