"""An excitation that tells most, under all limits: seeded global start, then descent with exact derivatives.

Random series are drawn and scored; the best are descended from (`descent`) with a blurred criterion on few samples,
the best of these with ever sharper ones. Motion limits are linear in the coefficients and hold throughout; torque and
clearance are barriers inside the function. What comes out is judged anew, exactly, on a fine grid: should a peak
between samples break a limit, the motion is drawn towards rest in the start posture until all hold.

`Excitation` is the answer, whatever method finds it (`genetic` is the paper's).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..arrays import FloatArray
from ..errors import UserError
from .constraints import Margin, broken, check, require
from .criteria import CRITERIA, D_OPTIMAL, PREDICTION, Information
from .descent import Function, descend
from .problem import BARRIERS, Problem
from .segments import Rest
from .trajectory import FourierTrajectory, Trajectory, draw_coefficients

Progress = Callable[[float, str], None]

DRAWN, DESCENDED = 32, 2
STAGES = ((6.0, 0.10, 40, 1e-2), (16.0, 0.06, 60, 3e-3), (64.0, 0.04, 40, 1e-3))
"""Sharpness, softness of the direction of motion (share of the velocity limit), steps, tolerance."""
DRAWN_TOGETHER = 0.1
"""A criterion (logarithm) worse by more after the last check: the motion was made much smaller, another is tried."""
FINER = 4
"""Samples of the descent that follows such a motion, over the usual: clearance every 80 ms of a period of 10 s."""
SHRINK = (1.0, 0.7, 0.45, 0.25, 0.12, 0.05, 0.02)
INFORMATION_HZ = 200.0
"""Samples a second of the exact criterion: against 500 the logarithm moves by at most 1e-4 (six runs of three arms,
2026-11-25), a three-hundredth of `WORTH_A_HARMONIC`."""
RATE_HZ = 1000.0
WAY_HOME = (0.75, 0.5, 0.25, 0.1)
"""Shares of a motion about its start posture at which it is examined, too, before it is descended from; ratio."""
LARGEST_HARMONICS = 10
GENTLE = 0.4
"""Share of the velocity and acceleration limits that a first run uses, and of the way from its start posture."""
GENTLE_PERIODS = 2
WORTH_A_HARMONIC = 0.03
"""A further harmonic is taken if it lowers the criterion by this share (of standard errors, or of the condition)."""
NO_BETTER = 1e-3
"""Gain (logarithm) below which a search with one harmonic more failed: all that fewer can do is open to it."""


@dataclass(frozen=True)
class Excitation:
    """An excitation found.

    Attributes:
        problem: What was asked.
        series: The periodic part.
        run: All of it, from rest to rest.
        information: What one period tells, exactly.
        margins: Every limit along the run.
        tried: Criterion value by number of harmonics, where several were.
    """

    problem: Problem
    series: FourierTrajectory
    run: Trajectory
    information: Information
    margins: tuple[Margin, ...]
    tried: tuple[tuple[int, float], ...] = ()

    @cached_property
    def criteria(self) -> dict[str, float]:
        """All criteria; `prediction` is the root mean square of the predicted torque's sd over its noise."""
        sd = self.prediction_sd
        return {
            **self.information.values(),
            PREDICTION: float(np.sqrt(np.mean((sd / self.information.noise_Nm) ** 2))),
        }

    @property
    def samples(self) -> float:
        """Samples in the periodic part at `RATE_HZ`."""
        return self.series.duration_s * RATE_HZ

    @cached_property
    def prediction_sd(self) -> FloatArray:
        """(n,) N·m, of torque predicted on the test motions after this run, under independent noise."""
        return self.information.prediction_sd(self.problem.test_information, self.samples)

    @cached_property
    def value(self) -> float:
        """The criterion as a logarithm, as `exact_value` of the series."""
        return _value(self.problem, self.information)


