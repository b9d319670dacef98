"""Columns of the base model and of effects in a scene, whitened.

Before either is compared: what reversals do to friction stands beside the base model as a nuisance.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..dynamics.effects.effect import Effect, direction
from ..dynamics.friction import bristle_state
from ..dynamics.model import IdentifiedModel
from ..dynamics.term import Columns, Values
from ..signals.motion import Motion
from .scene import Scene

SHARP_DISTANCE = 2e-4
SHARP_SPEEDS = (2e-3, 8e-3, 0.025, 0.08)
"""How friction runs through a reversal is a nuisance, not a discovery: a short presliding distance, rad, and bells of
speed, rad/s, that make up any even curve there. What they are is the same in reference and field."""
NUISANCE = 1 + len(SHARP_SPEEDS)
"""Columns a joint."""

AT_ONCE = 32
"""Values of an effect's constants whose columns are computed together: of a minute of seven joints they take 30 MB."""

SHARP_SHARE, SHARP_LEAST = 0.5, 1e-3
"""Standard deviation of a nuisance parameter before the data: a share of the joint's Coulomb friction, whose way
through a reversal it describes, and no less than so much, N·m. Without it a few rows carry any value."""


@dataclass(frozen=True)
class Stacked:
    """An effect's whitened columns in a scene; zero outside some joints' rows.

    Attributes:
        rows: Where in the stack; of an event, whose rows lie apart, their numbers.
        kept: (r, k) the columns, in single precision where they are many.
    """

    rows: slice | np.ndarray
    kept: np.ndarray

    @property
    def columns(self) -> FloatArray:
        """(r, k), always in double precision: of what is left of them a millionth may count."""
        return np.asarray(self.kept, dtype=float)

    def rounded(self) -> Stacked:
        """The same of columns rounded to single precision, in half the memory."""
        return Stacked(self.rows, self.kept.astype(np.float32))

    def times(self, factors: FloatArray) -> Stacked:
        """The same, each row times its factor, in the precision that it has.

        Args:
            factors: (F,) of all rows of the stack.
        """
        return Stacked(self.rows, (self.kept * factors[self.rows, None]).astype(self.kept.dtype))

    @property
    def stop(self) -> int:
        """The row after the last."""
        if isinstance(self.rows, slice):
            return int(self.rows.stop)
        return int(self.rows[-1]) + 1 if len(self.rows) else 0

    def whole(self, count: int) -> FloatArray:
        """(count, k) the columns in all rows of a stack."""
        everywhere = np.zeros((count, self.kept.shape[1]))
        everywhere[self.rows] = self.kept
        return everywhere

    def inner(self, other: Stacked) -> FloatArray:
        """(k, l) inner products of the columns with another's."""
        first, second = self.rows, other.rows
        if isinstance(first, slice) and isinstance(second, slice):
            begin, end = max(first.start, second.start), min(first.stop, second.stop)
            if end <= begin:
                return np.zeros((self.kept.shape[1], other.kept.shape[1]))
            mine, theirs = (
                slice(begin - first.start, end - first.start),
                slice(begin - second.start, end - second.start),
            )
            return _products(self.kept[mine], other.kept[theirs])
        if isinstance(second, slice):
            return other.inner(self).T
        if isinstance(first, slice):
            inside = (second >= first.start) & (second < first.stop)
            return _products(self.kept[second[inside] - first.start], other.kept[inside])
        _, here, there = np.intersect1d(first, second, assume_unique=True, return_indices=True)
        return _products(self.kept[here], other.kept[there])


def _products(first: np.ndarray, second: np.ndarray) -> FloatArray:
    """(k, l) inner products of columns (r, k) and (r, l), summed in double precision."""
    return np.asarray(np.asarray(first, dtype=float).T @ np.asarray(second, dtype=float))


def stacked_effect(scene: Scene, effect: Effect, constants: Values) -> Stacked:
    """Whitened columns of an effect in a scene.

    Args:
        scene: Rows to compute them in.
        effect: The effect.
        constants: (c,) values of its constants.

    Returns:
        Columns in the rows from the first to the last joint it acts at; of an event, only in the rows that it changes.
    """
    return _stacked_effects(scene, effect, [constants])[0]


def stacked_effects(scene: Scene, effect: Effect, points: Sequence[Values]) -> list[Stacked]:
    """The same at many values of its constants, some at once: of the low-pass many columns cost little more than one.

    Args:
        scene: Rows to compute them in.
        effect: The effect.
        points: (c,) values of its constants each.

    Returns:
        Their columns, rounded: what is computed of them later is exact for the columns that are kept.
    """
    made: list[Stacked] = []
    for first in range(0, len(points), AT_ONCE):
        made += [one.rounded() for one in _stacked_effects(scene, effect, points[first : first + AT_ONCE])]
    return made


