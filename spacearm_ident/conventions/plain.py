"""What is read off a recording without a model: joints at rest, torques that say nothing, velocity, clock."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..recording.corrections import Corrections
from ..recording.interleaved import TWO_SOURCES
from ..recording.log_mapping import VELOCITY_UNITS
from ..recording.recording import TEMPERATURE_UNIT, Recording
from ..signals.motion import STUCK_RAD
from .clock import clock_error_s
from .finding import Finding, Level

NO_STAMPS = "no_stamps"
"""Kind of the finding that times of arrival stand in for header stamps."""
CLOCK_JITTER = "clock_jitter"
"""Kind of the findings on stamps that are off the instants of sampling."""
REST_RAD = 1e-3
"""A joint that ranges over less is at rest: the resolution of common encoders behind a gear is finer."""
FIXED_RANGE = 0.02
"""Range from which a joint that is fixed in the arm moves, rad or m: a held one sways by less (`STUCK_RAD`), and a base
that tilts by so much turns 2 % of gravity."""
DEAD_SHARE = 1e-6
"""A torque that varies by less than this share of the largest joint's says nothing."""
MOST_ZERO = 0.5
"""Share of the samples in which a joint moves whose torque may be exactly zero; friction alone makes it another value.
No joint of 17 recordings of five real arms has one value, whichever, in more than 0.09; a driver's empty ones 0.9."""
OFF_S = 0.5
"""Length of the windows, half of it apart, in which drives are looked at for being off, s: several times what a
reversal takes, at which torque may pass zero."""
OFF_SHARE = 0.15
"""Torque RMS in such a window over that of the recording below which a joint's drive gives none, where all joints'
do. With currents zero but for a noise of half a per cent of the limits it is 0.06; the least of 23 sound recordings, 17
of them of real arms, 0.41 (docs/check.md). The geometric mean lies between."""
CARRIED_SHARE = 2.0 * OFF_SHARE
"""Travel in such a window over its RMS over the recording from which a joint moves that its drive does not: at so much
of the usual speed viscous friction alone would ask for twice `OFF_SHARE` of the torque."""
SLOPE_OFF = 0.1
"""Relative deviation of recorded from differentiated velocity from which it is another quantity."""
SHIFT_S = 0.03
"""Shift of recorded against differentiated velocity that is worth a note, s; filters of drives reach 10 to 20 ms."""
LEAST_CORRELATION = 0.5
"""Correlation below which recorded velocity is no derivative of the position at all."""
JITTER_RATIO = 2.0
"""How many times smoother positions must be over an even clock than over the stamps for the stamps to be wrong."""
JITTER_S = 0.002
"""RMS error of stamps from which the data are unfit, s: a joint at 1 rad/s is then 2 mrad off, 20 times an encoder."""
JITTER_SEEN = 0.1
"""Share of `JITTER_S` above which an error of stamps is distinguished from the noise of positions: 0.2 ms, at 1 rad/s
the noise of an encoder."""
UNEVEN, FEWEST_UNEVEN = 0.1, 20
"""Distance of a stamp from the middle of its neighbours', as a share of theirs, from which it tells even time from the
stamps; and the fewest such positions that are judged."""
LOST_SHARE = 0.05
"""Share of samples lost to stamps out of order from which the clock is not to be believed."""
LET_MOVE = "record a run in which they move, or take their parameters for CAD's"
"""Remedy for joints at rest."""
LET_MOVE_FASTER = "record a run in which they move faster, or with finer positions"
"""Remedy for joints whose speed is lost in the noise of their positions."""
HEADER_STAMPS = "publish joint states with header stamps taken at the sampling instant, and record again"
"""Remedy where the time of recording stands in for them."""
IN_CELSIUS = "publish degrees Celsius (sensor_msgs/msg/Temperature) and record again for friction over temperature"
"""Remedy for temperatures in another unit."""
LOCK = "or lock them where they are (spacearm new-arm URDF --joints NAME ... --lock NAME=VALUE ...) and give that --arm"
"""Further remedy for joints at rest whose torque is constant: often a torso, a head or a gripper, and not the arm's."""


@dataclass(frozen=True)
class Plain:
    """What was read off.

    Attributes:
        findings: As they are.
        still: Numbers of the joints at rest.
        dead: Numbers of the joints whose torque says nothing.
        velocity_slopes: (n,) recorded over differentiated velocity; NaN where there is nothing to compare.
        clock_error_s: RMS error of the stamps as positions show it, s; 0 where they show none.
    """

    findings: tuple[Finding, ...]
    still: frozenset[int]
    dead: frozenset[int]
    velocity_slopes: FloatArray
    clock_error_s: float = 0.0


