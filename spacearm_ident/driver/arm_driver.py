"""`ArmDriver`: the arm behind six verbs: connect, enable, command, halt, recover, resume.

One thread owns the buses. It connects (boots and configures the drives, again and again until they answer),
then runs the cycle: target, SYNC, feedback, safety policy, sample. Everyone else leaves wishes for it and
waits for what it reports; nothing else touches the cycle. A second thread asks for temperatures by SDO.

A fault (`safety.Fault`) stops all axes with the frame after the one that showed it, and stays until
`recover`: the drives hold the arm on their quick-stop ramps, then at rest under power. Before the first `enable`
a pause of heartbeats or feedback is no fault: the drives are connected again, and a warning says so until they
are. `recover` never moves: it ends with the power stages off and the brakes closed, where a drive went astray
after configuring all anew.
`resume` recovers and enables in one, where a program may (`driver.resume`).
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Final

import numpy as np

from spacearm_ident.arrays import FloatArray
from spacearm_ident.canbus.arm_bus import STANDSTILL
from spacearm_ident.canbus.cia402 import Goal, State
from spacearm_ident.canbus.cycle import Cycle
from spacearm_ident.canbus.events import Event, EventKind
from spacearm_ident.canbus.master import HEARTBEAT_ERROR, DriveMaster, OtherMasterError
from spacearm_ident.canbus.pdo import Feedback
from spacearm_ident.canbus.realtime import Pacer, prepare_process, prepare_thread
from spacearm_ident.driver.arm_can import QUICK_STOP, ArmCan
from spacearm_ident.driver.bus_lock import BusLock
from spacearm_ident.driver.last_seen import LastSeen
from spacearm_ident.driver.playback import Playback
from spacearm_ident.driver.resume import Latch, Silence, resumable
from spacearm_ident.driver.safety import Fault, MotionMonitor, Rule, fault_of, stands_outside
from spacearm_ident.driver.set_points import SetPointStream
from spacearm_ident.driver.status import DriverStatus, Phase, silent_joint, stuck_joint
from spacearm_ident.driver.temperatures import OnTemperature, TemperatureReader
from spacearm_ident.errors import UserError

RETRY_S: Final = 0.5
ENABLE_S: Final = 3.0
REST_S: Final = 3.0
BOOT_S: Final = 2.0
RECONNECT_S: Final = BOOT_S + 2.0
_POLL_S: Final = 0.005
#: How long all joints must stand before the arm is said to be held, s: a drive in another mode of operation than wanted
#: leaves its place within some cycles.
HOLD_S: Final = 0.1
#: After these the drives' configuration is not to be trusted.
_ASTRAY: Final = frozenset(
    (EventKind.RESTARTED, EventKind.HEARTBEAT_LOST, EventKind.STALE_FEEDBACK, EventKind.BUS_ERROR, EventKind.BAD_FRAME)
)
#: After these a drive may have another position than before.
_UNSEEN: Final = frozenset((EventKind.RESTARTED, EventKind.STALE_FEEDBACK))
#: One side has not heard the other for a while: no danger to an arm that was never under power, and no wonder while a
#: machine starts all nodes at once. Then the drives are connected again; from the first enable on it is a fault.
_PAUSES: Final = frozenset((EventKind.HEARTBEAT_LOST, EventKind.STALE_FEEDBACK, EventKind.MASTER_MISSED))

#: Called in the cyclic thread for every complete cycle: time of its SYNC (ns since the epoch), feedback.
OnSample = Callable[[int, Feedback], None]


class ArmDriver:
    """Drives one arm. The verbs may be called from any thread but the cyclic one."""

    def __init__(
        self,
        config: ArmCan,
        on_sample: OnSample,
        on_temperature: OnTemperature | None = None,
        *,
        delay: float = 0.2,
        priority: int = 60,
        temperature_hz: float = 1.0,
    ) -> None:
        """Take the buses' locks; nothing is sent before `start`.

        Args:
            config: The arm.
            on_sample: Takes feedback.
            on_temperature: Takes winding temperatures; they are not read unless given.
            delay: Of the set-points, s; see `set_points`.
            priority: Real-time priority of the cyclic thread; 0 for none.
            temperature_hz: Readings a joint and second.

        Raises:
            OtherMasterError: Another driver on this machine has a bus.
        """
        self.config = config
        self._of_master: list[str] = []
        self.notes: list[str] = []
        self._latch = Latch()
        self._silence = Silence(config.bus.heartbeat, config.bus.heartbeat_timeout)
        self.connection = "not started"
        self.refused: str | None = None
        self._on_sample, self._delay, self._priority = on_sample, delay, priority
        self._reader = None
        if on_temperature is not None:
            joints = len(config.limits.joints)
            self._reader = TemperatureReader(joints, temperature_hz, self._temperature, on_temperature)
        self._locks = [BusLock(address.interface, address.channel) for address in config.buses]
        self._sdo = threading.Lock()
        self._ending = threading.Event()
        self._threads: list[threading.Thread] = []
        self._master: DriveMaster | None = None
        self._cycle: Cycle | None = None
        self._pacer = Pacer(config.bus.period)
        self._missed_before = 0
        self._monitor = MotionMonitor(config.limits)
        self._stream: SetPointStream | None = None
        self._playback = Playback(config.bus.period, config.bus.extrapolation)
        self._seen = LastSeen(
            config.limits,
            [axis.quick_stop_deceleration / QUICK_STOP for axis in config.bus.axes],
            config.bus.extrapolation,
            config.bus.period,
        )
        self._elsewhere = ""
        self._errors: dict[int, str] = {}
        self._widened: dict[int, str] = {}
        self._standing = 0
        self._wanted = self._resetting = self._reconnecting = self._astray = self._ever_enabled = False
        self._again = self._tried = ""
        self._latency: str | None = None
        self.samples = self.set_points = self.reconnections = 0

    def start(self) -> None:
        """Connect and run, in the background."""
        self._threads = [threading.Thread(target=self._work, name="cycle", daemon=True)]
        if self._reader is not None:
            work = self._reader.work
            self._threads.append(threading.Thread(target=work, args=(self._ending,), name="temperatures", daemon=True))
        for thread in self._threads:
            thread.start()

    @property
    def fault(self) -> Fault | None:
        """Why the arm was stopped, until recovered."""
        return self._latch.fault

    @property
    def phase(self) -> Phase:
        """What it does."""
        if self.fault is not None:
            return Phase.FAULT
        if self._cycle is None:
            return Phase.CONNECTING
        if self._wanted:
            return Phase.ENABLED if self._stream is not None else Phase.ENABLING
        return Phase.DISABLED

    @property
    def doing(self) -> str:
        """What is done to connect the drives, for a person; may be empty."""
        return self._master.doing if self._cycle is None and self._master is not None else ""

    @property
    def warnings(self) -> list[str]:
        """What a user should know of the settings of the drives that were connected, or of what they refuse since."""
        return [*self._of_master, *self._widened.values()]

    @property
    def findings(self) -> list[str]:
        """The same, and which drives were found in fault."""
        joints = self.config.limits.joints
        return [*self.warnings, *(f"{joints[joint]} is in fault, {text}" for joint, text in self._errors.items())]

    # Verbs ----------------------------------------------------------------------------------------------

    def enable(self) -> str:
        """Bring all drives to "operation enabled", holding the arm where it is.

        Raises:
            UserError: A fault is latched, the arm is not connected, or a drive does not come.
        """
        if self._again:
            # After a pause the drives are connected again within a second or two: no reason to ask the caller twice.
            self._until(lambda: self._cycle is not None or self.refused is not None, RECONNECT_S)
        cycle = self._connected()
        if self.fault is not None:
            raise UserError(f"not enabled, the arm was stopped ({self.fault}): call /driver/recover first")
        if self._wanted:
            return "enabled already"
        try:
            self._require_fit(cycle)
            self._beside(lambda master, joint: master.prepare(joint))
        except UserError as error:
            raise UserError(f"not enabled: {error}") from error
        self._standing = 0
        self._wanted = self._ever_enabled = True
        if self._until(lambda: self._stream is not None or self.fault is not None, ENABLE_S) and self.fault is None:
            try:
                # Some drives change their mode, or show it, only now.
                self._beside(lambda master, joint: master.check_mode(joint))
                return "enabled, the arm is held where it is"
            except UserError as error:
                self._wanted = False
                raise UserError(f"not enabled: {error}") from error
        stuck = self._not_in(State.OPERATION_ENABLED, cycle) or self._moving()
        self._wanted = False
        raise UserError(f"not enabled: {self.fault or stuck or 'a drive left operation'}")

    def disable(self) -> str:
        """Stop the arm if it moves, then take the drives out of operation.

        Raises:
            UserError: The arm does not come to rest, or a drive stays under power.
        """
        self._wanted = False
        cycle = self._cycle
        if cycle is None:
            return "disabled"
        off = (State.SWITCH_ON_DISABLED, State.FAULT, State.READY_TO_SWITCH_ON)
        if self.fault is None and not self._until(lambda: all(state in off for state in cycle.states), REST_S):
            raise UserError(f"still under power: {self._not_in(State.SWITCH_ON_DISABLED, cycle)}")
        return f"stopped, held by a fault ({self.fault}): call /driver/recover" if self.fault else "disabled"

    def halt(self, reason: str = "asked for by /driver/halt") -> str:
        """Stop all axes now, latched."""
        self._latch.halt(reason)
        return "stopping, held until /driver/recover"

    def recover(self) -> str:
        """Leave a fault without moving.

        Raises:
            UserError: The arm still moves, a drive does not answer, or does not leave its fault.
        """
        self._latch.release()
        return self._recover()

    def resume(self) -> str:
        """Recover and enable, where what stopped the arm was a cycle or set-points held up, and nothing else.

        Raises:
            UserError: A person must see to the arm first, or it does not recover.
        """
        fault = self._latch.require_resumable()
        self._recover()
        self.enable()
        return f"resumed after: {fault}"

    def _recover(self) -> str:
        if self.fault is None and self._cycle is not None and not (self._elsewhere or self._faulty(self._cycle)):
            return "there is no fault to recover from"
        self._wanted = False
        if not self._until(lambda: self._monitor.at_rest or self._cycle is None, REST_S):
            raise UserError("not recovered: the arm still moves")
        if self._cycle is None or self._astray or self._silent():
            self._reconnecting = True
            if not self._until(lambda: not self._reconnecting, RECONNECT_S):
                raise UserError(f"not recovered: {self.connection}")
        cycle = self._connected()
        if self._elsewhere:
            raise UserError(f"not recovered: {self._elsewhere}")
        said = self._said_of_faults(cycle)
        try:
            self._reset_faults(cycle)
            self._beside(lambda master, joint: master.prepare(joint))
        except UserError as error:
            raise UserError(f"not recovered: {error}") from error
        self._latch.clear()
        return f"recovered{said and f' from: {said}'}, disabled: call /driver/enable"

    def _reset_faults(self, cycle: Cycle) -> None:
        """Bring all drives to "switch on disabled", out of their faults too."""
        self._resetting = True
        try:
            done = self._until(lambda: all(state is State.SWITCH_ON_DISABLED for state in cycle.states), ENABLE_S)
        finally:
            self._resetting = False
        if not done or self._silent():
            raise UserError(str(self._silent() or self._not_in(State.SWITCH_ON_DISABLED, cycle) or self.fault))

    def command(self, stamp_ns: int, position: FloatArray) -> None:
        """Take a set-point (n,) rad; a refused one stops the arm. Ignored while not enabled."""
        stream = self._stream
        if stream is not None and self.fault is None:
            self.set_points += 1
            fault = stream.put(stamp_ns, position, time.time_ns())
            if fault is not None:
                self.trip(fault)

    def trip(self, fault: Fault) -> None:
        """Stop the arm for this reason; the first one stays."""
        self._latch.trip(fault)

    def close(self) -> None:
        """Bring the arm to rest and the drives out of operation, then leave the buses. Never raises."""
        with suppress(UserError):
            self.disable()
        self._until(lambda: self._cycle is None or self._monitor.at_rest, REST_S)
        self._ending.set()
        for thread in self._threads:
            thread.join(REST_S + BOOT_S)
        for lock in self._locks:
            lock.release()

    def status(self) -> DriverStatus:
        """What the diagnostics show; cheap, from any thread."""
        cycle, master = self._cycle, self._master
        return DriverStatus(
            phase=self.phase,
            fault=self.fault,
            resumable=self._latch.resumable,
            connection=self.connection,
            states=dict(zip(self.config.limits.joints, cycle.states)) if cycle else {},
            cycles=cycle.cycles if cycle else 0,
            missed=self._missed_before + self._pacer.missed,
            incomplete=cycle.incomplete if cycle else 0,
            late_frames=cycle.late if cycle else 0,
            malformed=cycle.malformed if cycle else 0,
            lateness_s=tuple(self._pacer.lateness(q) for q in (0.5, 0.99, 0.999)),
            samples=self.samples,
            set_points=self.set_points,
            buffered_s=self._stream.fill_s if self._stream else 0.0,
            stalls=self._playback.stalls,
            lag_s=1e-9 * self._playback.lag_ns if self._stream else 0.0,
            temperature_failures=self._reader.failures if self._reader else 0,
            reconnections=self.reconnections,
            loads=tuple(master.loads) if master else (),
            warnings=(*self.warnings, *self._obstacles(), *((self._latency,) if self._latency else ())),
        )

    # Connecting -----------------------------------------------------------------------------------------

    def _work(self) -> None:
        self._latency = prepare_thread(self._priority)
        while not self._ending.is_set():
            try:
                self._connect()
                self._serve()
            except OtherMasterError as error:
                self.refused = self.connection = str(error)
                return
            except UserError as error:
                self.connection = str(error)
                # Said during the next attempt too: whoever stops waiting then is to learn the reason.
                self._tried = f", the last attempt ended with: {error}"
                self._reconnecting = False
            except Exception as error:
                # The drives stop by themselves: their master's heartbeat ends here.
                self.trip(Fault(Rule.BUS, f"the cycle has failed: {type(error).__name__} {error}"))
                self.refused = self.connection = str(self.fault)
            finally:
                self._disconnect()
            if self.refused:
                return
            self._ending.wait(0.0 if self._reconnecting else RETRY_S)

    def _connect(self) -> None:
        with self._sdo:
            self.connection = f"connecting to the drives{self._again}{self._tried}"
            master = DriveMaster(self.config.bus, self.config.open(), self.config.eds)
            self._master = master
            master.boot(timeout=BOOT_S)
            # The same lists: a drive may refuse its temperature later.
            self._of_master, self.notes = master.warnings, master.notes
            # A drive that is connected again has the limits of before.
            self._widened = master.widened | self._widened
            self._elsewhere = self._seen.compare(master.positions)
            # What `recover` is asked next is whether it is so still.
            self._astray = bool(self._elsewhere)
            self._errors = dict(master.errors)

    def _disconnect(self) -> None:
        self._cycle = self._stream = None
        self._missed_before += self._pacer.missed
        self._pacer = Pacer(self.config.bus.period)
        with self._sdo:
            if self._master is not None:
                self._master.close()
            self._master = None

    # The cycle ------------------------------------------------------------------------------------------

    def _serve(self) -> None:
        assert self._master is not None
        cycle = self._master.cycle()
        # Before the first heartbeat: the drives do not forgive a pause after it.
        prepare_process()
        monitor = self._monitor = MotionMonitor(self.config.limits)
        self._silence = Silence(self.config.bus.heartbeat, self.config.bus.heartbeat_timeout)
        cycle.run()
        begin_ns = cycle.sync_ns
        self._cycle, self.connection, self._reconnecting, self._again = cycle, "connected", False, ""
        self._tried = ""
        pacer, sample = self._pacer, self._on_sample
        while not self._ending.is_set() and not self._reconnecting:
            late = pacer.wait()
            self._lead(cycle)
            feedback = cycle.run(self._next_target(late))
            fresh = cycle.missing == 0
            monitor.observe(1e-9 * (cycle.sync_ns - begin_ns), feedback.position, feedback.torque, fresh)
            target = cycle.set_points.position()
            self._judge(cycle, monitor, feedback, target)
            self._seen.observe(feedback.position, monitor.speed, fresh, target, cycle.powered)
            if fresh.all():
                self.samples += 1
                sample(cycle.sync_ns, feedback)

    def _lead(self, cycle: Cycle) -> None:
        """Set the goal of this cycle."""
        if self._resetting:
            self._stream = None
            cycle.goal = Goal.RESET
        elif self.fault is not None:
            self._stream = None
            if cycle.goal not in (Goal.QUICK_STOP, Goal.RESET):
                cycle.quick_stop()
        elif self._wanted:
            cycle.goal = Goal.ENABLED
        elif self._stream is not None or (cycle.goal is Goal.ENABLED and not self._monitor.at_rest):
            self._stream = None
            cycle.quick_stop()
        elif self._monitor.at_rest:
            cycle.goal = Goal.DISABLED

    def _next_target(self, late: float) -> Callable[[int], FloatArray | None] | None:
        stream, late_ns = self._stream, round(1e9 * late)
        if stream is None:
            return None
        # For when the slot began: a target for now would turn every lateness into a jerk.
        return lambda sync_ns: self._playback.target(stream, sync_ns - late_ns)

    def _judge(self, cycle: Cycle, monitor: MotionMonitor, feedback: Feedback, target: FloatArray) -> None:
        self._silence.cycle(cycle.sync_ns)
        events = cycle.events
        while events:
            event = events.popleft()
            if event.kind in _UNSEEN:
                self._seen.distrust(event.axis)
            if event.kind in _PAUSES and not self._ever_enabled and self.fault is None:
                self._connect_again(event)
                continue
            self._astray = self._astray or event.kind in _ASTRAY
            fault = fault_of(event)
            if fault is not None:
                self._latch.trip(fault, self._silence.explains(event))
        if self.fault is None and self._wanted and cycle.enabled:
            if self._stream is None:
                self._hold(monitor, feedback, target)
            fault = monitor.judge(target)
            if self._stream is not None:
                fault = fault or self._playback.starved(self._stream, cycle.sync_ns)
            if fault is not None:
                self._latch.trip(fault, resumable(fault, self._playback.bridging(cycle.sync_ns)))
        if self.fault is not None and cycle.goal is Goal.ENABLED:
            cycle.quick_stop()

    def _hold(self, monitor: MotionMonitor, feedback: Feedback, target: FloatArray) -> None:
        """Take set-points once all joints have stood under power for `HOLD_S`."""
        if not self._standing:
            monitor.limits = self.config.limits.around(feedback.position)
        self._standing = self._standing + 1 if monitor.at_rest else 1
        if self._standing > HOLD_S / self.config.bus.period:
            self._playback.begin()
            self._stream = SetPointStream(monitor.limits, target, self._delay)

    def _connect_again(self, event: Event) -> None:
        if not self._reconnecting:
            self._reconnecting, self._again = True, f" again, for {event.message}"
            self.reconnections += 1
            self.connection = f"connecting to the drives{self._again}"

    # Beside the cycle -----------------------------------------------------------------------------------

    def _temperature(self, joint: int) -> float | None:
        """°C of a joint's drive; None where it says nothing."""
        cycle = self._cycle
        if cycle is None or cycle.missing[joint] >= self.config.bus.stale_cycles:
            return None
        with self._sdo:
            return None if self._master is None else self._master.temperature(joint)

    def _beside(self, act: Callable[[DriveMaster, int], None]) -> None:
        """Act on every joint's drive by SDO, beside the cycle."""
        for joint in range(len(self.config.limits.joints)):
            with self._sdo:
                if self._master is None or self._cycle is None:
                    raise UserError(f"the arm is not connected: {self.connection}")
                act(self._master, joint)

    def _require_fit(self, cycle: Cycle) -> None:
        """Refuse to enable an arm that is elsewhere, outside of its limits, or in fault.

        Raises:
            UserError: It is, with the joint and what to do.
        """
        if not self._until(lambda: bool(cycle.received.all()), REST_S):
            raise UserError(self._silent() or "a drive sends no feedback")
        if said := self._elsewhere or stands_outside(self.config.limits, cycle.feedback.position):
            raise UserError(said)
        if said := self._said_of_faults(cycle):
            with self._sdo:
                codes = {self._master.error_code(joint) for joint in self._faulty(cycle)} if self._master else set()
            if codes != {HEARTBEAT_ERROR}:
                raise UserError(f"{said}: see to the cause, then call /driver/recover, which resets the fault")
            # The answer to this driver's own pause, as it was connected: nothing was under power.
            self._reset_faults(cycle)

    def _faulty(self, cycle: Cycle) -> list[int]:
        return [joint for joint, state in enumerate(cycle.states) if state is State.FAULT]

    def _said_of_faults(self, cycle: Cycle) -> str:
        """What the drives in fault say of it; empty if none is."""
        faulty, joints = self._faulty(cycle), self.config.limits.joints
        with self._sdo:
            if (master := self._master) is not None:
                self._errors = self._errors | {joint: master.error(joint) for joint in faulty}
        return "; ".join(f"{joints[joint]} is in fault, {self._errors.get(joint, '')}" for joint in faulty)

    def _obstacles(self) -> list[str]:
        """Why the arm would not be enabled now, as far as that is known without asking a drive."""
        cycle = self._cycle
        if cycle is None or self._wanted or not cycle.received.all():
            return []
        joints = self.config.limits.joints
        said = [self._elsewhere or stands_outside(self.config.limits, cycle.feedback.position)]
        said += [f"{joints[k]} is in fault, {self._errors.get(k, 'for a reason that /driver/recover says')}: "
                 "/driver/recover resets it" for k in self._faulty(cycle)]  # fmt: skip
        return [text for text in said if text]

    def _moving(self) -> str:
        """The fastest joint that moves, as a clause; empty if none does."""
        speed = np.nan_to_num(np.abs(self._monitor.speed))
        joint = int(speed.argmax())
        return (
            f"{self.config.limits.joints[joint]} moves with {speed[joint]:.2g} rad/s though it is to stand still"
            if speed[joint] >= STANDSTILL
            else ""
        )

    def _connected(self) -> Cycle:
        cycle = self._cycle
        if cycle is None:
            raise UserError(f"the arm is not connected: {self.connection}")
        return cycle

    def _silent(self) -> str:
        """Which drive sends no usable feedback; empty if all do."""
        cycle = self._cycle
        if cycle is None:
            return self.connection
        return silent_joint(self.config.limits.joints, cycle.missing, self.config.bus.stale_cycles)

    def _not_in(self, wanted: State, cycle: Cycle) -> str:
        words = cycle.feedback.statusword.tolist()
        stuck = stuck_joint(self.config.limits.joints, cycle.states, wanted, words)
        said = self._said_of_faults(cycle)
        return f"{stuck}; {said}" if stuck and said else stuck

    def _until(self, condition: Callable[[], bool], seconds: float) -> bool:
        deadline = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > deadline:
                return False
            time.sleep(_POLL_S)
        return True
