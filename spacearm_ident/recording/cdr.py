"""CDR, the wire format of ROS 2 messages: decode and encode the types a recording holds.

A payload is a 4-byte encapsulation header (second byte: 0 big-endian, 1 little-endian; last two: options)
followed by the plain CDR (XCDR1) body; alignment counts from the first byte after that header (OMG DDSI-RTPS
10.2, formal/2021-03-01). A string is a uint32 length, its bytes and a NUL; a sequence is a uint32 count and
its elements; float64 aligns to 8, and an empty sequence has no alignment behind its count.

A thousand joint states a second nearly always share one *layout*: same joints in the same order, hence same
places of every number. `decode_joint_states` parses one message, compares the bytes that fix the layout over
all messages at once, and reads the numbers of those that agree with one array view. What disagrees is tried
with the next layout, and in the end message by message. Every length is checked against the bytes that are
there before anything is allocated. The states that ros2_control publishes in types of its own are joint states of
another layout.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray, IntArray
from . import messages

_HEADER_BYTES = 4
_STAMP = slice(4, 12)
_VECTOR_ATTEMPTS = 12  # layouts compared over all messages before going message by message
_NOWHERE = -1  # start of a number that a message does not have
_COMPARED_TOGETHER = 4096  # messages compared in one go: the temporaries stay in the cache


class CdrError(ValueError):
    """The bytes are not a CDR message of the expected type."""


class _Cursor:
    """Reads CDR primitives one after another, never past the end of the payload."""

    def __init__(self, payload: bytes) -> None:
        if len(payload) < _HEADER_BYTES or payload[0] != 0 or payload[1] > 1:
            raise CdrError("not a plain CDR payload")
        self.payload = payload
        self.order = "<" if payload[1] == 1 else ">"
        self.position = _HEADER_BYTES
        self.fixed = [(1, 2)]  # byte spans read that decide where everything behind them stands
        self._u32 = struct.Struct(self.order + "I")

    def align(self, size: int) -> None:
        self.position += -(self.position - _HEADER_BYTES) % size

    def skip(self, size: int) -> int:
        """Step over `size` bytes; returns where they start."""
        start = self.position
        if size > len(self.payload) - start:
            raise CdrError(f"{size} bytes announced, {max(0, len(self.payload) - start)} left")
        self.position = start + size
        return start

    def u32(self) -> int:
        self.align(4)
        start = self.skip(4)
        self.fixed.append((start, start + 4))
        return int(self._u32.unpack_from(self.payload, start)[0])

    def string(self) -> str:
        size = self.u32()
        start = self.skip(size)
        self.fixed.append((start, start + size))
        try:
            return self.payload[start : start + size].removesuffix(b"\0").decode()
        except UnicodeDecodeError as error:
            raise CdrError("a string is not UTF-8") from error

    def strings(self) -> tuple[str, ...]:
        count = self.u32()
        if count * 4 > len(self.payload) - self.position:
            raise CdrError(f"{count} strings announced, too few bytes left")
        return tuple(self.string() for _ in range(count))

    def float64s(self) -> range:
        """Where each number of a sequence of float64 starts."""
        count = self.u32()
        if count == 0:
            return range(0)
        self.align(8)
        start = self.skip(8 * count)
        return range(start, start + 8 * count, 8)

    def stamp_ns(self) -> int:
        seconds, nanoseconds = struct.unpack_from(self.order + "iI", self.payload, self.skip(8))
        return int(seconds) * 1_000_000_000 + int(nanoseconds)


@dataclass(frozen=True)
class _Layout:
    """Where the numbers of a joint state stand, and which bytes make it so."""

    size: int
    order: str
    names: tuple[str, ...]
    starts: tuple[range | tuple[int, ...], ...]  # of each joint's position, velocity, effort; `_NOWHERE`: it has none
    fixed: tuple[tuple[int, int], ...]  # byte spans any message of this layout repeats; padding is not one


def _begin(payload: bytes) -> tuple[_Cursor, tuple[str, ...]]:
    """A cursor behind the header and the joints' names, with which every kind of joint state begins."""
    cursor = _Cursor(payload)
    cursor.skip(8)
    cursor.skip(cursor.u32())  # the frame_id may change: only its length matters
    return cursor, cursor.strings()


