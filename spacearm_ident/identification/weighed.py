"""Torque gains of an arm from recordings with a known mass and without it.

Recorded torque is motor current times a torque constant and a ratio, or a sensor's reading: it differs from the joint's
torque by a gain g_j that no motion of the arm alone shows, because rigid-body parameters scale with it. A known mass
fixes the scale, and the links' inertials, which several joints share, carry it from joint to joint:

    tau_j = g_j (Y_j beta + P_j phi) + F_j f_j,

with Y_j, P_j the regressors of arm and body, phi the body's inertial parameters of which the mass is known, and F_j f_j
friction and offset, which may differ between the recordings with the body and those without. All of it is fitted
jointly to all recordings (Gautier and Briot 2014, "Global identification of joint drive gains and dynamic parameters of
robots", ASME J. Dyn. Syst. Meas. Control 136, 051025): an arm identified first, by torque whose gains disagree, would
have put the disagreement into its inertials.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.optimize import least_squares

from ..arrays import FloatArray
from ..dynamics.arm import Arm
from ..dynamics.model import TorqueModel
from ..dynamics.regressor import INERTIAL_SYMBOLS
from ..errors import UnfitDataError, UserError
from ..estimate.identified import GAIN_DEVIATION
from ..noise.weights import common_correlation, residual_noise
from ..recording.recording import Recording
from ..regression.balanced import pseudo_inverse
from ..regression.prior import make_prior
from ..regression.regression import Regression
from ..signals.motion import Motion
from ..signals.prepare import prepare
from ..solvers.solution_columns import columns_at
from .plain import plain_structure
from .torque_gain import assumed_covariance

GAIN_BEFORE = 0.5
"""Standard deviation of a gain about 1 before the data: factors of 0.5 to 2 have been seen (AIRBOT 0.5 and 0.56)."""
REACH_M = 0.3
"""Standard deviation of the body's centre about the frame that it is said to be in, m."""
COMPACT_M = 0.2
"""Radius of gyration from which the standard deviation of the body's inertia follows, m: mass times its square."""
CHANGING = ("f_c", "k_v1", "offset")
"""Parameters that may differ between the recordings with the body and those without: friction and the sensor's zero."""
PASSES = 3
"""Fits, each with the weights that the residuals of the one before give."""
FEWEST_ROWS = 20
"""Rows in motion below which a joint is left out: its noise is not known from fewer."""


@dataclass(frozen=True)
class Weight:
    """A known mass.

    Attributes:
        mass_kg: Its mass.
        link: Link of the URDF that it is fixed to; empty: the last joint's.
    """

    mass_kg: float
    link: str = ""


