"""Live nodes for tests: processes that never outlive their test, and a probe on the graph.

Importing it puts this process, and those it starts, on a ROS domain of their own on this machine alone.
"""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import pytest
from domains import domain

from spacearm_ident.canbus.realtime import come_first

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_DOMAIN_ID"] = domain("graph")
os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"
# Fast DDS leaves its shared memory (a file in /dev/shm) behind with every killed process, and tests kill many.
# What is measured of shared memory is measured by the demo, which ends its nodes properly.
os.environ.setdefault("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")

PATIENCE_S = 30.0
"""Longest wait for anything that is bound to happen, on a busy machine."""
LIVE = [pytest.mark.live, pytest.mark.flaky(reruns=2, reruns_delay=5)]
"""Marks of tests whose processes must keep time: a machine that stops them for longer than the arm forgives says
nothing about them. A test that was run again is counted as such in the summary."""
ROOT = Path(__file__).parent.parent


def wait_for(condition, what: str, patience_s: float = PATIENCE_S, step=lambda: time.sleep(0.02)):
    """What `condition` returns as soon as it is true."""
    end = time.monotonic() + patience_s
    while time.monotonic() < end:
        result = condition()
        if result:
            return result
        step()
    raise AssertionError(f"not within {patience_s:.0f} s: {what}")


class Processes:
    """Starts processes in process groups of their own; `end` leaves none."""

    def __init__(self, folder: Path):
        self._folder = folder
        self._all: list[subprocess.Popen] = []

    def node(self, name: str, *ros_arguments: str, words: Sequence[str] = (), **options) -> subprocess.Popen:
        """A node by the name of its executable; each argument is what follows `-p`, such as `rate_hz:=100`.

        `words` follow `--ros-args` as they are.
        """
        given = [*words, *(word for argument in ros_arguments for word in ("-p", argument))]
        code = f"import sys; from spacearm_ident.nodes.main import start; sys.exit(start({name!r}, sys.argv[1:]))"
        process = self.python("-c", code, *(["--ros-args", *given] if given else []), **options)
        come_first(process.pid)
        return process

    def python(self, *arguments: str, **options) -> subprocess.Popen:
        """A Python process; its output goes to `output`."""
        environment = {**os.environ, "PYTHONPATH": f"{ROOT}:{ROOT / 'test'}", "PYTHONUNBUFFERED": "1"}
        log = (self._folder / f"process_{len(self._all)}.log").open("w")
        with log:
            process = subprocess.Popen(
                [sys.executable, *arguments],
                env=environment,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                cwd=self._folder,
                **options,
            )
        process.log_path = Path(log.name)
        self._all.append(process)
        return process

    def end(self):
        """Kill every process group."""
        for process in self._all:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def output(process: subprocess.Popen) -> str:
    """What a process has said so far, on both streams."""
    return process.log_path.read_text()


def end(process: subprocess.Popen, number: int = signal.SIGINT) -> int:
    """Send a signal; the exit code."""
    process.send_signal(number)
    return process.wait(PATIENCE_S)


class Probe:
    """A node in the test's process: publishes, listens, calls."""

    patience_s = PATIENCE_S

    def __init__(self):
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray
        from rclpy.signals import SignalHandlerOptions

        from spacearm_ident.nodes.runtime import LiveExecutor

        self._context = rclpy.Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node("probe", context=self._context)
        # First come, first served. The other executors start over with the subscriptions whenever `spin_once` is
        # given another timeout than before: where messages come faster than they are taken, no reply is ever seen.
        self._executor = LiveExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._clients = {}
        self.statuses = {}
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._keep, 100)

    def _keep(self, message):
        for status in message.status:
            self.statuses[status.name] = status

    def spin(self, seconds: float = 0.02):
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            self._executor.spin_once(timeout_sec=left)

    def wait_for(self, condition, what: str, patience_s: float | None = None):
        return wait_for(condition, what, patience_s or self.patience_s, self.spin)

    def call(self, name: str, data: bool | None = None) -> tuple[bool, str]:
        """Call a Trigger service, or a SetBool service with `data`."""
        from std_srvs.srv import SetBool, Trigger

        if name not in self._clients:
            # It stays: finding a service takes longer than calling it.
            self._clients[name] = self.node.create_client(Trigger if data is None else SetBool, name)
        client = self._clients[name]
        self.wait_for(client.service_is_ready, f"service {name}")
        future = client.call_async(Trigger.Request() if data is None else SetBool.Request(data=data))
        self.wait_for(future.done, f"a reply from {name}")
        return future.result().success, future.result().message

    def must(self, name: str, data: bool | None = None) -> str:
        """Call what has to be done; the reply."""
        done, reply = self.call(name, data)
        assert done, reply
        return reply

    def hear_runs(self, said: list, place: str = "") -> None:
        """Append every `/excitation/state` from now on."""
        from rclpy.qos import DurabilityPolicy, QoSProfile
        from std_msgs.msg import String

        # Depth 1 keeps the last state only: fine for who wants to know it, too little for who counts them.
        every = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        hear = lambda message: said.append(json.loads(message.data))  # noqa: E731
        self.node.create_subscription(String, f"{place}/excitation/state", hear, every)

    def values(self, name: str) -> dict[str, str]:
        """The figures of a part's latest diagnostics; empty before the first."""
        status = self.statuses.get(name)
        return {value.key: value.value for value in status.values} if status else {}

    def level(self, name: str) -> int:
        """The level of a part's latest diagnostics; -1 before the first."""
        status = self.statuses.get(name)
        return status.level[0] if status else -1

    def close(self):
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()