def _joint_state(payload: bytes) -> _Layout:
    cursor, names = _begin(payload)
    starts = tuple(cursor.float64s() for _ in range(3))
    return _Layout(len(payload), cursor.order, names, starts, tuple(cursor.fixed))


def _dynamic_joint_state(payload: bytes) -> _Layout:
    """Of each joint some interfaces, by name, and a number of each."""
    cursor, names = _begin(payload)
    if cursor.u32() != len(names):
        raise CdrError("not as many interfaces as joints")
    columns: tuple[list[int], ...] = ([], [], [])
    for _ in names:
        interfaces, numbers = cursor.strings(), cursor.float64s()
        if len(interfaces) != len(numbers):
            raise CdrError("not as many values as interfaces")
        place = dict(zip(interfaces, numbers))
        for column, signal in zip(columns, ("position", "velocity", "effort")):
            column.append(place.get(signal, _NOWHERE))
    return _Layout(len(payload), cursor.order, names, tuple(map(tuple, columns)), tuple(cursor.fixed))


def _trajectory_point(payload: bytes, before: int) -> _Layout:
    """A JointTrajectoryPoint with as many `before` it."""
    cursor, names = _begin(payload)
    for point in range(before + 1):
        position, velocity, _, effort = (cursor.float64s() for _ in range(4))
        if point < before:
            cursor.align(4)
            cursor.skip(8)  # time_from_start
    return _Layout(len(payload), cursor.order, names, (position, velocity, effort), tuple(cursor.fixed))


def _layout_of(kind: str, commanded: bool) -> Callable[[bytes], _Layout]:
    """What reads the layout of a message of a type; a type that is not known is taken for a JointState."""
    if kind == messages.DYNAMIC_JOINT_STATE:
        return _dynamic_joint_state
    if kind == messages.CONTROLLER_STATE:
        return lambda payload: _trajectory_point(payload, 0 if commanded else 1)
    return _joint_state


@dataclass(frozen=True)
class JointStateBlock:
    """Joint states of one layout, k messages of n joints.

    Attributes:
        rows: (k,) places of the messages among those given, ascending.
        names: The n joints, in message order.
        stamp_ns: (k,) header stamps in nanoseconds.
        position: (k, n) rad (m), or None where the messages carry none (or not one a joint).
        velocity: (k, n) rad/s (m/s), or None.
        effort: (k, n) N·m (N), or None.
    """

    rows: IntArray
    names: tuple[str, ...]
    stamp_ns: IntArray
    position: FloatArray | None
    velocity: FloatArray | None
    effort: FloatArray | None


def _block(layout: _Layout, matrix: NDArray[np.uint8], rows: IntArray) -> JointStateBlock:
    def numbers(start: int, count: int, kind: str) -> NDArray[np.generic]:
        dtype = np.dtype(layout.order + kind)
        span = np.ascontiguousarray(matrix[:, start : start + count * dtype.itemsize])
        return span.view(dtype)

    def array(starts: range | tuple[int, ...]) -> FloatArray | None:
        if len(starts) != len(layout.names) or all(start == _NOWHERE for start in starts):
            return None
        if isinstance(starts, range):
            return numbers(starts.start, len(starts), "f8").astype(np.float64)
        values = np.full((len(matrix), len(starts)), np.nan)
        for column, start in enumerate(starts):
            if start != _NOWHERE:
                values[:, column] = numbers(start, 1, "f8")[:, 0]
        return values

    seconds = numbers(_STAMP.start, 1, "i4")[:, 0].astype(np.int64)
    nanoseconds = numbers(_STAMP.start + 4, 1, "u4")[:, 0].astype(np.int64)
    position, velocity, effort = map(array, layout.starts)
    return JointStateBlock(rows, layout.names, seconds * 1_000_000_000 + nanoseconds, position, velocity, effort)


