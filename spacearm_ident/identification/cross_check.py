"""Cross-checks: the same model by a method that noise in the positions does not bias, and how far apart they are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ..arrays import FloatArray
from ..recording.recording import Recording
from ..regression.regression import Regression
from ..signals.prepare import prepare
from ..solvers.solution_columns import residuals_of
from . import instrumental, output_error
from .comparison import compare
from .fit import Fit, covariance_of, refitted, revealed


def fit_instrumental(known: Fit, recordings: Sequence[Recording], cutoff_hz: float) -> Fit:
    """Instrumental variables in the structure that least squares chose, and the verdict on how far apart they are.

    Args:
        known: The least-squares fit; its structure and constants are taken over.
        recordings: Those of that fit.
        cutoff_hz: Low-pass cut-off, Hz.

    Raises:
        UserError, UnfitDataError: As `prepare`, or a segment of a recording has fewer than eight samples.
    """
    model = known.regression.model
    plain, first, second = instrumental.split_motions(recordings, model.arm.joint_names, cutoff_hz)
    regression, prior, solution, noise = refitted(known, plain)
    parameters = instrumental.instrumental(
        regression, Regression(model, first), Regression(model, second), prior, solution
    )
    residuals = residuals_of(regression, solution)
    fit = Fit(regression, prior, replace(solution, parameters=parameters), residuals, noise)
    return _compared("instrumental variables", fit, solution.parameters)


def fit_output_error(known: Fit, recordings: Sequence[Recording], cutoff_hz: float) -> Fit:
    """Closed-loop output error in the structure that least squares chose, and the verdict on how far apart they are.

    Args:
        known: The least-squares fit; its structure and constants are taken over.
        recordings: Those of that fit.
        cutoff_hz: Low-pass cut-off, Hz.

    Raises:
        UserError, UnfitDataError: As `prepare`, or the structure cannot be simulated (UserError).
    """
    plain, _ = prepare(recordings, known.regression.model.arm.joint_names, cutoff_hz, average=False)
    regression, prior, solution, noise = refitted(known, plain)
    found = output_error.solve(recordings, regression, prior, solution, cutoff_hz)
    residuals = residuals_of(found.regression, found.solution)
    fit = Fit(found.regression, prior, found.solution, residuals, noise, (found.words,))
    return _compared("closed-loop output errors", fit, found.least_squares)


def _compared(method: str, fit: Fit, least_squares: FloatArray) -> Fit:
    """The fit, with the verdict on how far from least squares (p,) it is."""
    base = revealed(fit.regression)
    verdict = compare(method, base, fit.solution.parameters, least_squares, base.errors(covariance_of(fit)))
    return replace(fit, stages=(*fit.stages, verdict.words))
