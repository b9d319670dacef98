"""How slow the noise of a few seconds is, read off its correlation over the length of the low-pass.

The integrated autocorrelation time kappa is the noise's spectrum at zero frequency over its variance, and that part of
the spectrum is what a fit takes from its residual first: of noise with a time constant of 50 ms, twice as slow as the
low-pass makes white noise, the residual of a 5 s fit shows nothing at zero (kappa by Sokal's sum: white noise's in half
of the runs). It does show over the length of the low-pass, as in von Neumann's ratio. So noise is taken to be of first
order, white before the low-pass at the least, and its decay is read off the correlation rho at half that length; every
direction that was fitted has taken kappa/M of the variance from all short lags alike, which is given back as far as
white noise has it (with the kappa that is sought, both run away where rows are few).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray

DECAYS = 1.0 - np.geomspace(1.0, 0.01, 60)
"""Of the noise from one row to the next; 0 is white."""
MOST_LOST = 0.75
"""Of the residual's variance may have been fitted; what more it says is not believed."""


@dataclass(frozen=True)
class FirstOrder:
    """What a low-pass makes of first-order noise, for each of `DECAYS`.

    Attributes:
        lag: Rows, half the length of the low-pass.
        correlation: (K,) at that lag, rising.
        kappa: (K,) integrated autocorrelation time, rows, rising.
        squared: (K,) that of the squared autocorrelation, rows: what counts for the variance of a variance.
    """

    lag: int
    correlation: FloatArray
    kappa: FloatArray
    squared: FloatArray

    @classmethod
    def after(cls, white: FloatArray) -> FirstOrder:
        """Of a low-pass that gives white noise the autocorrelation (L,), by lag in rows."""
        reach = len(white)
        lag = max(1, reach // 2)
        sides = np.concatenate([white[:0:-1], white])
        shifts = np.abs(np.arange(max(reach, lag + 1))[:, None] - np.arange(1 - reach, reach))
        covariance = np.array([(decay**shifts) @ sides for decay in DECAYS])
        rho = covariance / covariance[:, :1]
        # Beyond the reach of the low-pass the correlation is a geometric series.
        rest = rho[:, -1] ** 2 * DECAYS**2 / (1.0 - DECAYS**2)
        kappa = sides.sum() * (1.0 + DECAYS) / (1.0 - DECAYS) / covariance[:, 0]
        return cls(lag, rho[:, lag], kappa, 1.0 + 2.0 * ((rho[:, 1:] ** 2).sum(axis=1) + rest))

    def kappa_of(self, residual: FloatArray, place: np.ndarray, fitted: float) -> float:
        """Correlation time of a residual, rows.

        Args:
            residual: (M,) N·m, outliers bounded.
            place: (M,) row numbers in time, gaps left out.
            fitted: Directions that a fit took from it, a row.
        """
        signal, present = np.zeros((2, int(place[-1] - place[0]) + 1))
        signal[place - place[0]] = residual
        present[place - place[0]] = 1.0
        pairs = float(present[self.lag :] @ present[: -self.lag])
        power = float(np.mean(residual**2))
        if pairs == 0.0 or power == 0.0:
            return float(self.kappa[0])
        seen = float(signal[self.lag :] @ signal[: -self.lag]) / pairs / power
        lost = min(fitted * float(self.kappa[0]), MOST_LOST)
        return float(np.interp(seen * (1.0 - lost) + lost, self.correlation, self.kappa))

    def squared_share(self, kappa: float) -> float:
        """Correlation time of the square over kappa, for noise of this kappa."""
        return float(np.interp(kappa, self.kappa, self.squared / self.kappa))