def _agrees(layout: _Layout, matrix: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Which messages of the same size repeat the bytes that fix the layout of `layout`'s message (row 0)."""
    free = np.ones(layout.size, dtype=bool)
    for start, stop in layout.fixed:
        free[start:stop] = False
    agrees = np.empty(len(matrix), dtype=bool)
    for start in range(0, len(matrix), _COMPARED_TOGETHER):
        part = slice(start, start + _COMPARED_TOGETHER)
        agrees[part] = ((matrix[part] == matrix[0]) | free).all(axis=1)
    return agrees


def _same_size(
    payloads: Sequence[bytes],
    rows: IntArray,
    read: Callable[[bytes], _Layout],
    blocks: list[JointStateBlock],
    bad: list[int],
) -> None:
    """Decode messages of one size: by comparison with a few layouts, the rest one by one."""
    size = len(payloads[rows[0]])
    joined = b"".join([payloads[row] for row in rows])
    matrix = np.frombuffer(joined, dtype=np.uint8).reshape(len(rows), size)
    for _ in range(_VECTOR_ATTEMPTS):
        if len(rows) == 0:
            return
        try:
            layout = read(payloads[rows[0]])
        except CdrError:
            bad.append(int(rows[0]))
            rows, matrix = rows[1:], matrix[1:]
            continue
        agrees = _agrees(layout, matrix)
        everything = bool(agrees.all())
        blocks.append(_block(layout, matrix if everything else matrix[agrees], rows[agrees]))
        if everything:
            return
        rows, matrix = rows[~agrees], matrix[~agrees]
    groups: dict[_Layout, list[int]] = {}
    for index, row in enumerate(rows):
        try:
            groups.setdefault(read(payloads[row]), []).append(index)
        except CdrError:
            bad.append(int(row))
    blocks.extend(_block(layout, matrix[group], rows[group]) for layout, group in groups.items())


def decode_joint_states(
    payloads: Sequence[bytes], kind: str = "", *, commanded: bool = False
) -> tuple[list[JointStateBlock], list[int]]:
    """Decode `sensor_msgs/msg/JointState` messages in bulk, or what ros2_control publishes in their place.

    Args:
        payloads: CDR payloads, either byte order, in any mixture of layouts.
        kind: Type of the messages, `messages.DYNAMIC_JOINT_STATE` or `messages.CONTROLLER_STATE`; any other is taken
            for a JointState.
        commanded: Whether the set-points of a controller's state are wanted, not what it measures.

    Returns:
        The messages grouped by layout, and the places of those that could not be decoded. Memory is
        proportional to the payloads, whatever lengths they announce.
    """
    blocks: list[JointStateBlock] = []
    bad: list[int] = []
    read = _layout_of(kind, commanded)
    sizes = np.fromiter((len(payload) for payload in payloads), dtype=np.int64, count=len(payloads))
    order = np.argsort(sizes, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(sizes[order])) + 1):
        if len(rows) and sizes[rows[0]] == 0:
            bad.extend(rows.tolist())
        elif len(rows):
            _same_size(payloads, rows, read, blocks, bad)
    return blocks, sorted(bad)


def decode_stamped(payload: bytes, texts: int, numbers: int) -> tuple[int, tuple[str, ...], tuple[float, ...]]:
    """Decode a message of a stamp, some strings, the first the frame_id, and float64 that are no sequence.

    Args:
        payload: CDR payload.
        texts: How many strings.
        numbers: How many float64 after them; more may follow.

    Returns:
        Stamp in nanoseconds, strings, numbers.

    Raises:
        CdrError: The payload is no such message.
    """
    cursor = _Cursor(payload)
    stamp_ns = cursor.stamp_ns()
    words = tuple(cursor.string() for _ in range(texts))
    cursor.align(8)
    return stamp_ns, words, struct.unpack_from(f"{cursor.order}{numbers}d", payload, cursor.skip(8 * numbers))


def decode_temperature(payload: bytes) -> tuple[int, str, float]:
    """Decode a `sensor_msgs/msg/Temperature`: stamp in nanoseconds, frame_id, °C.

    Raises:
        CdrError: The payload is no such message.
    """
    stamp_ns, (frame_id,), (temperature,) = decode_stamped(payload, 1, 1)
    return stamp_ns, frame_id, temperature


def decode_string(payload: bytes) -> str:
    """Decode a `std_msgs/msg/String`.

    Raises:
        CdrError: The payload is no such message.
    """
    return _Cursor(payload).string()


