"""Residuals in newton metres, on the rows of a scene, for figures of merit and for pictures.

Figures are root mean squares in which a row counts for what the reference says that it is worth: a few rows beside a
reversal, which no model gets right, would otherwise be all that they tell of.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.signal import butter, sosfiltfilt

from ..arrays import FloatArray
from ..dynamics.model import IdentifiedModel, TorqueModel
from ..noise.between import ordinary_shifts
from .candidate import Candidate, without_effects
from .evidence import Evidence
from .finding import Trace
from .scene import FEWEST_ROWS, Scene, Whitener
from .scored import BEST, PARTS
from .stacked import base_columns, stacked_effect

HIGHEST = 0.45
"""Of the sampling rate: where a filter's band ends at the latest."""


def unwhitened(base: IdentifiedModel, scene: Scene) -> Scene:
    """The scene with rows in N·m, every row of every joint.

    Args:
        base: The base model.
        scene: With weighted rows.
    """
    count = len(base.model.arm.joints)
    return Scene(base, scene.motions, [Whitener(np.zeros(0), 1.0)] * count, scene.backgrounds)


class Residuals:
    """A scene without whitening.

    Attributes:
        scene: Its rows, in N·m.
        information: (V,) what each row counts for.
    """

    def __init__(self, evidence: Evidence, scene: Scene, plain: Sequence[Whitener]) -> None:
        self.scene = unwhitened(evidence.base, scene)
        weights = [whitener.weight(*self._rows(j)) for j, whitener in enumerate(plain)]
        self.information = np.concatenate(weights) ** 2
        self._columns = base_columns(evidence.base, self.scene, evidence.common)
        self._torque = self.scene.torque()
        self._few = self.scene.by_joint(np.ones(len(self.scene))) < FEWEST_ROWS

    @property
    def width(self) -> int:
        """Number of the base's columns, nuisance and common effects included."""
        return int(self._columns.shape[1])

    def _rows(self, joint: int) -> tuple[FloatArray, FloatArray]:
        mine = self.scene.joint == joint
        return self.scene.speed[mine], self.scene.gone[mine]

    def of(self, base: FloatArray, candidates: Sequence[Candidate], values: FloatArray) -> FloatArray:
        """(V,) measured minus predicted, N·m.

        Args:
            base: Parameters of the base, nuisance and common effects last, as from `Evidence.base_parameters`.
            candidates: Effects in the model beside the base.
            values: (k,) their parameters, one candidate after the other.
        """
        return without_effects(
            self._torque - self._columns @ base,
            candidates,
            values,
            lambda candidate: stacked_effect(self.scene, candidate.effect, candidate.constants),
        )

    def rms(self, residual: FloatArray) -> FloatArray:
        """(n,) weighted RMS by joint; NaN where a joint has fewer than `FEWEST_ROWS`."""
        squares = self.scene.by_joint(self.information * residual**2)
        return self._root_mean(squares, self.scene.by_joint(self.information))

    def _root_mean(self, squares: FloatArray, information: FloatArray) -> FloatArray:
        squares[self._few] = np.nan
        with np.errstate(invalid="ignore"):
            return np.asarray(np.sqrt(squares / information))

    def error_Nm(self, evidence: Evidence) -> FloatArray:
        """(n,) RMS of the standard error of the predicted torque (`Evidence.error_of`).

        Args:
            evidence: Whose fit predicts it; its base is the scene's.
        """
        return self.rms(evidence.error_of(self._columns))

    def acceleration(self) -> FloatArray:
        """(n,) RMS of each joint's acceleration, rad/s^2."""
        reduced = [motion.reduce(motion.acceleration) for motion in self.scene.motions]
        return self.rms(self.scene.stacked_rows(reduced))

    def ordinary_Nm(self, model: TorqueModel, base: FloatArray) -> FloatArray:
        """(n,) RMS of the usual difference of friction torque between two recordings, N·m (`ordinary_shifts`).

        Args:
            model: The base's.
            base: Its parameters, nuisance and common effects last.
        """
        return self.rms(np.linalg.norm(self._columns @ ordinary_shifts(model, base), axis=1))

    def rms_throughout(self, residual: FloatArray) -> FloatArray:
        """The same without each joint's loudest parts of the time: what shows there alone is an accident."""
        parts = self.scene.part(PARTS)
        shape = len(self.scene.whiteners), PARTS
        squares, information = np.zeros(shape), np.zeros(shape)
        np.add.at(squares, (self.scene.joint, parts), self.information * residual**2)
        np.add.at(information, (self.scene.joint, parts), self.information)
        mean = np.divide(squares, information, out=np.zeros(shape), where=information > 0.0)
        kept = np.argsort(mean, axis=1)[:, :-BEST]
        return self._root_mean(*(np.take_along_axis(x, kept, axis=1).sum(axis=1) for x in (squares, information)))

    def without_band(self, residual: FloatArray, bands: Sequence[tuple[float, float] | None]) -> FloatArray:
        """(V,) the residual less what it has between two frequencies, Hz, of each motion.

        Args:
            residual: (V,) N·m, rows of all motions.
            bands: Lowest and highest frequency of each motion, Hz; None: nothing is taken away.
        """
        kept = residual.copy()
        for m, (motion, band) in enumerate(zip(self.scene.motions, bands)):
            rate = motion.row_rate_hz
            if band is None or band[1] <= 0.0 or band[0] >= HIGHEST * rate:
                continue
            edges = max(band[0], 0.01 * rate), min(band[1], HIGHEST * rate)
            sos = butter(2, edges, "bandpass", fs=rate, output="sos")
            for j in range(motion.torque_rows.shape[1]):
                slot = self.scene.slot(j, m)
                whole = np.zeros(len(motion.torque_rows))
                whole[self.scene.place[slot]] = residual[slot]
                kept[slot] -= sosfiltfilt(sos, whole)[self.scene.place[slot]]
        return kept

    def traces(self, before: FloatArray, after: FloatArray) -> tuple[Trace, ...]:
        """Signals of each motion.

        Args:
            before: (V,) residual of the base, N·m.
            after: (V,) with the findings, N·m.
        """
        made = []
        for m, motion in enumerate(self.scene.motions):
            shape = motion.torque_rows.shape
            parts = []
            for residual in (before, after):
                whole = np.full(shape, np.nan)
                for j in range(shape[1]):
                    slot = self.scene.slot(j, m)
                    whole[self.scene.place[slot], j] = residual[slot]
                parts.append(whole)
            made.append(Trace(motion.time, motion.reduce(motion.position), motion.velocity_rows, *parts))
        return tuple(made)
