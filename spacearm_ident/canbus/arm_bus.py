"""What a master is told about the drives and their buses, and the SDO writes that follow from it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

from spacearm_ident.canbus.bus_load import BitRate, BusLoad, Traffic, check
from spacearm_ident.canbus.pdo import (
    CONTROLWORD,
    FEEDBACK,
    INTERPOLATED_TARGET,
    ON_EVENT,
    SET_POINT,
    STATUSWORD,
    SYNC,
    TARGET,
    Layout,
    SdoWrite,
    pdo_off,
    pdo_writes,
)
from spacearm_ident.canbus.scaling import JointScale
from spacearm_ident.errors import UserError

#: Reactions asked of every drive: quick stop when the master is lost (0x6007), stay under power after it
#: (0x605A), stop on the quick-stop ramp in a fault (0x605E).
ON_LOST_MASTER: Final = 3
AFTER_QUICK_STOP: Final = 6
IN_FAULT: Final = 2
INTERPOLATED_MODE: Final = 7
CYCLIC_MODE: Final = 8
#: Joints slower than this stand still, rad/s.
STANDSTILL: Final = 0.005
#: Extrapolation where none is given, and the longest that is believed, s.
EXTRAPOLATION: Final = 0.06
MOST_EXTRAPOLATION: Final = 1.0
#: Units of 0x6085 that drives have: counts of the encoder, or speed of the motor; or it is left as the drive has it.
QUICK_STOP_UNITS: Final = ("counts/s2", "rpm/s", "none")
#: How long a drive may take to answer an SDO request where nothing is given, s: the canopen library's own.
SDO_TIMEOUT: Final = 0.3
_I32: Final = 2**31 - 1
_U32: Final = 2**32 - 1
STATUS_PDO: Final = Layout((STATUSWORD,))
CONTROL_PDO: Final = Layout((CONTROLWORD,))


@dataclass(frozen=True)
class Axis:
    """One joint's drive.

    Attributes:
        node_id: CANopen node, 1 to 126.
        scale: How it counts.
        bus: Number of its bus.
        limits: Smallest and largest target the drive itself accepts, rad.
        following_error: Distance of target and actual position that is a fault in the drive, rad.
        following_error_time: For how long, s.
        quick_stop_deceleration: Of the drive's ramp, rad/s².
        temperature_object: Index of the maker's object that has the winding temperature, signed, in 0.1 °C; None: none.
        quick_stop_unit: What the drive counts 0x6085 in, one of `QUICK_STOP_UNITS`; `none`: it is not written.
    """

    node_id: int
    scale: JointScale
    bus: int = 0
    limits: tuple[float, float] = (-math.inf, math.inf)
    following_error: float = math.inf
    following_error_time: float = 0.01
    quick_stop_deceleration: float = 20.0
    temperature_object: int | None = None
    quick_stop_unit: str = "counts/s2"

    def __post_init__(self) -> None:
        """Refuse a unit that is not known.

        Raises:
            UserError: It is none of `QUICK_STOP_UNITS`.
        """
        if self.quick_stop_unit not in QUICK_STOP_UNITS:
            raise UserError(f"quick_stop_unit is '{self.quick_stop_unit}': give one of {', '.join(QUICK_STOP_UNITS)}")


@dataclass(frozen=True)
class ArmBus:
    """All axes and what is common to them. Times in seconds.

    Attributes:
        axes: In joint order.
        period: Of SYNC.
        set_point_divider: Set-points go with every how many-th SYNC.
        mode: Mode of operation: 8 (cyclic synchronous position), or 7 (interpolated position).
        feedback: Layout of the TPDO.
        set_point: Layout of the RPDO; in mode 7 its target is taken as 0x60C1.
        answer_time: From SYNC until all feedback must be there.
        master_id: Node of the master, whose heartbeat the drives watch.
        heartbeat: Interval of the master's and the drives' heartbeats.
        heartbeat_timeout: Without a heartbeat for so long, the other side is lost.
        stale_cycles: Cycles in a row without feedback after which an axis is reported.
        extrapolation: How long the drives go on with their last velocity when set-points fail to come; 0: they stand.
        sdo_timeout: How long a drive may take to answer an SDO request.
        bit_rate: For the load of the buses.
    """

    axes: tuple[Axis, ...]
    period: float = 1e-3
    set_point_divider: int = 1
    mode: int = 8
    feedback: Layout = FEEDBACK
    set_point: Layout = SET_POINT
    answer_time: float = 0.9e-3
    master_id: int = 127
    heartbeat: float = 0.05
    heartbeat_timeout: float = 0.2
    stale_cycles: int = 20
    extrapolation: float = EXTRAPOLATION
    sdo_timeout: float = SDO_TIMEOUT
    bit_rate: BitRate = field(default_factory=BitRate)

    def __post_init__(self) -> None:
        """Refuse what cannot work.

        Raises:
            UserError: Nodes doubled or out of range, an unknown mode, no axis.
        """
        places = [(axis.bus, axis.node_id) for axis in self.axes]
        if not places or len(set(places)) < len(places):
            raise UserError("give each axis its own node on its bus, and at least one axis")
        for axis in self.axes:
            if not 1 <= axis.node_id <= 126 or axis.node_id == self.master_id:
                raise UserError(f"node {axis.node_id} cannot be a drive: use 1 to 126, not the master's")
        if self.mode not in (INTERPOLATED_MODE, CYCLIC_MODE):
            raise UserError(f"mode of operation {self.mode} is not supported: use 8, or 7")
        if self.mode == INTERPOLATED_MODE:
            fields = tuple(INTERPOLATED_TARGET if field is TARGET else field for field in self.set_point.fields)
            object.__setattr__(self, "set_point", Layout(fields))
        if not 0 <= self.extrapolation <= MOST_EXTRAPOLATION:
            raise UserError(f"extrapolation_s is {self.extrapolation:g}: give seconds from 0 to {MOST_EXTRAPOLATION:g}")
        if not self.sdo_timeout > 0:
            raise UserError(f"sdo_timeout_s is {self.sdo_timeout:g}: give a positive number of seconds")
        if not 0 < self.answer_time < self.period:
            raise UserError("answer_time must be positive and shorter than the period")

    @property
    def scales(self) -> list[JointScale]:
        """Of all axes."""
        return [axis.scale for axis in self.axes]

    @property
    def buses(self) -> int:
        """How many buses the axes are on."""
        return 1 + max(axis.bus for axis in self.axes)

    def loads(self) -> list[BusLoad]:
        """Load of each bus.

        Raises:
            UserError: A bus would be over 100 %.
        """
        counts = [sum(axis.bus == bus for axis in self.axes) for bus in range(self.buses)]
        rate = 1.0 / self.period
        traffic = Traffic(
            feedback_bytes=self.feedback.size,
            set_point_bytes=self.set_point.size,
            rate=rate,
            set_point_rate=rate / self.set_point_divider,
            heartbeat_rate=1.0 / self.heartbeat,
        )
        return check(counts, traffic, self.bit_rate)


def required_writes(axis: Axis, arm: ArmBus) -> list[SdoWrite]:
    """What a drive must accept to work in the cycle: PDOs, SYNC, heartbeats, mode, interpolation time.

    Args:
        axis: The drive that is written to; its node id goes into the PDOs' identifiers.
        arm: Layouts of the PDOs, timing and mode, common to all drives.

    Returns:
        In the order in which they are written; the master gives up where a drive refuses one.
    """
    value, exponent = interpolation_time(arm.period * arm.set_point_divider)
    node = axis.node_id
    timeout_ms = round(1e3 * arm.heartbeat_timeout)
    own_status = STATUSWORD not in arm.feedback.fields
    own_control = CONTROLWORD not in arm.set_point.fields
    writes = [
        SdoWrite(0x1005, 0, SYNC, 4),
        *pdo_writes(node, arm.feedback, transmit=True),
        *pdo_writes(node, arm.set_point, transmit=False),
    ]
    if own_status:
        writes += pdo_writes(node, STATUS_PDO, transmit=True, number=2, transmission_type=ON_EVENT)
    if own_control:
        writes += pdo_writes(node, CONTROL_PDO, transmit=False, number=2, transmission_type=ON_EVENT)
    return [
        *writes,
        SdoWrite(0x1016, 1, arm.master_id << 16 | timeout_ms, 4),
        SdoWrite(0x1017, 0, round(1e3 * arm.heartbeat), 2),
        SdoWrite(0x6060, 0, arm.mode, 1),
        SdoWrite(0x60C2, 1, value, 1),
        SdoWrite(0x60C2, 2, exponent, 1),
    ]


def optional_writes(axis: Axis, arm: ArmBus, present: int | None = None) -> list[SdoWrite]:
    """What makes the drive itself stop in time; not every drive has all of it, and a refusal is reported.

    Args:
        axis: The drive that is written to, with its position limits, following error and quick-stop ramp.
        arm: Layouts, which leave some PDOs unused, and the SYNC period.
        present: Where the drive is, counts; None: not known.

    Returns:
        Unused PDOs switched off, then the SYNC period, reactions, following-error window and position limits.
    """
    per_rad = 1.0 / abs(axis.scale.rad_per_count)
    window = _U32 if math.isinf(axis.following_error) else min(round(axis.following_error * per_rad), _U32)
    unused = [(transmit, number) for number in (2, 3, 4) for transmit in (True, False)]
    if STATUSWORD not in arm.feedback.fields:
        unused.remove((True, 2))
    if CONTROLWORD not in arm.set_point.fields:
        unused.remove((False, 2))
    return [
        *(pdo_off(axis.node_id, transmit=transmit, number=number) for transmit, number in unused),
        SdoWrite(0x1006, 0, round(1e6 * arm.period), 4),
        SdoWrite(0x6007, 0, ON_LOST_MASTER, 2),
        SdoWrite(0x605A, 0, AFTER_QUICK_STOP, 2),
        SdoWrite(0x605E, 0, IN_FAULT, 2),
        *_quick_stop(axis),
        SdoWrite(0x6065, 0, window, 4),
        SdoWrite(0x6066, 0, round(1e3 * axis.following_error_time), 2),
        *position_limits(axis, present),
    ]


def position_limits(axis: Axis, present: int | None = None) -> list[SdoWrite]:
    """The writes of 0x607D: an axis' position limits, widened to where it is.

    Args:
        axis: With its limits.
        present: Where the drive is, counts: a drive that keeps its target within limits that exclude it moves as it is
            enabled. None: not known.
    """
    low, high = sorted(_counts(limit, axis.scale) for limit in axis.limits)
    if present is not None:
        low, high = min(low, present), max(high, present)
    return [SdoWrite(0x607D, 1, low, 4), SdoWrite(0x607D, 2, high, 4)]


def _quick_stop(axis: Axis) -> list[SdoWrite]:
    """The write of 0x6085, in the drive's unit."""
    if axis.quick_stop_unit == "none":
        return []
    rpm = axis.scale.gear_ratio * 60.0 / (2.0 * math.pi)
    per_rad = rpm if axis.quick_stop_unit == "rpm/s" else 1.0 / abs(axis.scale.rad_per_count)
    return [SdoWrite(0x6085, 0, min(round(axis.quick_stop_deceleration * per_rad), _U32), 4)]


def interpolation_time(period: float) -> tuple[int, int]:
    """0x60C2: `period` (s) as a value of 1 to 255 and a power of ten.

    Raises:
        UserError: The period cannot be said exactly.
    """
    for exponent in (-3, -4, -5):
        value = period * 10.0**-exponent
        if 1 <= round(value) <= 255 and math.isclose(value, round(value), rel_tol=1e-9):
            return round(value), exponent
    raise UserError(f"a drive cannot be set to a period of {period:g} s: use whole milliseconds up to 0.255 s")


def _counts(angle: float, scale: JointScale) -> int:
    if math.isinf(angle):
        return int(math.copysign(_I32, angle * scale.direction))
    return max(-_I32, min(round(angle / scale.rad_per_count) + scale.zero_counts, _I32))
