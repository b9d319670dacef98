"""Cross-checks: the same model by a method that noise in the positions does not bias, and how far apart they are.

Both share the noise of the torque. Without noise in the columns they are far closer than their standard errors, so a
difference of a few of these is a sign of biased data.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..arrays import FloatArray
from ..dynamics.base_parameters import BaseParameters
from ..recording.recording import Recording
from ..regression.regression import Regression
from ..signals.prepare import prepare
from ..solvers.solution_columns import residuals_of
from . import instrumental, output_error
from .fit import Fit, covariance_of, refitted, revealed

DISAGREEMENT = 2.0
"""Base parameters this many standard errors apart are held to disagree."""


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
    words = compare(method, base, fit.solution.parameters - least_squares, base.errors(covariance_of(fit)))
    return replace(fit, stages=(*fit.stages, words))


def compare(method: str, base: BaseParameters, departure: FloatArray, errors: FloatArray) -> str:
    """The verdict on an estimate beside least squares, in a sentence.

    Args:
        method: What the other estimate is called, in the plural.
        base: The b base parameters.
        departure: (p,) the other estimate of the parameters less that by least squares.
        errors: (b,) standard errors of the base parameters; what has none agrees.
    """
    apart = np.abs(base.regrouping @ departure)
    apart = np.divide(apart, errors, out=np.zeros_like(apart), where=errors > 0)
    most, many = float(apart.max(initial=0.0)), int(np.sum(apart > DISAGREEMENT))
    if not many:
        return f"{method} agree with least squares: no base parameter is more than {most:.2g} standard errors apart"
    return (
        f"{method} disagree with least squares at {many} base parameters, most at {base.names[int(apart.argmax())]} "
        f"({most:.2g} standard errors): noise in the measured positions biases least squares; trust these values "
        "rather, or record with less noise or faster motion"
    )
