"""All drives of the simulated arm in one thread: frames in, feedback out, physics in between.

A drive answers SYNC with a state that is already there: the physics runs one step ahead, so that the state is
that of the moment the SYNC is expected, and the step after it runs once every bus has been answered. The
phase of the steps follows the SYNC slowly (a phase-locked loop of at most `SLEW`), and what a SYNC deviates
from it is made up with the velocity. So feedback belongs to the time stamp of its SYNC, however late the
process was scheduled, and the physics may take most of a millisecond without delaying an answer.

Without SYNC the physics follows the clock. A process that was held up lives through what it missed in the order
it happened: each waiting SYNC with its set-points, then its step, as if nothing had been; only the answers, which
would come too late, are missing. Beyond `CATCH_UP` steps it leaves them out and counts them in `skipped`.
"""

from __future__ import annotations

import select
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final

import can
import numpy as np

from spacearm_ident.canbus.pdo import SYNC
from spacearm_ident.simulation.drives.communication import Route
from spacearm_ident.simulation.drives.dictionary import key
from spacearm_ident.simulation.drives.drive import VELOCITY, DriveConfig, SimulatedDrive
from spacearm_ident.simulation.live_arm import LiveArm

CATCH_UP: Final = 300
#: Largest shift of the physics' phase a SYNC may cause, as a share of the step.
SLEW: Final = 0.005
GAIN: Final = 0.02
#: How long past its time a state waits for a SYNC, as a share of the step.
GRACE: Final = 0.8
#: A SYNC this share of a step before its state's time belongs to the state before.
OVERDUE: Final = 0.1
#: A SYNC this many steps after its state's time belongs to a later state.
BEHIND: Final = 1.5
#: Seconds without SYNC after which a bus is not waited for.
SYNC_MEMORY: Final = 0.05
#: A SYNC older than this share of the cycle is not answered: the master would take it for the next one's.
ANSWERABLE: Final = 0.8
#: Frames taken from one bus before the others and the physics get their turn.
BURST: Final = 64
_CYCLE_PERIOD: Final = key(0x1006)


@dataclass
class _Line:
    """One bus with the drives on it."""

    bus: can.BusABC
    drives: list[SimulatedDrive] = field(default_factory=list)
    routes: dict[int, list[Route]] = field(default_factory=dict)
    last_sync: float = 0.0
    answered: bool = False
    actuate: bool = False
    # Steps since a SYNC, and whether the last was made without waiting for one any longer.
    steps: int = 0
    ahead: bool = False
    stale: float = 0.0