def _stacked_effects(scene: Scene, effect: Effect, points: Sequence[Values]) -> list[Stacked]:
    here = [m for m, motion in enumerate(scene.motions) if not effect.elsewhere(motion)] or [0]
    if effect.event:
        # A second or two of a minute: the rest would take most of the time and the memory that a search has.
        made = ([piece for m in here for piece in _pieces(scene, effect, [point], m)] for point in points)
        return [_where_it_acts(pieces, len(effect.parameters)) for pieces in made]
    pieces = [piece for m in here for piece in _pieces(scene, effect, points, m)]
    rows = slice(min(slot.start for slot, _, _ in pieces), max(slot.stop for slot, _, _ in pieces))
    stacked = np.zeros((len(points), rows.stop - rows.start, len(effect.parameters)))
    for slot, indices, values in pieces:
        stacked[:, slot.start - rows.start : slot.stop - rows.start][..., indices] = values
    return [Stacked(rows, columns) for columns in stacked]


def _pieces(
    scene: Scene, effect: Effect, points: Sequence[Values], m: int
) -> Iterator[tuple[slice, list[int], FloatArray]]:
    """Of one motion by joint: rows in the stack, numbers of k parameters, and their columns (points, r, k).

    Of an event one point at a time.
    """
    motion = scene.motions[m]
    if len(points) > 1:
        effect.prepare(motion, points, scene.backgrounds[m])
    each = [effect.columns(motion, point, scene.backgrounds[m]) for point in points]
    joints = sorted(each[0])
    lasts = effect.lasts(motion, points[0])
    whole = np.concatenate([columns[joint][1][lasts] for joint in joints for columns in each], axis=1)
    reduced = motion.reduce_part(whole, lasts.start) if effect.event else motion.reduce(whole)
    ends = np.cumsum([len(points) * len(each[0][joint][0]) for joint in joints])
    for joint, own in zip(joints, np.split(reduced, ends[:-1], axis=1)):
        indices = list(each[0][joint][0])
        whitened = scene.whiten(joint, m, own).reshape(-1, len(points), len(indices))
        yield scene.slot(joint, m), indices, np.swapaxes(whitened, 0, 1)


def _where_it_acts(pieces: Sequence[tuple[slice, list[int], FloatArray]], count: int) -> Stacked:
    """Of an event's pieces those rows that are not zero, in the order of the stack."""
    rows, columns = [np.zeros(0, dtype=int)], [np.zeros((0, count))]
    for slot, _, values in sorted(pieces, key=lambda piece: piece[0].start):
        place = np.flatnonzero(np.any(values[0] != 0.0, axis=1))
        rows.append(slot.start + place)
        columns.append(values[0][place])
    return Stacked(np.concatenate(rows), np.concatenate(columns))


def base_columns(base: IdentifiedModel, scene: Scene, common: Sequence[tuple[Effect, tuple[float, ...]]]) -> FloatArray:
    """(R, p + NUISANCE n + c) whitened columns of the base model, of its reversals, and of effects it includes.

    Args:
        base: Base model of p parameters; its constants are used, its parameter values are not.
        scene: The R rows to compute the columns in.
        common: Effects that belong to the base, of c parameters in all, each with values of its constants.
    """
    ends = len(base.model.parameters) + np.cumsum(
        [NUISANCE * len(base.model.arm.joints), *(len(effect.parameters) for effect, _ in common)]
    )
    # Filled in place: every block twice would be most of the memory that a fit of the base takes.
    whole = np.zeros((len(scene), ends[-1]))
    for term, first_parameter, first in base.model.numbered():
        constants = base.constants[first : first + len(term.constants)]
        columns = [term.columns(motion, constants, b) for motion, b in zip(scene.motions, scene.backgrounds)]
        block = whole[:, first_parameter : first_parameter + len(term.parameters)]
        scene.fill(block, columns)
        block[:, [parameter.held for parameter in term.parameters]] = 0.0
    scene.fill(whole[:, len(base.model.parameters) : ends[0]], [sharpness(motion) for motion in scene.motions])
    for (effect, values), start, end in zip(common, ends, ends[1:]):
        shared = stacked_effect(scene, effect, values)
        whole[shared.rows, start:end] = shared.columns
    return whole


def nuisance_scale(base: IdentifiedModel) -> FloatArray:
    """(NUISANCE n,) prior standard deviation of the nuisance parameters, N·m."""
    coulomb = {p.joint: abs(float(v)) for p, v in zip(base.model.parameters, base.parameters) if p.symbol == "f_c"}
    size = [max(SHARP_SHARE * coulomb.get(name, 0.0), SHARP_LEAST) for name in base.model.arm.joint_names]
    return np.repeat(size, NUISANCE)


def sharpness(motion: Motion) -> Columns:
    """Columns that only the rows near a reversal feel."""
    columns: Columns = {}
    for row in range(len(motion.joints)):
        velocity, sign = motion.velocity[:, row], direction(motion, row)
        travel = np.abs(velocity) / motion.rate_hz
        state = bristle_state(sign[:, None], travel, SHARP_DISTANCE, motion.cyclic)[:, 0]
        bells = [sign * np.exp(-((velocity / speed) ** 2)) for speed in SHARP_SPEEDS]
        columns[row] = list(range(NUISANCE * row, NUISANCE * (row + 1))), np.stack([state - sign, *bells], axis=1)
    return columns
