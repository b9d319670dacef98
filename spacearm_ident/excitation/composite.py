"""Excitation for effects that a periodic run at full speed does not excite: one motion for each purpose.

| purpose | motion | what is observed |
|---|---|---|
| ripple | each joint alone over its free range, two constant speeds, both directions | torque against position |
| presliding | all joints, slow sines of growing amplitude | friction against distance after a reversal |
| stribeck | all joints, two slow sines, then constant speeds to 0.1 rad/s | friction against speed |
| temperature | all joints there and back at three constant speeds, again and again | friction against temperature |
| elasticity | each joint alone, chirps band by band at half its acceleration limit | resonance, delay, filter |

Everything starts and ends at rest in the start posture. A motion that breaks a limit is made smaller until it keeps
all of them; `constraints.check` decides, on the whole run.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray
from ..dynamics.arm import Arm
from ..dynamics.effects import EFFECTS
from ..errors import UserError
from .constraints import Requirements, allowed_torque, check, model_torque, require
from .nominal import nominal_model
from .segments import Chirp, Cruise, Motion, MotionLimits, Quintic, Rest, Segment, still
from .trajectory import FourierTrajectory, Trajectory, random_feasible

SLOW_RAD_S = 0.01
"""Fastest speed of a slow segment."""
SLOW_PERIOD_S = 10.0
SLOWER_SHARE = 0.3
"""The second slow sine's share of it: the slower, the longer a low-passed torque stays inside the peak."""
AMPLITUDES_RAD = (1e-3, 3e-3, 1e-2, 3e-2)
SPEEDS_RAD_S = (5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 3e-2, 1e-1)
TEMPERATURE_SHARES = (0.05, 0.2, 0.6)
TEMPERATURE_REPEATS = 3
BANDS_HZ = ((0.5, 2.0), (2.0, 5.0), (5.0, 10.0), (10.0, 20.0))
BAND_S = 6.0
_RANGE_SHARE = 0.9
_SWEEP_S = 12.0
LARGEST_STROKE_RAD = 1.0
"""Farthest that a composite run swings a joint to one side of its centre."""
_PAUSE_S = 0.5
_GENTLE_S = 3.0
_QUINTIC_PEAK = 1.875
"""Highest speed of a quintic from rest to rest over its mean speed."""
_POSTURES = 120
SIZES = (1.0, 0.8, 0.6, 0.4, 0.25, 0.12)

PURPOSES = {
    "ripple": "each joint alone at two constant speeds over its free range, both directions",
    "presliding": "slow sines of all joints, amplitudes 0.001 to 0.03 rad, at most 0.01 rad/s",
    "stribeck": "slow sines of all joints, up to 0.01 and 0.003 rad/s, then constant speeds 0.0005 to 0.1 rad/s",
    "temperature": "all joints there and back at 5, 20 and 60 % of the velocity limits, three times over",
    "elasticity": "chirps of each joint alone, 0.5-2, 2-5, 5-10 and 10-20 Hz, at half the acceleration limit",
}
"""Purpose -> its motion, with the spectrum, in words."""

EXPERIMENT_OF = {
    kind: purpose
    for kind, effect in EFFECTS.items()
    for purpose in PURPOSES
    if f"--for {purpose})" in effect.experiment
}
"""Effect -> purpose of the composite run that its `Effect.experiment` asks for; the other effects ask for none."""

LEAST_RANGE = 2 * max(AMPLITUDES_RAD)
"""rad (m): of a joint that may move over less, the largest of the slow sines has no room: in less, a joint does little
but reverse."""


