"""What is in the cyclic frames: layouts, the bytes for all drives at once, the SDO writes that set them up.

A layout is a list of objects in the order they are packed (CiA 301, little endian). `Feedback` and
`SetPoints` hold the payloads of all drives in one buffer with a numpy view on it, so a frame costs one copy
of 8 bytes, and scaling to SI one vector operation a quantity.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spacearm_ident.arrays import FloatArray
from spacearm_ident.canbus.scaling import JointScale, Scaling

#: COB-IDs of the predefined connection set (CiA 301), and the bit that switches a PDO off.
TPDO1: Final = 0x180
RPDO1: Final = 0x200
SYNC: Final = 0x080
INVALID: Final = 0x80000000
#: PDO transmission types: with every SYNC, and on change (transmit) or at once (receive).
EVERY_SYNC: Final = 1
ON_EVENT: Final = 255
_INT32: Final = np.iinfo(np.int32)


class Field(NamedTuple):
    """One mapped object: its name here, its place in the dictionary, its numpy type."""

    name: str
    index: int  # type: ignore[assignment]  # the field hides tuple.index, which nobody calls
    sub: int
    kind: str

    @property
    def bits(self) -> int:
        """Length in bits."""
        return 8 * np.dtype(self.kind).itemsize

    @property
    def mapping(self) -> int:
        """The mapping parameter: index, sub-index and length in bits (CiA 301, 7.5.2.36)."""
        return self.index << 16 | self.sub << 8 | self.bits


STATUSWORD: Final = Field("statusword", 0x6041, 0, "<u2")
POSITION: Final = Field("position", 0x6064, 0, "<i4")
TORQUE: Final = Field("torque", 0x6077, 0, "<i2")
CURRENT: Final = Field("torque", 0x6078, 0, "<i2")
TARGET: Final = Field("target", 0x607A, 0, "<i4")
INTERPOLATED_TARGET: Final = Field("target", 0x60C1, 1, "<i4")
CONTROLWORD: Final = Field("controlword", 0x6040, 0, "<u2")


@dataclass(frozen=True)
class Layout:
    """The objects of one PDO, in order."""

    fields: tuple[Field, ...]

    @property
    def dtype(self) -> np.dtype[np.void]:
        """The payload as a packed structured type."""
        return np.dtype([(field.name, field.kind) for field in self.fields])

    @property
    def size(self) -> int:
        """Bytes."""
        return self.dtype.itemsize


FEEDBACK: Final = Layout((POSITION, TORQUE, STATUSWORD))
SET_POINT: Final = Layout((TARGET, CONTROLWORD))
#: For a full bus: status word and controlword go in PDOs of their own, only when they change.
SLIM_FEEDBACK: Final = Layout((POSITION, TORQUE))
SLIM_SET_POINT: Final = Layout((TARGET,))


class SdoWrite(NamedTuple):
    """One expedited SDO download: `value` as an unsigned or signed integer of `size` bytes."""

    index: int  # type: ignore[assignment]  # as in `Field`
    sub: int
    value: int
    size: int

    @property
    def data(self) -> bytes:
        """The bytes to write."""
        return self.value.to_bytes(self.size, "little", signed=self.value < 0)


def pdo_writes(
    node_id: int, layout: Layout, *, transmit: bool, number: int = 1, transmission_type: int = EVERY_SYNC
) -> list[SdoWrite]:
    """The writes that give a drive's PDO this layout, in the order CiA 301 (7.5.2.36) prescribes.

    Args:
        node_id: The drive.
        layout: What it packs.
        transmit: A TPDO (feedback) or an RPDO (set-point).
        number: 1 to 4; the COB-ID is that of the predefined connection set.
        transmission_type: 1: with every SYNC.
    """
    cob_id = (TPDO1 if transmit else RPDO1) + 0x100 * (number - 1) + node_id
    communication = (0x1800 if transmit else 0x1400) + number - 1
    mapping = communication + 0x200
    return [
        SdoWrite(communication, 1, INVALID | cob_id, 4),
        SdoWrite(communication, 2, transmission_type, 1),
        SdoWrite(mapping, 0, 0, 1),
        *(SdoWrite(mapping, sub, field.mapping, 4) for sub, field in enumerate(layout.fields, start=1)),
        SdoWrite(mapping, 0, len(layout.fields), 1),
        SdoWrite(communication, 1, cob_id, 4),
    ]


def pdo_off(node_id: int, *, transmit: bool, number: int) -> SdoWrite:
    """The write that switches a PDO off.

    Args:
        node_id: CANopen node ID of the drive.
        transmit: Whether it is a TPDO (feedback); else an RPDO (set-point).
        number: 1 to 4; the COB-ID is that of the predefined connection set.
    """
    cob_id = (TPDO1 if transmit else RPDO1) + 0x100 * (number - 1) + node_id
    return SdoWrite((0x1800 if transmit else 0x1400) + number - 1, 1, INVALID | cob_id, 4)


class Feedback:
    """The last feedback of n drives, as received and in SI.

    Attributes:
        statusword: (n,) uint16 view of the payloads; zeros where the layout has none.
        position: (n,) rad, after `decode`.
        torque: (n,) N·m on the output side, after `decode`.
        current: (n,) A, after `decode`.
    """

    def __init__(self, joints: Sequence[JointScale], layout: Layout = FEEDBACK) -> None:
        count = len(joints)
        self.layout = layout
        self._size = layout.size
        self._buffer = bytearray(count * self._size)
        self._bytes = memoryview(self._buffer)
        raw = np.frombuffer(self._buffer, dtype=layout.dtype)
        self._scaling = Scaling(joints)
        self._slices = [slice(k * self._size, (k + 1) * self._size) for k in range(count)]
        self.counts: NDArray[np.int32] = raw["position"]
        self.units: NDArray[np.int16] = raw["torque"]
        self.statusword: NDArray[np.uint16] = (
            raw["statusword"] if "statusword" in (layout.dtype.names or ()) else np.zeros(count, dtype=np.uint16)
        )
        self.position = np.zeros(count)
        self.torque = np.zeros(count)
        self.current = np.zeros(count)

    def put(self, drive: int, payload: bytes | bytearray) -> bool:
        """Take in the payload of a drive's TPDO; False, and nothing taken, if its length is wrong."""
        if len(payload) != self._size:
            return False
        self._bytes[self._slices[drive]] = payload
        return True

    def decode(self) -> None:
        """Scale the payloads into `position`, `torque` and `current`."""
        self._scaling.to_position(self.counts, self.position)
        np.multiply(self.units, self._scaling.torque_per_unit, out=self.torque)
        np.multiply(self.units, self._scaling.amps_per_unit, out=self.current)


