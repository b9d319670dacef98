"""`InformationFilter`: recursive least squares in square-root information form that forgets only what it hears anew.

What is known of x is kept as R x = z + unit noise, R upper triangular (information R'R, estimate R^-1 z), and new
rows B x = b + unit noise join by one QR factorisation (Bierman 1977, ch. V, "square root information filter"). No
covariance is ever subtracted from, so none can lose its positive definiteness: plain covariance recursions blew up
here.

*Forgetting* is directional: old information fades only in the directions in which new information arrives, by the
decomposition of the information matrix that Cao and Schwartz (2000, "A directional forgetting algorithm based on the
decomposition of the information matrix", Automatica 36) give for one row, and Lai and Bernstein (2024, SIFt-RLS) for
several. Seen from what is known already, C = B R^-1, the singular values of C say how much each direction u_i hears
anew: mu_i = sigma_i^2 is new information over old. That direction alone keeps the share

    lambda_i = 1 - a mu_i / (mu_i + TAPER a),      a = (share of the memory that this batch is) / (1 - TAPER).

The taper is ours. A direction that hears nothing keeps everything (no wind-up at rest, no drift); one that hears
steadily settles where lambda_i + mu_i = 1, at the information of one memory length of such rows, whatever their
size; in between the memory lengthens as the excitation weakens.

The covariance (R'R)^-1 is that of a parameter which may wander by about its standard error within one memory; for one
that stands still it is twice what the noise alone would leave (exponential weights), so standard errors are 1.4 times
too long there, never too short.
"""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray

TAPER = 0.5


class InformationFilter:
    """J filters side by side, p unknowns each, that have nothing to do with each other.

    Args:
        spread: (J, p) standard deviation of each unknown about zero before any data, above zero.

    Attributes:
        root: (J, p, p) R.
        side: (J, p) z.
    """

    def __init__(self, spread: FloatArray) -> None:
        self.root: FloatArray = np.eye(spread.shape[1]) / spread[:, :, None]
        self.side: FloatArray = np.zeros(spread.shape)

    @property
    def estimate(self) -> FloatArray:
        """(J, p)."""
        return np.asarray(np.linalg.solve(self.root, self.side[:, :, None])[:, :, 0])

    @property
    def covariance(self) -> FloatArray:
        """(J, p, p)."""
        inverse = np.linalg.inv(self.root)
        return np.asarray(inverse @ inverse.transpose(0, 2, 1))

    def add(self, rows: FloatArray, side: FloatArray, share: FloatArray) -> None:
        """Forget, then take rows.

        Args:
            rows: (J, r, p) in units of their noise.
            side: (J, r).
            share: (J,) of the memory that these rows are; 0: nothing is forgotten.
        """
        if np.any(share > 0.0):
            self._forget(rows, share)
        self.root, self.side = compress(
            np.concatenate([self.root, rows], axis=1), np.concatenate([self.side, side], axis=1)
        )

    def _forget(self, rows: FloatArray, share: FloatArray) -> None:
        """Let what the rows tell anew fade in what is known; the estimate does not move."""
        heard = np.linalg.solve(self.root.transpose(0, 2, 1), rows.transpose(0, 2, 1)).transpose(0, 2, 1)
        _, size, directions = np.linalg.svd(heard)
        news = np.zeros(self.side.shape)
        news[:, : size.shape[1]] = size**2
        rate = np.clip(share / (1.0 - TAPER), 1e-12, 1.0)[:, None]
        kept = np.sqrt(1.0 - np.where(share[:, None] > 0.0, rate * news / (news + TAPER * rate), 0.0))
        self.root = kept[:, :, None] * (directions @ self.root)
        self.side = kept * (directions @ self.side[:, :, None])[:, :, 0]

    def loosen(self, spread: FloatArray) -> None:
        """Add independent noise of standard deviation `spread` (J, p) to what is known; the estimate does not move."""
        estimate, covariance = self.estimate, self.covariance
        for block in np.flatnonzero((spread > 0).any(axis=1)):
            wider = covariance[block] + np.diag(spread[block] ** 2)
            # Scaled first: unknowns held by a tight belief stand beside loose ones.
            scale = np.sqrt(np.diag(wider))
            factor = np.linalg.cholesky(wider / np.outer(scale, scale))
            self.root[block] = np.linalg.qr(np.linalg.inv(factor) / scale, mode="r")
            self.side[block] = self.root[block] @ estimate[block]


def compress(rows: FloatArray, side: FloatArray) -> tuple[FloatArray, FloatArray]:
    """At most p rows (J, p, p) and (J, p) that say of x what `rows` (J, r, p) and `side` (J, r) do.

    Args:
        rows: (J, r, p) for each of J filters, in units of their noise.
        side: (J, r) right-hand sides.

    Returns:
        Upper triangular matrices and their right-hand sides; the residual that no x can explain is left out.
    """
    count = rows.shape[2]
    whole: FloatArray = np.asarray(np.linalg.qr(np.concatenate([rows, side[:, :, None]], axis=2), mode="r"))
    triangle = whole[:, :count]
    return triangle[:, :, :count], triangle[:, :, count]