class _Run:
    """A run being put together: segments, and where they have led to."""

    def __init__(self, needs: Requirements, start: FloatArray) -> None:
        self.limits = needs.motion
        self.start = start
        self.segments: list[Segment] = [Rest(start, 1.0)]
        self._state = still(start)

    def add(self, segment: Segment, shortest_s: float = 0.3) -> None:
        """Go to where a segment starts, at its speed, and follow it."""
        first = segment.evaluate(0.0).at(0)
        apart = max(float(np.abs(a - b).max()) for a, b in zip(first, self._state))
        if apart > 1e-12:
            self.segments.append(Quintic.within(self.limits, self._state, first, shortest_s))
        self.segments.append(segment)
        self._state = segment.evaluate(segment.duration_s).at(0)

    def go_slowly(self, position: FloatArray, speed: float) -> None:
        """Rest at `position` (n,), reached at no more than `speed`, rad/s."""
        apart = float(np.abs(position - self._state.q).max())
        self.add(Rest(position, _PAUSE_S), max(_QUINTIC_PEAK * apart / speed, 0.3))

    def pass_by(self, begin: FloatArray, end: FloatArray, duration_s: float, *, slowly: bool = False) -> None:
        """Constant speed from `begin` to `end` (n,), with run-up from rest and run-out to rest outside of them.

        `slowly`: no faster on the way there. Nothing has shown that to be free at a higher speed.
        """
        velocity = (end - begin) / duration_s
        ramp = self.ramp_s(velocity)
        outside = begin - velocity * ramp / 2
        if slowly:
            self.go_slowly(outside, float(np.abs(velocity).max()))
        elif np.abs(outside - self._state.q).max() > 1e-12:
            self.add(Rest(outside, _PAUSE_S))
        cruise = Cruise(begin, velocity, duration_s)
        self.segments.append(Quintic(self._state, cruise.evaluate(0.0).at(0), ramp))
        self.segments.append(cruise)
        stop = Rest(end + velocity * ramp / 2, _PAUSE_S)
        self.segments += [Quintic(cruise.evaluate(duration_s).at(0), still(stop.position), ramp), stop]
        self._state = still(stop.position)

    def ramp_s(self, velocity: FloatArray) -> float:
        """Run-up from rest at half the acceleration limit: it peaks at 1.5 v / T, the jerk at 6 v / T²."""
        speed = np.abs(velocity)
        ramp = float((3.0 * speed / self.limits.acceleration).max())
        if self.limits.jerk is not None:
            ramp = max(ramp, float(np.sqrt(6.5 * speed / self.limits.jerk).max()))
        return float(np.ceil(10 * max(ramp, 0.2)) / 10)

    def done(self, joints: tuple[str, ...]) -> Trajectory:
        """Back to the start posture."""
        self.add(Rest(self.start, 1.0))
        return Trajectory(joints, tuple(self.segments))


@dataclass(frozen=True)
class _Scene:
    """What every experiment knows: the limits, where it starts, which joints (numbers) it moves."""

    needs: Requirements
    start: FloatArray
    moved: tuple[int, ...]

    def free_range(self, joint: int) -> tuple[float, float]:
        """Interval about the start posture in which a joint alone keeps position, clearance and static torque."""
        limits = self.needs.motion
        low, high = max(limits.lower[joint], -np.pi), min(limits.upper[joint], np.pi)
        middle, half = (low + high) / 2, _RANGE_SHARE * (high - low) / 2
        low, high = min(middle - half, self.start[joint]), max(middle + half, self.start[joint])
        grid = np.linspace(low, high, _POSTURES)
        postures = np.tile(self.start, (_POSTURES, 1))
        postures[:, joint] = grid
        zero = np.zeros_like(postures)
        allowed = self.needs.torque_Nm
        kept = np.all(np.abs(model_torque(self.needs.identified, Motion(postures, zero, zero), 1.0)) < allowed, axis=1)
        clearance = self.needs.clearance
        if clearance is not None and clearance.pairs:
            kept &= clearance.distances(postures).min(axis=1) > 1.05 * clearance.needed_m
        here = int(np.argmin(np.abs(grid - self.start[joint])))
        broken = np.flatnonzero(~kept)
        below, above = broken[broken < here], broken[broken > here]
        first = int(below[-1]) + 1 if len(below) else 0
        last = int(above[0]) - 1 if len(above) else _POSTURES - 1
        return float(grid[first]), float(grid[max(first, last)])

    def room(self) -> FloatArray:
        """(n,) rad: how far each moved joint may swing to both sides of a centre, zero for the others."""
        limits, out = self.needs.motion, np.zeros(len(self.start))
        chosen = list(self.moved)
        out[chosen] = np.minimum((limits.upper - limits.lower)[chosen] / 2 * _RANGE_SHARE, LARGEST_STROKE_RAD)
        return out

    def centre(self, room: FloatArray) -> FloatArray:
        """The posture nearest to the start that leaves `room` to both sides."""
        limits = self.needs.motion
        return np.clip(self.start, limits.lower + room, limits.upper - room)

    def slow(self, amplitude_rad: float, period_s: float, periods: int) -> FourierTrajectory:
        """A sine of the moved joints that begins and ends at rest, at its turning point."""
        size = np.zeros((len(self.start), 1))
        size[list(self.moved)] = amplitude_rad
        centre = self.centre(np.abs(size[:, 0]) * 1.01)
        omega = 2 * np.pi / period_s
        return FourierTrajectory(self.needs.joints, centre, 0 * size, size * omega, 1.0 / period_s, periods)