_LITTLE_ENDIAN = b"\x00\x01\x00\x00"


class _Builder:
    """Appends CDR primitives, little-endian; counterpart of `_Cursor`."""

    def __init__(self) -> None:
        self.data = bytearray(_LITTLE_ENDIAN)

    def align(self, size: int) -> None:
        self.data += bytes(-(len(self.data) - _HEADER_BYTES) % size)

    def u32(self, value: int) -> None:
        self.align(4)
        self.data += struct.pack("<I", value)

    def string(self, value: str) -> None:
        encoded = value.encode() + b"\0"
        self.u32(len(encoded))
        self.data += encoded

    def float64_room(self, count: int) -> int:
        """Append a sequence of `count` zeros; returns where the numbers start."""
        self.u32(count)
        if count:
            self.align(8)
        start = len(self.data)
        self.data += bytes(8 * count)
        return start

    def stamp(self, stamp_ns: int) -> None:
        seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
        self.data += struct.pack("<iI", seconds, nanoseconds)


def encode_joint_states(
    stamp_ns: IntArray | Sequence[int],
    names: Iterable[str],
    position: FloatArray | None = None,
    velocity: FloatArray | None = None,
    effort: FloatArray | None = None,
    *,
    frame_id: str = "",
) -> list[bytes]:
    """Encode N `sensor_msgs/msg/JointState` messages at once.

    Args:
        stamp_ns: (N,) header stamps, nanoseconds.
        names: The n joints.
        position: (N, n) rad (m); None leaves the array of the message empty, as for the next two.
        velocity: (N, n) rad/s (m/s).
        effort: (N, n) N·m (N).
        frame_id: Frame of all headers.

    Returns:
        N payloads, little-endian.
    """
    builder = _Builder()
    builder.stamp(0)
    builder.string(frame_id)
    names = tuple(names)
    builder.u32(len(names))
    for name in names:
        builder.string(name)
    stamps = np.asarray(stamp_ns, dtype=np.int64)
    filled = []
    for values in (position, velocity, effort):
        if values is None:
            builder.float64_room(0)
        else:
            wanted = np.ascontiguousarray(values, dtype="<f8").reshape(len(stamps), len(names))
            filled.append((builder.float64_room(len(names)), wanted.view(np.uint8)))
    size = len(builder.data)
    matrix = np.tile(np.frombuffer(builder.data, dtype=np.uint8), (len(stamps), 1))
    seconds, nanoseconds = np.divmod(stamps, 1_000_000_000)
    clock = np.empty((len(stamps), 2), dtype="<u4")
    clock[:, 0], clock[:, 1] = seconds.astype("<i4").view("<u4"), nanoseconds
    matrix[:, _STAMP] = clock.view(np.uint8)
    for start, data in filled:
        matrix[:, start : start + data.shape[1]] = data
    everything = matrix.tobytes()
    return [everything[start : start + size] for start in range(0, len(everything), size)]


def encode_stamped(stamp_ns: int, texts: Iterable[str], numbers: Iterable[float]) -> bytes:
    """Encode a message of a stamp, strings and float64; counterpart of `decode_stamped`.

    Args:
        stamp_ns: Stamp of the header, ns since the epoch.
        texts: Strings, the first the frame_id.
        numbers: Float64 values after them.
    """
    builder = _Builder()
    builder.stamp(stamp_ns)
    for text in texts:
        builder.string(text)
    builder.align(8)
    values = tuple(numbers)
    return bytes(builder.data) + struct.pack(f"<{len(values)}d", *values)


def encode_temperature(stamp_ns: int, frame_id: str, temperature: float, variance: float = 0.0) -> bytes:
    """Encode a `sensor_msgs/msg/Temperature`.

    Args:
        stamp_ns: Stamp of the header, ns since the epoch.
        frame_id: Name of the joint.
        temperature: °C.
        variance: Variance of the temperature, °C²; 0: unknown.
    """
    return encode_stamped(stamp_ns, (frame_id,), (temperature, variance))


def encode_string(text: str) -> bytes:
    """Encode a `std_msgs/msg/String`."""
    builder = _Builder()
    builder.string(text)
    return bytes(builder.data)
