"""How well the base predicts parts of the reference that its fit leaves out, and how far its fits differ.

What a healthy arm's runs differ by is not in the residual of a fit to all of them. Leaving out whole recordings in
turn, or parts of the only one (`regression.held_out`), measures it: the squares of the part that was left out, and
the jackknife's standard error of what is predicted on another motion (Efron and Stein 1981, Ann. Statist. 9, 586).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from scipy.stats import t as student

from ..arrays import FloatArray
from ..dynamics.model import OwnRecordings
from ..regression.held_out import FEWEST_BLOCKS, folds_of, time_blocks
from .evidence import Evidence
from .residuals import Residuals
from .scene import Scene

LEVEL = 0.01
"""Probability with which a joint of a healthy arm leaves more than `largest_rms`: six joints, one alarm in
twenty recordings."""


class LeftOut:
    """Fits of the base to a reference, each without some of its blocks.

    Attributes:
        squares: (blocks, n) sum of squared residuals of each block by the fit that left it out, N²·m²; every row
            counts for what `Residuals` says that it is worth.
        fitted_squares: (blocks, n) the same by the fit to all of them.
        folds: Numbers of the blocks that were left out together.
        fits: By fold, parameters of the base.
        fold_of_row: (R,) which of them left out a row of the reference.
        information: (blocks, n) sum of what the rows count for.
    """

    def __init__(self, healthy: Evidence, residuals: Residuals) -> None:
        """Fit.

        Args:
            healthy: Base and reference alone.
            residuals: The reference's rows without whitening.
        """
        in_fit, recording = _blocks(healthy.field)
        judged, _ = _blocks(residuals.scene)
        shape = len(recording), len(residuals.scene.whiteners)
        self.squares, self.fitted_squares, self.information = np.zeros(shape), np.zeros(shape), np.zeros(shape)
        np.add.at(self.information, (judged, residuals.scene.joint), residuals.information)
        fitted = residuals.of(healthy.base_parameters([], np.zeros(0)), [], np.zeros(0))
        np.add.at(self.fitted_squares, (judged, residuals.scene.joint), residuals.information * fitted**2)
        self.folds = folds_of(recording)
        self.fits: list[FloatArray] = []
        self.fold_of_row = np.full(len(in_fit), -1)
        if len(recording) < FEWEST_BLOCKS or len(self.folds) < 2:
            return
        for number, fold in enumerate(self.folds):
            out = np.isin(in_fit, fold)
            fit = healthy.base_parameters_without(out)
            self.fold_of_row[out] = number
            left = residuals.of(fit, [], np.zeros(0))
            mine = np.isin(judged, fold)
            where = judged[mine], residuals.scene.joint[mine]
            np.add.at(self.squares, where, residuals.information[mine] * left[mine] ** 2)
            self.fits.append(fit)

    @property
    def known(self) -> bool:
        """Whether the recordings were long enough for parts to be left out."""
        return bool(self.fits)

    @cached_property
    def rms_Nm(self) -> FloatArray:
        """(n,) RMS of what was left out; NaN where a joint has no rows, or nothing was left out."""
        if not self.known:
            return np.full(self.squares.shape[1], np.nan)
        with np.errstate(invalid="ignore"):
            return np.asarray(np.sqrt(self.squares.sum(axis=0) / self.information.sum(axis=0)))

    @cached_property
    def largest_Nm(self) -> FloatArray:
        """(n,) RMS that the fit to all leaves of another part of motion with a probability of `LEVEL` or less.

        What it predicts worse of a motion of another kind is not in it, but in `error_Nm`.

        Returns:
            NaN where a joint has no rows, or nothing was left out.
        """
        if not self.known:
            return self.rms_Nm
        squares, rows = (
            np.stack([by[fold].sum(axis=0) for fold in self.folds]) for by in (self.fitted_squares, self.information)
        )
        return largest_rms(squares, rows)

    @property
    def times(self) -> float:
        """How many times `error_Nm` an error is with a probability of `LEVEL` (Student; all joints tell its size)."""
        return _times(len(self.fits), self.squares.shape[1])

    def error_Nm(self, residuals: Residuals) -> FloatArray:
        """(n,) jackknife standard error of the predicted torque, RMS over other rows; zero if nothing was left out."""
        return jackknife_Nm(self.fits, residuals, self.squares.shape[1])


class LeftOfOwn:
    """The same of a model's own recordings, as its file has it (`dynamics.model.OwnRecordings`).

    In another bandwidth more or less is left: what the file has are shares of what the fit to all leaves.
    """

    def __init__(self, own: OwnRecordings, fitted_Nm: FloatArray) -> None:
        """Take for the (n,) RMS of the fit to all that of a fit in the bandwidth looked at, N·m."""
        self._own, self._fitted_Nm = own, fitted_Nm

    @property
    def rms_Nm(self) -> FloatArray:
        """(n,) RMS of the parts that were left out; NaN where a joint has no rows."""
        return self._scaled(self._mean(self._own.left_out_Nm))

    @property
    def largest_Nm(self) -> FloatArray:
        """(n,) RMS that the fit to all leaves of another part with a probability of `LEVEL` or less."""
        return self._scaled(largest_rms(self._own.rows * self._own.fitted_Nm**2, self._own.rows))

    def _scaled(self, rms_Nm: FloatArray) -> FloatArray:
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(self._fitted_Nm * rms_Nm / self._mean(self._own.fitted_Nm))

    def _mean(self, parts_Nm: FloatArray) -> FloatArray:
        with np.errstate(invalid="ignore"):
            return np.asarray(np.sqrt(np.sum(self._own.rows * parts_Nm**2, axis=0) / np.sum(self._own.rows, axis=0)))

    @property
    def acceleration(self) -> FloatArray:
        """(n,) RMS of each joint's acceleration, rad/s^2."""
        return self._own.acceleration

    @property
    def times(self) -> float:
        """As `LeftOut.times`."""
        return _times(*self._own.rows.shape)

    def error_Nm(self, residuals: Residuals) -> FloatArray:
        """As `LeftOut.error_Nm`."""
        fits = [np.pad(fit, (0, residuals.width - len(fit))) for fit in self._own.parameters]
        return jackknife_Nm(fits, residuals, self._own.rows.shape[1])