def read_off(recording: Recording) -> Plain:
    """Look at one recording, its columns in the arm's order."""
    names = recording.joints
    still = frozenset(np.flatnonzero(np.ptp(recording.position, axis=0) < REST_RAD).tolist())
    spread = recording.effort.std(axis=0)
    constant = spread <= DEAD_SHARE * max(float(spread.max()), 1e-9)
    dead = frozenset(np.flatnonzero(constant | (zero_share(recording) > MOST_ZERO)).tolist())
    findings = [*_rest(names, still, dead), *_dead(recording, dead - still, constant), *_off(recording, still, dead)]
    slopes, velocity = compare_velocity(recording, still)
    if _on_arrival(recording):
        # What is wrong with the velocity itself is wrong over an even clock as well; the rest is the arrival's.
        slopes, evenly = compare_velocity(Corrections(clock="even").applied(recording), still)
        told = {one.joints for one in velocity}
        velocity = [one for one in evenly if one.joints in told]
    error_s = clock_error_s(recording)
    findings = [*_arrival(recording), *findings, *velocity, *_clock(recording, error_s), *_temperatures(recording)]
    return Plain(tuple(findings), still, dead, slopes, error_s)


def _arrival(recording: Recording) -> list[Finding]:
    """That there are no header stamps: what explains uneven times and a poor fit, and so the first to be mended."""
    if not _on_arrival(recording):
        return []
    text = (
        "the header stamps carry no time (zero, or all the same); times of arrival stand in for them, late by an "
        "unknown time that changes: uneven times, noisy speeds and a poor fit follow from that"
    )
    return [Finding(NO_STAMPS, Level.NOTE, (), text, HEADER_STAMPS)]


def _temperatures(recording: Recording) -> list[Finding]:
    """That temperatures are in another unit: a note, as they are left out, and friction over temperature is refused."""
    return [
        Finding(TEMPERATURE_UNIT, Level.NOTE, (), issue.message, IN_CELSIUS)
        for issue in recording.issues
        if issue.kind == TEMPERATURE_UNIT
    ]


def _rest(names: tuple[str, ...], still: frozenset[int], dead: frozenset[int]) -> list[Finding]:
    if not still:
        return []
    joints = tuple(names[k] for k in sorted(still))
    every = len(joints) == len(names)
    text = "no joint moves" if every else f"{', '.join(joints)} {'does' if len(joints) == 1 else 'do'} not move"
    what = "record an excitation run" if every else LET_MOVE
    if not every and still & dead:
        what = f"{what}, {LOCK}"
    level = Level.UNFIT if every else Level.NOTE
    return [Finding("at_rest", level, joints, f"{text} (less than {REST_RAD:g} rad)", what)]


def without_motion(recording: Recording, joints: Sequence[str], clock_error_s: float) -> list[Finding]:
    """What is said of joints of which no uninterrupted motion remains, though they are not at rest.

    Args:
        recording: That they are in.
        joints: Their names.
        clock_error_s: `Plain.clock_error_s`.
    """
    ranges = {name: float(np.ptp(recording.position[:, recording.joints.index(name)])) for name in joints}
    moving = [name for name in joints if ranges[name] > STUCK_RAD]
    hardly = tuple(name for name in joints if name not in moving)
    findings = []
    if hardly:
        verb = "moves" if len(hardly) == 1 else "move"
        findings.append(Finding("at_rest", Level.NOTE, hardly, f"{', '.join(hardly)} hardly {verb}", LET_MOVE))
    if moving:
        sizes = ", ".join(f"{name} by {ranges[name]:.2g} rad" for name in moving)
        text = f"the speed of {', '.join(moving)} nowhere stands out of the noise, though they move ({sizes})"
        if clock_error_s > JITTER_SEEN * JITTER_S:
            findings.append(_uneven(recording, clock_error_s, f"; {text}"))
        else:
            findings.append(Finding("position_noise", Level.NOTE, tuple(moving), text, LET_MOVE_FASTER))
    return findings


def _on_arrival(recording: Recording) -> bool:
    """Whether the time of recording stands in for header stamps that carry none."""
    return any(issue.kind == "log_time_used" for issue in recording.issues)


