"""Another estimate beside least squares on the same rows: do they agree, and if not, what that means.

Both share the noise of the torque. Without noise in the columns they are far closer than their standard errors, so a
difference of a few of these is a sign of biased data.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..dynamics.base_parameters import BaseParameters

DISAGREEMENT = 2.0
"""Base parameters this many standard errors apart are held to disagree."""


@dataclass(frozen=True)
class Comparison:
    """An estimate beside least squares, in standard errors of a base parameter.

    Attributes:
        method: What the other estimate is called, in the plural.
        apart: (b,) differences; 0 where there is no standard error.
        worst: Name of the base parameter that is farthest off.
    """

    method: str
    apart: FloatArray
    worst: str

    @property
    def agree(self) -> bool:
        """Whether no base parameter is farther apart than `DISAGREEMENT`."""
        return bool(np.abs(self.apart).max(initial=0.0) <= DISAGREEMENT)

    @property
    def words(self) -> str:
        """The verdict in a sentence."""
        most = float(np.abs(self.apart).max(initial=0.0))
        if self.agree:
            return (
                f"{self.method} agree with least squares: no base parameter is more than {most:.2g} standard "
                "errors apart"
            )
        many = int(np.sum(np.abs(self.apart) > DISAGREEMENT))
        return (
            f"{self.method} disagree with least squares at {many} base parameters, most at {self.worst} "
            f"({most:.2g} standard errors): noise in the measured positions biases least squares; trust these values "
            "rather, or record with less noise or faster motion"
        )


def compare(
    method: str, base: BaseParameters, other: FloatArray, least_squares: FloatArray, errors: FloatArray
) -> Comparison:
    """Compare two estimates in base parameters.

    Args:
        method: What the other estimate is called, in the plural.
        base: The b base parameters.
        other: (p,) the other estimate of the parameters.
        least_squares: (p,) estimate by least squares.
        errors: (b,) standard errors of the base parameters.

    Returns:
        The differences in standard errors, and the base parameter with the largest.
    """
    apart = base.regrouping @ (other - least_squares)
    apart = np.divide(apart, errors, out=np.zeros_like(apart), where=errors > 0)
    return Comparison(method, apart, base.names[int(np.argmax(np.abs(apart)))])
