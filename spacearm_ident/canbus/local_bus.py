"""`LocalBus`: a python-can interface between processes of one machine, without a kernel module.

Every participant holds one `SOCK_SEQPACKET` connection to every other one (see `meeting_point`); a frame is
one packet to each. Compared with a real bus:

- A frame is stamped when it is sent. Frames of one sender stay in order; there is no arbitration.
- Nobody else on the bus means nobody acknowledges: `send` raises, as a full transmit queue does on
  SocketCAN. When the last other participant leaves or dies, `recv` returns one error frame
  (`ERROR_NO_ACKNOWLEDGE`) at once, then waits for new participants. Nothing hangs.
- A participant that does not read loses frames once its buffer is full; it never slows the others down. The
  sender counts them in `dropped`, the reader in `lost` (from the sequence numbers).

Registered as the python-can interface `local`; `canbus.open_bus` also finds it without installation.
"""

from __future__ import annotations

import select
import socket
import struct
import threading
import time
from typing import Any, Final

import can
from can import BusState

from spacearm_ident.canbus import frames
from spacearm_ident.canbus.meeting_point import MeetingPoint

#: Bytes of send buffer a connection: about a second of a full 1 kHz cycle of six drives where the kernel
#: allows it (`net.core.wmem_max`).
SEND_BUFFER: Final = 4 << 20
#: How often a participant that only sends looks for newcomers, nanoseconds.
ACCEPT_INTERVAL_NS: Final = 20_000_000
#: Frames read from one sender before the others get their turn.
BURST: Final = 32
_NO_WAIT: Final = socket.MSG_DONTWAIT | socket.MSG_NOSIGNAL


class _Peer:
    """The connection to one other participant (or to ourselves, for our own frames)."""

    __slots__ = ("expected", "own", "sock")

    def __init__(self, sock: socket.socket, own: bool = False) -> None:
        self.sock = sock
        self.own = own
        self.expected: int | None = None