def two_sources(recording: Recording) -> list[Finding]:
    """That what was recorded are joint states of two sources by turns, as the reader found; no motion and no clock."""
    remedy = (
        "publish the arm's joint states from one node: end the others ('ros2 topic info -v' on the topic names them), "
        "or let them publish another topic, and record again"
    )
    return [
        Finding(TWO_SOURCES, Level.UNFIT, (), issue.message, remedy, values={"samples": issue.count})
        for issue in recording.issues
        if issue.kind == TWO_SOURCES
    ]


def _uneven(recording: Recording, error_s: float, effect: str = "") -> Finding:
    """The finding that stamps deviate from the sampling instants and that no even clock corrects them."""
    arrival = _on_arrival(recording)
    what = "times of arrival, used for want of header stamps," if arrival else "stamps"
    text = (
        f"the {what} are too uneven to differentiate positions: about {error_s * 1e3:.2g} ms RMS off the sampling "
        f"instants, or more{effect}"
    )
    remedy = HEADER_STAMPS if arrival else "stamp joint states at the sampling instant, and record again"
    return Finding(CLOCK_JITTER, Level.UNFIT, (), text, remedy, values={"rms_s": error_s})


def zero_share(recording: Recording) -> FloatArray:
    """(n,) share of the samples in which a joint moves whose effort is exactly zero; zero where it never moves."""
    moves = np.diff(recording.position, axis=0, prepend=recording.position[:1]) != 0.0
    return np.asarray((moves & (recording.effort == 0.0)).sum(axis=0) / np.maximum(moves.sum(axis=0), 1))


def _dead(recording: Recording, dead: frozenset[int], constant: NDArray[np.bool_]) -> list[Finding]:
    """The joints among these, which move, whose torque says nothing; of a joint at rest it need not say anything."""
    remedy = "have the driver publish the joint's torque in JointState.effort and record again"
    shares = zero_share(recording)
    said: dict[str, list[str]] = {}
    for k in sorted(dead):
        zero = "zero throughout" if not recording.effort[0, k] else "constant throughout"
        what = zero if constant[k] else f"exactly zero in {shares[k]:.0%} of the samples in which it moves"
        said.setdefault(what, []).append(recording.joints[k])
    return [
        Finding("no_effort", Level.UNFIT, tuple(joints), f"the effort of {', '.join(joints)} is {what}", remedy)
        for what, joints in said.items()
    ]