class DriveNetwork:
    """The drives and the physics behind them.

    Attributes:
        drives: In joint order.
        steps: Steps of the physics so far.
        skipped: Steps left out because the process was held up.
        unanswered: SYNCs that came too late to be answered.
        unsent: Frames no one acknowledged.
    """

    def __init__(
        self,
        buses: Sequence[can.BusABC],
        configs: Sequence[tuple[int, DriveConfig]],
        mechanics: LiveArm,
        dt: float = 1e-3,
    ) -> None:
        """Put the drives on their buses; nothing is sent before `boot`.

        Args:
            buses: Interfaces with a file descriptor (`local`, `socketcan`).
            configs: Of each joint, in the order of `mechanics`: the number of its bus, and its drive.
            mechanics: The physics.
            dt: Step of the physics, seconds.
        """
        self._lines = [_Line(bus) for bus in buses]
        self._mechanics = mechanics
        self._dt = dt
        self.steps = self.skipped = self.unanswered = self.unsent = 0
        self.drives: list[SimulatedDrive] = []
        for number, config in configs:
            line = self._lines[number]
            drive = SimulatedDrive(config, self._sender(line.bus))
            line.drives.append(drive)
            self.drives.append(drive)
        count = len(self.drives)
        self._target = np.zeros(count)
        self._enabled = np.zeros(count, dtype=bool)
        self._state_time = time.time()
        self._by_fd = {line.bus.fileno(): line for line in self._lines}

    def boot(self) -> None:
        """Switch the drives on: boot-up messages, pre-operational."""
        self._observe()
        for drive in self.drives:
            drive.reset()
        self._observe()
        for line in self._lines:
            _collect_routes(line)
        self._state_time = time.time()

    def run(self, stop: Callable[[], bool]) -> None:
        """Boot, then serve until `stop()` is true.

        Raises:
            can.CanOperationError: A bus has failed.
        """
        self.boot()
        while not stop():
            self.poll()

    def quiet_s(self) -> float:
        """Time since the last SYNC on any bus, s; from any thread."""
        return time.time() - max(line.last_sync for line in self._lines)

    def poll(self) -> None:
        """Wait for frames or for the next step, whichever comes first, and deal with it."""
        wait = self._due() - time.time()
        # A step that is due needs no frames but those of the SYNC it has been waiting for.
        lines = self._by_fd if wait > 0.0 else [fd for fd, line in self._by_fd.items() if not line.answered]
        for fd in select.select(lines, (), (), max(0.0, wait))[0]:
            self._drain(self._by_fd[fd])
        if wait <= 0.0 and self._due() <= time.time():
            self._step()

    def _due(self) -> float:
        """Earliest time of the next step, s: at once if all buses are answered, else `GRACE` steps after the last."""
        newest = max(line.last_sync for line in self._lines)
        waiting = any(not line.answered and newest - line.last_sync < SYNC_MEMORY for line in self._lines) or not any(
            line.answered for line in self._lines
        )
        return self._state_time + (GRACE if waiting else -0.5) * self._dt

    def _drain(self, line: _Line) -> None:
        bus = line.bus
        for _ in range(BURST):
            message = bus.recv(0)
            if line.actuate:
                # Only what came before the SYNC takes effect with it.
                _actuate(line)
            if message is None:
                return
            if message.is_error_frame or message.is_remote_frame:
                continue
            if message.arbitration_id == SYNC:
                self._sync(line, message.timestamp)
                # The other buses wait for their answer; set-points do not.
                return
            for route in line.routes.get(message.arbitration_id, ()):
                route(message)
            if any([drive.routes_changed for drive in line.drives]):
                _collect_routes(line)

    def _sync(self, line: _Line, stamp: float) -> None:
        # A position that is behind must not be reported as that of now.
        while stamp - self._state_time > BEHIND * self._dt:
            self._step()
        lag = stamp - self._state_time
        drift = min(max(lag, -self._dt), self._dt)
        cycle = max(self._dt, stamp - line.last_sync)
        if time.time() - stamp < ANSWERABLE * cycle:
            for drive in line.drives:
                drive.drift(drive.values[VELOCITY] * drift)
                drive.on_sync()
        else:
            self.unanswered += 1
        line.actuate = True
        if not any(other.answered for other in self._lines):
            limit = SLEW * self._dt
            self._state_time += min(max(GAIN * lag, -limit), limit)
        # A SYNC that comes after the step it should have caused has none to cause.
        steps_a_sync = self._steps_a_sync(line)
        line.answered = not (line.ahead and steps_a_sync == 1 and lag < -OVERDUE * self._dt)
        line.last_sync = stamp
        beyond = (line.steps - steps_a_sync) * self._dt if steps_a_sync else 0.0
        line.stale = beyond if 0.0 < beyond < SYNC_MEMORY else 0.0
        line.steps = 0

    def _steps_a_sync(self, line: _Line) -> int:
        """Steps in the period of SYNC that the master has stated; 0 where it has not."""
        return round(1e-6 * line.drives[0].values[_CYCLE_PERIOD] / self._dt) if line.drives else 0

    def _step(self) -> None:
        behind = int((time.time() - self._state_time) / self._dt)
        if behind > CATCH_UP:
            self.skipped += behind
            self._state_time += behind * self._dt
        self._state_time += self._dt
        for line in self._lines:
            line.steps += 1
            line.ahead = not line.answered
            line.answered = False
            if line.actuate:
                _actuate(line)
        for joint, drive in enumerate(self.drives):
            drive.advance(self._dt, self._state_time)
            self._target[joint] = drive.target
            self._enabled[joint] = drive.enabled
        self._mechanics.step(self._target, self._enabled, ~self._enabled, self._dt)
        self._observe()
        self.steps += 1

    def _observe(self) -> None:
        physics = self._mechanics
        seen = zip(
            self.drives,
            physics.position.tolist(),
            physics.velocity.tolist(),
            physics.torque.tolist(),
            physics.temperature.tolist(),
        )
        for drive, position, velocity, torque, temperature in seen:
            drive.observe(position, velocity, torque, temperature)

    def _sender(self, bus: can.BusABC) -> Callable[[int, bytes], None]:
        def send(can_id: int, data: bytes) -> None:
            try:
                bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))
            except can.CanError:
                self.unsent += 1

        return send


def _actuate(line: _Line) -> None:
    line.actuate = False
    for drive in line.drives:
        drive.after_sync(line.stale)


def _collect_routes(line: _Line) -> None:
    line.routes = {}
    for drive in line.drives:
        drive.routes_changed = False
        for can_id, route in drive.routes().items():
            line.routes.setdefault(can_id, []).append(route)
