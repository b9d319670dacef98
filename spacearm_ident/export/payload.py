"""`find_payload`: mass, centre and inertia of what an arm holds, from seconds of motion and a model without it.

What the model leaves of the torque is linear in the ten inertial parameters of a body fixed to the last link (Khalil,
Gautier and Lemoine 2007), beside which friction is let change: a Coulomb and a viscous part a joint, for it differs
from day to day. Least squares over the rows where a joint moves, weighted by each joint's residual and the joints' mean
correlation time (as `noise.weights` has it, and why).
The unknowns are the mass m, the first moment m c and the inertia J about the centre, so that the inertia about the
joint's frame, J + m (c'c 1 - c c'), always has the share that mass and centre fix. J is zero before the data, with the
standard deviation m `COMPACT_M`^2: what a motion does not show of it enters the errors of mass and centre.

A base whose motion is recorded moves in these columns as in an identification (`dynamics/base_link.py`); its own
inertia is in none of the joints' rows. What is no payload (another gravity, a model that does not fit) is told apart by
`export/unweighed.py`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ..arrays import FloatArray
from ..bayes.updated import REDUCED
from ..conventions.physical import SURE_BODY
from ..dynamics.arm import Arm
from ..dynamics.base_link import base_notes, placed
from ..dynamics.model import IdentifiedModel
from ..dynamics.regressor import rigid_body_blocks
from ..errors import UserError
from ..estimate.consistency import pseudo_inertia
from ..identification.weighed import COMPACT_M
from ..noise.weights import residual_noise
from ..recording.recording import Recording
from ..signals.motion import Motion
from ..signals.prepare import prepare
from .unweighed import BodyFit, caveats, refuse_no_body, refuse_other_gravity

FEWEST_ROWS = 20
"""Rows in motion below which a joint is left out: fewer do not tell its noise."""
PASSES, FIRST = 10, 3
"""Fits, each about the values and with the weights that the one before gives, and how many of them are of mass and
first moment alone: the weights of the first are those of torque unexplained. On the recordings of test_payload.py the
last moves nothing by more than a thousandth of its standard error."""
WEAK, HELD = 1e-9, 1e12
"""Precision before the data of what is free and of what is held, one over the square of its unit: next to none beside
any data, and beyond any."""
MATRIX = np.array([[0, 1, 3], [1, 2, 4], [3, 4, 5]])
"""Which of Ixx, Ixy, Iyy, Ixz, Iyz, Izz stands where in the matrix."""
ELEMENTS = (np.array([0, 0, 1, 0, 1, 2]), np.array([0, 1, 1, 2, 2, 2]))
"""Rows and columns of these in the matrix."""
TOOL_FRAMES = ("tool0", "flange", "tool_flange", "ee_link", "link8", "panda_link8", "fr3_link8")
"""Names of the flange's frame, by the URDFs of those who make arms."""


@dataclass(frozen=True)
class Held:
    """What is held, in a frame fixed to the last link.

    Attributes:
        frame: Its name; the last joint's where no flange is known.
        mass: kg.
        centre: (3,) centre of mass in the frame, m.
        inertia: (3, 3) about the centre of mass, axes of the frame, kg m^2; None: these data do not show it.
        mass_error, centre_error, inertia_error: Standard errors of the same; inertia's by element.
        before_Nm, after_Nm: (n,) RMS that the model leaves without and with it, N·m.
        notes: What was assumed of the base, and what speaks against the result, a sentence each.
    """

    frame: str
    mass: float
    centre: FloatArray
    inertia: FloatArray | None
    mass_error: float
    centre_error: FloatArray
    inertia_error: FloatArray | None
    before_Nm: FloatArray
    after_Nm: FloatArray
    notes: tuple[str, ...] = ()


