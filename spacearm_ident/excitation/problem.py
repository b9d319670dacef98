"""`Problem`: an excitation wanted, and its criterion as a function of the series' coefficients.

Motion limits are not in that function: they are linear there (`series_space`). Torque and clearance are, as barriers:
finite only where they hold at the samples.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..arrays import FloatArray
from .constraints import Requirements
from .criteria import CONDITION, PREDICTION, SCALED_CONDITION, Information, Question, smooth_criterion
from .descent import Function
from .segments import Motion
from .series_space import Basis, SeriesSpace
from .smooth_columns import SmoothColumns
from .trajectory import FourierTrajectory, draw_coefficients

SAMPLES_A_HARMONIC = 14
"""Samples a period on which the criterion is descended; the columns turn with sums of joint angles, not only once."""
TORQUE_BARRIER, CLEARANCE_BARRIER, CLEARANCE_REACH_M = 0.01, 0.01, 0.1
CLEARANCE_SAMPLES = 32
BARRIERS = ("torque", "clearance")
"""Kinds of margins (`constraints.Margin`) whose limits are barriers of the function."""
TESTS, TEST_SEED = 5, 20_000


@dataclass(frozen=True)
class Problem:
    """An excitation wanted.

    Attributes:
        question: What is to be known.
        needs: What the run must keep.
        criterion: One of `CRITERIA`, to be as small as can be.
        fundamental_hz: f0.
        harmonics: N_h.
        periods: How often the period is repeated.
        start: (n,) posture of rest before and after, rad.
        rest_s: How long it rests there, s.
    """

    question: Question
    needs: Requirements
    criterion: str
    fundamental_hz: float
    harmonics: int
    periods: int
    start: FloatArray
    rest_s: float = 1.0

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the n joints."""
        return self.needs.joints

    @cached_property
    def space(self) -> SeriesSpace:
        """The series there are."""
        return SeriesSpace(self.joints, self.needs.motion, self.fundamental_hz, self.harmonics)

    @cached_property
    def weights(self) -> FloatArray:
        """(n,) what a joint's rows count: nothing but one for condition numbers, as published."""
        if self.criterion in (CONDITION, SCALED_CONDITION):
            return np.ones(len(self.joints))
        return self.question.noise_Nm**-2.0

    @cached_property
    def tests(self) -> tuple[FourierTrajectory, ...]:
        """Random motions within the limits, the same for every method, on which predictions are judged."""
        rng = np.random.default_rng(TEST_SEED)
        made = (draw_coefficients(rng, self.needs.motion, 0.1, 5, (0.5, 0.95)) for _ in range(TESTS))
        return tuple(FourierTrajectory(self.joints, centre, a, b, 0.1, 1) for a, b, centre in made)

    @cached_property
    def test_information(self) -> tuple[Information, ...]:
        """Information matrices of the motions `tests`, on which every method's prediction error is computed."""
        times = np.arange(0.0, self.tests[0].period_s, 0.01)
        return tuple(self.question.information(test.evaluate(times), 100.0) for test in self.tests)

    def function(self, sharpness: float, softness: float, finer: int = 1, slopes: bool = True) -> Function:
        """The smooth criterion of a point with the barriers; infinite where torque or clearance is broken.

        Args:
            sharpness: p of the eigenvalues' p-norms, see `criteria.smooth_criterion`.
            softness: Speed over which the direction of motion changes, as a share of the velocity limit.
            finer: Multiple of the usual number of samples.
            slopes: Whether to compute the gradient. Without it the gradient is zero, at a third of the time.
        """
        samples = finer * SAMPLES_A_HARMONIC * max(self.harmonics, 4)
        basis = self.space.basis(samples)
        columns = SmoothColumns(self.question, softness * np.minimum(self.needs.motion.velocity, 1e3))
        criterion = smooth_criterion(self.criterion, sharpness, self._moment(columns))
        sparse = self.space.basis(finer * CLEARANCE_SAMPLES)

        def function(z: FloatArray) -> tuple[float, FloatArray]:
            motion = self.space.motion(z, basis)
            at = columns.at(self._with_led_back(motion), samples)
            barrier, by_torque = torque_barrier(at.torque, self.needs.torque_Nm, samples)
            if not np.isfinite(barrier):
                return barrier, np.zeros_like(z)
            nearness, by_posture = self._clearance(z, sparse, slopes)
            if not np.isfinite(nearness):
                return nearness, np.zeros_like(z)
            value, slope = criterion(at.information(self.weights))
            if not slopes:
                return value + barrier + nearness, np.zeros_like(z)
            gradient = self.space.gradient(self._folded(at.back(self.weights, slope, by_torque), samples), basis)
            if nearness > 0.0:
                nothing = np.zeros_like(by_posture)
                gradient += self.space.gradient(Motion(by_posture, nothing, nothing), sparse)
            return value + barrier + nearness, gradient

        return function

    def _with_led_back(self, motion: Motion) -> Motion:
        """The states of `motion`, then those with the largest of `needs.accelerations`, whose torque must be kept too.

        Those with the least are left to the check: torque lies between those of less and of more acceleration, and
        only gravity against inertia makes less of it the worse.
        """
        most = max(self.needs.accelerations)
        if most == 1.0:
            return motion
        q, qd, qdd = motion
        return Motion(np.vstack([q, q]), np.vstack([qd, qd]), np.vstack([qdd, most * qdd]))

    def _folded(self, by: Motion, samples: int) -> Motion:
        """Derivatives by the `samples` states planned, from those by the states of `_with_led_back`."""
        most = max(self.needs.accelerations)
        if most == 1.0:
            return by
        q, qd, qdd = (part.reshape(2, samples, -1) for part in by)
        return Motion(q.sum(axis=0), qd.sum(axis=0), qdd[0] + most * qdd[1])

    def _clearance(self, z: FloatArray, basis: Basis, slopes: bool) -> tuple[float, FloatArray]:
        postures = self.space.motion(z, basis).q
        if self.needs.clearance is None:
            return 0.0, np.zeros_like(postures)
        value, slope = self.needs.clearance.barrier(postures, CLEARANCE_REACH_M, slopes)
        weight = CLEARANCE_BARRIER / len(postures)
        return weight * value, weight * slope

    def _moment(self, columns: SmoothColumns) -> FloatArray | None:
        """V: the test motions' mean squared columns, each joint in units of its torque noise."""
        if self.criterion != PREDICTION:
            return None
        times = np.linspace(0.0, self.tests[0].period_s, 200, endpoint=False)
        moments = [columns.at(test.evaluate(times)).information(self.weights) for test in self.tests]
        return np.asarray(np.mean(moments, axis=0))

    @cached_property
    def home(self) -> FloatArray:
        """The point that rests in the start posture."""
        empty = np.zeros((len(self.joints), self.harmonics))
        return self.space.point(FourierTrajectory(self.joints, self.start, empty, empty, self.fundamental_hz, 1))


def torque_barrier(torque: FloatArray, limit: FloatArray, samples: int) -> tuple[float, FloatArray | None]:
    """Barrier on the torque, and its derivative.

    The value is `TORQUE_BARRIER` / `samples` times the sum of −log(1 − (torque/limit)²).

    Args:
        torque: (T, n) N·m.
        limit: (n,) N·m; infinite where there is none.
        samples: Number by which the sum is divided.

    Returns:
        The value, infinite where a limit is reached, and its derivative (T, n) by the torque. The derivative is None
        where there are no limits or the value is infinite.
    """
    bounded = np.isfinite(limit)
    if not bounded.any():
        return 0.0, None
    share = np.where(bounded, torque / np.where(bounded, limit, 1.0), 0.0)
    room = 1.0 - share**2
    if room.min() <= 0.0:
        return float("inf"), None
    scale = TORQUE_BARRIER / samples
    slope = np.where(bounded, 2 * share / room / np.where(bounded, limit, 1.0), 0.0)
    return -scale * float(np.log(room).sum()), scale * slope
