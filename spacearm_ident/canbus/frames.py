"""CAN frames as bytes: the kernel's `struct can_frame` and `struct canfd_frame`, with a short trailer.

The layout is that of `linux/can.h` in host byte order, so that a frame captured here reads like one from a
SocketCAN socket. The trailer carries what a CAN controller adds by itself: the time the frame was sent
(nanoseconds, `CLOCK_REALTIME`) and a sequence number a sender, by which a receiver counts what it lost.
"""

from __future__ import annotations

import struct
from typing import Final

import can

CLASSIC: Final = struct.Struct("=IBBBB8sQI")
FD: Final = struct.Struct("=IBBBB64sQI")

EXTENDED_FLAG: Final = 0x80000000
REMOTE_FLAG: Final = 0x40000000
ERROR_FLAG: Final = 0x20000000
BIT_RATE_SWITCH: Final = 0x01
ERROR_STATE_INDICATOR: Final = 0x02
FD_FRAME: Final = 0x04

#: Arbitration identifiers of error frames, `linux/can/error.h`.
ERROR_NO_ACKNOWLEDGE: Final = 0x20
ERROR_BUS_OFF: Final = 0x40


def pack(message: can.Message, sent_ns: int, sequence: int) -> bytes:
    """Bytes of a frame.

    Args:
        message: Any classical, FD, remote or error frame.
        sent_ns: Time of transmission, nanoseconds since the epoch.
        sequence: Number of the frame among those of its sender; taken modulo 2³².
    """
    can_id = message.arbitration_id
    if message.is_extended_id:
        can_id |= EXTENDED_FLAG
    if message.is_remote_frame:
        can_id |= REMOTE_FLAG
    if message.is_error_frame:
        can_id |= ERROR_FLAG
    sequence &= 0xFFFFFFFF
    if not message.is_fd:
        return CLASSIC.pack(can_id, message.dlc, 0, 0, 0, bytes(message.data), sent_ns, sequence)
    flags = FD_FRAME
    if message.bitrate_switch:
        flags |= BIT_RATE_SWITCH
    if message.error_state_indicator:
        flags |= ERROR_STATE_INDICATOR
    return FD.pack(can_id, len(message.data), flags, 0, 0, bytes(message.data), sent_ns, sequence)


def unpack(raw: bytes, channel: str) -> tuple[can.Message, int]:
    """The frame in `raw` and its sequence number.

    Args:
        raw: As `pack` makes it.
        channel: Name of the bus that the message is to bear.

    Raises:
        struct.error: `raw` is neither a classical nor an FD frame.
    """
    layout = CLASSIC if len(raw) == CLASSIC.size else FD
    can_id, length, flags, _, _, data, sent_ns, sequence = layout.unpack(raw)
    if can_id <= 0x7FF and layout is CLASSIC:
        # Nearly every frame of a cycle.
        return can.Message(sent_ns * 1e-9, can_id, False, channel=channel, dlc=length, data=data[:length]), sequence
    remote = bool(can_id & REMOTE_FLAG)
    message = can.Message(
        timestamp=sent_ns * 1e-9,
        arbitration_id=can_id & (0x1FFFFFFF if can_id & (EXTENDED_FLAG | ERROR_FLAG) else 0x7FF),
        is_extended_id=bool(can_id & EXTENDED_FLAG),
        is_remote_frame=remote,
        is_error_frame=bool(can_id & ERROR_FLAG),
        channel=channel,
        dlc=length,
        data=None if remote else data[:length],
        is_fd=layout is FD,
        bitrate_switch=bool(flags & BIT_RATE_SWITCH),
        error_state_indicator=bool(flags & ERROR_STATE_INDICATOR),
    )
    return message, sequence
