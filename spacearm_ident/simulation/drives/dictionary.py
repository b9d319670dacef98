"""The object dictionary of a simulated drive: integers from the EDS, served by SDO, shared with the PDOs.

Every integer object lives in one flat table, so what a master reads by SDO and what a PDO carries is the same
number. Transfers, segments and toggle bits are the `canopen` library's `SdoServer`; the rules about what may
be written when are here and in `pdo`.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import TYPE_CHECKING, Final

import canopen
from canopen.objectdictionary import INTEGER_TYPES, ODVariable
from canopen.sdo import SdoAbortedError, SdoServer

from spacearm_ident.canbus.eds import eds_path

if TYPE_CHECKING:
    from spacearm_ident.simulation.drives.communication import Communication

# The library logs every transfer a master gets wrong, with traceback; the abort code tells the master.
logging.getLogger("canopen.sdo.server").setLevel(logging.CRITICAL)

#: SDO abort codes (CiA 301, table 22).
READ_ONLY: Final = 0x06010002
WRITE_ONLY: Final = 0x06010001
NO_OBJECT: Final = 0x06020000
CANNOT_MAP: Final = 0x06040041
MAPPING_TOO_LONG: Final = 0x06040042
WRONG_LENGTH: Final = 0x06070010
NO_SUB_INDEX: Final = 0x06090011
OUT_OF_RANGE: Final = 0x06090030
WRONG_STATE: Final = 0x08000022

#: Called before a value is stored; raises SdoAbortedError to refuse it.
WriteHook = Callable[[int], None]


def key(index: int, sub: int = 0) -> int:
    """Place of an object in the flat table.

    Args:
        index: Index of the object, 16 bits.
        sub: Subindex, 8 bits; 0 for an object that is one variable.
    """
    return index << 8 | sub


class DriveDictionary:
    """The objects of one drive.

    Attributes:
        values: `key(index, sub)` to integer value, of all integer objects.
        before_write: Checks of single objects, run before a master's write is stored.
        after_write: What to do once a master's write is stored.
    """

    def __init__(self, node_id: int, sender: Communication) -> None:
        """Load the EDS for node `node_id` and put every object at its default; `sender` takes the answers."""
        self.object_dictionary = canopen.import_od(str(eds_path()), node_id=node_id)
        self._variables: dict[int, ODVariable] = {}
        for entry in self.object_dictionary.values():
            members = [entry] if isinstance(entry, ODVariable) else entry.values()
            self._variables |= {key(variable.index, variable.subindex): variable for variable in members}
        self.values: dict[int, int] = {}
        self.before_write: dict[int, WriteHook] = {}
        self.after_write: dict[int, WriteHook] = {}
        self.restore()
        self._server = SdoServer(0x600 + node_id, 0x580 + node_id, self)
        self._server.network = sender  # type: ignore[assignment]  # all that the server does with it is send
        # An abort before the first transfer would otherwise have no index to name.
        self._server._index = self._server._subindex = 0

    def restore(self, last: int = 0xFFFF) -> None:
        """Put the objects (from 0x1000) with an index up to `last`, included, back to their defaults."""
        for place, variable in self._variables.items():
            if 0x1000 <= variable.index <= last and variable.data_type in INTEGER_TYPES:
                self.values[place] = int(variable.default or 0)

    def variable(self, index: int, sub: int) -> ODVariable | None:
        """The description of an object; None if there is no such object.

        Args:
            index: Of the object.
            sub: Its sub-index.
        """
        return self._variables.get(key(index, sub))

    def on_sdo(self, data: bytes | bytearray) -> None:
        """Answer an SDO request."""
        if len(data) == 8:
            self._server.on_request(0, data, 0.0)

    def get_data(self, index: int, subindex: int, check_readable: bool = False) -> bytes:
        """Bytes of an object, for the SDO server.

        Args:
            index: Index of the object, 16 bit.
            subindex: Its subindex, 8 bit.
            check_readable: Whether an object that can only be written is refused.

        Raises:
            SdoAbortedError: No such object, or it cannot be read.
        """
        variable = self._find(index, subindex)
        if check_readable and not variable.readable:
            raise SdoAbortedError(WRITE_ONLY)
        if variable.data_type in INTEGER_TYPES:
            return bytes(variable.encode_raw(self.values[key(index, subindex)]))
        return bytes(variable.encode_raw(variable.default))  # type: ignore[arg-type]  # strings have one in our EDS

    def set_data(self, index: int, subindex: int, data: bytes, check_writable: bool = False) -> None:
        """Store what a master wrote.

        Args:
            index: Index of the object, 16 bit.
            subindex: Its subindex, 8 bit.
            data: The value as the SDO carries it, of the object's length.
            check_writable: Whether an object that can only be read is refused.

        Raises:
            SdoAbortedError: No such object, read only, of another length, or refused by a rule.
        """
        variable = self._find(index, subindex)
        if check_writable and not variable.writable:
            raise SdoAbortedError(READ_ONLY)
        if 8 * len(data) != len(variable):
            raise SdoAbortedError(WRONG_LENGTH)
        value = int(variable.decode_raw(bytes(data)))
        if (variable.min is not None and value < variable.min) or (variable.max is not None and value > variable.max):
            raise SdoAbortedError(OUT_OF_RANGE)
        place = key(index, subindex)
        if place in self.before_write:
            self.before_write[place](value)
        self.values[place] = value
        if place in self.after_write:
            self.after_write[place](value)

    def _find(self, index: int, sub: int) -> ODVariable:
        variable = self.variable(index, sub)
        if variable is None:
            raise SdoAbortedError(NO_SUB_INDEX if index in self.object_dictionary else NO_OBJECT)
        return variable