def _ripple(scene: _Scene, run: _Run, size: float) -> None:
    limits = scene.needs.motion
    for joint in scene.moved:
        here = scene.start[joint]
        low, high = (here + size * (end - here) for end in scene.free_range(joint))
        fast = min((high - low) / _SWEEP_S, 0.3 * float(limits.velocity[joint]))
        for speed in (fast, fast / 2):
            # The run-up needs room inside the range.
            inset = min(0.5 * speed * run.ramp_s(np.full(1, speed)), 0.1 * (high - low))
            begin, end = scene.start.copy(), scene.start.copy()
            begin[joint], end[joint] = low + inset, high - inset
            duration = max(float(end[joint] - begin[joint]) / speed, 0.2)
            run.pass_by(begin, end, duration, slowly=True)
            run.pass_by(end, begin, duration)
        run.go_slowly(scene.start, fast)


def _presliding(scene: _Scene, run: _Run, size: float) -> None:
    for amplitude in AMPLITUDES_RAD:
        period = max(4.0, 2 * np.pi * amplitude / SLOW_RAD_S)
        run.add(scene.slow(size * amplitude, float(np.ceil(period)), 3), _GENTLE_S)


def _stribeck(scene: _Scene, run: _Run, size: float) -> None:
    for share in (1.0, SLOWER_SHARE):
        run.add(slow_segment(scene, 3, share), _GENTLE_S)
    room = scene.room()
    for speed in SPEEDS_RAD_S:
        pace = np.minimum(speed, 0.9 * scene.needs.motion.velocity)
        duration = float(np.clip(0.6 / speed, 4.0, 12.0))
        stroke = np.where(room > 0, np.minimum(pace * duration, 1.6 * size * room), 0.0)
        centre = scene.centre(np.minimum(room, stroke))
        run.pass_by(centre - stroke / 2, centre + stroke / 2, duration)
        run.pass_by(centre + stroke / 2, centre - stroke / 2, duration)


def _temperature(scene: _Scene, run: _Run, size: float) -> None:
    room = size * scene.room()
    centre = scene.centre(room)
    velocity = np.where(room > 0, scene.needs.motion.velocity, np.inf)
    for _ in range(TEMPERATURE_REPEATS):
        for share in TEMPERATURE_SHARES:
            # All joints take as long as the one that reaches its speed's share; the stroke leaves room for run-up.
            duration = float((room / (share * velocity)).max())
            run.pass_by(centre - room / 2, centre + room / 2, duration)
            run.pass_by(centre + room / 2, centre - room / 2, duration)


def _elasticity(scene: _Scene, run: _Run, size: float) -> None:
    limits = scene.needs.motion
    for joint in scene.moved:
        for low, high in BANDS_HZ:
            omega = 2 * np.pi * high
            alone = [0.5 * limits.velocity[joint] / omega, 0.5 * limits.acceleration[joint] / omega**2]
            if limits.jerk is not None:
                alone.append(0.5 * limits.jerk[joint] / omega**3)
            amplitude = np.zeros(len(scene.start))
            amplitude[joint] = size * min(0.1, *alone)
            run.add(Chirp(scene.centre(amplitude), amplitude, low, high, BAND_S))
            run.add(Rest(scene.centre(amplitude), _PAUSE_S))


