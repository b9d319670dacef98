"""`find_payload`: mass, centre and inertia of what an arm holds, from seconds of motion and a model without it.

What the model leaves of the torque is linear in the ten inertial parameters of a body fixed to the last link (Khalil,
Gautier and Lemoine 2007), beside which friction is let change: a Coulomb and a viscous part a joint, for it differs
from day to day. Least squares over the rows where a joint moves, weighted by each joint's residual and the joints' mean
correlation time (as `noise.weights` has it, and why).
A weak belief in a compact body keeps inertias that a slow motion cannot show near zero; where the result is no body all
the same, mass and centre are fitted without an inertia of their own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ..arrays import FloatArray
from ..dynamics.arm import Arm
from ..dynamics.model import IdentifiedModel
from ..dynamics.regressor import rigid_body_blocks
from ..errors import UnfitDataError, UserError
from ..estimate.consistency import pseudo_inertia
from ..noise.weights import residual_noise
from ..recording.recording import Recording
from ..signals.motion import Motion
from ..signals.prepare import prepare
from .frames import inertia_about_centre

INERTIA_SD = 0.2
"""Standard deviation of the belief about the inertia of what is held about the last joint's frame, kg m^2: 10 kg at
0.14 m, more than most arms may carry."""
SURE = 3.0
"""Standard errors from which a mass is one."""
FEWEST_ROWS = 20
"""Rows in motion below which a joint is left out: fewer do not tell its noise."""
PASSES = 3
"""Fits, each with the weights that the residuals of the one before give."""
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


def find_payload(model: IdentifiedModel, recordings: Sequence[Recording], frame: str | None = None) -> Held:
    """Identify what is held.

    Args:
        model: Of the arm without it; its gains are taken for right.
        recordings: With it, effort in N·m.
        frame: Link of the URDF, fixed to the last joint's, in which it is told; None: the flange, if its name is known.

    Raises:
        UnfitDataError: The motion does not show a mass: too short, too small, or nothing is held.
        UserError: No such frame, or a joint is missing in a recording.
    """
    arm = model.model.arm
    name, rotation, origin = tool_frame(arm, frame)
    motions, _ = prepare(recordings, arm.joint_names, model.cutoff_hz)
    left = [motion.torque_rows - motion.reduce(model.torque(motion)) for motion in motions]
    values, covariance, before, after = _fit(arm, motions, left, inertia=True)
    known = _is_body(values[:10])
    if not known:
        values, covariance, before, after = _fit(arm, motions, left, inertia=False)
    mass, error = float(values[0]), float(np.sqrt(covariance[0, 0]))
    if not mass > SURE * error:
        raise UnfitDataError(
            f"no payload detected: mass {mass:.4f} ± {error:.4f} kg (standard error); attach one, or move the last "
            "joints through larger angles against gravity for ten seconds"
        )

    def told(phi: FloatArray) -> FloatArray:
        """Mass, centre and inertia in the frame asked for, as one vector."""
        centre = phi[1:4] / phi[0]
        turned = rotation.T @ inertia_about_centre(phi) @ rotation
        return np.concatenate([[phi[0]], rotation.T @ (centre - origin), turned.ravel()])

    phi = values[:10]
    result = told(phi)
    steps = np.sqrt(np.maximum(np.diag(covariance)[:10], 1e-300)) * 1e-3
    slopes = np.column_stack([(told(phi + step * unit) - result) / step for step, unit in zip(steps, np.eye(10))])
    errors = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", slopes, covariance[:10, :10], slopes), 0.0))
    return Held(
        name,
        mass,
        result[1:4],
        result[4:].reshape(3, 3) if known else None,
        error,
        errors[1:4],
        errors[4:].reshape(3, 3) if known else None,
        before,
        after,
    )


def tool_frame(arm: Arm, name: str | None) -> tuple[str, FloatArray, FloatArray]:
    """A frame fixed to the last joint's: its name, its axes (3, 3) and origin (3,) in the joint's frame.

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


def _fit(
    arm: Arm, motions: Sequence[Motion], left: Sequence[FloatArray], inertia: bool
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Values (10 + 2 n,), covariance, and RMS before and after (n,)."""
    n = len(arm.joints)
    matrices, targets, places = _rows(arm, motions, left, inertia)
    belief = np.zeros(10 + 2 * n)
    belief[4:10] = 1.0 / INERTIA_SD**2 if inertia else 1e12
    residuals = targets
    for _ in range(PASSES):
        information, moment = np.diag(np.maximum(belief, 1e-9)), np.zeros(10 + 2 * n)
        used = [k for k in range(n) if len(targets[k]) >= FEWEST_ROWS]
        noises = {k: residual_noise(residuals[k], places[k], motions[0].white_correlation) for k in used}
        kappa = float(np.mean([noise.correlation_rows for noise in noises.values()])) if used else 1.0
        for k, noise in noises.items():
            weight = 1.0 / max(noise.sigma_Nm**2 * kappa, 1e-12)
            information += weight * matrices[k].T @ matrices[k]
            moment += weight * matrices[k].T @ targets[k]
        covariance = np.linalg.inv(information)
        values = covariance @ moment
        residuals = [target - matrix @ values for target, matrix in zip(targets, matrices)]

    def rms(parts: Sequence[FloatArray]) -> FloatArray:
        return np.array([np.sqrt(np.mean(part**2)) if len(part) else 0.0 for part in parts])

    return values, covariance, rms(targets), rms(residuals)


def _rows(
    arm: Arm, motions: Sequence[Motion], left: Sequence[FloatArray], inertia: bool
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
                matrix[:, 4:10] *= inertia
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