def optimise(
    problem: Problem, seed: int = 0, progress: Progress | None = None, known: FourierTrajectory | None = None
) -> Excitation:
    """The default method.

    Args:
        problem: What is wanted.
        seed: Same seed, same trajectory.
        progress: Called with the share done and what is going on.
        known: A good series of no more harmonics, to start from as well.

    Raises:
        UserError: The limits leave no motion: which, by how much, and what to do.
    """
    report = progress or (lambda share, what: None)
    check_start(problem)
    rng = np.random.default_rng(seed)
    sharpness, softness, steps, tolerance = STAGES[0]
    function = problem.function(sharpness, softness)
    report(0.0, "drawing starts")
    values = problem.function(sharpness, softness, slopes=False)
    drawn = draw_feasible(problem, values, rng, DRAWN)
    starts = [*known_point(problem, function, known), *_reachable(problem, values, drawn, DESCENDED)]
    found = []
    for number, (_, point) in enumerate(starts):
        share = 0.5 / len(starts)
        stage = _staged(report, 0.1 + share * number, share, steps, f"descent {number + 1} of {len(starts)}")
        found.append(descend(function, point, problem.space.rows, steps, tolerance, stage))
    # A descent may end where clearance is broken between samples, or where rest cannot be reached: then the next one is
    # refined as well.
    refusal = UserError()
    finished: list[Excitation] = []
    for descent in sorted(found, key=lambda descent: descent.value):
        valued = _refined(problem, descent.point, report)
        for _, point in known_point(problem, function, known):
            valued.append((exact_value(problem, problem.space.series(point, 1)), point))
        try:
            finished.append(_best_finished(problem, valued))
        except UserError as error:
            refusal = error
            continue
        enough = valued[0][0] + DRAWN_TOGETHER
        if known is not None or finished[-1].value < enough:
            break  # what is known already is the way out of a failure, and cheaper
        finished.append(_between_closer_samples(problem, finished[-1], report))
        if finished[-1].value < enough:
            break
    if not finished:
        raise refusal
    return min(finished, key=lambda excitation: excitation.value)


def _refined(problem: Problem, point: FloatArray, report: Progress) -> list[tuple[float, FloatArray]]:
    """A descent's end and what each further stage makes of it, with `exact_value`, the best first.

    Sharper is not always better once judged exactly.
    """
    points = [point]
    for number, (sharpness, softness, steps, tolerance) in enumerate(STAGES[1:]):
        function = problem.function(sharpness, softness)
        if np.isfinite(function(points[-1])[0]):
            stage = _staged(report, 0.6 + 0.15 * number, 0.15, steps, "refining")
            points.append(descend(function, points[-1], problem.space.rows, steps, tolerance, stage).point)
    report(0.9, "checking all limits")
    return sorted(
        ((exact_value(problem, problem.space.series(one, 1)), one) for one in points), key=lambda pair: pair[0]
    )


def _between_closer_samples(problem: Problem, excitation: Excitation, report: Progress) -> Excitation:
    """The excitation descended from again with more samples; the same where that is not possible.

    Limits broken between the samples leave a motion much smaller than it need be.
    """
    sharpness, softness, steps, tolerance = STAGES[1]
    function, point = problem.function(sharpness, softness, FINER), problem.space.point(excitation.series)
    point = point / np.maximum(1.0, problem.space.usage(point))[:, None]
    if not np.isfinite(function(point)[0]):
        return excitation
    stage = _staged(report, 0.95, 0.05, steps, "again between closer samples")
    again = descend(function, point, problem.space.rows, steps, tolerance, stage).point
    return _best_finished(problem, [(excitation.value, again), (excitation.value, point)])


def _best_finished(problem: Problem, valued: Sequence[tuple[float, FloatArray]]) -> Excitation:
    """The first point that `finish` leaves nearly as good as it was; where it draws all of them together, the best.

    Args:
        problem: What is wanted.
        valued: `exact_value` of a point, and the point.

    Raises:
        UserError: None can be joined within the limits.
    """
    refusal = UserError()
    found: list[Excitation] = []
    for value, point in valued:
        try:
            found.append(finish(problem, point))
        except UserError as error:
            refusal = error
            continue
        if found[-1].value < value + DRAWN_TOGETHER:
            break
    if not found:
        raise refusal
    return min(found, key=lambda excitation: excitation.value)


def optimise_harmonics(
    problem: Problem, seed: int = 0, progress: Progress | None = None, method: Callable[..., Excitation] = optimise
) -> Excitation:
    """The smallest N_h whose successor no longer lowers the criterion by `WORTH_A_HARMONIC`, from 3 upwards.

    A successor that gains nothing at all has found no better optimum, which says nothing of the next: that is tried.

    Args:
        problem: What is wanted; its `harmonics` are replaced.
        seed: Seed of every optimisation.
        progress: Called with the share done and what is going on.
        method: Optimiser for a given N_h, with the arguments of `optimise`.

    Raises:
        UserError: As `optimise`.
    """
    report = progress or (lambda share, what: None)
    highest = LARGEST_HARMONICS
    if problem.needs.structural_hz is not None:
        highest = min(highest, int(problem.needs.structural_hz / problem.fundamental_hz + 1e-9))
    first = min(3, max(1, highest))
    best: Excitation | None = None
    tried: list[tuple[int, float]] = []
    failed = False
    for harmonics in range(first, max(first, highest) + 1):
        begin = (harmonics - first) / (highest - first + 1)
        part = _part(report, begin, 1.0 / (highest - first + 1), f"{harmonics} harmonics: ")
        candidate = method(replace(problem, harmonics=harmonics), seed, part, best and best.series)
        tried.append((harmonics, candidate.criteria[problem.criterion]))
        if best is None or candidate.value < best.value - WORTH_A_HARMONIC:
            best, failed = candidate, False
        elif failed or candidate.value < best.value - NO_BETTER:
            break
        else:
            failed = True
    assert best is not None
    return replace(best, tried=tuple(tried))


