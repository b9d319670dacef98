"""Whether one model predicts held-out blocks of time better than another, beyond chance.

The rows of the motions are cut into blocks, blocks are held out together as folds: whole recordings where there are
several, because recordings of one arm differ by more than blocks of one recording do, else contiguous parts of the only
one (blocked cross-validation, Roberts et al. 2017, Ecography 40, 913). Whatever is chosen
by prediction is chosen here, at one significance level: terms (`identification/structure.py`), a coupled wrist
(`coupled_wrist.py`), a blend (`blend.py`), a simulation's layers (`layers/joint_fit.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
from scipy.stats import t as student

from ..arrays import FloatArray
from ..signals.motion import Motion

BEYOND = 1.0
"""Standard errors by which held-out squares must drop for the less simple of two models to stay (Breiman et al. 1984,
"Classification and regression trees", section 3.4.3)."""
LEVEL = 0.05
"""Probability with which a change that brings nothing is made, shared out between the two tests of it (Bonferroni)."""
BLOCK_S = 0.5
"""Shortest block, s: a few correlation times of the residuals of the five real arms (0.05 to 0.4 s)."""
BLOCKS = 12
"""Most blocks in all; t with 11 degrees of freedom is within a fifth of the normal quantile at 1 %."""
FEWEST_BLOCKS = 6
"""With fewer blocks in all no choice is made: the plain law stays."""
FOLDS = 5
"""Parts of a single recording that are held out in turn."""
_LEAST = 1e-300
"""Squares below are none: keeps ratios and logarithms finite."""


def time_blocks(motions: Sequence[Motion], most: int = BLOCKS) -> tuple[list[np.ndarray], np.ndarray]:
    """Blocks of time of the motions' rows.

    Args:
        motions: What is cut, each into parts of one length.
        most: Number of blocks in all, unless they were shorter than `BLOCK_S`.

    Returns:
        Per motion, (M,) the block of every row, counted over all motions; and per block the recording it belongs to.
    """
    seconds = [len(motion.torque_rows) / motion.row_rate_hz for motion in motions]
    length = max(sum(seconds) / most, BLOCK_S)
    block_of, recording, first = [], [], 0
    for motion, duration in zip(motions, seconds):
        rows, count = len(motion.torque_rows), max(1, round(duration / length))
        block_of.append(first + np.arange(rows) * count // max(rows, 1))
        recording += [motion.source] * count
        first += count
    return block_of, np.array(recording)


def folds_of(recording: np.ndarray) -> list[np.ndarray]:
    """Numbers of the blocks that are held out together, from the recording that each of them belongs to."""
    recordings = np.unique(recording)
    if len(recordings) > 1:
        return [np.flatnonzero(recording == number) for number in recordings]
    return [part for part in np.array_split(np.arange(len(recording)), FOLDS) if len(part)]


def gain(before: FloatArray, after: FloatArray) -> float:
    """Sum over the joints of the share of held-out squares (blocks, n) that a change takes away.

    Args:
        before: (blocks, n) N²·m², or in the weights of the rows.
        after: (blocks, n) with the change.
    """
    total = np.maximum(before.sum(axis=0), _LEAST)
    return float(((before.sum(axis=0) - after.sum(axis=0)) / total).sum())


def t_of_drop(before: FloatArray, after: FloatArray) -> float:
    """How clearly a joint's squares drop, block by block: (blocks,) each; t, zero where there are too few blocks.

    The difference of the squares is tested and that of their logarithms, and the clearer of the two counts: the first
    sees what acts in few blocks, the second what acts in all, though their squares differ a lot.

    Args:
        before: (blocks,) squares of the joint.
        after: (blocks,) in the same unit.
    """
    moving = before > 1e-12 * max(before.max(), _LEAST)
    before, after = before[moving], np.maximum(after[moving], _LEAST)
    return max(_t_value(before - after), _t_value(np.log(before / after)))


@cache
def bound(level: float, blocks: int) -> float:
    """Value of t that the clearer of the two tests exceeds by chance with a probability of `level`.

    Args:
        level: Shared by the two tests, each of which asks whether squares drop.
        blocks: Number of blocks; at least two.
    """
    return float(student.ppf(1.0 - level / 2, blocks - 1))


def t_of_all(before: FloatArray, after: FloatArray) -> float:
    """How clearly the squares (blocks, n) of all joints together drop: t of the blocks' mean logarithmic ratio.

    Args:
        before: (blocks, n) squares.
        after: (blocks, n) in the same unit, joint by joint.
    """
    moving = before > 1e-12 * np.maximum(before.max(axis=0), _LEAST)
    ratio = np.log(np.maximum(before, _LEAST) / np.maximum(after, _LEAST))
    return _t_value(np.where(moving, ratio, 0.0).mean(axis=1))


def predicts_better(before: FloatArray, after: FloatArray) -> bool:
    """Whether a second model predicts some joint better, beyond chance, and all together no worse: (blocks, n) each.

    Args:
        before: (blocks, n) squares that the first leaves of held-out blocks.
        after: (blocks, n) those that the second leaves.
    """
    level = bound(LEVEL / before.shape[1], len(before))
    clear = any(t_of_drop(left, right) > level for left, right in zip(before.T, after.T))
    return clear and gain(before, after) > 0.0


def _t_value(drop: FloatArray) -> float:
    """Mean of the blocks' drops over its standard error; zero where there are too few blocks."""
    if len(drop) < FEWEST_BLOCKS:
        return 0.0
    return float(drop.mean() / max(drop.std(ddof=1) / np.sqrt(len(drop)), _LEAST))
