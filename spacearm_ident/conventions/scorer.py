"""`Scorer`: how well a `Setup` explains a recording: log-likelihood of torque and ranges, log prior of its changes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..arrays import FloatArray
from ..dynamics.arm import Arm
from .change import Change
from .evidence import (
    CAD_SCALES,
    GAIN_SD,
    OWN,
    Design,
    Evidence,
    Frame,
    Measured,
    mass_likelihood,
    predicted,
    rms,
    weigh,
)
from .plausible import Ranges
from .rows import Rows
from .setup import Setup, motion_of, torque_of

SCREEN_ROWS = 130
"""Rows of a first look."""
SCREEN_ITERATIONS = 3
"""Alternations of a first look."""
SURE, CHANCE = 7.0, 0.02
"""Log odds from which a change is a fact: `SURE`, and what explaining a share `CHANCE` of the residual's variance
gains. The residual is what the model leaves out: a change that is wrong explains a little of it (Panda: 2 %)."""

BUILT_UP = 1e-3
"""Share of Coulomb friction that is still to build up, past a reversal: after 35 mrad, seven `rows.PRESLIDING_RAD`."""


@dataclass(frozen=True)
class Scored:
    """A setup with its score: log-likelihood of data and ranges, and log prior of its changes."""

    changes: tuple[Change, ...]
    setup: Setup
    score: float
    evidence: Evidence


class Scorer:
    """Scores setups of one recording; motions once computed are kept.

    Attributes:
        counts: (n,) independent samples of each joint's torque.
        idle: Recorded columns that move in no more rows than a joint has columns of its own, which fit those exactly.
        dead: Those whose torque says nothing.
        base_held: Whether a sensor has shown that the base stands still.
    """

    def __init__(
        self,
        arm: Arm,
        rows: Rows,
        bonus: Callable[[Setup], float] = lambda setup: 0.0,
        dead: frozenset[int] = frozenset(),
        own: FloatArray | None = None,
        base_held: bool = False,
    ) -> None:
        """Take a recording.

        Args:
            arm: The arm.
            rows: Its motion and torque.
            bonus: What else a setup explains, as a log-likelihood.
            dead: Joints whose torque says nothing.
            own: (n, OWN) what is known of Coulomb, presliding, viscous, rotor inertia and offset; None: nothing.
            base_held: Whether a sensor has shown that the base stands still.
        """
        self.arm, self.rows, self.bonus = arm, rows, bonus
        self.ranges = Ranges(arm, rows)
        self.frame = Frame(arm, rms(rows.torque(np.zeros(len(arm.joints)))), own)
        self.base_held = base_held
        self._designs: list[tuple[Setup, Design]] = []
        self.counts = self._independent()
        self.idle = frozenset(np.flatnonzero(rows.moving.sum(axis=0) <= OWN).tolist()) - dead
        self.dead = dead

    @cached_property
    def _moving_frame(self) -> Frame:
        """The frame of a base that moves."""
        return Frame(self.arm, rms(self.rows.torque(np.zeros(len(self.arm.joints)))), self.frame.own, base_moves=True)

    @property
    def sure(self) -> float:
        """Log odds from which a change is taken for a fact."""
        return SURE - 0.5 * float(np.log1p(-CHANCE)) * float(self.counts.sum())

    def screen(self) -> Scorer:
        """The same on fewer rows, each of which counts for more."""
        few = copy(self)
        few.rows = self.rows.thinned(max(1, len(self.rows.time) // SCREEN_ROWS))
        few._designs = []
        return few

    def silent(self, setup: Setup) -> frozenset[int]:
        """Joints of the arm that move too little, or whose torque is constant, under a setup."""
        still = np.isin(setup.position_from, sorted(self.idle | self.dead))
        return frozenset(np.flatnonzero(still | np.isin(setup.effort_from, sorted(self.dead))).tolist())

    def where_all_move(self, columns: np.ndarray) -> Scorer:
        """A scorer on fewer rows: those of some recorded columns in which all of these columns move."""
        moving = self.rows.moving.copy()
        moving[:, columns] &= moving[:, columns].all(axis=1, keepdims=True)
        return self._where(moving)

    def past_reversals(self) -> Scorer:
        """A scorer without the rows in which a joint's friction has not built up since its velocity changed sign."""
        return self._where(self.rows.moving & (np.abs(self.rows.unbuilt) < BUILT_UP))

    def _where(self, moving: np.ndarray) -> Scorer:
        other, share = copy(self), moving.sum(axis=0) / np.maximum(self.rows.moving.sum(axis=0), 1)
        other.rows, other.counts, other._designs = replace(self.rows, moving=moving), self.counts * share, []
        return other

    def design(self, setup: Setup) -> Design:
        """Columns of a setup's motion."""
        for known, design in self._designs:
            if known.same_motion(setup):
                return design
        frame = self.frame if setup.free_base is None else self._moving_frame
        made = Design(frame, motion_of(self.rows, setup, self.arm))
        self._designs = [*self._designs[-5:], (setup, made)]
        return made

    def measured(self, setup: Setup) -> Measured:
        """Torque of a setup."""
        torque, counts = torque_of(self.rows, setup), self.counts[setup.effort_from]
        return Measured(torque, counts, setup.gain_sd, setup.common_gain_sd, setup.payload_kg)

    def _independent(self) -> FloatArray:
        """(n,) independent samples that each joint's torque counts for.

        The more of two: by what the arm as recorded leaves of the torque, and by what the CAD inertials' torque times
        any factor, and friction, leave of it. The second is the same whatever the sign, unit or gain of a joint, where
        the first is nearly all of the torque, as slow as the motion, and counts for a handful of samples.
        """
        setup = Setup.as_recorded(self.arm)
        counts = np.empty(len(self.arm.joints))
        self.counts = np.full(len(counts), len(self.rows.time) / 5.0)
        design, measured = self.design(setup), self.measured(setup)
        residual = measured.torque - predicted(design, weigh(design, measured))
        for j, rows in enumerate(design.motion.moving.T):
            alone = design.times_cad(j, np.where(rows, measured.torque[:, j], 0.0))[1]
            left = residual[rows, j], alone[rows]
            counts[j] = rows.sum() / min(rows_a_sample(one, measured.torque[rows, j]) for one in left)
        return np.maximum(counts, 2.0)

    def score(
        self, changes: Sequence[Change], setup: Setup, scales: Sequence[float] = CAD_SCALES, iterations: int = 8
    ) -> Scored:
        """Score a setup.

        Args:
            changes: Departures from the conventions that `setup` undoes; their log priors are added to the score.
            setup: Assignment, scale, offset and timing of the recorded columns, and gravity.
            scales: Relative standard deviations of the CAD inertials; the evidence is averaged over them.
            iterations: Alternations between parameters, gains and error size, for each scale. Three times as many are
                made where a gain is free.
        """
        design, measured = self.design(setup), self.measured(setup)
        if measured.common_gain_sd or measured.gain_sd.max() > GAIN_SD:
            iterations *= 3
        evidence = weigh(design, measured, scales, iterations)
        value = evidence.log_likelihood + self.ranges.log_likelihood(setup) + self.bonus(setup)
        # A torque in other units is another density: the change of variables.
        value += float(measured.counts @ np.log(np.abs(setup.effort_sign)))
        if scales is CAD_SCALES:
            value += mass_likelihood(design, evidence)
        return Scored(tuple(changes), setup, value + sum(change.log_prior for change in changes), evidence)