def check_start(problem: Problem) -> None:
    """Refuse what no motion can mend: the excited frequency, and the start posture itself.

    Raises:
        UserError: Which limit, by how much, and what to do.
    """
    if problem.criterion not in CRITERIA:
        raise UserError(f"no criterion {problem.criterion!r}: choose one of {', '.join(CRITERIA)}")
    highest, structural = problem.harmonics * problem.fundamental_hz, problem.needs.structural_hz
    if structural is not None and highest > structural:
        most = int(structural / problem.fundamental_hz + 1e-9)
        raise UserError(
            f"{problem.harmonics} harmonics of {problem.fundamental_hz:g} Hz reach {highest:g} Hz, "
            f"{highest - structural:.3g} Hz above the structural frequency {structural:g} Hz; "
            + (f"give --harmonics {most} at most, or a" if most else "give a")
            + " lower --fundamental"
        )
    try:
        require(check(Trajectory(problem.joints, (Rest(problem.start, 0.1),)), problem.needs))
    except UserError as error:
        raise UserError(f"already at rest in the start posture, {error}") from None


def draw_feasible(
    problem: Problem, function: Function, rng: np.random.Generator, count: int
) -> list[tuple[float, FloatArray]]:
    """Random points where all limits hold at the samples, best first; drawn towards rest until they do.

    Args:
        problem: What is wanted.
        function: Criterion of a point, infinite where a limit of torque or clearance is broken.
        rng: Source of the random series.
        count: Series drawn; those that cannot be made feasible are left out.

    Returns:
        At most `count` pairs of value and point (n, 1 + 2 N_h).

    Raises:
        UserError: None does however small; the arm can only rest in its start posture. The limit, and what to do.
    """
    drawn = []
    for _ in range(count):
        coefficients = draw_coefficients(
            rng, problem.needs.motion, problem.fundamental_hz, problem.harmonics, (0.5, 0.9)
        )
        a, b, centre = coefficients
        point = problem.space.point(FourierTrajectory(problem.joints, centre, a, b, problem.fundamental_hz, 1))
        point /= np.maximum(1.0, problem.space.usage(point) / 0.95)[:, None]
        for share in SHRINK:
            shrunk = problem.home + share * (point - problem.home)
            value, _ = function(shrunk)
            if np.isfinite(value):
                drawn.append((value, shrunk))
                break
    if not drawn:
        smallest = problem.space.series(problem.home + SHRINK[-1] * (point - problem.home), 1)
        margins = check(Trajectory(problem.joints, (smallest,)), problem.needs)
        require(margins)
        # The check allows for rounding, the barriers of torque and clearance do not.
        tightest = max((margin for margin in margins if margin.kind in BARRIERS), key=lambda margin: margin.used)
        raise UserError(f"no motion about the start posture keeps all limits; the tightest: {tightest.complaint()}")
    return sorted(drawn, key=lambda pair: pair[0])


def _reachable(
    problem: Problem, function: Function, drawn: Sequence[tuple[float, FloatArray]], count: int
) -> list[tuple[float, FloatArray]]:
    """The best `count` drawn points that keep all limits on the whole way towards rest in the start posture.

    The others move where only a detour leads, as round the floor: such a motion can neither be joined to the start
    posture by one smooth move nor be drawn together where a peak between samples breaks a limit. They fill up.
    """
    near: list[tuple[float, FloatArray]] = []
    far: list[tuple[float, FloatArray]] = []
    for value, point in drawn:
        if len(near) == count:
            break
        ways = (function(problem.home + share * (point - problem.home))[0] for share in WAY_HOME)
        (near if all(np.isfinite(way) for way in ways) else far).append((value, point))
    return [*near, *far][:count]


