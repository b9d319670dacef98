"""Closed-loop output error: least squares on the motion of a simulated arm, in whose columns there is no noise.

Least squares takes its columns from measured positions, and noise in them biases it. Here the arm is simulated in
closed loop with the parameters as they are, and the columns are those of the simulated motion; the output is the
motors' torque. Because the simulated and the real loop follow the same reference, the motion hardly depends on the
parameters, the error is linear in them, and

    x_(k+1) = argmin |W (tau - A(q_sim(x_k)) x)|^2

settles in a few simulations (DIDIM: Gautier, Janot and Vandanjon 2013, "A new closed-loop output error method for
parameter identification of robot dynamics"). They know the controller. Here it is computed torque
(`simulated_loop.py`), as stiff as the recorded loop shows itself, along what the arm was told (`recorded_loop.py`).

The structure, constants and weights are those of the least-squares solution on the same rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray
from ..dynamics.effects import EFFECTS
from ..dynamics.model import Structure
from ..errors import UserError
from ..estimate.consistency import make_consistent
from ..recording.recording import Recording
from ..regression.prior import Prior
from ..regression.regression import Regression
from ..signals.motion import Motion
from ..signals.prepare import prepare
from ..solvers.separable import Solution, solve_linear, system
from .instrumental import with_speeds_of
from .recorded_loop import RECORDED_SHARE, RecordedLoop

FIRST_BANDWIDTH_HZ = 20.0
"""Of all loops, before they are matched; position loops of arms have 2 to 50 Hz."""
MATCHES = 3
MOST_SIMULATIONS = 8
SETTLED = 0.1
"""No parameter, nor any combination of them, still moves by more than so many of its standard errors."""


@dataclass(frozen=True)
class Outcome:
    """Output error beside least squares on the same rows.

    Attributes:
        regression: Weighted rows, columns of the simulated motion.
        solution: By output error.
        least_squares: (p,) parameters, columns of the recorded motion.
        words: How it was simulated.
    """

    regression: Regression
    solution: Solution
    least_squares: FloatArray
    words: str


def require_simulated(structure: Structure) -> None:
    """Refuse a structure whose closed loop is not simulated.

    Raises:
        UserError: It has effects in it; the line names them.
    """
    effects = [kind for kind in structure if kind in EFFECTS]
    if effects:
        raise UserError(
            f"the solver cloe simulates rigid arms with friction, not {', '.join(effects)}: "
            "take the solver separable, or a structure without effects"
        )


def solve(
    recordings: Sequence[Recording],
    regression: Regression,
    prior: Prior,
    solution: Solution,
    cutoff_hz: float,
    bandwidth_hz: float = FIRST_BANDWIDTH_HZ,
) -> Outcome:
    """Closed-loop output error from a least-squares solution.

    Args:
        recordings: What the motions of `regression` were made of, periods not averaged.
        regression: Weighted rows.
        prior: Beliefs.
        solution: Least squares on them; its constants stay.
        cutoff_hz: Bandwidth of the fit.
        bandwidth_hz: Of the simulated loops, before they are matched to the recorded ones.

    Raises:
        UserError: The structure cannot be simulated.
    """
    model, constants = regression.model, solution.constants
    require_simulated(model.structure)
    loops = [RecordedLoop(model, recording, cutoff_hz, bandwidth_hz) for recording in recordings]

    def simulated(current: Regression, parameters: FloatArray) -> list[Motion]:
        matrix, _ = system(current, prior, constants)
        consistent = make_consistent(model, matrix, parameters, prior.scale)
        runs = [loop.simulate(consistent, constants) for loop in loops]
        motions, _ = prepare(runs, model.arm.joint_names, cutoff_hz, average=False)
        return with_speeds_of(regression.motions, motions)

    for _ in range(MATCHES):
        motions = simulated(regression, solution.parameters)
    # Rows in which either arm stands still say nothing of both.
    moving = [one.moving & other.moving for one, other in zip(motions, regression.motions)]
    current = _on_rows(regression, regression.motions, moving)
    current.update_background(solution.parameters, constants)
    parameters, _ = solve_linear(current, prior, constants)
    least_squares, change, number = parameters, np.inf, 0
    while change > SETTLED and number < MOST_SIMULATIONS:
        number += 1
        current = _on_rows(regression, simulated(current, parameters), moving)
        current.update_background(parameters, constants)
        before, (parameters, cost) = parameters, solve_linear(current, prior, constants)
        # In standard errors, for the rows of the system are in units of theirs.
        change = float(np.linalg.norm(system(current, prior, constants)[0] @ (parameters - before)))
    status = "settled" if change <= SETTLED else f"still moving by {change:.2g} standard errors"
    return Outcome(
        current,
        Solution(parameters, constants, cost, number, status),
        least_squares,
        _words(loops, current.motions, regression.motions, cutoff_hz),
    )


def _on_rows(regression: Regression, motions: Sequence[Motion], moving: Sequence[np.ndarray]) -> Regression:
    """A regression on other motions and fewer rows, each with the weight it has in the known one."""
    fewer = [replace(motion, given_moving=rows) for motion, rows in zip(motions, moving)]
    result = Regression(regression.model, fewer)
    for joint, known in enumerate(regression.rows):
        kept = np.concatenate([rows[own.moving[:, joint], joint] for rows, own in zip(moving, regression.motions)])
        result.rows[joint].set_weight(known.weight[kept], known.trust[kept])
    return result


def _words(
    loops: Sequence[RecordedLoop],
    simulated: Sequence[Motion],
    recorded: Sequence[Motion],
    cutoff_hz: float,
) -> str:
    """How the arm was simulated, in a sentence."""
    apart = np.max(
        [np.sqrt(np.mean((a.position - b.position) ** 2, axis=0)) for a, b in zip(simulated, recorded)], axis=0
    )
    worst = int(np.argmax(apart))
    bandwidths = np.array([loop.bandwidth_hz for loop in loops])
    what = "the recorded commands"
    if not all(loop.commanded for loop in loops):
        limit = RECORDED_SHARE * cutoff_hz
        what = f"recorded positions (there are no commands that the arm followed): noise below {limit:.2g} Hz stays"
    return (
        f"simulated in closed loop along {what}; joints' loops of {bandwidths.min():.3g} to {bandwidths.max():.3g} Hz; "
        f"simulated and recorded motion up to {1e3 * apart[worst]:.2g} mrad RMS apart ({recorded[0].joints[worst]})"
    )
