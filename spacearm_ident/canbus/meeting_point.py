"""Where the processes on one local bus find each other: a private directory with one socket a participant.

Whoever joins connects to all who are there and then listens for those who come later, all under one lock, so
each pair shares exactly one connection. There is no hub, therefore nothing whose death takes the bus down.
A socket file nobody listens on any more (its process was killed) refuses the connection and is removed.
"""

from __future__ import annotations

import fcntl
import os
import re
import secrets
import socket
import stat
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import can

#: How long to wait for another process that is joining or leaving at this moment, seconds.
LOCK_TIMEOUT = 2.0
#: Connections that may wait for a participant that is busy elsewhere.
BACKLOG = 64


def runtime_dir() -> Path:
    """The directory of this user's buses, created if need be; nobody else can enter it.

    `$SPACEARM_RUNTIME_DIR`, else `$XDG_RUNTIME_DIR/spacearm_ident`, else `/tmp/spacearm_ident-UID`.

    Raises:
        can.CanInitializationError: It belongs to somebody else, or others may enter it.
    """
    if chosen := os.environ.get("SPACEARM_RUNTIME_DIR"):
        path = Path(chosen)
    elif session := os.environ.get("XDG_RUNTIME_DIR"):
        path = Path(session) / "spacearm_ident"
    else:
        path = Path("/tmp") / f"spacearm_ident-{os.getuid()}"
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = path.lstat()
    except OSError as error:
        raise can.CanInitializationError(
            f"cannot create {path} for the local bus ({error.strerror}): set SPACEARM_RUNTIME_DIR"
        ) from error
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o077:
        raise can.CanInitializationError(
            f"{path} is not a private directory of this user: chmod 700 it, or set SPACEARM_RUNTIME_DIR"
        )
    return path


class MeetingPoint:
    """One participant's place on the bus `name`."""

    def __init__(self, name: str) -> None:
        """Check the name; nothing is created before `join`.

        Raises:
            can.CanInitializationError: The name cannot be a directory name.
        """
        if not re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.-]*", name):
            raise can.CanInitializationError(
                f"'{name}' is not a bus name: use letters, digits, '_', '-' and '.', such as 'arm0'"
            )
        self._root = runtime_dir()
        self._dir = self._root / name
        self._address = self._dir / f"{os.getpid()}-{secrets.token_hex(3)}.sock"

    def join(self) -> tuple[socket.socket, list[socket.socket]]:
        """Enter the bus.

        Returns:
            The listening socket for later participants, and one connection to each present one.

        Raises:
            can.CanInitializationError: The directory cannot be used, or another process holds the lock.
        """
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        listener.setblocking(False)
        present: list[socket.socket] = []
        try:
            with self._locked():
                self._dir.mkdir(mode=0o700, exist_ok=True)
                for address in sorted(self._dir.glob("*.sock")):
                    if (connection := _connect(address)) is not None:
                        present.append(connection)
                listener.bind(str(self._address))
                listener.listen(BACKLOG)
        except OSError as error:
            for each in (listener, *present):
                each.close()
            raise can.CanInitializationError(f"cannot join the local bus at {self._dir}: {error}") from error
        return listener, present

    def leave(self) -> None:
        """Remove this participant's socket, and the bus directory with the last one. Never raises."""
        with suppress(OSError, can.CanInitializationError), self._locked():
            self._address.unlink(missing_ok=True)
            self._dir.rmdir()

    @contextmanager
    def _locked(self) -> Iterator[None]:
        # The lock is on the directory above, which stays, so the bus directory can go under the lock.
        handle = os.open(self._root, os.O_RDONLY | os.O_DIRECTORY)
        try:
            deadline = time.monotonic() + LOCK_TIMEOUT
            while True:
                try:
                    fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    break
                except BlockingIOError:
                    if time.monotonic() > deadline:
                        raise can.CanInitializationError(
                            f"another process holds {self._root}: end it, or set SPACEARM_RUNTIME_DIR"
                        ) from None
                    time.sleep(0.002)
            yield
        finally:
            os.close(handle)


def _connect(address: Path) -> socket.socket | None:
    """A connection to the participant at `address`; None, and its file removed, if it has died."""
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    connection.setblocking(False)
    try:
        connection.connect(str(address))
    except (ConnectionRefusedError, FileNotFoundError):
        connection.close()
        address.unlink(missing_ok=True)
        return None
    except BlockingIOError:
        # It has been stopped for so long that its backlog is full; it is no participant any more.
        connection.close()
        return None
    return connection