def jackknife_Nm(fits: Sequence[FloatArray], residuals: Residuals, joints: int) -> FloatArray:
    """(n,) standard error of the predicted torque from fits that each leave out a part, RMS over rows; 0 without any.

    Args:
        fits: Parameters of the base.
        residuals: The rows.
        joints: n.
    """
    if not fits:
        return np.zeros(joints)
    left = np.stack([residuals.of(fit, [], np.zeros(0)) for fit in fits])
    return np.nan_to_num(residuals.rms(np.sqrt(len(fits) - 1) * left.std(axis=0)))


def _times(fits: int, joints: int) -> float:
    """How many standard errors by so many fits an error is with a probability of `LEVEL`."""
    return float(student.ppf(1.0 - LEVEL, max((fits - 1) * joints, 1)))


def largest_rms(squares: FloatArray, rows: FloatArray) -> FloatArray:
    """(n,) RMS that a further part exceeds with a probability of `LEVEL`; NaN where a joint has no rows.

    The parts' mean squares are taken as log-normal, with one variance at all joints: few parts tell it better together.

    Args:
        squares: (parts, n) sums of squares.
        rows: (parts, n) of so many rows.
    """
    level = np.log(squares, out=np.full(squares.shape, np.nan), where=rows > 0.0)
    level -= np.log(rows, out=np.full(rows.shape, np.nan), where=rows > 0.0)
    known = np.isfinite(level)
    parts = np.maximum(known.sum(axis=0), 1)
    mean = np.where(known, level, 0.0).sum(axis=0) / parts
    freedom = max(int((parts - 1).sum()), 1)
    spread = np.sqrt(np.where(known, (level - mean) ** 2, 0.0).sum() / freedom)
    above = student.ppf(1.0 - LEVEL, freedom) * spread * np.sqrt(1.0 + 1.0 / parts)
    return np.where(known.any(axis=0), np.exp(0.5 * (mean + above)), np.nan)


def _blocks(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """(R,) block of each stacked row, and the recording of each block."""
    of_motion, recording = time_blocks(scene.motions)
    starts = np.concatenate([[0], np.cumsum([len(blocks) for blocks in of_motion])])
    return np.concatenate(of_motion)[starts[scene.owner] + scene.place], recording
