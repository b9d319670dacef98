"""`SimulatedDrive`: a CiA 402 servo drive towards the bus, a target and two switches towards the physics.

Towards the bus it is a CANopen slave as CiA 301 describes it: boot-up, NMT, SDO server, PDOs as the master
mapped them, heartbeat producer and consumer, EMCY. The drive owns no thread and no clock: frames come in
through `routes`, time through `advance` and `observe`, both called by `network`.

Choices where the standards leave one (ours): a quick stop that the drive began itself, for a lost heartbeat,
ignores "enable operation" until the master has once sent another command, so a master that wakes up does not
resume the motion. RPDOs that come while the drive is not enabled do not reach the motion.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from spacearm_ident.canbus.arm_bus import EXTRAPOLATION
from spacearm_ident.canbus.cia402 import (
    FOLLOWING,
    FOLLOWING_ERROR,
    Command,
    Event,
    State,
    after_command,
    after_event,
    command_of,
    statusword_of,
)
from spacearm_ident.canbus.scaling import JointScale
from spacearm_ident.simulation.drives.communication import Communication, NmtState
from spacearm_ident.simulation.drives.dictionary import key
from spacearm_ident.simulation.drives.motion import Motion

CONTROLWORD: Final = key(0x6040)
STATUSWORD: Final = key(0x6041)
ERROR_CODE: Final = key(0x603F)
MODE: Final = key(0x6060)
TARGET: Final = key(0x607A)
INTERPOLATED_TARGET: Final = key(0x60C1, 1)
POSITION: Final = key(0x6064)
VELOCITY: Final = key(0x606C)
TORQUE: Final = key(0x6077)
CURRENT: Final = key(0x6078)
TEMPERATURE: Final = key(0x2000)
DEMAND: Final = key(0x6062)
POSITION_ERROR: Final = key(0x60F4)
POSITION_WINDOW: Final = key(0x6065)
INTERPOLATED_MODE: Final = 7
CYCLIC_MODE: Final = 8
NO_WINDOW: Final = 0xFFFFFFFF
#: EMCY error code (CiA 402-2).
FOLLOWING_ERROR_CODE: Final = 0x8611
#: Bit 4 of a controlword: run the interpolation, in mode 7.
RUN_INTERPOLATION: Final = 0x10
#: Option codes of 0x605A after which the drive stays in "quick stop active".
STAY_STOPPED: Final = (5, 6, 7, 8)
_CLOSED_LOOP: Final = (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE)
_I16: Final = (-(2**15), 2**15 - 1)
_I32: Final = (-(2**31), 2**31 - 1)


@dataclass(frozen=True)
class DriveConfig:
    """One drive of the simulated arm: its node, how it counts (see `canbus.scaling`), how long it extrapolates (s)."""

    node_id: int
    scale: JointScale
    extrapolation: float = EXTRAPOLATION


class SimulatedDrive(Communication):
    """One drive.

    Attributes:
        state: CiA 402 state.
        motion: The demand, in counts.
    """

    def __init__(self, config: DriveConfig, send: Callable[[int, bytes], None]) -> None:
        """A drive that is switched on but has not booted; `send(can_id, payload)` puts a frame on its bus."""
        super().__init__(config.node_id, send)
        self.config = config
        self.state = State.NOT_READY_TO_SWITCH_ON
        self.motion = Motion(config.extrapolation)
        self._controlword = 0
        self._stop_latched = False
        self._excess_s = 0.0
        scale = config.scale
        self._zero = float(scale.zero_counts)
        self._counts_per_rad, self._units_per_Nm = 1.0 / scale.rad_per_count, 1.0 / scale.torque_per_unit
        self._actual = self._zero
        self._settled: tuple[State, int] | None = None
        after = self.dictionary.after_write
        after[CONTROLWORD] = lambda _: self._command()
        after[MODE] = lambda _: self._change_mode()
        after[TARGET] = after[INTERPOLATED_TARGET] = lambda _: self._set_point()
        self._state_rated_values()

    # Towards the physics ------------------------------------------------------------------------------

    @property
    def enabled(self) -> bool:
        """Whether the position loop is closed."""
        return self.state in _CLOSED_LOOP and not self.faults.powerless

    @property
    def target(self) -> float:
        """What the joint shall follow now, rad on the output side."""
        return (self.motion.demand - self._zero) / self._counts_per_rad

    def advance(self, dt: float, now: float) -> None:
        """Let `dt` seconds pass for set-points and ramps, up to the time `now` for the timers."""
        self.keep_time(now)
        self.motion.advance(dt)
        if self.state is State.QUICK_STOP_ACTIVE and self.motion.stopped:
            if self.values[key(0x605A)] not in STAY_STOPPED:
                self._enter(after_event(self.state, Event.STOP_DONE))
        elif self.state is State.FAULT_REACTION_ACTIVE and self.motion.stopped:
            self._enter(after_event(self.state, Event.REACTION_DONE))
        self._watch_following(dt)

    def observe(self, position: float, velocity: float, torque: float, temperature: float) -> None:
        """Update the objects of measured values from what the sensors see, all on the output side.

        Args:
            position: rad.
            velocity: rad/s.
            torque: N·m.
            temperature: Temperature of the winding, °C.
        """
        values, per_rad = self.values, self._counts_per_rad
        self._actual = position * per_rad + self._zero
        counts = values[POSITION] = _limited(round(self._actual), _I32)
        values[VELOCITY] = _limited(round(velocity * per_rad), _I32)
        values[TORQUE] = values[CURRENT] = _limited(round(torque * self._units_per_Nm), _I16)
        values[TEMPERATURE] = _limited(round(10.0 * temperature), _I16)
        demand = values[DEMAND] = _limited(round(self.motion.demand), _I32)
        values[POSITION_ERROR] = _limited(demand - counts, _I32)
        if not self.enabled:
            self.motion.hold(self._actual)

    def drift(self, counts: float) -> None:
        """Report the position `counts` further than observed: the motion between observation and SYNC."""
        self.values[POSITION] = _limited(round(self._actual + counts), _I32)

    # Power state machine ------------------------------------------------------------------------------

    def fault(self, code: int, register: int = 0x01) -> None:
        """Detect a fault: EMCY, then the reaction 0x605E asks for."""
        self.values[ERROR_CODE] = code
        self.emergency(code, register)
        moving = self.enabled
        self._enter(after_event(self.state, Event.FAULT))
        if moving and self.values[key(0x605E)] != 0:
            self.motion.stop(self._deceleration())
        elif self.state is State.FAULT_REACTION_ACTIVE:
            self._enter(after_event(self.state, Event.REACTION_DONE))

    def process_received(self, mapped: tuple[int, ...]) -> None:
        """Act on objects that an RPDO has just changed."""
        if MODE in mapped:
            self._change_mode()
        if CONTROLWORD in mapped:
            self._command()
        if TARGET in mapped or INTERPOLATED_TARGET in mapped:
            self._set_point()

    def connection_lost(self, code: int) -> None:
        """The master has gone: what 0x6007 asks for (1 fault, 2 disable voltage, 3 quick stop)."""
        option = self.values[key(0x6007)]
        if option == 1:
            self.fault(code, 0x11)
            return
        if code:
            self.emergency(code, 0x11)
        if option == 2:
            self._apply(Command.DISABLE_VOLTAGE.value)
        elif option == 3:
            self._apply(Command.QUICK_STOP.value)
        self._stop_latched = option in (2, 3)
        self._settled = None

    def reset(self, communication_only: bool = False) -> None:
        """NMT reset node: power off, objects at their defaults, boot-up, pre-operational.

        Args:
            communication_only: NMT reset communication: the application, its power state and its objects stay as they
                are; a drive in operation has lost its master (0x6007).
        """
        if communication_only:
            if self.nmt is NmtState.OPERATIONAL:
                self.connection_lost(0)
            super().reset(True)
            return
        self._enter(State.NOT_READY_TO_SWITCH_ON)
        self._controlword = 0
        self._stop_latched = False
        self._settled = None
        super().reset()
        self._state_rated_values()
        self._enter(after_event(self.state, Event.INITIALISED))

    def _command(self) -> None:
        word = self.values[CONTROLWORD]
        if (self.state, word) == self._settled:
            return
        if self._stop_latched and command_of(word) is not Command.ENABLE_OPERATION:
            self._stop_latched = False
        before = self.state
        if not self._stop_latched:
            self._apply(word)
        # A word repeated in a state that it leaves as it is, which is nearly every one of a run, changes nothing.
        repeated = word == self._controlword and self.state is before and not self._stop_latched
        self._settled = (before, word) if repeated else None
        self._controlword = word
        self._show_status()

    def _apply(self, word: int) -> None:
        before = self.state
        after = after_command(before, word, self._controlword)
        if before is State.FAULT and after is not before:
            self.values[ERROR_CODE] = 0
            self.clear_emergency()
        self._enter(after)
        if after is before:
            return
        if after is State.QUICK_STOP_ACTIVE:
            if self.values[key(0x605A)] == 0:
                self._enter(State.SWITCH_ON_DISABLED)
            else:
                self.motion.stop(self._deceleration())

    def _enter(self, state: State) -> None:
        if state is State.OPERATION_ENABLED and self.state is not state:
            self.motion.hold(self._actual)
            self._excess_s = 0.0
        self.state = state
        self._show_status()

    def _show_status(self) -> None:
        word = statusword_of(self.state)
        if self._following():
            word |= FOLLOWING
        if self._excess_s > 0.0:
            word |= FOLLOWING_ERROR
        self.values[STATUSWORD] = word
        self.status_changed()

    # Set-points ---------------------------------------------------------------------------------------

    def _following(self) -> bool:
        if self.state is not State.OPERATION_ENABLED:
            return False
        mode = self.values[MODE]
        return mode == CYCLIC_MODE or (mode == INTERPOLATED_MODE and bool(self._controlword & RUN_INTERPOLATION))

    def _set_point(self) -> None:
        if not self._following():
            return
        values = self.values
        target = values[TARGET if values[MODE] == CYCLIC_MODE else INTERPOLATED_TARGET]
        target = min(max(target, values[key(0x607D, 1)]), values[key(0x607D, 2)])
        period = values[key(0x60C2, 1)] * 10.0 ** values[key(0x60C2, 2)]
        self.motion.follow(target, period, self.stale)

    def _change_mode(self) -> None:
        if self.values[key(0x6061)] == self.values[MODE]:
            return
        self.values[key(0x6061)] = self.values[MODE]
        if self.state is State.OPERATION_ENABLED:
            self.motion.hold(self.motion.demand)
        self._show_status()

    def _deceleration(self) -> float:
        return float(self.values[key(0x6085)])

    def _watch_following(self, dt: float) -> None:
        window = self.values[POSITION_WINDOW]
        was = self._excess_s
        if self.enabled and window != NO_WINDOW and abs(self.motion.demand - self._actual) > window:
            self._excess_s += dt
        else:
            self._excess_s = 0.0
        if (self._excess_s > 0.0) != (was > 0.0):
            self._show_status()
        if self._excess_s > 1e-3 * self.values[key(0x6066)] and self.state is not State.FAULT_REACTION_ACTIVE:
            self.fault(FOLLOWING_ERROR_CODE, 0x21)

    def _state_rated_values(self) -> None:
        """0x6075 (mA) and 0x6076 (mN·m on the motor side), in the kind of ampere the drive reports."""
        scale = self.config.scale
        by_torque = scale.torque_source == "rated_torque"
        rated_A = scale.rated / scale.torque_constant if by_torque else scale.rated
        rated_Nm = scale.rated if by_torque else scale.rated * scale.torque_constant
        self.values[key(0x6075)] = round(1e3 * rated_A)
        self.values[key(0x6076)] = round(1e3 * rated_Nm)
        self.values[key(0x6061)] = self.values[MODE]


def _limited(value: int, limits: tuple[int, int]) -> int:
    low, high = limits
    return low if value < low else high if value > high else value