class SetPoints:
    """The payloads to send to n drives."""

    def __init__(self, joints: Sequence[JointScale], layout: Layout = SET_POINT) -> None:
        count = len(joints)
        self._buffer = bytearray(count * layout.size)
        raw = np.frombuffer(self._buffer, dtype=layout.dtype)
        self._scaling = Scaling(joints)
        self._target: NDArray[np.int32] = raw["target"]
        self._scratch = np.zeros(count)
        self.controlword: NDArray[np.uint16] = (
            raw["controlword"] if "controlword" in (layout.dtype.names or ()) else np.zeros(count, dtype=np.uint16)
        )
        view = memoryview(self._buffer)
        self.payloads = [view[k * layout.size : (k + 1) * layout.size] for k in range(count)]

    def encode(self, position: FloatArray) -> None:
        """Put joint angles (n,), rad, into the payloads.

        Raises:
            ValueError: An angle is not finite or beyond the drive's range; the targets stay as they were.
        """
        self._scaling.to_counts(position, self._scratch)
        # NaN fails both comparisons.
        if not (self._scratch.min() >= _INT32.min and self._scratch.max() <= _INT32.max):
            raise ValueError("a set-point is not finite or beyond the drive's 32-bit range")
        self._target[:] = self._scratch

    def hold(self, feedback: Feedback, axes: NDArray[np.bool_]) -> None:
        """Set the targets of `axes` (n,) to the actual position, count for count: enabling moves nothing."""
        np.copyto(self._target, feedback.counts, where=axes)

    def position(self) -> FloatArray:
        """The targets as joint angles (n,), rad; a new array."""
        out = np.empty(len(self._target))
        self._scaling.to_position(self._target, out)
        return out
