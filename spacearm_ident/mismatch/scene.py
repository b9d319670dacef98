"""`Scene`: recordings as whitened rows under a base model.

Every joint's rows of every motion go through that joint's whitening filter, torque and columns alike, and are stacked
joint by joint into one vector. After that all noise is white with variance one, and a sum of squares is a chi-square.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from ..arrays import FloatArray
from ..dynamics.background import Background
from ..dynamics.effects.effect import direction
from ..dynamics.model import IdentifiedModel
from ..dynamics.term import Columns
from ..signals.motion import Motion

COARSE_HZ = 250.0
"""Effects are computed at about this rate: far above the bandwidth, and several times faster than at 1 kHz."""


def coarse(motion: Motion, cutoff_hz: float, rate_hz: float = COARSE_HZ) -> Motion:
    """The motion averaged to a lower sampling rate, with another cut-off of its reduced rows.

    Args:
        motion: The motion at its full rate; a last incomplete group of samples is left out.
        cutoff_hz: Cut-off of the reduced rows, Hz.
        rate_hz: Lower bound of the new sampling rate, Hz; a slower motion keeps its rate.
    """
    step = max(1, int(motion.rate_hz / rate_hz))
    whole = len(motion.position) // step

    def mean(signal: FloatArray) -> FloatArray:
        return np.asarray(signal[: whole * step].reshape(whole, step, *signal.shape[1:]).mean(axis=1))

    rate = motion.rate_hz / step
    return replace(
        motion,
        rate_hz=rate,
        start_s=motion.start_s + 0.5 * (step - 1) / motion.rate_hz,
        position=mean(motion.position),
        velocity=mean(motion.velocity),
        acceleration=mean(motion.acceleration),
        torque=mean(motion.torque),
        temperature=None if motion.temperature is None else mean(motion.temperature),
        base=None if motion.base is None else motion.base.mapped(mean),
        block=1,
        cutoff_hz=cutoff_hz,
        stride=max(1, int(rate / (4 * cutoff_hz))),
    )


SLOW = (0.003, 0.006, 0.012, 0.025, 0.05)
"""rad/s. Below, what a joint does between stick and slip is not all in the recorded position: rows count for less,
as the reference shows."""
NEAR = (2e-4, 5e-4, 1e-3, 2e-3, 5e-3)
"""rad since the last reversal. There friction builds up by no law known to the last N m: rows count for less too."""
ALIKE = 4.0
"""Rows that what all joints show together is worth: a joint may have none as slow or as near a reversal."""
LARGEST_ROOT = 0.995
"""Of an autoregressive model: noise that remembers two hundred rows is a base model's error, and has no variance."""
FEWEST_ROWS = 40
"""Rows below which a joint's noise is not known: a standard deviation from so many independent ones has an error of a
tenth, 1/sqrt(2 N). At 80 rows a second it is half a second of motion."""
OUTLIER = 6.0
"""Robust standard deviations beyond which a residual does not say what the noise is like."""
ONE_WAY = 0.98
"""A row counts if this share of what went into it moves one way. Half a millisecond's error in when a joint turns
round moves all of its friction by so much: no row with a reversal in it is known as well as the others are."""


def travel(motion: Motion) -> FloatArray:
    """(M, n) rad that each joint went since it last turned round or stood still."""
    return motion.reduce(np.stack([since_reversal(motion, row) for row in range(len(motion.joints))], axis=1))


def since_reversal(motion: Motion, row: int) -> FloatArray:
    """(N,) rad that one joint went since it last turned round or stood still.

    Args:
        motion: N samples at full rate.
        row: Number of the joint.
    """
    sign = direction(motion, row)
    path = np.cumsum(np.abs(motion.velocity[:, row])) / motion.rate_hz
    turned = np.concatenate([[True], sign[1:] != sign[:-1]])
    return np.asarray(path - np.maximum.accumulate(np.where(turned, path, 0.0)))


def one_way(motion: Motion) -> np.ndarray:
    """(M, n) rows that are free of standstill and reversal, and count."""
    signs = np.stack([direction(motion, row) for row in range(len(motion.joints))], axis=1)
    void = np.zeros(len(motion.time), dtype=bool)
    for begin_s, end_s in motion.void:
        void |= (motion.time >= begin_s) & (motion.time < end_s)
    return motion.moving & (np.abs(motion.reduce(signs)) > ONE_WAY) & ~void[:, None]


def quiet(motion: Motion) -> Motion:
    """The motion with accelerations of the band alone.

    An effect may be a derivative of what the rest of the model says, in which noise grows, and noise in a column makes
    its value too small (errors in variables).
    """
    return replace(motion, acceleration=motion.smoothed(motion.acceleration, motion.cutoff_hz))