class LocalBus(can.BusABC):
    """One participant of the bus `channel`.

    Attributes:
        dropped: Frames of ours that a slow reader's full buffer could not take.
        lost: Frames of others that our own full buffer could not take.
    """

    def __init__(
        self,
        channel: str = "arm0",
        can_filters: can.typechecking.CanFilters | None = None,
        receive_own_messages: bool = False,
        **kwargs: Any,
    ) -> None:
        """Join the bus.

        Args:
            channel: Name of the bus; all participants of one user that give the same name share it.
            can_filters: As for every python-can bus.
            receive_own_messages: Also receive what this participant sends.
            **kwargs: Options of other interfaces (`bitrate`, `fd`, …); accepted and without effect.

        Raises:
            can.CanInitializationError: The bus cannot be joined; the message says what to do.
        """
        self.channel_info = f"local bus '{channel}'"
        self._channel = channel
        self.dropped = 0
        self.lost = 0
        self._lock = threading.Lock()
        self._sequence = 0
        self._next_accept_ns = 0
        self._hot: _Peer | None = None
        self._last: _Peer | None = None
        self._burst = 0
        self._by_fd: dict[int, _Peer] = {}
        self._peers: list[_Peer] = []
        self._others = 0
        self._epoll = select.epoll()
        self._meeting_point = MeetingPoint(channel)
        self._listener, present = self._meeting_point.join()
        self._epoll.register(self._listener, select.EPOLLIN)
        for sock in present:
            self._add(_Peer(sock))
        if receive_own_messages:
            sender, receiver = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            self._own_sender: socket.socket | None = sender
            self._add(_Peer(receiver, own=True))
        else:
            self._own_sender = None
        super().__init__(channel, can_filters=can_filters, **kwargs)

    @property
    def state(self) -> BusState:
        """ACTIVE with others on the bus, PASSIVE alone."""
        return BusState.ACTIVE if self._others else BusState.PASSIVE

    @state.setter
    def state(self, new_state: BusState) -> None:
        raise NotImplementedError("the state of a local bus follows from who is on it")

    def fileno(self) -> int:
        """A descriptor that is readable when `recv` has something to do (also accepting a newcomer)."""
        return self._epoll.fileno()

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame to every other participant; never blocks, whatever `timeout` is.

        Raises:
            can.CanOperationError: Nobody is there to acknowledge, or the bus has been shut down.
        """
        now_ns = time.time_ns()
        with self._lock:
            if now_ns >= self._next_accept_ns or not self._others:
                self._accept(now_ns)
            packet = frames.pack(msg, now_ns, self._sequence)
            self._sequence += 1
            if self._own_sender is not None:
                self._put(self._own_sender, packet)
            for peer in tuple(self._peers):
                if peer.own:
                    continue
                try:
                    self._put(peer.sock, packet)
                except OSError:
                    # It has gone. What it sent before is still to be read: `recv` closes the connection.
                    self._peers.remove(peer)
                    self._others -= 1
            if not self._others:
                raise can.CanOperationError(f"nobody acknowledges on {self.channel_info}: no one else is on it")

    def shutdown(self) -> None:
        """Leave the bus; the others see it at once."""
        if self._is_shutdown:
            return
        super().shutdown()
        self._meeting_point.leave()
        with self._lock:
            for peer in self._by_fd.values():
                peer.sock.close()
            self._by_fd.clear()
            self._peers.clear()
            self._others = 0
            self._hot = None
            if self._own_sender is not None:
                self._own_sender.close()
            self._listener.close()
            self._epoll.close()

    def _put(self, sock: socket.socket, packet: bytes) -> None:
        try:
            sock.send(packet, _NO_WAIT)
        except BlockingIOError:
            self.dropped += 1

    def _add(self, peer: _Peer) -> None:
        peer.sock.setblocking(False)
        peer.sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
        self._by_fd[peer.sock.fileno()] = peer
        self._peers.append(peer)
        self._others += not peer.own
        self._epoll.register(peer.sock, select.EPOLLIN)

    def _accept(self, now_ns: int) -> None:
        """Take in newcomers; the caller holds the lock."""
        self._next_accept_ns = now_ns + ACCEPT_INTERVAL_NS
        try:
            while True:
                self._add(_Peer(self._listener.accept()[0]))
        except BlockingIOError:
            return
        except OSError as error:
            raise can.CanOperationError(f"{self.channel_info} has been shut down") from error

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        deadline = None if timeout is None else time.monotonic() + timeout
        while True:
            # The sender of the last frame usually has more: one system call a frame within a burst.
            if self._hot is not None:
                message = self._read(self._hot)
                if message is not None:
                    return message, False
            remaining = None if deadline is None else max(0.0, deadline - time.monotonic())
            if not self._wait(remaining):
                return None, False

    def _wait(self, remaining: float | None) -> bool:
        """Wait until a sender is ready (then it is `_hot`) or somebody joins; False when time is up."""
        try:
            # select() keeps microseconds; epoll rounds a timeout up to whole milliseconds.
            if remaining != 0.0 and not select.select([self._epoll], (), (), remaining)[0]:
                return False
            ready = self._epoll.poll(0)
        except (OSError, ValueError) as error:
            raise can.CanOperationError(f"{self.channel_info} has been shut down") from error
        if not ready:
            return remaining != 0.0
        self._burst = 0
        for fd, _ in ready:
            peer = self._by_fd.get(fd)
            if peer is None:
                with self._lock:
                    self._accept(time.time_ns())
            elif self._hot is None or peer is not self._last:
                self._hot = peer
        self._last = self._hot
        return True

    def _read(self, peer: _Peer) -> can.Message | None:
        """The next frame of `peer`; None if it has none now."""
        try:
            raw = peer.sock.recv(frames.FD.size)
        except BlockingIOError:
            self._hot = None
            return None
        except OSError:
            raw = b""
        if not raw:
            return self._gone(peer)
        self._burst += 1
        if self._burst >= BURST:
            self._hot = None
        try:
            message, sequence = frames.unpack(raw, self._channel)
        except struct.error:
            return None
        if peer.expected is not None:
            self.lost += (sequence - peer.expected) & 0xFFFFFFFF
        peer.expected = sequence + 1
        message.is_rx = not peer.own
        return message

    def _gone(self, peer: _Peer) -> can.Message | None:
        """Forget a participant that left; an error frame if it was the last one."""
        with self._lock:
            self._hot = None
            if self._by_fd.pop(peer.sock.fileno(), None) is None:
                return None
            self._epoll.unregister(peer.sock)
            peer.sock.close()
            if peer in self._peers:
                self._peers.remove(peer)
                self._others -= 1
            if self._others:
                return None
        return can.Message(
            timestamp=time.time(),
            arbitration_id=frames.ERROR_NO_ACKNOWLEDGE,
            is_extended_id=False,
            is_error_frame=True,
            channel=self._channel,
            dlc=8,
            data=bytes(8),
        )