_MAKERS: dict[str, Callable[[_Scene, _Run, float], None]] = {
    "ripple": _ripple,
    "presliding": _presliding,
    "stribeck": _stribeck,
    "temperature": _temperature,
    "elasticity": _elasticity,
}


def slow_segment(scene: _Scene, periods: int = 1, share: float = 1.0) -> FourierTrajectory:
    """A sine up to a share of `SLOW_RAD_S`: Stribeck velocities of a thousandth of a radian a second show there.

    Args:
        scene: Limits, start posture and the joints to move.
        periods: Number of periods, of `SLOW_PERIOD_S` each.
        share: Peak velocity over `SLOW_RAD_S`.
    """
    return scene.slow(share * SLOW_RAD_S * SLOW_PERIOD_S / (2 * np.pi), SLOW_PERIOD_S, periods)


def with_slow_segment(run: Trajectory, needs: Requirements, periods: int = 1) -> Trajectory:
    """A run from rest to rest, with a slow segment of all joints appended.

    Args:
        run: The run; the slow segment begins and ends at the posture in which it ends.
        needs: Limits that the whole must keep.
        periods: Periods of the slow segment.

    Raises:
        UserError: A limit is in the way.
    """
    home = run.segments[-1].evaluate(run.segments[-1].duration_s).at(0).q
    scene = _Scene(needs, home, tuple(range(len(home))))
    more = _Run(needs, home)
    more.add(slow_segment(scene, periods))
    whole = Trajectory(run.joints, (*run.segments, *more.done(run.joints).segments[1:]))
    require(check(whole, needs))
    return whole


def compose(purpose: str, needs: Requirements, start: FloatArray, joints: Sequence[str] | None = None) -> Trajectory:
    """The composite run for a purpose, as large as the limits let it be.

    Args:
        purpose: One of `PURPOSES`.
        needs: Limits to keep.
        start: (n,) posture of rest before and after, rad.
        joints: Which joints to move; all unless given.

    Raises:
        UserError: An unknown purpose or joint, or limits that leave no such motion: which one, and by how much.
    """
    if purpose not in PURPOSES:
        raise UserError(f"no excitation for {purpose!r}: there are {', '.join(PURPOSES)}")
    names = needs.joints
    unknown = [name for name in joints or () if name not in names]
    if unknown:
        raise UserError(f"joint {unknown[0]!r} is not the arm's; its joints are {', '.join(names)}")
    scene = _Scene(needs, start, tuple(k for k, name in enumerate(names) if joints is None or name in joints))
    require(check(Trajectory(names, (Rest(start, 0.1),)), needs))
    refusal = UserError()
    for size in SIZES:
        run = _Run(needs, start)
        try:
            _MAKERS[purpose](scene, run, size)
            whole = run.done(names)
            require(check(whole, needs))
        except UserError as error:
            refusal = error
            continue
        return whole
    raise refusal


def experiment_for(
    effect: str,
    arm: Arm,
    limits: MotionLimits,
    *,
    needs: Requirements | None = None,
    start: FloatArray | None = None,
    joints: Sequence[str] | None = None,
    seed: int = 0,
) -> Trajectory:
    """The experiment that would show an effect of the contract: a run from rest to rest.

    Args:
        effect: Name of the contract (`torque_ripple`, `joint_elasticity`, ...) or a purpose (`ripple`, ...).
        arm: The arm.
        limits: Its motion limits.
        needs: All limits; only `limits` and the CAD torque unless given.
        start: (n,) posture of rest, rad; zeros unless given.
        joints: Where the effect is believed; all unless given.
        seed: For effects that want a further periodic run at full speed: other seed, other coefficients.

    Raises:
        UserError: No such experiment within the limits: which one, and by how much.
    """
    home = np.zeros(len(arm.joints)) if start is None else np.asarray(start, dtype=float)
    needs = needs or Requirements(limits, allowed_torque(arm), nominal_model(arm))
    needs = replace(needs, motion=limits)
    purpose = EXPERIMENT_OF.get(effect, effect)
    if purpose in PURPOSES:
        return compose(purpose, needs, home, joints)
    series = random_feasible(arm.joint_names, limits, seed=seed, start=home)
    run = series.run(limits, home)
    require(check(run, needs))
    return run