def rows_a_sample(residual: FloatArray, torque: FloatArray) -> float:
    """Rows that one independent sample of a residual (M,) stands for, at least 1.

    The larger of two: 1 plus twice its autocorrelations to the first zero; and its power spectral density where the
    torque has its power, over its mean. The second sees a slow model error under white noise.

    Args:
        residual: (M,) at even intervals, N·m.
        torque: (M,) what the residual is of, N·m.
    """
    n = len(residual)
    if n < 8 or not residual.any():
        return float(max(n, 1))
    power = np.abs(np.fft.rfft(residual - residual.mean(), 2 * n)) ** 2
    correlation = np.fft.irfft(power)[:n]
    ends = np.flatnonzero(correlation <= 0)
    slow = 1.0 + 2.0 * float(correlation[1 : int(ends[0]) if len(ends) else n].sum()) / float(correlation[0])
    weight = np.abs(np.fft.rfft(torque - torque.mean(), 2 * n)) ** 2
    band = float(power @ weight / max(weight.sum(), 1e-300) / power.mean())
    return float(max(1.0, slow, band))


def loaded_joints(scorer: Scorer, start: Scored) -> tuple[int, ...]:
    """Joints whose torque is gravity's enough to tell a gain from CAD inertias or a payload that are not known.

    Args:
        scorer: Scores, with the arm and what was recorded.
        start: The scored setup whose parameters are taken.

    Returns:
        Their numbers, in the arm's order.
    """
    design = scorer.design(start.setup)
    ratios = design.mass_ratios(start.evidence)
    return tuple(int(j) for j in np.flatnonzero(np.isfinite(ratios)))


def carried(scorer: Scorer, start: Scored) -> float:
    """The torque that carries the arm over that of its CAD masses: of the loaded joints the one nearest to 1.

    Args:
        scorer: Scores, with the arm and what was recorded.
        start: The scored setup whose parameters are taken.

    Returns:
        The factor; NaN where no joint is loaded, CAD is a placeholder, or joints are off in opposite ways.
    """
    design = scorer.design(start.setup)
    ratios = design.mass_ratios(start.evidence)
    ratios = ratios[np.isfinite(ratios)]
    if scorer.frame.rough or not len(ratios) or ratios.min() <= 0.0:
        return float("nan")
    logs = np.log(ratios)
    return float(np.exp(logs[np.argmin(np.abs(logs))])) if np.all(logs > 0.0) or np.all(logs < 0.0) else float("nan")