def _off(recording: Recording, still: frozenset[int], dead: frozenset[int]) -> list[Finding]:
    """When the arm moved though no joint had torque: carried by hand, or fallen, with the drives off.

    A joint that a drive moves takes its friction at least, and an arm that stands or moves against gravity its weight.
    """
    told = sorted(set(range(len(recording.joints))) - dead)
    moved = sorted(set(range(len(recording.joints))) - still)
    if not told or not moved:
        return []
    size = max(4, round(OFF_S * recording.rate_hz))
    starts = [k for part in recording.segments for k in range(part.start, part.stop - size + 1, max(1, size // 2))]
    if not starts:
        return []
    torque = np.array([np.sqrt(np.mean(recording.effort[k : k + size, told] ** 2, axis=0)) for k in starts])
    travel = np.array([np.ptp(recording.position[k : k + size, moved], axis=0) for k in starts])
    usual = np.sqrt(np.mean(recording.effort[:, told] ** 2, axis=0))
    off = np.all(torque < OFF_SHARE * usual, axis=1)
    carried = (travel > REST_RAD) & (travel > CARRIED_SHARE * np.sqrt(np.mean(travel**2, axis=0)))
    spans: list[tuple[float, float]] = []
    for window in np.flatnonzero(off & carried.any(axis=1)):
        first, last = recording.time[starts[window]], recording.time[starts[window] + size - 1]
        if spans and first <= spans[-1][1]:
            spans[-1] = (spans[-1][0], float(last))
        else:
            spans.append((float(first), float(last)))
    if not spans:
        return []
    times = [(round(first - recording.time[0], 2), round(last - recording.time[0], 2)) for first, last in spans]
    words = ", ".join(f"from {first:.1f} to {last:.1f} s" for first, last in times)
    text = f"the arm moves though no joint has torque, {words}: the drives were off (emergency stop, carried by hand)"
    remedy = f"record again, or cut these seconds, and {OFF_S:g} s on either side, out of the log: a gap is left out"
    return [Finding("drives_off", Level.UNFIT, (), text, remedy, values={"from_to_s": times})]


def _blocks(recording: Recording, length_s: float = 0.04) -> list[tuple[FloatArray, FloatArray, float]]:
    """Way by the recorded velocity, way by positions, and duration of the blocks of every segment.

    Ways, not speeds: messages that are stamped together on arrival span no time, and over it a speed without bound.
    """
    assert recording.velocity is not None
    size = max(4, round(length_s * recording.rate_hz))
    found = []
    for segment in recording.segments:
        time, position = recording.time[segment], recording.position[segment]
        count = (len(time) - 1) // size
        if count < 20:
            continue
        ends = np.arange(count + 1) * size
        # The integral over a block, by the trapezoidal rule, is the difference of its ends.
        step = np.diff(time)[:, None]
        area = 0.5 * (recording.velocity[segment][1:] + recording.velocity[segment][:-1]) * step
        total = np.add.reduceat(area[: ends[-1]], ends[:-1], axis=0)
        found.append((total, np.diff(position[ends], axis=0), float(np.median(np.diff(time[ends])))))
    return found


def compare_velocity(recording: Recording, still: frozenset[int]) -> tuple[FloatArray, list[Finding]]:
    """Recorded over differentiated velocity (n,), and what is wrong with the recorded one.

    Args:
        recording: With or without velocities.
        still: Numbers of the joints that stand still.

    Returns:
        (n,) ratios, NaN where nothing can be said; and findings.
    """
    n = len(recording.joints)
    slopes = np.full(n, np.nan)
    if recording.velocity is None:
        return slopes, []
    blocks = _blocks(recording)
    if not blocks:
        return slopes, []
    findings = []
    for k in range(n):
        if k in still:
            continue
        shift, correlation, slope = best_shift([(a[:, k], b[:, k], step) for a, b, step in blocks])
        slopes[k] = slope if abs(correlation) > LEAST_CORRELATION else np.nan
        text = _velocity_words(slope, correlation, shift)
        if text is not None:
            values = {"slope": round(slope, 5), "correlation": round(correlation, 4), "shift_s": round(shift, 4)}
            findings.append(
                Finding(
                    "velocity",
                    Level.NOTE,
                    (recording.joints[k],),
                    f"the recorded velocity of {recording.joints[k]} {text}",
                    "the recorded velocity is not used here (positions are differentiated); mend the driver for others",
                    values=values,
                )
            )
    return slopes, findings


def best_shift(parts: list[tuple[FloatArray, FloatArray, float]]) -> tuple[float, float, float]:
    """Shift (s, positive: recorded late), correlation and slope at which recorded is nearest to derived velocity."""
    best = (0.0, 0.0, 0.0)
    scores = {}
    for lag in range(-8, 9):
        pairs = [_shifted(a, b, lag) for a, b, _ in parts]
        a, b = np.concatenate([p[0] for p in pairs]), np.concatenate([p[1] for p in pairs])
        size = float(np.sqrt((a @ a) * (b @ b)))
        scores[lag] = float(a @ b) / size if size > 0 else 0.0
        if abs(scores[lag]) > abs(best[1]):
            best = (float(lag), scores[lag], float(a @ b) / float(b @ b))
    lag = int(best[0])
    fine = 0.0
    if lag - 1 in scores and lag + 1 in scores:
        left, centre, right = (abs(scores[k]) for k in (lag - 1, lag, lag + 1))
        bend = left - 2 * centre + right
        fine = 0.5 * (left - right) / bend if bend < 0 else 0.0
    return (lag + fine) * parts[0][2], best[1], best[2]


def _shifted(a: FloatArray, b: FloatArray, lag: int) -> tuple[FloatArray, FloatArray]:
    """`a` taken `lag` blocks later than `b`."""
    if lag > 0:
        return a[lag:], b[:-lag]
    return (a[:lag], b[-lag:]) if lag < 0 else (a, b)


def _velocity_words(slope: float, correlation: float, shift: float) -> str | None:
    if abs(correlation) < LEAST_CORRELATION:
        return f"is not the derivative of its position (correlation {correlation:.2f})"
    turned = np.pi / 180
    if abs(abs(slope) / turned - 1) < SLOPE_OFF:
        return "is in rad/s where the position is in degrees"
    if abs(abs(slope) * turned - 1) < SLOPE_OFF:
        return "is in degrees/s where the position is in radians"
    if abs(abs(slope) * VELOCITY_UNITS["rpm"] - 1) < SLOPE_OFF:
        return "is in rpm where the position is in radians"
    if abs(slope + 1) < SLOPE_OFF:
        return "has the opposite sign of its position's derivative"
    if abs(slope - 1) > SLOPE_OFF:
        return f"is {slope:.3g} times its position's derivative"
    if abs(shift) > SHIFT_S:
        return f"is {abs(shift) * 1e3:.0f} ms {'late' if shift > 0 else 'early'} against its position's derivative"
    return None


def _clock(recording: Recording, error_s: float) -> list[Finding]:
    """What the reader found wrong with stamps, and whether they are less even than the motion.

    Args:
        recording: With its issues.
        error_s: RMS error of the stamps as positions show it, s.
    """
    findings = []
    samples, arrival = len(recording.time), _on_arrival(recording)
    for issue in recording.issues:
        if issue.kind == "backward_clock":
            remedy = "stamp joint states with a clock that counts up; check the result against another run"
            findings.append(Finding("clock_backward", Level.UNFIT, (), issue.message, remedy))
        if issue.kind in ("backward_stamp", "repeated_stamp", "zero_stamp"):
            lost = issue.count / (samples + issue.count)
            level = Level.UNFIT if lost > LOST_SHARE else Level.NOTE
            text = f"{issue.message} ({lost:.1%} of the samples)"
            remedy = "stamp every joint state when it is sampled, by one steady clock"
            if issue.kind == "repeated_stamp" and arrival:
                remedy = f"{HEADER_STAMPS}; a recorder with use_sim_time repeats the times of a slow /clock"
            findings.append(Finding("clock_order", level, (), text, remedy, values={"share": round(lost, 4)}))
    found = jitter(recording)
    if found is not None:
        ratio, rms_s = found
        if ratio > JITTER_RATIO and rms_s > JITTER_SEEN * JITTER_S:
            what = "times of arrival" if arrival else "stamps"
            text = (
                f"the {what} jitter by {rms_s * 1e3:.2g} ms RMS where the samples are even: positions are "
                f"{ratio:.1f} times smoother over an even clock"
            )
            stamp = HEADER_STAMPS if arrival else "stamp at the sampling instant, not on arrival"
            remedy = f"{stamp}; 'corrections: {{clock: even}}' in the arm YAML mends it"
            level = Level.UNFIT if rms_s > JITTER_S else Level.NOTE
            values = {"rms_s": rms_s, "ratio": round(ratio, 2)}
            return [*findings, Finding(CLOCK_JITTER, level, (), text, remedy, values=values)]
    return [*findings, _uneven(recording, error_s)] if error_s > JITTER_S else findings


def jitter(recording: Recording) -> tuple[float, float] | None:
    """How many times smoother positions are over even time than over the stamps, and the stamps' RMS error, s.

    Each position is predicted from its neighbours by a straight line, over the stamps and over the sample number; of
    samples whose stamp is near the middle of its neighbours' both say the same, and they are left out.
    """
    over_stamps = over_numbers = errors = 0.0
    count = decided = 0
    for segment in recording.segments:
        time, position = recording.time[segment], recording.position[segment]
        if len(time) < 100:
            continue
        share = ((time[1:-1] - time[:-2]) / (time[2:] - time[:-2]))[:, None]
        by_stamp = position[1:-1] - (1 - share) * position[:-2] - share * position[2:]
        by_number = position[1:-1] - 0.5 * (position[:-2] + position[2:])
        speed = np.abs(position[2:] - position[:-2])
        fast = speed > np.percentile(speed, 70, axis=0)
        uneven = fast & (np.abs(share - 0.5) > UNEVEN)
        over_stamps += float(np.sum(by_stamp[uneven] ** 2))
        over_numbers += float(np.sum(by_number[uneven] ** 2))
        decided += int(uneven.sum())
        # The centre's stamp against the middle of its neighbours' has 1.5 times the variance of one stamp.
        errors += float(np.sum((time[1:-1] - 0.5 * (time[:-2] + time[2:])) ** 2)) / 1.5
        count += len(time) - 2
    if decided < FEWEST_UNEVEN or over_numbers <= 0:
        return None
    return float(np.sqrt(over_stamps / over_numbers)), float(np.sqrt(errors / count))
