"""Open a CAN bus by interface and channel, with errors that say what to do."""

from __future__ import annotations

from typing import Any

import can
from can.interfaces import BACKENDS

from spacearm_ident.errors import UserError

# In an uninstalled checkout nobody has registered the entry point.
BACKENDS.setdefault("local", ("spacearm_ident.canbus.local_bus", "LocalBus"))


def open_bus(interface: str, channel: str, **options: Any) -> can.BusABC:
    """The bus `channel` of `interface` (`local`, `socketcan`, or any other of python-can).

    Args:
        interface: python-can's name of the interface.
        channel: Name of the bus there, such as `can0`.
        **options: Handed to the interface: `bitrate`, `fd`, `can_filters`, `receive_own_messages`, …

    Raises:
        UserError: No such interface, or the bus cannot be opened.
    """
    try:
        return can.Bus(channel=channel, interface=interface, ignore_config=True, **options)
    except NotImplementedError as error:
        raise UserError(
            f"CAN interface '{interface}' is not available ({error}): use 'local' or 'socketcan', "
            "or install its python-can plug-in"
        ) from error
    except (can.CanError, OSError, ValueError) as error:
        hint = (
            f": bring it up with `ip link set {channel} up type can bitrate 1000000`"
            if interface == "socketcan"
            else ""
        )
        raise UserError(f"cannot open CAN bus '{channel}' of '{interface}' ({error}){hint}") from error
