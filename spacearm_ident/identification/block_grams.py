"""`BlockGrams`: a regression as Gram matrices by joint and block of time, its constants held.

A fit to any of the blocks, and the squares that any parameters leave in any of them, cost no more than the number of
parameters asks for, whatever the recording's length (Golub and Van Loan 2013, ch. 5).
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular

from ..arrays import FloatArray
from ..regression.held_out import folds_of, time_blocks
from ..regression.prior import Prior
from ..regression.regression import Regression
from ..solvers.solution_columns import columns_at


class BlockGrams:
    """Gram matrices of weighted columns and torque.

    Attributes:
        recording: (blocks,) which recording a block belongs to.
    """

    def __init__(self, regression: Regression, constants: FloatArray) -> None:
        """Build the columns at some constants (c,), and cut them into blocks."""
        block_of, self.recording = time_blocks(regression.motions)
        self._parts: list[tuple[list[int], FloatArray]] = []
        information = []
        for rows, columns, numbers in zip(regression.rows, *columns_at(regression, constants)):
            stacked = np.column_stack([columns, rows.torque]) * rows.weight[:, None]
            block = rows.group(block_of)
            own = [stacked[block == number] for number in range(len(self.recording))]
            self._parts.append((numbers, np.stack([part.T @ part for part in own])))
            information.append(np.bincount(block, rows.weight**2, len(self.recording)))
        self._information = np.column_stack(information)

    def rest(self, fold: np.ndarray) -> np.ndarray:
        """Numbers of the blocks that are not in a fold."""
        return np.setdiff1d(np.arange(len(self.recording)), fold)

    def solve(self, blocks: np.ndarray, prior: Prior) -> tuple[FloatArray, FloatArray]:
        """The compressed rows (p, p) of some blocks and the prior, and the parameters (p,) they ask for."""
        normal, side = prior.rows.T @ prior.rows, prior.rows.T @ prior.target
        for numbers, grams in self._parts:
            gram = grams[blocks].sum(axis=0)
            normal[np.ix_(numbers, numbers)] += gram[:-1, :-1]
            side[numbers] += gram[:-1, -1]
        parameters, free = prior.held.copy(), prior.free
        # In units of the prior's scales, in which the prior makes the matrix at least the unit matrix.
        unit = prior.scale[free]
        root = cholesky(normal[np.ix_(free, free)] * np.outer(unit, unit))
        known = (side - prior.fixed_part(normal))[free]
        parameters[free] = cho_solve((root, False), known * unit) * unit
        matrix = np.zeros(normal.shape)
        matrix[np.ix_(free, free)] = root / unit
        return matrix, parameters

    def left_out(self, prior: Prior) -> FloatArray:
        """(blocks, n) weighted squares that fits leave in the blocks of a fold that each does not see (`folds_of`)."""
        left = np.zeros((len(self.recording), len(self._parts)))
        for fold in folds_of(self.recording):
            left[fold] = self.squares(fold, self.solve(self.rest(fold), prior)[1])
        return left

    def slowness(self, blocks: np.ndarray, parameters: FloatArray, factor: FloatArray) -> FloatArray:
        """(2, n) how far what parameters leave in some blocks would move a fit, and how far noise that is white would.

        Both are sums over blocks of s'(I + G)^-1 s, with the score s and the information G of the block's rows at a
        joint for v ~ N(0, I); E[s s'] is G if their noise is white and as large as their weights say.

        Args:
            blocks: Their numbers.
            parameters: (p,).
            factor: (p, v) departures of the parameters by v.
        """
        found = np.zeros((2, len(self._parts)))
        for joint, (numbers, grams) in enumerate(self._parts):
            # Of all v only what this joint's parameters depart by counts: as many combinations as it has columns.
            own = np.asarray(np.linalg.qr(factor[numbers].T, mode="r")).T
            vector, count = np.append(-parameters[numbers], 1.0), own.shape[1]
            for gram in grams[blocks]:
                root = cholesky(np.eye(count) + own.T @ gram[:-1, :-1] @ own, lower=True)
                inverse = solve_triangular(
                    root, np.column_stack([own.T @ (gram @ vector)[:-1], np.eye(count)]), lower=True
                )
                found[:, joint] += np.sum(inverse[:, 0] ** 2), count - np.sum(inverse[:, 1:] ** 2)
        return found

    def information(self, blocks: np.ndarray) -> FloatArray:
        """(n,) what some blocks' rows of each joint count for, 1/(N·m)²: the sum of their squared weights."""
        return np.asarray(self._information[blocks].sum(axis=0))

    def squares(self, blocks: np.ndarray, parameters: FloatArray) -> FloatArray:
        """(len(blocks), n) weighted squares that parameters leave."""
        left = [
            np.einsum("i,bij,j->b", vector, grams[blocks], vector)
            for numbers, grams in self._parts
            for vector in (np.append(parameters[numbers], -1.0),)
        ]
        return np.asarray(np.maximum(np.column_stack(left), 0.0))
