"""SDO transfers that say what failed: the object by number and name, what was written, why, and what to do.

The `canopen` library transfers; its own messages name no object.
"""

from __future__ import annotations

import logging
from typing import Final

import can
import canopen
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError, SdoError

from spacearm_ident.canbus.pdo import SdoWrite
from spacearm_ident.errors import UserError

# The library logs every time-out as "Transfer aborted by client"; the errors here say which transfer it was.
logging.getLogger("canopen.sdo.client").setLevel(logging.CRITICAL)

#: Longest object that is read, bytes; a drive that goes on sending segments is cut off (CiA 301, table 22).
LONGEST_OBJECT: Final = 8
#: SDO abort codes (CiA 301, table 22).
TOO_LONG: Final = 0x06070012
NO_OBJECT: Final = 0x06020000
NO_SUB_INDEX: Final = 0x06090011
READ_ONLY: Final = 0x06010002
OUT_OF_RANGE: Final = (0x06090030, 0x06090031, 0x06090032)
MAPPING_TOO_LONG: Final = 0x06040042
WRONG_STATE: Final = (0x08000020, 0x08000021, 0x08000022)

#: Names of CiA 301 and CiA 402 of the objects that are read or written here.
NAMES: Final[dict[int, str]] = {
    0x1000: "device type",
    0x1005: "COB-ID SYNC",
    0x1006: "communication cycle period",
    0x1016: "consumer heartbeat time",
    0x1017: "producer heartbeat time",
    0x6007: "abort connection option code",
    0x603F: "error code",
    0x6040: "controlword",
    0x6041: "statusword",
    0x605A: "quick stop option code",
    0x605E: "fault reaction option code",
    0x6060: "modes of operation",
    0x6061: "modes of operation display",
    0x6064: "position actual value",
    0x6065: "following error window",
    0x6066: "following error time-out",
    0x6075: "motor rated current",
    0x6076: "motor rated torque",
    0x607D: "software position limit",
    0x607E: "polarity",
    0x6085: "quick stop deceleration",
    0x60C2: "interpolation time period",
}
_PDOS: Final = ((0x1400, "RPDO {} communication"), (0x1600, "RPDO {} mapping"),
                (0x1800, "TPDO {} communication"), (0x1A00, "TPDO {} mapping"))  # fmt: skip


class SdoTransferError(UserError):
    """A transfer that did not succeed.

    Attributes:
        code: SDO abort code of the drive; None where it did not answer, or not as it should.
    """

    def __init__(self, message: str, code: int | None) -> None:
        super().__init__(message)
        self.code = code


def object_name(index: int, sub: int = 0) -> str:
    """An object for people: `0x6060 (modes of operation)`; the sub-index only where it is not 0.

    Args:
        index: Index of the object.
        sub: Its sub-index.
    """
    name = NAMES.get(index, "")
    for first, words in _PDOS:
        if first <= index < first + 4:
            name = words.format(index - first + 1)
    # Of an array or a record sub-index 0 is an entry, too.
    place = f"0x{index:04X}:{sub}" if sub or index in (0x1016, 0x607D, 0x60C2) or _is_pdo(index) else f"0x{index:04X}"
    return f"{place} ({name})" if name else place


def write(node: canopen.RemoteNode, what: SdoWrite) -> None:
    """Write an object.

    Args:
        node: The drive.
        what: Object and value.

    Raises:
        SdoTransferError: The drive refuses it, or does not answer.
    """
    try:
        node.sdo.download(what.index, what.sub, what.data)
    except (SdoError, can.CanError) as error:
        raise _failure(error, node, what.index, what.sub, what.value) from error


def read(node: canopen.RemoteNode, index: int, sub: int = 0, *, signed: bool = False) -> int:
    """Read an integer object, but never more than `LONGEST_OBJECT` bytes of one.

    Args:
        node: The drive.
        index: Index of the object.
        sub: Its sub-index.
        signed: Whether it is of a signed type.

    Raises:
        SdoTransferError: The drive does not answer, has no such object, or does not stop answering.
    """
    data = b""
    try:
        with node.sdo.open(index, sub, "rb", buffering=0) as stream:
            while part := stream.read(7):
                data += part
                if len(data) > LONGEST_OBJECT:
                    node.sdo.abort(TOO_LONG)
                    raise SdoCommunicationError(f"is longer than {LONGEST_OBJECT} bytes")
    except (SdoError, can.CanError) as error:
        raise _failure(error, node, index, sub, None) from error
    variable = node.object_dictionary.get_variable(index, sub)
    size = len(data) if variable is None else len(variable) // 8
    return int.from_bytes(data[:size], "little", signed=signed)


def read_if_there(node: canopen.RemoteNode, index: int, sub: int = 0, *, signed: bool = False) -> int | None:
    """Read an integer object that not every drive has; None where the drive refuses.

    Args:
        node: The drive.
        index: Index of the object.
        sub: Its sub-index.
        signed: Whether it is of a signed type.

    Raises:
        SdoTransferError: The drive does not answer.
    """
    try:
        return read(node, index, sub, signed=signed)
    except SdoTransferError as failure:
        if failure.code is None:
            raise
        return None


def _failure(error: Exception, node: canopen.RemoteNode, index: int, sub: int, value: int | None) -> SdoTransferError:
    what = object_name(index, sub) + ("" if value is None else f" = {value}")
    if isinstance(error, SdoAbortedError):
        meaning = SdoAbortedError.CODES.get(error.code, "a reason of the drive's own")
        verb = "cannot be read" if value is None else "is refused"
        return SdoTransferError(
            f"{what} {verb}: {meaning} (0x{error.code:08X}){_remedy(error.code, index)}", error.code
        )
    if "longer than" in str(error):
        return SdoTransferError(f"0x{index:04X} {error}", None)
    if "No SDO response" in str(error):
        return SdoTransferError(
            f"{what}: no answer within {node.sdo.RESPONSE_TIMEOUT:g} s: check the drive's power and the bus; for a "
            "slow drive raise sdo_timeout_s under 'cycle' in the CAN YAML",
            None,
        )
    return SdoTransferError(f"{what}: {error}", None)


def _remedy(code: int, index: int) -> str:
    """What to do about an abort code, as the end of a sentence; empty where nothing general can be said."""
    if _is_pdo(index):
        if code == MAPPING_TOO_LONG:
            return ": the drive maps fewer objects or bytes in a PDO: try slim: true under 'cycle' in the CAN YAML"
        if code in WRONG_STATE or code == READ_ONLY:
            return (
                ": the drive does not let this PDO be set: switch its mapping from fixed to variable in its own tool; "
                "where it takes fewer objects, try slim: true under 'cycle' in the CAN YAML"
            )
    if code in (NO_OBJECT, NO_SUB_INDEX):
        return ": this drive or its firmware has no such object: spacearm check compares its EDS"
    if code in OUT_OF_RANGE:
        return ": see in its manual which values and which unit it takes"
    if code in WRONG_STATE:
        return (
            ": it is in a state or under a control that forbids it: end other tools, see to its power, then try again"
        )
    return ""


def _is_pdo(index: int) -> bool:
    return any(first <= index < first + 4 for first, _ in _PDOS)
