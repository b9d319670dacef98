"""PDOs of a simulated drive: the mapping a master wrote by SDO compiled to one `struct` a PDO.

A mapping is checked when its number of entries is written, as CiA 301 (7.5.2.36) demands; a PDO may only be
remapped while it is switched off.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Final

from canopen.objectdictionary import SIGNED_TYPES
from canopen.sdo import SdoAbortedError

from spacearm_ident.canbus.pdo import INVALID
from spacearm_ident.simulation.drives.dictionary import (
    CANNOT_MAP,
    MAPPING_TOO_LONG,
    WRONG_STATE,
    DriveDictionary,
    key,
)

_LETTERS: Final = {8: "b", 16: "h", 32: "i", 64: "q"}
#: Transmission types up to this one are synchronous (CiA 301, table 68).
LAST_SYNCHRONOUS: Final = 240
PDOS: Final = 4


class Pdo:
    """One transmit or receive PDO of a drive, governed by the objects that describe it.

    Attributes:
        can_id: Its COB-ID; None while it is switched off.
        synchronous: Whether it goes with SYNC.
        divider: With every how many-th SYNC.
        mapped: Places (`key`) of the mapped objects, in order.
    """

    def __init__(
        self, dictionary: DriveDictionary, number: int, *, transmit: bool, changed: Callable[[], None]
    ) -> None:
        """Take over PDO `number` (0 to 3); `changed` is called when the master has changed it."""
        self._dictionary = dictionary
        self._communication = (0x1800 if transmit else 0x1400) + number
        self._mapping = self._communication + 0x200
        self._transmit = transmit
        self._changed = changed
        self._layout = struct.Struct("<")
        self._values = dictionary.values
        self.can_id: int | None = None
        self.synchronous = True
        self.divider = 1
        self.mapped: tuple[int, ...] = ()
        self._count = 0
        before, after = dictionary.before_write, dictionary.after_write
        before[key(self._mapping, 0)] = self._check_count
        for sub in range(1, 9):
            before[key(self._mapping, sub)] = self._check_entry
        after[key(self._mapping, 0)] = after[key(self._communication, 1)] = self.configure
        after[key(self._communication, 2)] = self.configure
        self.configure()

    @property
    def size(self) -> int:
        """Bytes of the payload."""
        return self._layout.size

    def pack(self) -> bytes:
        """The payload of a TPDO from the dictionary."""
        values = self._values
        return self._layout.pack(*[values[place] for place in self.mapped])

    def unpack(self, payload: bytes | bytearray) -> None:
        """Store the payload of an RPDO, which has at least `size` bytes, in the dictionary."""
        self._values.update(zip(self.mapped, self._layout.unpack_from(payload)))

    def due(self) -> bool:
        """Whether a synchronous TPDO goes with this SYNC; call it once a SYNC."""
        self._count += 1
        if self._count < self.divider:
            return False
        self._count = 0
        return True

    def configure(self, _: int = 0) -> None:
        """Read the describing objects, after a reset or one was written."""
        values = self._dictionary.values
        cob_id = values[key(self._communication, 1)]
        self.can_id = None if cob_id & INVALID else cob_id & 0x7FF
        kind = values[key(self._communication, 2)]
        self.synchronous = kind <= LAST_SYNCHRONOUS
        self.divider = max(1, kind) if self.synchronous else 1
        self._compile(values[key(self._mapping, 0)])
        self._changed()

    def _entry(self, sub: int) -> tuple[int, int]:
        """Place and bits of a mapped object; aborts if it cannot be mapped."""
        word = self._dictionary.values[key(self._mapping, sub)]
        index, object_sub, bits = word >> 16, word >> 8 & 0xFF, word & 0xFF
        variable = self._dictionary.variable(index, object_sub)
        if variable is None or not variable.pdo_mappable or len(variable) != bits:
            raise SdoAbortedError(CANNOT_MAP)
        if not (variable.readable if self._transmit else variable.writable):
            raise SdoAbortedError(CANNOT_MAP)
        return key(index, object_sub), bits

    def _check_count(self, count: int) -> None:
        self._check_entry(count)
        if count > 8:
            raise SdoAbortedError(MAPPING_TOO_LONG)
        if sum(self._entry(sub)[1] for sub in range(1, count + 1)) > 64:
            raise SdoAbortedError(MAPPING_TOO_LONG)

    def _check_entry(self, _: int) -> None:
        if self.can_id is not None:
            raise SdoAbortedError(WRONG_STATE)

    def _compile(self, count: int) -> None:
        entries = [self._entry(sub) for sub in range(1, count + 1)]
        letters = ""
        for place, bits in entries:
            variable = self._dictionary.variable(place >> 8, place & 0xFF)
            signed = variable is not None and variable.data_type in SIGNED_TYPES
            letters += _LETTERS[bits] if signed else _LETTERS[bits].upper()
        self._layout = struct.Struct("<" + letters)
        self.mapped = tuple(place for place, _ in entries)
