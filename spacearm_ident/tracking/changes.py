"""`ChangeWatch`: did something change within the last seconds, what, and when.

A generalised likelihood ratio test (Willsky and Jones 1976; Basseville and Nikiforov 1993, ch. 7) over the recent
batches. For each moment t0 of the window, what was known before it (information L0, estimate x0) predicts the rows
since (information G, score s). A jump by H d at t0, d ~ N(0, D), would show in the score left when everything may also
be what it was thought to be,

    u = (I - G (L0 + G)^-1) (s - G x0),      F = G - G (L0 + G)^-1 G,
    T = (H'u)' (H'F H + D^-1)^-1 (H'u)        ~ chi^2 (dim d) without a jump,

so that ignorance before t0 (a joint that has hardly moved, an estimate just loosened) is not taken for a change since.
Rows come weighted by 1/(sigma^2 kappa), which makes slow residuals count for no more than they say. The hypothesis and
the t0 that are least probable by chance are the finding; it must be so improbable (`false_alarm`), must not be
smaller than is worth a word, and is believed only when the next batches do not take it back. A finding that points to
the oldest part of a full window has taken long to show: that is the lag behind a drift, no jump.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln, ndtri_exp
from scipy.stats import chi2

from ..arrays import FloatArray
from .information_filter import InformationFilter

CONFIRM_BATCHES = 2
OLDEST_SHARE = 0.25
BEYOND = 500.0
TIE = 1e-6
AMBIGUOUS = 6.0
"""A rival whose likelihood ratio is within so much of the best is named with it."""


@dataclass(frozen=True)
class Hypothesis:
    """One way to change.

    Attributes:
        what: In words, such as `f_c`.
        joint: Index.
        block: Which filter.
        basis: (p, d) direction of the jump in the filter's unknowns.
        spread: (d,) how large a jump may well be.
    """

    what: str
    joint: int
    block: int
    basis: FloatArray
    spread: FloatArray


@dataclass(frozen=True)
class Batch:
    """Rows of a short time, compressed, and what was known before them.

    Attributes:
        start_s, stop_s: First and last row.
        root, side: The filters before these rows.
        rows, target: (J, r, p), (J, r) in units of their noise.
        heard: (n,) joints that have a row here.
    """

    start_s: float
    stop_s: float
    root: FloatArray
    side: FloatArray
    rows: FloatArray
    target: FloatArray
    heard: np.ndarray


@dataclass(frozen=True)
class Found:
    """What the test found: hypothesis, place in the window, jump and its errors, log of its p-value, rivals.

    `slow`: it began before the oldest part of the window ended, and took so long to show: a drift, not a jump.
    """

    hypothesis: Hypothesis
    place: int
    jump: FloatArray
    errors: FloatArray
    log_p: float
    rivals: tuple[Hypothesis, ...]
    slow: bool

    @property
    def significance(self) -> float:
        """In standard deviations of a normal variable, two-sided."""
        return float(-ndtri_exp(self.log_p - np.log(2.0)))


class ChangeWatch:
    """Watches the recent batches for a jump.

    Args:
        hypotheses: What may change.
        batches: Length of the window.
        false_alarm: Largest probability by chance that one hypothesis at one moment may have.
        smallest: Least jump worth a word, as a share of the hypothesis' `spread`.
    """

    def __init__(self, hypotheses: Sequence[Hypothesis], batches: int, false_alarm: float, smallest: float) -> None:
        self._hypotheses = tuple(hypotheses)
        self._smallest = smallest
        self._log_alarm = float(np.log(false_alarm))
        self.window: deque[Batch] = deque(maxlen=batches)
        self._suspected = 0
        self._freedom = np.array([len(hypothesis.spread) for hypothesis in self._hypotheses])
        single = np.flatnonzero(self._freedom == 1)
        lone = [self._hypotheses[k] for k in single]
        self._singles = (
            single,
            np.array([hypothesis.block for hypothesis in lone]),
            np.stack([hypothesis.basis[:, 0] for hypothesis in lone]),
            np.array([hypothesis.spread[0] ** -2.0 for hypothesis in lone]),
        )

    def add(self, batch: Batch) -> Found | None:
        """Take a batch; a change, once it is sure (or a drift, `Found.slow`, which is none)."""
        self.window.append(batch)
        found = self._test()
        if found is None or np.abs(found.jump / found.hypothesis.spread).max() < self._smallest:
            self._suspected = 0
            return None
        if found.slow:
            return found
        if batch.heard[found.hypothesis.joint]:
            self._suspected += 1
        return found if self._suspected > CONFIRM_BATCHES else None

    def forget(self) -> None:
        """Begin anew after a change has been dealt with."""
        self.window.clear()
        self._suspected = 0

    def _test(self) -> Found | None:
        everywhere = np.arange(len(self.window))
        ratios = self._ratios(*self._scores(everywhere, everywhere))
        places = ratios.argmax(axis=0)
        log_p = _log_chance(ratios.max(axis=0), self._freedom)
        place, least = int(places[np.argmin(log_p)]), float(log_p.min())
        if least > self._log_alarm:
            return None
        # What it is, and how large, only rows say that are clearly before or after.
        free, fisher = self._scores(*(np.array([number]) for number in self._around(place)))
        sure = _log_chance(self._ratios(free, fisher)[0], self._freedom)
        # Until a joint reverses, friction and load are the same to the last digit: the first named it is.
        number = int(np.flatnonzero(sure < sure.min() + TIE)[0])
        winner = self._hypotheses[number]
        covariance = np.linalg.inv(self._precision(winner, fisher[0]))
        jump = covariance @ winner.basis.T @ free[0, winner.block]
        rivals = tuple(
            rival
            for k, rival in enumerate(self._hypotheses)
            if k != number and rival.joint == winner.joint and sure[k] < sure[number] + 0.5 * AMBIGUOUS
        )
        full = len(self.window) == self.window.maxlen
        slow = full and place < OLDEST_SHARE * len(self.window)
        return Found(winner, place, jump, np.sqrt(np.diag(covariance)), min(least, sure[number]), rivals, slow)

    def _around(self, place: int) -> tuple[int, int]:
        """Batches that are before and after a jump at `place` for sure: it falls within one, or its neighbour."""
        return max(place - 1, 0), min(place + 1, len(self.window) - 1)

    def _scores(self, known: np.ndarray, since: np.ndarray) -> tuple[FloatArray, FloatArray]:
        """What batches from `since` on say beyond what was known before `known`: u (W, J, p) and F (W, J, p, p)."""
        batches = list(self.window)
        root = np.stack([batches[k].root for k in known])
        side = np.stack([batches[k].side for k in known])
        before = np.linalg.solve(root, side[..., None])
        own = np.stack([batch.rows.transpose(0, 2, 1) @ batch.rows for batch in batches])
        told = np.stack([np.einsum("jrp,jr->jp", batch.rows, batch.target) for batch in batches])
        gained = np.cumsum(own[::-1], axis=0)[::-1][since]
        left = np.cumsum(told[::-1], axis=0)[::-1][since] - (gained @ before)[..., 0]
        share = np.linalg.solve(root.transpose(0, 1, 3, 2) @ root + gained, gained)
        return left - np.einsum("wjpq,wjp->wjq", share, left), gained - gained @ share

    @staticmethod
    def _precision(hypothesis: Hypothesis, fisher: FloatArray) -> FloatArray:
        """(..., d, d) information about the jump, from Fisher information (..., J, p, p)."""
        inside = hypothesis.basis.T @ fisher[..., hypothesis.block, :, :] @ hypothesis.basis
        return np.asarray(inside + np.diag(hypothesis.spread**-2.0))

    def _ratios(self, free: FloatArray, fisher: FloatArray) -> FloatArray:
        """(W, h) the statistic T of every hypothesis, for a jump before each batch of the window."""
        ratios = np.empty((len(free), len(self._hypotheses)))
        single, blocks, bases, least = self._singles
        pull = np.einsum("whp,hp->wh", free[:, blocks], bases)
        inside = np.einsum("whp,hp->wh", (fisher[:, blocks] @ bases[:, :, None])[..., 0], bases)
        ratios[:, single] = pull**2 / (inside + least)
        for k in np.flatnonzero(self._freedom > 1):
            hypothesis = self._hypotheses[k]
            pulls = free[:, hypothesis.block] @ hypothesis.basis
            solved = np.linalg.solve(self._precision(hypothesis, fisher), pulls[..., None])[..., 0]
            ratios[:, k] = np.einsum("wd,wd->w", pulls, solved)
        return ratios

    def times(self, found: Found) -> tuple[float, float]:
        """(earliest, latest) moment of the change: between two rows of its joint."""
        joint, batches = found.hypothesis.joint, list(self.window)
        latest = next((b.start_s for b in batches[found.place :] if b.heard[joint]), batches[-1].stop_s)
        earliest = next((b.stop_s for b in batches[: found.place][::-1] if b.heard[joint]), batches[0].start_s)
        return min(earliest, latest), latest

    def replay(self, found: Found, filters: InformationFilter, spread: FloatArray) -> None:
        """Put the filters back to before the change, loosen them, and take the rows since.

        Args:
            found: The change, within the present window.
            filters: The J filters; changed in place.
            spread: (J, p) standard deviation that is added to each unknown, in its unit.
        """
        batches = list(self.window)
        known, since = self._around(found.place)
        filters.root, filters.side = batches[known].root.copy(), batches[known].side.copy()
        filters.loosen(spread)
        for batch in batches[since:]:
            filters.add(batch.rows, batch.target, np.zeros(len(filters.side)))


def _log_chance(ratio: FloatArray, freedom: np.ndarray) -> FloatArray:
    """Log of the probability that chi^2 exceeds `ratio`; by its asymptote where scipy's underflows."""
    half = 0.5 * np.maximum(ratio, BEYOND)
    far = -half + (0.5 * freedom - 1.0) * np.log(half) - gammaln(0.5 * freedom)
    return np.asarray(np.where(ratio < BEYOND, chi2.logsf(np.minimum(ratio, BEYOND), freedom), far))
