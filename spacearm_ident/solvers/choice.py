"""The solvers a user may choose between.

`separable` is the default. `pso-lm` is the paper's, with the paper's unknowns, unit weights and no prior. `idim-iv` and
`cloe` take the structure and constants of `separable`, and tell whether noise in the positions biases it.
"""

from __future__ import annotations

from ..errors import UserError

SEPARABLE, PSO_LM, IDIM_IV, CLOE = "separable", "pso-lm", "idim-iv", "cloe"
SOLVERS = (SEPARABLE, PSO_LM, IDIM_IV, CLOE)


def require_solver(name: str) -> str:
    """`name`, if there is such a solver.

    Raises:
        UserError: There is none.
    """
    if name not in SOLVERS:
        raise UserError(f"no solver {name!r}: choose one of {', '.join(SOLVERS)}")
    return name
