"""`Problem`: an excitation wanted, and its criterion as a function of the series' coefficients.

Motion limits are not in that function: they are linear there (`series_space`). Torque and clearance are, as barriers:
finite only where they hold at the samples.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..dynamics.arm import FloatArray
from .constraints import Requirements
from .criteria import CONDITION, PREDICTION, SCALED_CONDITION, Question, smooth_criterion
from .descent import Function
from .segments import Motion
from .series_space import Basis, SeriesSpace
from .smooth_columns import SmoothColumns
from .trajectory import FourierTrajectory, draw_coefficients

SAMPLES_A_HARMONIC = 14
"""Samples a period on which the criterion is descended; the columns turn with sums of joint angles, not only once."""
TORQUE_BARRIER, CLEARANCE_BARRIER, CLEARANCE_REACH_M = 0.01, 0.01, 0.1
CLEARANCE_SAMPLES = 32
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

    def function(self, sharpness: float, softness: float, samples: int | None = None, slopes: bool = True) -> Function:
        """The smooth criterion of a point with the barriers; infinite where torque or clearance is broken.

        Without `slopes` the gradient is left zero, at a third of the time.
        """
        samples = samples or SAMPLES_A_HARMONIC * max(self.harmonics, 4)
        basis = self.space.basis(samples)
        columns = SmoothColumns(self.question, softness * np.minimum(self.needs.motion.velocity, 1e3))
        criterion = smooth_criterion(self.criterion, sharpness, self._moment(columns))
        sparse = self.space.basis(CLEARANCE_SAMPLES)

        def function(z: FloatArray) -> tuple[float, FloatArray]:
            motion = self.space.motion(z, basis)
            at = columns.at(motion)
            barrier, by_torque = torque_barrier(at.torque, self.needs.torque_Nm)
            led_back, back_by = self._led_back(columns, motion)
            barrier += led_back
            if not np.isfinite(barrier):
                return barrier, np.zeros_like(z)
            nearness, by_posture = self._clearance(z, sparse, slopes)
            if not np.isfinite(nearness):
                return nearness, np.zeros_like(z)
            value, slope = criterion(at.information(self.weights))
            if not slopes:
                return value + barrier + nearness, np.zeros_like(z)
            gradient = self.space.gradient(at.back(self.weights, slope, by_torque), basis)
            if back_by is not None:
                gradient += self.space.gradient(back_by(), basis)
            if nearness > 0.0:
                nothing = np.zeros_like(by_posture)
                gradient += self.space.gradient(Motion(by_posture, nothing, nothing), sparse)
            return value + barrier + nearness, gradient

        return function

    def _led_back(self, columns: SmoothColumns, motion: Motion) -> tuple[float, Callable[[], Motion] | None]:
        """The torque barrier of the largest of `needs.accelerations`, and its derivatives by the states.

        That of the least is left to the check: torque lies between those of less and of more acceleration, and only
        gravity against inertia makes less of it the worse.
        """
        most = max(self.needs.accelerations)
        if most == 1.0:
            return 0.0, None
        at = columns.at(Motion(motion.q, motion.qd, most * motion.qdd))
        barrier, by_torque = torque_barrier(at.torque, self.needs.torque_Nm)
        if by_torque is None or not np.isfinite(barrier):
            return barrier, None

        def back() -> Motion:
            none = np.zeros((columns.size, columns.size))
            by = at.back(self.weights, none, by_torque)
            return Motion(by.q, by.qd, most * by.qdd)

        return barrier, back

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


def torque_barrier(torque: FloatArray, limit: FloatArray) -> tuple[float, FloatArray | None]:
    """−log(1 − (torque/limit)²), mean over samples, and its derivative (T, n); None where there are no limits."""
    bounded = np.isfinite(limit)
    if not bounded.any():
        return 0.0, None
    share = np.where(bounded, torque / np.where(bounded, limit, 1.0), 0.0)
    room = 1.0 - share**2
    if room.min() <= 0.0:
        return float("inf"), None
    scale = TORQUE_BARRIER / len(torque)
    slope = np.where(bounded, 2 * share / room / np.where(bounded, limit, 1.0), 0.0)
    return -scale * float(np.log(room).sum()), scale * slope