@dataclass(frozen=True)
class Whitener:
    """An autoregressive model of one joint's noise: e_t = sum a_k e_(t-k) + sigma w_t.

    Attributes:
        coefficients: (p,) a.
        sigma_Nm: Standard deviation of what drives it, N·m; infinite where the reference does not tell: the joint's
            rows do not count then.
        inflation: (s + 1, d + 1) variance inflation factor by speed (bounds `SLOW`) and by distance from a velocity
            reversal (bounds `NEAR`): 1 at the last, not decreasing towards lower speeds and smaller distances.
    """

    coefficients: FloatArray
    sigma_Nm: float
    inflation: FloatArray = field(default_factory=lambda: np.ones((len(SLOW) + 1, len(NEAR) + 1)))

    @property
    def order(self) -> int:
        """P."""
        return len(self.coefficients)

    @cached_property
    def predictors(self) -> list[tuple[FloatArray, float]]:
        """Best prediction from 0, 1, ... p rows before: coefficients, and standard deviation of its error, N·m.

        The Levinson recursion backwards (Brockwell and Davis 1991, §5.2).
        """
        own, sigma = self.coefficients, self.sigma_Nm
        steps = [(own, sigma)]
        while len(own):
            last = float(own[-1])
            remaining = 1.0 - last**2
            own = (own[:-1] + last * own[-2::-1]) / remaining
            sigma = sigma / np.sqrt(remaining)
            steps.append((own, sigma))
        return steps[::-1]

    def matrix(self, before: np.ndarray) -> csr_array:
        """(r, M) what makes white rows of M rows, those that count.

        Args:
            before: (M,) how many rows before each belong to the same stretch, -1 where it does not count; a stretch
                begins unpredicted.
        """
        lags = np.arange(self.order + 1)
        predictors = np.zeros((self.order + 1, self.order + 1))
        for known, (coefficients, sigma) in enumerate(self.predictors):
            predictors[known, : known + 1] = np.array([1.0, *-coefficients]) / sigma
        place = np.flatnonzero(before >= 0)
        known = np.minimum(before[place], self.order)
        used = lags <= known[:, None]
        starts = np.concatenate([[0], np.cumsum(known + 1)])
        return csr_array((predictors[known][used], (place[:, None] - lags)[used], starts), (len(place), len(before)))

    def weight(self, speed: FloatArray, gone: FloatArray) -> FloatArray:
        """(M,) what rows at these speeds, rad/s, so far from a reversal, rad, count for.

        Args:
            speed: (M,).
            gone: (M,).
        """
        return np.asarray(1.0 / np.sqrt(self.inflation[_cell(speed, gone)]))


def stretch(sound: np.ndarray) -> np.ndarray:
    """(M,) number of sound rows without interruption before each sound one (M,); -1 where it is not sound."""
    place = np.arange(len(sound))
    return np.where(sound, place - np.maximum.accumulate(np.where(sound, -1, place)) - 1, -1)


