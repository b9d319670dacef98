"""The solvers a user may choose between, and what each makes of a model on some motions.

`separable` and `pso-separable` differ in how the nonlinear constants are searched, and share everything else: the
weights, the prior, the refinement. `pso-lm` is the paper's, with the paper's unknowns, unit weights and no prior.
`idim-iv` and `cloe` take the structure and constants of `separable`, and tell whether noise in the positions biases it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..arrays import FloatArray
from ..errors import UserError
from ..regression.prior import Prior
from ..regression.regression import Regression
from . import pso_separable
from .separable import grid_search

SEPARABLE, PSO_LM, PSO_SEPARABLE, IDIM_IV, CLOE = "separable", "pso-lm", "pso-separable", "idim-iv", "cloe"
SOLVERS = (SEPARABLE, PSO_LM, PSO_SEPARABLE, IDIM_IV, CLOE)
SEEDED = (PSO_LM, PSO_SEPARABLE)
LEAST_SQUARES = (SEPARABLE, PSO_SEPARABLE)
"""Those whose fit is least squares in the torque over all parameters: blocks of rows can be held out of it."""

Search = Callable[[Regression, Prior, float], FloatArray]
"""(rows with a background, prior, gate) -> constants to refine from."""


def require_solver(name: str) -> str:
    """`name`, if there is such a solver.

    Raises:
        UserError: There is none.
    """
    if name not in SOLVERS:
        raise UserError(f"no solver {name!r}: choose one of {', '.join(SOLVERS)}")
    return name


def search_of(solver: str, seed: int) -> Search:
    """How a solver of the separable kind searches the constants.

    Args:
        solver: `PSO_SEPARABLE`; any other name: the grid.
        seed: Of the particle swarm.
    """
    if solver != PSO_SEPARABLE:
        return lambda regression, prior, gate: grid_search(regression, gate)
    rng = np.random.default_rng(seed)
    return lambda regression, prior, gate: pso_separable.search(regression, prior, gate, rng)