@dataclass(frozen=True)
class TorqueGains:
    """Recorded torque over the joint's torque.

    Attributes:
        joints: (n,) names.
        value: (n,) gains; 1 where the recordings determine none.
        covariance: (n, n) of them; `GAIN_DEVIATION` squared where the recordings determine none.
        determined: (n,) whether the standard error is below `GAIN_DEVIATION`, what is assumed without a known mass.
        weight: The known mass.
    """

    joints: tuple[str, ...]
    value: FloatArray
    covariance: FloatArray
    determined: np.ndarray
    weight: Weight

    @property
    def error(self) -> FloatArray:
        """(n,) standard errors."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def words(self) -> str:
        """The gains with their standard errors, for the user."""
        known, unknown = [], []
        for name, gain, error, determined in zip(self.joints, self.value, self.error, self.determined):
            if determined:
                known.append(f"{name} {gain:.3f} ± {error:.3f}")
            else:
                unknown.append(name)
        place = f" at {self.weight.link}" if self.weight.link else ""
        beyond = f"; not determined, and left as recorded: {', '.join(unknown)}" if unknown else ""
        return (
            f"torque gains (recorded over true torque) from the known mass of {self.weight.mass_kg:g} kg{place}: "
            f"{', '.join(known)}; recorded torque is divided by them{beyond}"
        )

    def as_dict(self) -> dict[str, Any]:
        """By joint, as JSON."""
        columns = zip(self.joints, self.value.tolist(), self.error.tolist(), self.determined.tolist())
        return {
            name: {"value": value, "standard_error": error, "determined": determined}
            for name, value, error, determined in columns
        }

    def corrected(self, arm: Arm) -> Arm:
        """The arm whose recorded effort is divided by the gains."""
        joints = tuple(
            replace(joint, effort_scale=joint.effort_scale / float(gain)) for joint, gain in zip(arm.joints, self.value)
        )
        return replace(arm, joints=joints, effort_declared=True)


def parse_weight(text: str) -> Weight:
    """A known mass from `MASS` or `MASS@LINK`, kg.

    Raises:
        UserError: No positive number in front.
    """
    number, _, link = text.partition("@")
    try:
        mass = float(number)
    except ValueError:
        mass = float("nan")
    if not mass > 0.0:
        raise UserError(f"a known mass is MASS@LINK, as 2.5@tool0, in kg; not {text!r}")
    return Weight(mass, link)


def calibrate_gains(
    recordings: Sequence[Recording], loaded: Sequence[Recording], arm: Arm, weight: Weight
) -> TorqueGains:
    """Estimate the joints' torque gains.

    Args:
        recordings: Runs without the mass, effort in N·m as the arm declares it.
        loaded: Runs with it.
        arm: The arm.
        weight: The mass and where it is.

    Raises:
        UnfitDataError: The recordings determine no joint's gain.
        UserError: The arm has no such link, or it does not move.
    """
    body, origin = _fixed_to(arm, weight.link)
    free, bandwidth = prepare(recordings, arm.joint_names)
    carrying, _ = prepare(loaded, arm.joint_names, bandwidth.cutoff_hz)
    gains, covariance = _Problem(arm, [*free, *carrying], len(free), body, weight.mass_kg, origin).solve()
    determined = np.sqrt(np.diag(covariance)) < GAIN_DEVIATION
    if not determined.any():
        raise UnfitDataError(
            "the recordings with the known mass determine no torque gain: move the joints that carry it against "
            "gravity through large angles, with and without it"
        )
    covariance = np.where(np.outer(determined, determined), covariance, assumed_covariance(len(gains)))
    return TorqueGains(arm.joint_names, np.where(determined, gains, 1.0), covariance, determined, weight)


def _fixed_to(arm: Arm, link: str) -> tuple[int, FloatArray]:
    """Number of the joint that moves a link, and the link's origin (3,) in the joint's frame, m.

    Raises:
        UserError: No such link, or one of the base.
    """
    model = pin.buildModelFromXML(arm.urdf)
    if not link:
        return len(arm.joints) - 1, np.zeros(3)
    if not model.existFrame(link):
        raise UserError(f"the arm has no link {link!r} that could carry the known mass")
    frame = model.frames[model.getFrameId(link)]
    if frame.parentJoint == 0:
        raise UserError(f"the link {link!r} does not move: a mass there is not carried by any joint")
    return int(frame.parentJoint) - 1, np.asarray(frame.placement.translation).copy()


class _Problem:
    """Least squares over all recordings.

    Unknowns are the parameters of the arm, the change of friction under the body, the body's ten inertial parameters,
    and the gains.

    Attributes:
        matrices: By joint, (M, t) columns of the first three groups, and the torque last.
        scaled: (t,) columns that the joint's gain multiplies: those of rigid bodies.
        centre: (t,) value before the data.
        deviation: (t,) standard deviation about it; zero: held there.
    """

    def __init__(
        self,
        arm: Arm,
        motions: Sequence[Motion],
        without_body: int,
        body: int,
        mass_kg: float,
        origin: FloatArray,
    ) -> None:
        """Compute the columns.

        Args:
            arm: The arm.
            motions: Those without the body first.
            without_body: How many these are.
            body: Number of the joint that carries the body.
            mass_kg: Mass of the body.
            origin: (3,) where it is said to be, in the frame of that joint, m.
        """
        model = TorqueModel(arm, plain_structure(arm))
        self.regression = Regression(model, motions)
        prior = make_prior(model, motions)
        names = [(parameter.symbol, parameter.joint) for parameter in model.parameters]
        rigid = np.array([symbol in INERTIAL_SYMBOLS for symbol, _ in names])
        changing = np.flatnonzero([symbol in CHANGING and prior.scale[k] > 0 for k, (symbol, _) in enumerate(names)])
        carried = [names.index((symbol, arm.joint_names[body])) for symbol in INERTIAL_SYMBOLS]
        self.matrices = []
        for rows, columns, numbers in zip(
            self.regression.rows, *columns_at(self.regression, np.zeros(len(model.constants)))
        ):
            whole = np.zeros((len(rows.torque), len(names)))
            whole[:, numbers] = columns
            beside = (rows.owner >= without_body)[:, None]
            self.matrices.append(
                np.column_stack([whole, whole[:, changing] * beside, whole[:, carried] * beside, rows.torque])
            )
        expected = mass_kg * np.concatenate([[1.0], origin, np.zeros(6)])
        spread = mass_kg * np.concatenate([[0.0], np.full(3, REACH_M), np.full(6, COMPACT_M**2)])
        self.scaled = np.concatenate([rigid, np.zeros(len(changing), dtype=bool), np.ones(len(carried), dtype=bool)])
        self.centre = np.concatenate([prior.held, np.zeros(len(changing)), expected])
        self.deviation = np.concatenate([prior.scale, prior.scale[changing], spread])

    def solve(self) -> tuple[FloatArray, FloatArray]:
        """Gains (n,) and their covariance (n, n)."""
        count = len(self.matrices)
        free = np.flatnonzero(self.deviation > 0.0)
        x = np.concatenate([self.centre[free], np.ones(count)])
        left = [matrix[:, -1] for matrix in self.matrices]
        for _ in range(PASSES):
            compressed = self._compressed(left)
            solved = least_squares(self._residuals, x, self._jacobian, x_scale="jac", args=(compressed, free))
            x = solved.x
            left = [self._left(matrix, joint, x, free) for joint, matrix in enumerate(self.matrices)]
        covariance = pseudo_inverse(solved.jac.T @ solved.jac)
        return x[-count:], covariance[-count:, -count:]

    def _compressed(self, left: Sequence[FloatArray]) -> list[FloatArray]:
        """By joint, the triangle of its rows (t + 1, t + 1), weighted by the RMS of what is left (M,), N·m."""
        motions, noises, sizes = self.regression.motions, [], []
        for rows, residual in zip(self.regression.rows, left):
            for k, motion in enumerate(motions):
                mine = rows.owner == k
                noises.append(residual_noise(residual[mine], rows.place[mine], motion.white_correlation))
            sizes.append(float(np.sqrt(np.mean(residual**2))) if len(residual) >= FEWEST_ROWS else np.inf)
        correlation = np.sqrt(common_correlation(noises))
        return [np.linalg.qr(matrix, mode="r") / (size * correlation) for matrix, size in zip(self.matrices, sizes)]

    def _values(self, x: FloatArray, free: np.ndarray) -> FloatArray:
        values = self.centre.copy()
        values[free] = x[: len(free)]
        return values

    def _left(self, matrix: FloatArray, joint: int, x: FloatArray, free: np.ndarray) -> FloatArray:
        """(M,) measured minus modelled, of any rows (M, t + 1) of a joint."""
        gain = np.where(self.scaled, x[len(free) + joint], 1.0)
        return np.asarray(matrix[:, -1] - matrix[:, :-1] @ (gain * self._values(x, free)))

    def _residuals(self, x: FloatArray, compressed: Sequence[FloatArray], free: np.ndarray) -> FloatArray:
        known = (x[: len(free)] - self.centre[free]) / self.deviation[free]
        near = (x[len(free) :] - 1.0) / GAIN_BEFORE
        return np.concatenate([*(self._left(r, j, x, free) for j, r in enumerate(compressed)), known, near])

    def _jacobian(self, x: FloatArray, compressed: Sequence[FloatArray], free: np.ndarray) -> FloatArray:
        values = self._values(x, free)
        blocks = []
        for joint, rows in enumerate(compressed):
            block = np.zeros((len(rows), len(x)))
            gain = np.where(self.scaled, x[len(free) + joint], 1.0)
            block[:, : len(free)] = -rows[:, :-1][:, free] * gain[free]
            block[:, len(free) + joint] = -rows[:, :-1] @ (self.scaled * values)
            blocks.append(block)
        deviation = np.concatenate([self.deviation[free], np.full(len(x) - len(free), GAIN_BEFORE)])
        return np.concatenate([*blocks, np.diag(1.0 / deviation)])