class Scene:
    """Motions under a base model, whitened.

    Attributes:
        motions: What was recorded.
        backgrounds: What the base model says of each.
        joint: (R,) joint of each stacked row.
        owner: (R,) motion of each stacked row.
        place: (R,) row within its motion.
        speed: (R,) rad/s of the joint there.
        gone: (R,) rad since the joint's last reversal.
        weight: (R,) what the row counts for.
        sound: By motion, (M, n) rows that count.
    """

    def __init__(
        self,
        base: IdentifiedModel,
        motions: Sequence[Motion],
        whiteners: Sequence[Whitener],
        backgrounds: Sequence[Background] | None = None,
    ) -> None:
        """Stack motions; their backgrounds may be known from another scene of the same ones."""
        self.motions = list(motions)
        self.whiteners = list(whiteners)
        self.model = model = base.model
        self.backgrounds: list[Background] = list(
            backgrounds or (model.background(quiet(motion), base.parameters, base.constants) for motion in self.motions)
        )
        known = np.array([np.isfinite(whitener.sigma_Nm) for whitener in whiteners])
        self.sound = [one_way(motion) & known for motion in self.motions]
        self._whitening = [
            [own.matrix(stretch(sound[:, j])) for sound in self.sound] for j, own in enumerate(whiteners)
        ]
        joint, owner, place = [], [], []
        for j in range(len(whiteners)):
            for m, sound in enumerate(self.sound):
                where = np.flatnonzero(sound[:, j])
                joint.append(np.full(len(where), j))
                owner.append(np.full(len(where), m))
                place.append(where)
        self.joint, self.owner, self.place = (np.concatenate(parts) for parts in (joint, owner, place))
        self._travel = [travel(motion) for motion in self.motions]
        self._starts = np.concatenate([[0], np.cumsum([len(part) for part in joint])])
        self.speed, self.gone = (
            self.stacked_rows(by) for by in ([motion.velocity_rows for motion in self.motions], self._travel)
        )
        self.weight = self._weight()

    def stacked_rows(self, by: Sequence[FloatArray]) -> FloatArray:
        """(R,) what a signal of the joints is at each stacked row.

        Args:
            by: By motion, (M, n) at its rows.
        """
        joints = range(len(self.whiteners))
        return np.concatenate([by[m][self.place[self.slot(j, m)], j] for j in joints for m in range(len(by))])

    def _weight(self) -> FloatArray:
        """(R,) what each row counts for."""
        own = (self.joint == j for j in range(len(self.whiteners)))
        return np.concatenate([w.weight(self.speed[rows], self.gone[rows]) for w, rows in zip(self.whiteners, own)])

    def reweighted(self, whiteners: Sequence[Whitener]) -> Scene:
        """The same rows under whiteners that differ from its own in their inflation alone."""
        other = copy(self)
        other.whiteners = list(whiteners)
        other.weight = other._weight()
        return other

    def __len__(self) -> int:
        return len(self.joint)

    @property
    def temperatures_known(self) -> bool:
        """Whether the temperature of every joint was recorded throughout."""
        return len(self.warm_joints) == len(self.motions[0].joints)

    @property
    def warm_joints(self) -> frozenset[str]:
        """Joints whose temperature was recorded throughout."""
        measured = [motion.temperature for motion in self.motions]
        return frozenset(
            joint
            for k, joint in enumerate(self.motions[0].joints)
            if all(signal is not None and bool(np.isfinite(signal[:, k]).all()) for signal in measured)
        )

    def part(self, count: int) -> np.ndarray:
        """(R,) the part of the time, out of so many equal ones, in which each stacked row is."""
        lengths = [len(sound) for sound in self.sound]
        begins = np.concatenate([[0], np.cumsum(lengths)])
        return np.asarray(count * (begins[self.owner] + self.place) // begins[-1])

    def by_joint(self, values: FloatArray) -> FloatArray:
        """(n,) sums of stacked values (R,) by joint."""
        return np.asarray(np.bincount(self.joint, weights=values, minlength=len(self.whiteners)), dtype=float)

    def slot(self, joint: int, motion: int) -> slice:
        """Where the rows of one joint in one motion are in the stack.

        Args:
            joint: Its number.
            motion: Its number.
        """
        number = joint * len(self.motions) + motion
        return slice(int(self._starts[number]), int(self._starts[number + 1]))

    def rows_of(self, first: int, last: int) -> slice:
        """Where the rows of the joints `first` to `last` are in the stack.

        Args:
            first: Number of a joint.
            last: Number of a joint, which is among them.
        """
        count = len(self.motions)
        return slice(int(self._starts[first * count]), int(self._starts[(last + 1) * count]))

    def whiten(self, joint: int, motion: int, rows: FloatArray) -> FloatArray:
        """Whiten and weight the rows of one joint in one motion.

        Args:
            joint: Index of the joint.
            motion: Index of the motion.
            rows: (M, k) rows reduced to the bandwidth, N·m or columns of a regressor.

        Returns:
            (r, k) whitened rows of those that count, as in `slot(joint, motion)`.
        """
        return np.asarray(self._whitening[joint][motion] @ rows * self.weight[self.slot(joint, motion), None])

    def torque(self) -> FloatArray:
        """(R,) measured torque."""
        stacked = np.empty(len(self))
        for j in range(len(self.whiteners)):
            for m, motion in enumerate(self.motions):
                stacked[self.slot(j, m)] = self.whiten(j, m, motion.torque_rows[:, [j]])[:, 0]
        return stacked

    def set_high_orders(self, parameters: FloatArray) -> None:
        """Friction terms of second and third order as these base parameters (p,) have them, for what removes them."""
        for motion, background in zip(self.motions, self.backgrounds):
            background.with_high_orders(self.model.high_orders(motion, parameters))

    def stack(self, columns: Sequence[Columns], count: int) -> FloatArray:
        """(R, count) stacked rows of full-rate columns, given motion by motion.

        Args:
            columns: Of each motion: joint -> numbers of the columns, and their values (N, k).
            count: Number of all columns.
        """
        stacked = np.zeros((len(self), count))
        self.fill(stacked, columns)
        return stacked

    def fill(self, stacked: FloatArray, columns: Sequence[Columns]) -> None:
        """Add the rows of full-rate columns, as `stack` has them, to those of a stack (R, count)."""
        for m, (motion, rows) in enumerate(zip(self.motions, columns)):
            for j, (indices, values) in rows.items():
                if values.any():
                    block = stacked[self.slot(j, m)]
                    block[:, indices] += self.whiten(j, m, motion.reduce(values))


def fit_whitener(residuals: Sequence[FloatArray], moving: Sequence[np.ndarray], order: int, floor: float) -> Whitener:
    """The autoregressive model of a residual, by least squares over uninterrupted rows.

    Where fewer than `FEWEST_ROWS` count, its sigma is infinite.

    Args:
        residuals: (M,) one joint's reduced residual, motion by motion, N·m.
        moving: (M,) rows that count.
        order: Lags; fewer where there are too few rows.
        floor: Smallest sigma, N·m.
    """
    if sum(int(kept.sum()) for kept in moving) < FEWEST_ROWS:
        return Whitener(np.zeros(0), float("inf"))
    while order > 0:
        past, now = [], []
        for residual, kept in zip(residuals, moving):
            whole = stretch(kept)[order:] >= order
            lags = np.stack([residual[order - k : len(residual) - k] for k in range(1, order + 1)], axis=1)
            past.append(lags[whole])
            now.append(residual[order:][whole])
        columns, target = np.concatenate(past), np.concatenate(now)
        if len(target) > 8 * order:
            # Outliers (a contact, a lost sample, a reversal) are not to define the noise, nor to be its past.
            within = OUTLIER * 1.4826 * np.median(np.abs(target)) + floor
            sound = np.all(np.abs(np.column_stack([target, columns])) < within, axis=1)
            coefficients = stable(
                np.asarray(np.linalg.lstsq(columns[sound], target[sound], rcond=None)[0], dtype=float)
            )
            error = target[sound] - columns[sound] @ coefficients
            return Whitener(coefficients, max(float(np.sqrt(np.mean(error**2))), floor))
        order //= 2
    usable = np.concatenate([residual[kept] for residual, kept in zip(residuals, moving)])
    return Whitener(np.zeros(0), max(float(np.sqrt(np.mean(usable**2))), floor))


def stable(coefficients: FloatArray) -> FloatArray:
    """Autoregressive coefficients (p,) with no root near the unit circle or outside, moved in as little as need be."""
    roots = np.abs(np.roots([1.0, *-coefficients])) if len(coefficients) else np.zeros(0)
    shrink = min(1.0, LARGEST_ROOT / max(float(roots.max(initial=0.0)), 1e-9))
    return np.asarray(coefficients * shrink ** np.arange(1, len(coefficients) + 1))


def inflated(whiteners: Sequence[Whitener], scene: Scene, residual: FloatArray) -> list[Whitener]:
    """Whiteners whose variance at low speed and near a reversal is estimated from a residual.

    Args:
        whiteners: One for each of the n joints.
        scene: Rows that were weighted by these whiteners.
        residual: (R,) residual in the rows of `scene`; only ratios within a joint matter.

    Returns:
        (n,) whiteners with the factors `inflation`, and the same filters.
    """
    shape = len(whiteners), len(SLOW) + 1, len(NEAR) + 1
    total, count = np.zeros(shape), np.zeros(shape)
    where = scene.joint, *_cell(scene.speed, scene.gone)
    np.add.at(total, where, (residual / scene.weight) ** 2)
    np.add.at(count, where, 1.0)
    usual = total[:, -1, -1] / np.maximum(count[:, -1, -1], 1.0)
    total /= np.where(usual > 0.0, usual, 1.0)[:, None, None]
    together = _inflation(total.sum(axis=0), count.sum(axis=0), np.ones(shape[1:]))
    own = (_inflation(total[j], count[j], together) for j in range(len(whiteners)))
    return [replace(whitener, inflation=inflation) for whitener, inflation in zip(whiteners, own)]


def _inflation(total: FloatArray, count: FloatArray, likely: FloatArray) -> FloatArray:
    """Mean squares by cell, no less the slower and the nearer a reversal; what is likely counts as `ALIKE` rows."""
    inflation = np.ones_like(total)
    for row, column in reversed(list(np.ndindex(*total.shape))):
        beyond = float(inflation[row:, column:].max())
        prior = ALIKE * max(beyond, float(likely[row, column]))
        inflation[row, column] = max(beyond, float((total[row, column] + prior) / (count[row, column] + ALIKE)))
    return inflation


def _cell(speed: FloatArray, gone: FloatArray) -> tuple[np.ndarray, np.ndarray]:
    """Where rows of these speeds, rad/s, so far from a reversal, rad, are among `SLOW` and `NEAR`: (M,) each."""
    return np.searchsorted(SLOW, np.abs(speed)), np.searchsorted(NEAR, gone)