def find_payload(model: IdentifiedModel, recordings: Sequence[Recording], frame: str | None = None) -> Held:
    """Identify what is held.

    Args:
        model: Of the arm without it, in the gravity of the recordings (`with_gravity`); its gains are taken for right.
        recordings: With it, effort in N·m; where the base's motion is recorded, it is used.
        frame: Link of the URDF, fixed to the last joint's, in which it is told; None: the flange, if its name is known.

    Raises:
        UnfitDataError: The motion does not show a mass: too short, too small, or nothing is held.
        UserError: No such frame, a joint or the place of a moving base's sensor is missing, or the model is not of the
            arm as recorded: another gravity, or a mass that is negative beyond its error.
    """
    arm = model.model.arm
    name, rotation, origin = tool_frame(arm, frame)
    motions, _ = prepare(placed(recordings, arm), arm.joint_names, model.cutoff_hz)
    fit = _fit(model, motions)
    refuse_other_gravity(arm, motions, fit, lambda gravity: _fit(model.with_gravity(gravity), motions))
    refuse_no_body(arm, motions, fit)
    body, uncertain = fit.values[:10], fit.covariance[:10, :10]
    mass, error = fit.mass, fit.mass_error

    def told(x: FloatArray) -> FloatArray:
        """Mass, centre and inertia in the frame asked for, as one vector."""
        turned = rotation.T @ x[4:][MATRIX] @ rotation
        return np.concatenate([[x[0]], rotation.T @ (x[1:4] / x[0] - origin), turned.ravel()])

    result = told(body)
    steps = np.sqrt(np.maximum(np.diag(uncertain), 1e-300)) * 1e-3
    slopes = np.column_stack([(told(body + step * unit) - result) / step for step, unit in zip(steps, np.eye(10))])
    errors = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", slopes, uncertain, slopes), 0.0))
    told_by_data = np.diag(uncertain)[4:] < (1.0 - REDUCED) * (mass * COMPACT_M**2) ** 2
    known = _is_body(about_joint(body)) and bool(told_by_data.all())
    return Held(
        name,
        mass,
        result[1:4],
        result[4:].reshape(3, 3) if known else None,
        error,
        errors[1:4],
        errors[4:].reshape(3, 3) if known else None,
        fit.before_Nm,
        fit.after_Nm,
        (*base_notes(recordings, arm), *caveats(arm, motions, fit)),
    )


def tool_frame(arm: Arm, name: str | None) -> tuple[str, FloatArray, FloatArray]:
    """A frame fixed to the last joint's: its name, its axes (3, 3) and origin (3,) in the joint's frame.

    Args:
        arm: Its URDF may have links fixed to the last joint.
        name: Link whose frame is wanted; None: the first of `TOOL_FRAMES` on the last joint, else its own.

    Raises:
        UserError: The URDF has no such frame there.
    """
    model = pin.buildModelFromXML(arm.urdf)
    there = {frame.name: frame.placement for frame in model.frames if frame.parentJoint == model.njoints - 1}
    if name is not None and name not in there:
        raise UserError(f"no link {name!r} on the last joint: it carries {', '.join(there)}")
    chosen = name or next((one for one in TOOL_FRAMES if one in there), None)
    if chosen is None:
        return f"the frame of {arm.joint_names[-1]}", np.eye(3), np.zeros(3)
    return chosen, there[chosen].rotation.copy(), there[chosen].translation.copy()


def about_joint(body: FloatArray) -> FloatArray:
    """(10,) inertial parameters about the frame's origin, by the parallel axis theorem.

    Args:
        body: (10,) m, mc, and Ixx, Ixy, Iyy, Ixz, Iyz, Izz about the centre of mass, kg, kg m, kg m^2.
    """
    moment = body[1:4]
    steiner = (moment @ moment * np.eye(3) - np.outer(moment, moment)) / body[0]
    return np.concatenate([body[:4], body[4:] + steiner[ELEMENTS]])


def _slopes(body: FloatArray) -> FloatArray:
    """(10, 10) derivatives of `about_joint`."""
    slopes = np.eye(10)
    mass, moment = body[0], body[1:4]
    about = moment @ moment * np.eye(3) - np.outer(moment, moment)
    slopes[4:, 0] = -about[ELEMENTS] / mass**2
    for axis, unit in enumerate(np.eye(3)):
        change = 2.0 * moment[axis] * np.eye(3) - np.outer(unit, moment) - np.outer(moment, unit)
        slopes[4:, 1 + axis] = change[ELEMENTS] / mass
    return slopes


