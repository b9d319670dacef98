"""How full a CAN bus will be, computed before anything is sent.

Bits of a frame (11-bit identifier, n data bytes), ISO 11898-1, including the three bits between frames:

- Classical: 47 + 8 n, of which 34 + 8 n are subject to bit stuffing: at worst one bit for the first five and
  one for every four after, ⌊(33 + 8 n)/4⌋.
- FD with bit-rate switch: 30 bits at the arbitration rate, then 5 + 8 n, the stuff count (4), the CRC (17, or
  21 above 16 bytes) and its fixed stuff bits (6 or 7) at the data rate.

Mean stuffing is taken as a third of the worst case (ours): frames of PDO-like content with their real CRC
have 0.21 to 0.32 of it, more than random payloads (0.14), for positions and torques have runs of equal bits.
A bus is refused on its worst case, for a cycle that only fits on average misses feedback at random.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final

from spacearm_ident.errors import UserError

MEAN_STUFFING: Final = 1.0 / 3.0
#: Payload sizes a CAN FD frame can have.
FD_SIZES: Final = (*range(9), 12, 16, 20, 24, 32, 48, 64)


@dataclass(frozen=True)
class BitRate:
    """Bits per second: of the bus, and of the data phase where frames are FD (None: classical)."""

    nominal: float = 1e6
    data: float | None = None


@dataclass(frozen=True)
class CyclicFrame:
    """Frames of `size` data bytes, `rate` of them a second; `fd` where the bus allows it."""

    size: int
    rate: float
    fd: bool = True


@dataclass(frozen=True)
class BusLoad:
    """Share of the bus in use (1 is full), with mean and with worst-case bit stuffing."""

    mean: float
    worst: float

    def __str__(self) -> str:
        return f"{100 * self.mean:.0f} % (worst case {100 * self.worst:.0f} %)"


@dataclass(frozen=True)
class Traffic:
    """What a bus carries: one SYNC a cycle, a feedback and a set-point frame an axis, heartbeats.

    Attributes:
        feedback_bytes: Bytes of a drive's TPDO.
        set_point_bytes: Bytes of a drive's RPDO.
        rate: SYNC and feedback, Hz.
        set_point_rate: Set-points, Hz; None: as `rate`.
        heartbeat_rate: Heartbeats of each drive and of the master, Hz.
    """

    feedback_bytes: int = 8
    set_point_bytes: int = 6
    rate: float = 1000.0
    set_point_rate: float | None = None
    heartbeat_rate: float = 0.0

    def frames(self, axes: int) -> list[CyclicFrame]:
        """The frames on a bus of `axes` drives; SYNC and heartbeats stay classical on an FD bus (CiA 301)."""
        set_points = self.rate if self.set_point_rate is None else self.set_point_rate
        return [
            CyclicFrame(0, self.rate, fd=False),
            CyclicFrame(self.feedback_bytes, axes * self.rate),
            CyclicFrame(self.set_point_bytes, axes * set_points),
            CyclicFrame(1, (axes + 1) * self.heartbeat_rate, fd=False),
        ]


def frame_seconds(size: int, rate: BitRate, fd: bool) -> tuple[float, float]:
    """Time a frame of `size` bytes takes on the bus, s: with mean and with worst-case stuffing.

    Args:
        size: Data bytes of the frame: 0 to 8 of a classical frame, one of `FD_SIZES` of an FD frame.
        rate: Bit rates of the bus, bit/s.
        fd: Whether the frame is an FD frame; it stays classical on a bus without a data rate.

    Raises:
        ValueError: No frame of this kind holds `size` bytes.
    """
    if not fd or rate.data is None:
        if not 0 <= size <= 8:
            raise ValueError(f"a classical CAN frame holds 0 to 8 bytes, not {size}")
        bits, stuff = 47 + 8 * size, (33 + 8 * size) // 4
        return (bits + MEAN_STUFFING * stuff) / rate.nominal, (bits + stuff) / rate.nominal
    if size not in FD_SIZES:
        raise ValueError(f"a CAN FD frame cannot hold {size} bytes exactly")
    crc = 17 + 6 if size <= 16 else 21 + 7
    stuff_nominal = 4
    stuff_data = (21 + 8 * size) // 4 - stuff_nominal
    plain = 30 / rate.nominal + (5 + 8 * size + 4 + crc) / rate.data
    stuffed = stuff_nominal / rate.nominal + stuff_data / rate.data
    return plain + MEAN_STUFFING * stuffed, plain + stuffed


def bus_load(frames: Iterable[CyclicFrame], rate: BitRate = BitRate()) -> BusLoad:
    """Load of one bus by `frames`.

    Args:
        frames: All that is sent on the bus in the cycle, as `Traffic.frames` gives it.
        rate: Bit rates of the bus, bit/s; default: classical CAN at 1 Mbit/s.

    Raises:
        ValueError: A frame cannot hold its bytes.
    """
    mean = worst = 0.0
    for frame in frames:
        mean_s, worst_s = frame_seconds(frame.size, rate, frame.fd)
        mean += frame.rate * mean_s
        worst += frame.rate * worst_s
    return BusLoad(mean, worst)


def alternatives(axes: int, traffic: Traffic, rate: BitRate) -> list[tuple[str, BusLoad]]:
    """Ways to carry `axes` axes, with the load of the fullest bus; those that give up least come first.

    Args:
        axes: Number of drives of the arm, over all buses.
        traffic: What each axis exchanges now; `rate` in Hz.
        rate: Bit rates of a bus, bit/s.

    Returns:
        What to change, in words, and the load of the fullest bus after that change.
    """

    def load(buses: int, changed: Traffic = traffic, bits: BitRate = rate) -> BusLoad:
        return bus_load(changed.frames(-(-axes // buses)), bits)

    ways = [(f"{n} buses of {-(-axes // n)} axes", load(n)) for n in (2, 3) if n <= axes]
    if rate.data is None:
        ways.append(("CAN FD at 1/5 Mbit/s", load(1, bits=BitRate(rate.nominal, 5 * rate.nominal))))
    slim = replace(traffic, feedback_bytes=6, set_point_bytes=4, set_point_rate=traffic.rate / 4)
    ways.append((f"6-byte feedback (no status word) and 4-byte set-points at {traffic.rate / 4:g} Hz", load(1, slim)))
    half = replace(
        traffic,
        rate=traffic.rate / 2,
        set_point_rate=None if traffic.set_point_rate is None else traffic.set_point_rate / 2,
    )
    ways.append((f"everything at {half.rate:g} Hz", load(1, half)))
    return ways


def check(
    axes_per_bus: Sequence[int],
    traffic: Traffic,
    rate: BitRate = BitRate(),
) -> list[BusLoad]:
    """Load of each bus, for the diagnostics.

    Args:
        axes_per_bus: Axes on each bus, such as (3, 3).
        traffic: What each axis exchanges.
        rate: Bit rate of the buses.

    Raises:
        UserError: A bus is over 100 % in the worst case; names the alternatives that fit, with their figures.
    """
    loads = [bus_load(traffic.frames(axes), rate) for axes in axes_per_bus]
    fullest = max(range(len(loads)), key=lambda bus: loads[bus].worst)
    if loads[fullest].worst > 1.0:
        ways = alternatives(sum(axes_per_bus), traffic, rate)
        fitting = "; ".join(f"{name}: {load}" for name, load in ways if load.worst <= 1.0)
        raise UserError(
            f"bus {fullest} with {axes_per_bus[fullest]} axes at {traffic.rate:g} Hz would be loaded "
            f"{loads[fullest]}: choose {fitting or 'a lower rate or fewer axes'}"
        )
    return loads
