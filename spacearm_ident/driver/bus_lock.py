"""One driver a bus on this machine: a lock that needs no file and goes with its process.

An abstract Unix socket name belongs to one socket at a time and vanishes when its process ends, however it
ends. Masters on other machines are found by their SYNC and heartbeat (`canbus.master`).
"""

from __future__ import annotations

import hashlib
import socket

from spacearm_ident.canbus.master import OtherMasterError
from spacearm_ident.canbus.meeting_point import runtime_dir


class BusLock:
    """The right to be master of one bus, or to be what is at its other end."""

    def __init__(self, interface: str, channel: str, node: str = "canopen_driver") -> None:
        """Take it.

        Args:
            interface: Of the bus.
            channel: Of the bus.
            node: Who wants it; one of each kind may have it.

        Raises:
            OtherMasterError: Another process has it.
        """
        # Local buses belong to a directory, all others to the machine.
        place = str(runtime_dir()) if interface == "local" else ""
        name = hashlib.sha256("\0".join((node, interface, channel, place)).encode()).hexdigest()
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            self._socket.bind(f"\0spacearm_ident/{name}")
        except OSError as error:
            self._socket.close()
            raise OtherMasterError(
                f"another {node} runs on {interface} bus '{channel}': stop it first (one a bus)"
            ) from error

    def release(self) -> None:
        """Give it back."""
        self._socket.close()