def _fit(model: IdentifiedModel, motions: Sequence[Motion]) -> BodyFit:
    """The body and the change of friction that explain best what a model leaves of the torque.

    Gauss-Newton's method. It begins with mass and first moment alone, and ends there where these show no mass: a centre
    is then anything, and so is the inertia that it fixes.
    """
    arm = model.model.arm
    n = len(arm.joints)
    left = [motion.torque_rows - motion.reduce(model.torque(motion)) for motion in motions]
    matrices, targets, places = _rows(arm, motions, left)
    used = [k for k in range(n) if len(targets[k]) >= FEWEST_ROWS]
    values, residuals = np.zeros(10 + 2 * n), targets
    for number in range(PASSES):
        slopes, held, precision = np.eye(10 + 2 * n), np.zeros(10 + 2 * n), np.full(10 + 2 * n, WEAK)
        precision[4:10] = HELD if number < FIRST else 1.0 / (values[0] * COMPACT_M**2) ** 2
        if number >= FIRST:
            # The curve through the values so far, as a straight line: about_joint(x) = held + slopes x near them.
            slopes[:10, :10] = _slopes(values[:10])
            held[:10] = about_joint(values[:10]) - slopes[:10, :10] @ values[:10]
        noises = {k: residual_noise(residuals[k], places[k], motions[0].white_correlation) for k in used}
        kappa = float(np.mean([noise.correlation_rows for noise in noises.values()])) if used else 1.0
        information, moment = np.diag(precision), np.zeros(10 + 2 * n)
        for k, noise in noises.items():
            weight = 1.0 / max(noise.sigma_Nm**2 * kappa, 1e-12)
            matrix = matrices[k] @ slopes
            information += weight * matrix.T @ matrix
            moment += weight * matrix.T @ (targets[k] - matrices[k] @ held)
        covariance = np.linalg.inv(information)
        values = covariance @ moment
        linear = slopes @ values + held
        residuals = [target - matrix @ linear for target, matrix in zip(targets, matrices)]
        if number == FIRST - 1 and not values[0] > SURE_BODY * np.sqrt(covariance[0, 0]):
            break

    def rms(parts: Sequence[FloatArray]) -> FloatArray:
        return np.array([np.sqrt(np.mean(part**2)) if len(part) else 0.0 for part in parts])

    torque = [np.concatenate([one.torque_rows[one.moving[:, k], k] for one in motions]) for k in range(n)]
    worth = np.array([len(targets[k]) / kappa if k in used else 0.0 for k in range(n)])
    own = np.full(n, np.nan)
    if model.own is not None:
        own = np.sqrt(np.mean(model.own.fitted_Nm**2, axis=0))
        own[own == 0.0] = np.nan  # a joint without rows there
    return BodyFit(values, covariance, rms(targets), rms(residuals), rms(torque), own, worth)


def _rows(
    arm: Arm, motions: Sequence[Motion], left: Sequence[FloatArray]
) -> tuple[list[FloatArray], list[FloatArray], list[np.ndarray]]:
    """Per joint: columns (M, 10 + 2 n), what the model leaves (M,), and row numbers, of the rows where it moves."""
    n, last = len(arm.joints), len(arm.joints) - 1
    columns: list[list[FloatArray]] = [[] for _ in range(n)]
    targets: list[list[FloatArray]] = [[] for _ in range(n)]
    places: list[list[np.ndarray]] = [[] for _ in range(n)]
    start = 0
    for motion, rest in zip(motions, left):
        blocks = rigid_body_blocks(arm, motion.position, motion.velocity, motion.acceleration, motion.base)
        for k in range(n):
            rows = motion.moving[:, k]
            matrix = np.zeros((int(rows.sum()), 10 + 2 * n))
            if (k, last) in blocks:
                matrix[:, :10] = motion.reduce(blocks[k, last].T)[rows]
            matrix[:, 10 + k] = motion.reduce(np.sign(motion.velocity[:, k]))[rows]
            matrix[:, 10 + n + k] = motion.velocity_rows[rows, k]
            columns[k].append(matrix)
            targets[k].append(rest[rows, k])
            places[k].append(start + np.flatnonzero(rows))
        start += len(rest) + 1000
    joined = [np.concatenate(one) for one in places]
    return [np.concatenate(one) for one in columns], [np.concatenate(one) for one in targets], joined


def _is_body(phi: FloatArray) -> bool:
    """Whether a body can have these parameters: its pseudo-inertia is positive definite (Wensing et al. 2018)."""
    return bool(np.linalg.eigvalsh(pseudo_inertia(phi))[0] > 0.0)
