"""One implicit step of dry friction over coupled joints: which stick, which slip, how fast.

Moreau's time stepping. With inertia A, momentum b = A v + h·(all other torques) and friction impulses
bounded by w = h·level, the new velocity solves the inclusion A v⁺ + w·Sgn(v⁺) ∋ b, where Sgn(0) = [−1, 1].
It is the optimality condition of ½ v⁺ᵀA v⁺ − bᵀv⁺ + Σ w_i |v⁺_i|, strictly convex, so there is exactly one
solution and joints that stick come out at exactly zero. References: D. E. Stewart,
J. C. Trinkle, Int. J. Numer. Meth. Eng. 39 (1996) 2673-2691 (implicit time stepping with Coulomb friction);
H. Lee et al., NIPS 2006 (the active-set search, there for sparse coding: the same cost).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray

_MOST_PASSES = 100
"""Every pass lowers the cost and there are finitely many patterns; six joints have needed 14."""
_BOUND_SLACK = 1e-9


def solve_stick_slip(inertia: FloatArray, momentum: FloatArray, bound: FloatArray, guess: FloatArray) -> FloatArray:
    """The velocity after the step.

    An active-set search over the pattern (forward, stuck, backward): solve for the joints that slip; where
    one would turn round, go to the best place on the way there; where one that sticks is overcome, let the
    worst go.

    Args:
        inertia: (n, n) symmetric positive definite, kg·m².
        momentum: (n,) b above, N·m·s.
        bound: (n,) largest friction impulse w, N·m·s, not negative.
        guess: (n,) velocity to start from, rad/s; the nearer, the quicker.

    Returns:
        (n,) velocity, rad/s; exactly 0.0 where a joint sticks.
    """
    velocity, sign = guess, np.sign(guess)
    # A joint without friction never sticks, and its direction is no part of the pattern.
    free = bound == 0
    for _ in range(_MOST_PASSES):
        target = _for_pattern(inertia, momentum, bound, sign, free)
        if np.count_nonzero(free | (target * sign >= 0)) < len(free):
            velocity = _best_on_the_way(inertia, momentum, bound, velocity, target)
            sign = np.sign(velocity)
            continue
        velocity = target
        pull = momentum - inertia @ velocity
        overcome = np.where(free | (sign != 0), 0.0, np.abs(pull) - bound * (1 + _BOUND_SLACK))
        worst = int(overcome.argmax())
        if overcome[worst] <= 0:
            break
        sign = sign.copy()
        sign[worst] = np.sign(pull[worst])
    return velocity


def _for_pattern(
    inertia: FloatArray, momentum: FloatArray, bound: FloatArray, sign: FloatArray, free: NDArray[np.bool_]
) -> FloatArray:
    """The velocity if every joint had the direction `sign` says, 0: stuck."""
    slips = (free | (sign != 0)).astype(float)
    # Stuck joints stay in the system as 0 = 0, which is quicker than cutting it down.
    system = inertia * (slips[:, None] * slips)
    system.flat[:: len(slips) + 1] += 1.0 - slips
    return np.linalg.solve(system, slips * (momentum - bound * sign))


def _best_on_the_way(
    inertia: FloatArray, momentum: FloatArray, bound: FloatArray, start: FloatArray, target: FloatArray
) -> FloatArray:
    """The cheapest of `target` and the points on the way to it at which a joint stops, exactly."""
    candidates = []
    for joint in np.flatnonzero(np.sign(start) * target < 0):
        point = start + start[joint] / (start[joint] - target[joint]) * (target - start)
        point[joint] = 0.0
        candidates.append(point)
    # Last, so that a tie (a joint with next to no friction) ends in a stop and not in turning back for ever.
    candidates.append(target)
    costs = [0.5 * v @ inertia @ v - momentum @ v + bound @ np.abs(v) for v in candidates]
    return np.asarray(candidates[int(np.argmin(costs))])
