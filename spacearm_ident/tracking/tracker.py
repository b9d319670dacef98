"""`Tracker`: friction levels (and a payload, and alpha) followed on line, with standard errors and changes.

Everything but the followed parameters is held where it was identified. What is estimated is their departure x from
there, in the residual r = Phi x + noise of rows that a `RowStream` (or `rows_of`) makes; an `InformationFilter` keeps
it, joint by joint where nothing couples them, in one block with a payload. `InnovationNoise` weighs the rows by what
the innovations show, `ChangeWatch` looks for jumps: after one, the filter goes back to before it, gives up what it
knew of the parameters concerned, takes the rows since again and forgets faster for a while.

A node feeds it a block every now and then::

    stream, tracker = RowStream(tracked, 1000.0), Tracker(tracked)
    for rows in stream.add(time, position, effort, temperature):
        for change in tracker.add(rows):
            ...
    tracker.state()
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..dynamics.effects.body import MASS
from ..dynamics.model import IdentifiedModel
from .changes import Batch, ChangeWatch, Found
from .information_filter import InformationFilter, compress
from .innovation_noise import START_ROWS, InnovationNoise
from .layout import UNITS, Layout, TrackedValue
from .rows import Rows, TrackedModel

BATCH_S = 0.25
WINDOW_S = 10.0
SETTLING_BATCHES = 4
WATCH_AFTER_BATCHES = 12
"""Moving batches of a joint (3 s) before its innovations are believed enough to look for changes."""

LEARNT = 4.0


@dataclass(frozen=True)
class TrackingSettings:
    """What a user may decide.

    Attributes:
        memory_s: Moving time after which what was learned has faded to 1/e where as much is heard anew.
        fast_memory_s, fast_for_s: The same after a change or when a drift is seen, and for how much moving time.
        start_share: Standard deviation of a level before any data, as a share of its identified value.
        false_alarm: Probability of one test's false alarm; some hundred independent ones an hour and joint.
        smallest_share: Jumps below this share of a level are followed, not reported.
        noise_Nm: (n,) standard deviation of a row's noise, kept as it is; estimated where None.
    """

    memory_s: float = 60.0
    fast_memory_s: float = 10.0
    fast_for_s: float = 20.0
    start_share: float = 0.5
    false_alarm: float = 1e-10
    smallest_share: float = 0.05
    noise_Nm: FloatArray | None = None


@dataclass(frozen=True)
class TrackingState:
    """What a tracker knows: the time of its last row, its parameters, noise (n,) N·m and correlation (n,) rows."""

    time_s: float
    parameters: tuple[TrackedValue, ...]
    noise_Nm: FloatArray
    correlation_rows: FloatArray


@dataclass(frozen=True)
class Change:
    """A sudden change.

    Attributes:
        time_s: The row that first shows it; it happened after `earliest_s`, the joint's last row before.
        found_s: The row that made it sure.
        joint: Where; the last one for a payload.
        what: `f_c`, `f_b`, `k_v1`, `friction level` (f_c and f_b alike), `load` (a torque that does not turn with the
            direction of motion) or `payload`.
        size, standard_error, unit: How large; the mass for a payload.
        significance: In standard deviations.
        rivals: What else explains it about as well.
        values: All components of a payload.
    """

    time_s: float
    earliest_s: float
    found_s: float
    joint: str
    what: str
    size: float
    standard_error: float
    unit: str
    significance: float
    rivals: tuple[str, ...] = ()
    values: Mapping[str, float] = field(default_factory=dict)


class Tracker:
    """Follows the parameters of a `TrackedModel`.

    Args:
        tracked: What is followed.
        settings: Decisions of the user.
    """

    def __init__(self, tracked: TrackedModel, settings: TrackingSettings | None = None) -> None:
        self.tracked = tracked
        self.settings = settings or TrackingSettings()
        self._layout = Layout(tracked)
        self._start = self._layout.start_spread(self.settings.start_share)
        self.filters = InformationFilter(self._start)
        self._watch = ChangeWatch(
            self._layout.hypotheses(),
            round(WINDOW_S / BATCH_S),
            self.settings.false_alarm,
            self.settings.smallest_share,
        )
        self._noise: InnovationNoise | None = None
        self._waiting: list[Rows] = []
        self._early: list[list[tuple[FloatArray, FloatArray]]] = [[] for _ in tracked.joints]
        self._heard = np.zeros(len(tracked.joints), dtype=int)
        self._fast = np.zeros(len(self._start), dtype=int)
        self._past: deque[tuple[FloatArray, FloatArray]] = deque()
        self._changes: list[Change] = []
        self._time_s = float("nan")

    def add(self, rows: Rows) -> list[Change]:
        """Take rows in the order of time; returns the changes they made sure."""
        if not len(rows.time):
            return []
        if self._noise is None:
            unknown = np.full(len(self.tracked.joints), np.nan)
            given = self.settings.noise_Nm
            self._noise = InnovationNoise(unknown if given is None else given, rows.white)
        self._waiting.append(rows)
        whole = _joined(self._waiting)
        size = max(1, round(BATCH_S / rows.spacing_s))
        found: list[Change] = []
        full = len(whole.time) // size * size
        for first in range(0, full, size):
            found += self._batch(_part(whole, slice(first, first + size)))
        self._waiting = [_part(whole, slice(full, None))]
        self._changes += found
        return found

    def changes(self) -> tuple[Change, ...]:
        """All changes so far."""
        return tuple(self._changes)

    def state(self) -> TrackingState:
        """What is known now."""
        joints = len(self.tracked.joints)
        value, variance = self._known()
        if self._past:
            # Exponential weights lag behind a steady drift by what it does in one memory.
            before, variance_before = self._past[0]
            lag = np.maximum(0.0, (value - before) ** 2 - variance - variance_before)
            # Where it was still being learned then, it has not drifted since.
            variance = variance + np.where(variance_before < LEARNT * variance, lag, 0.0)
        error = np.sqrt(variance)
        noise = self._noise
        return TrackingState(
            self._time_s,
            self._layout.values(value, error, error < 0.5 * self._start),
            np.full(joints, np.nan) if noise is None else noise.sigma.copy(),
            np.full(joints, np.nan) if noise is None else noise.correlation.copy(),
        )

    def _known(self) -> tuple[FloatArray, FloatArray]:
        """(J, p) estimates and their variances."""
        return self.filters.estimate, np.einsum("jpp->jp", self.filters.covariance)

    def model(self) -> IdentifiedModel:
        """The identified model with the followed values in it (a load torque is no part of it)."""
        known = self.tracked.model
        tracked = {item.name: item for item in self.state().parameters}
        values = {name: item.value for name, item in tracked.items()}
        for joint in self.tracked.joints:
            level, static = tracked.get(f"f_c[{joint}]"), tracked.get(f"f_b[{joint}]")
            if level and static and not static.informed:
                # No slow motion has told of the static level: its excess over the Coulomb level stays.
                values[static.name] = static.identified + level.value - level.identified
        names = [parameter.name for parameter in known.model.parameters]
        parameters = [values.get(name, value) for name, value in zip(names, known.parameters)]
        return known.moved_to(np.array(parameters, dtype=float), known.constants)

    def _batch(self, rows: Rows) -> list[Change]:
        """Weigh, test, and take the rows of one batch."""
        assert self._noise is not None
        self._time_s = float(rows.time[-1])
        moving = rows.moving & np.isfinite(rows.residual)
        if not moving.any():
            return []
        phi = self._layout.rows(rows)
        estimate = self._layout.spread_out(self.filters.estimate)
        innovations = np.where(moving, rows.residual - np.einsum("mnp,np->mn", phi, estimate), np.nan)
        if self.settings.noise_Nm is None:
            late = self._begin(phi, rows.residual, moving)
            # The first innovations of a joint are what its levels have moved by since it was identified.
            self._noise.add(np.where(self._heard > SETTLING_BATCHES, innovations, np.nan))
        else:
            late = {}
        weight = moving / (self._noise.sigma * np.sqrt(self._noise.correlation))
        # A joint whose noise is not known yet keeps its rows back.
        weight = np.where(np.isfinite(weight), weight, 0.0)
        matrix, target = self._layout.blocks(phi * weight[:, :, None], rows.residual * weight, late)
        return self._take(rows, matrix, target, np.asarray((weight > 0).any(axis=0)))

    def _begin(
        self, phi: FloatArray, residual: FloatArray, moving: np.ndarray
    ) -> dict[int, tuple[FloatArray, FloatArray]]:
        """Keep rows of joints whose noise is not known back until there are enough; those rows, weighted, then."""
        assert self._noise is not None
        late = {}
        for joint in np.flatnonzero(~np.isfinite(self._noise.sigma)):
            mine = moving[:, joint]
            self._early[joint].append((phi[mine, joint], residual[mine, joint]))
            if sum(len(part) for _, part in self._early[joint]) < START_ROWS:
                continue
            matrix = np.concatenate([part for part, _ in self._early[joint]])
            target = np.concatenate([part for _, part in self._early[joint]])
            belief = np.diag(1.0 / self._layout.spread_out(self._start)[joint]) * 1e-3 * np.abs(target).max()
            fit = np.linalg.lstsq(
                np.concatenate([matrix, belief]), np.concatenate([target, np.zeros(len(belief))]), rcond=None
            )[0]
            self._noise.begin(int(joint), target - matrix @ fit, int(np.any(matrix, axis=0).sum()))
            weight = 1.0 / (self._noise.sigma[joint] * np.sqrt(self._noise.correlation[joint]))
            # The last of these rows belong to this batch, which brings them itself.
            kept = len(target) - int(mine.sum())
            late[int(joint)] = matrix[:kept] * weight, target[:kept] * weight
            self._early[joint].clear()
        return late

    def _take(self, rows: Rows, matrix: FloatArray, target: FloatArray, heard: np.ndarray) -> list[Change]:
        """Test one batch for a change, then let the filters have it."""
        matrix, target = compress(matrix, target)
        before = Batch(
            float(rows.time[0]),
            float(rows.time[-1]),
            self.filters.root,
            self.filters.side,
            matrix,
            target,
            heard & (self._heard >= WATCH_AFTER_BATCHES),
        )
        memory = np.where(self._fast > 0, self.settings.fast_memory_s, self.settings.memory_s)
        active = self._layout.of_blocks(heard)
        self.filters.add(matrix, target, len(rows.time) * rows.spacing_s / memory)
        self._fast = np.maximum(self._fast - active, 0)
        self._heard += heard
        if active.any():
            self._past.append(self._known())
            if len(self._past) > self.settings.memory_s / BATCH_S:
                self._past.popleft()
        if not before.heard.any():
            return []
        found = self._watch.add(before)
        if found is None:
            return []
        # After a change, and while the estimate lags behind a drift, the memory is short.
        self._fast[found.hypothesis.block] = round(self.settings.fast_for_s / BATCH_S)
        return [] if found.slow else [self._change(found)]

    def _change(self, found: Found) -> Change:
        """Deal with a change, and say what it was."""
        hypothesis = found.hypothesis
        earliest, latest = self._watch.times(found)
        self._watch.replay(found, self.filters, self._layout.loosened((hypothesis, *found.rivals)))
        self._watch.forget()
        self._past.clear()
        return Change(
            latest,
            earliest,
            self._time_s,
            self.tracked.joints[hypothesis.joint],
            hypothesis.what,
            float(found.jump[0]),
            float(found.errors[0]),
            UNITS.get(hypothesis.what, "N m"),
            found.significance,
            tuple(rival.what for rival in found.rivals),
            {s: float(v) for s, v in zip(MASS, found.jump)} if len(found.jump) > 1 else {},
        )


BY_ROW = ("time", "measured", "predicted", "own", "shared", "moving")
"""What of `Rows` has an entry a row."""


def _part(rows: Rows, part: slice) -> Rows:
    """Some of the rows."""
    return replace(rows, **{name: getattr(rows, name)[part] for name in BY_ROW})


def _joined(parts: list[Rows]) -> Rows:
    """Rows one after the other."""
    if len(parts) == 1:
        return parts[0]
    whole: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in BY_ROW}
    return replace(parts[-1], **whole)