def known_point(
    problem: Problem, function: Function, series: FourierTrajectory | None
) -> list[tuple[float, FloatArray]]:
    """Value and point of a series already known, where it keeps all limits here, else nothing.

    Args:
        problem: What is wanted.
        function: Criterion of a point, infinite where a limit of torque or clearance is broken.
        series: A series of the problem's joints and fundamental; None, or one of more harmonics than the problem's,
            gives nothing. It is scaled down where it breaks a motion limit.

    Returns:
        One pair of value and point (n, 1 + 2 N_h), or none.
    """
    if series is None or series.a.shape[1] > problem.harmonics:
        return []
    point = problem.space.point(series)
    point = point / np.maximum(1.0, problem.space.usage(point))[:, None]
    value, _ = function(point)
    return [(value, point)] if np.isfinite(value) else []


def exact_value(problem: Problem, series: FourierTrajectory) -> float:
    """The criterion of a series as a logarithm, from exact columns on a fine grid.

    Args:
        problem: Arm, limits and criterion.
        series: A periodic trajectory.
    """
    times = np.arange(0.0, series.period_s, 1.0 / INFORMATION_HZ)
    return _value(problem, problem.question.information(series.evaluate(times), INFORMATION_HZ))


def _value(problem: Problem, information: Information) -> float:
    if problem.criterion == D_OPTIMAL:
        return information.values()[D_OPTIMAL] / 2
    if problem.criterion == PREDICTION:
        sd = information.prediction_sd(problem.test_information, 1.0) / information.noise_Nm
        return float(np.log(np.mean(sd**2)) / 2)
    return float(np.log(information.values()[problem.criterion]))


def finish(problem: Problem, point: FloatArray) -> Excitation:
    """Judge a point exactly, shrink it where a limit is broken between samples, and join it to the start posture.

    Args:
        problem: Arm, limits and criterion.
        point: (n, 1 + 2 N_h) of the series space.

    Raises:
        UserError: It cannot be joined within the limits.
    """
    point = point / np.maximum(1.0, problem.space.usage(point))[:, None]
    for share in (1.0, 0.99, 0.98, 0.96, 0.93, 0.9, 0.85, 0.8, 0.7, 0.5, 0.3, 0.1):
        shrunk = problem.home + share * (point - problem.home)
        series = problem.space.series(shrunk, problem.periods)
        margins = broken(Trajectory(problem.joints, (replace(series, periods=1),)), problem.needs)
        if not margins:
            break
    else:
        require(margins)
    series, run = join(problem, series)
    times = np.arange(0.0, series.period_s, 1.0 / INFORMATION_HZ)
    information = problem.question.information(series.evaluate(times), INFORMATION_HZ)
    found = check(run, problem.needs)
    require(found)
    return Excitation(problem, series, run, information, found)


def gentle(excitation: Excitation) -> Excitation:
    """The same motion drawn together about its start posture, slower to approach: for the first run on an arm.

    What is wrong with a limit, a sign or a brake shows at a share `GENTLE` of everything.

    Raises:
        UserError: It cannot be joined within the limits.
    """
    full = excitation.problem
    motion = full.needs.motion
    slower = replace(motion, velocity=GENTLE * motion.velocity, acceleration=GENTLE * motion.acceleration)
    problem = replace(full, needs=replace(full.needs, motion=slower), periods=GENTLE_PERIODS)
    series = excitation.series
    drawn = replace(series, q0=full.start + GENTLE * (series.q0 - full.start), a=GENTLE * series.a, b=GENTLE * series.b)
    return finish(problem, problem.space.point(drawn))


def join(problem: Problem, series: FourierTrajectory) -> tuple[FourierTrajectory, Trajectory]:
    """The series begun at a phase from which approach and return keep every limit, and the whole run.

    Args:
        problem: With the start posture and the limits.
        series: Within the limits by itself.

    Raises:
        UserError: There is no such phase: the limit broken least.
    """
    least = np.inf
    refusal = UserError("the excitation cannot be joined to the start posture; choose another with --start")
    for begun, run in series.runs_by_phase(problem.needs.motion, problem.start, problem.rest_s):
        place = run.segments.index(begun)
        parts = (run.segments[:place], run.segments[place + 1 :])
        margins = [margin for part in parts for margin in broken(Trajectory(run.joints, part), problem.needs)]
        if not margins:
            return begun, run
        worst = max(margins, key=lambda margin: margin.used)
        if worst.used < least:
            least = worst.used
            refusal = UserError(f"on the way between start posture and excitation, {worst.complaint()}")
    raise refusal


def _staged(report: Progress, begin: float, length: float, steps: int, what: str) -> Callable[[int, float], None]:
    return lambda step, value: report(begin + length * min(1.0, step / steps), f"{what}: {value:.3f}")


def _part(report: Progress, begin: float, length: float, prefix: str) -> Progress:
    return lambda share, what: report(begin + length * share, prefix + what)
