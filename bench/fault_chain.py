"""The live chain of the fault campaign: one that survives the death of its nodes, and the hand that breaks it."""

from __future__ import annotations

import contextlib
import os
import resource
import signal
import struct
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import can

from spacearm_ident.canbus.frames import ERROR_BUS_OFF
from spacearm_ident.canbus.local_bus import LocalBus
from spacearm_ident.cli.demo import enable
from spacearm_ident.errors import UserError
from spacearm_ident.nodes.chain import ENDED_S, Chain

CHANNELS = ("arm0", "arm1")
FREEZE, EMERGENCY, SPOIL = 1, 2, 3
PATIENCE_S = 180.0
"""Longest wait for nodes to come up on a machine that is busy."""
DISK_ROOM = 200_000
"""Bytes a full disk still takes."""


class BreakableChain(Chain):
    """A chain whose nodes may be killed, halted and started again."""

    def __init__(self, directory: Path, parameters: Mapping[str, Mapping[str, object]]) -> None:
        self.folder, self._parameters = directory, parameters
        super().__init__(directory, parameters)
        # This process joins the buses as one more participant.
        os.environ["SPACEARM_RUNTIME_DIR"] = self._environment["SPACEARM_RUNTIME_DIR"]

    def wait(self, condition: Callable[[], object], what: str, longest_s: float) -> None:
        """Spin until a condition holds; nodes may end meanwhile.

        Raises:
            UserError: It did not within `longest_s`.
        """
        if not self.holds(condition, longest_s):
            raise UserError(f"waited {longest_s:.0f} s for {what} in vain")

    def holds(self, condition: Callable[[], object], longest_s: float) -> bool:
        """Spin until a condition holds; whether it does in the end."""
        end = time.monotonic() + longest_s
        while not condition():
            if time.monotonic() > end:
                return False
            self._executor.spin_once(timeout_sec=0.02)
        return True

    def alive(self, name: str) -> bool:
        """Whether a node's process runs."""
        return self._processes[name].poll() is None

    def revive(self) -> list[str]:
        """Restart the nodes that have ended; returns their names.

        With a new arm, which stands where it begins, the driver as well: it enables no arm that has moved unseen.
        """
        if not self.alive("simulated_arm") and self.alive("canopen_driver"):
            self._processes["canopen_driver"].terminate()
            self._processes["canopen_driver"].wait()
        dead = [name for name in self._processes if not self.alive(name)]
        for name in dead:
            self._statuses.pop(name, None)
            log = self._logs / f"{name}.log"
            log.replace(log.with_suffix(f".{time.time_ns()}.log"))
            self._processes[name] = self._spawn(name, self._parameters.get(name, {}))
        return dead

    def serve(self) -> None:
        """All nodes up, no fault, drives enabled, recording: what every run begins with.

        Raises:
            UserError: They do not come.
        """
        self.revive()
        self._statuses.clear()  # who hangs says nothing new

        def ready() -> bool:
            connected = self.values("canopen_driver").get("connection") == "connected"
            return all(map(self.status, self._processes)) and connected

        if not self.holds(ready, PATIENCE_S):
            said = {name: self.status(name) for name in self._processes}
            raise UserError(f"waited {PATIENCE_S:.0f} s for all nodes in vain: {said}")
        if self.values("recorder").get("recording") != "true":
            with contextlib.suppress(UserError):
                self.call("/recorder/stop")
            self.call("/recorder/start")
        end = time.monotonic() + ENDED_S
        while True:  # a drive that was frozen takes its time
            try:
                return enable(self)
            except UserError:
                if time.monotonic() > end:
                    raise

    # What breaks it ---------------------------------------------------------------------------------------

    def inject(self, joint: int, sub: int, value: int) -> None:
        """Write the fault object 0x2F00 of a joint's drive."""
        size = 1 if sub == SPOIL else 2
        data = struct.pack("<BHBI", 0x23 | (4 - size) << 2, 0x2F00, sub, value)
        self.send(joint, 0x601 + joint, data)

    def write(self, joint: int, index: int, value: int, size: int) -> None:
        """Write an object of a joint's drive."""
        data = struct.pack("<BHBI", 0x23 | (4 - size) << 2, index, 0, value)
        self.send(joint, 0x601 + joint, data)

    def send(self, joint: int, can_id: int, data: bytes, *, error: bool = False) -> None:
        """Send a frame on the bus of a joint."""
        with LocalBus(CHANNELS[joint // 3]) as bus:
            bus.send(
                can.Message(arbitration_id=can_id, data=data, is_extended_id=False, is_error_frame=error, dlc=len(data))
            )
            self.holds(lambda: False, 0.05)

    def bus_off(self, joint: int) -> None:
        """An error frame of a controller that went bus off."""
        self.send(joint, ERROR_BUS_OFF, bytes(8), error=True)

    def kill(self, name: str) -> None:
        """As a crash would."""
        os.kill(self.processes[name], signal.SIGKILL)
        self._processes[name].wait()

    def halt(self, name: str, seconds: float) -> None:
        """Take a process off the processor for a while."""
        os.kill(self.processes[name], signal.SIGSTOP)
        time.sleep(seconds)
        os.kill(self.processes[name], signal.SIGCONT)

    @contextlib.contextmanager
    def full_disk(self) -> Iterator[None]:
        """No file of the recorder may grow much more."""
        pid = self.processes["recorder"]
        room = max(path.stat().st_size for path in self.bag().glob("*.mcap")) + DISK_ROOM
        _, hard = resource.prlimit(pid, resource.RLIMIT_FSIZE)
        resource.prlimit(pid, resource.RLIMIT_FSIZE, (room, hard))
        try:
            yield
        finally:
            resource.prlimit(pid, resource.RLIMIT_FSIZE, (hard, hard))

    # What is left of it -----------------------------------------------------------------------------------

    def bag(self) -> Path:
        """The newest bag."""
        return newest_bag(self.folder)

    def held(self) -> dict[str, tuple[int, int, int]]:
        """Of each node: file descriptors, threads, MiB of memory."""
        return {name: held(pid) for name, pid in self.processes.items() if self.alive(name)}


def newest_bag(folder: Path) -> Path:
    """The bag recorded last of a chain whose results go to `folder`."""
    return max((folder / "recordings").iterdir(), key=lambda path: path.stat().st_mtime_ns)


def held(pid: int) -> tuple[int, int, int]:
    """Of a process: file descriptors, threads, MiB of memory."""
    status = dict(line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines())
    return (
        len(os.listdir(f"/proc/{pid}/fd")),
        int(status["Threads"]),
        int(status["VmRSS"].split()[0]) // 1024,
    )
