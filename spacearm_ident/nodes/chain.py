"""The live chain on one machine: all nodes as processes, and a client that calls their services.

What an engineer does by hand with a launch file and `ros2 service call`, for `spacearm demo` and for tests. The
processes get a ROS domain and a CAN runtime folder of their own, so that two chains on one machine never meet, and
none of them outlives the chain.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from ..canbus.realtime import come_first, keep_apart
from ..errors import UserError
from .runtime import LATCHED

STARTED_S = 60.0
"""Longest wait for a node to come up, or a service to answer, on a busy machine."""
ENDED_S = 20.0
DOMAINS = range(1, 30)
"""ROS domains to choose from where the user has set none; the default, 0, is left to others."""
LONGEST_FOLDER = 60
STOP_ORDER = ("trajectory", "identifier", "recorder", "canopen_driver", "simulated_arm")
"""Who moves the arm goes first, the arm itself last."""
IN_TIME = frozenset(STOP_ORDER) - {"identifier"}
"""Who must keep time on a machine that is busy with other things."""
APART = ("canopen_driver", "simulated_arm")
"""Whose real-time threads together would take so much of a core that the kernel halts them (sched(7))."""

_LIBC = ctypes.CDLL(None)
_PR_SET_PDEATHSIG = 1
_ENDING = frozenset({signal.SIGINT, signal.SIGTERM})

Values = Mapping[str, str]


class Chain:
    """The running nodes, and what they say.

    Use it as a context manager: leaving it ends every process, whatever happened.
    """

    def __init__(self, directory: Path, parameters: Mapping[str, Mapping[str, object]]) -> None:
        """Start all nodes.

        Args:
            directory: Where each node's output goes, as `logs/NODE.log`.
            parameters: Node -> its ROS parameters.
        """
        self._logs = directory / "logs"
        self._logs.mkdir(parents=True, exist_ok=True)
        self._domain = _Domain()
        # The kernel takes socket paths of up to 107 bytes.
        short = len(tempfile.gettempdir()) <= LONGEST_FOLDER
        self._sockets = tempfile.TemporaryDirectory(prefix="spacearm-can-", dir=None if short else "/tmp")
        self._environment = {
            **os.environ,
            "ROS_DOMAIN_ID": str(self._domain.number),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "SPACEARM_RUNTIME_DIR": self._sockets.name,
            "PYTHONUNBUFFERED": "1",
        }
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        self._graph = contextlib.ExitStack()
        try:
            for name in reversed(STOP_ORDER):
                with _undisturbed():
                    self._processes[name] = self._spawn(name, parameters.get(name, {}))
            self._join_graph()
        except BaseException:
            self.close()
            raise

    def _join_graph(self) -> None:
        context = rclpy.Context()
        rclpy.init(
            context=context,
            domain_id=int(self._environment["ROS_DOMAIN_ID"]),
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self._graph.callback(context.try_shutdown)
        self._node = rclpy.create_node("chain", context=context)
        self._graph.callback(self._node.destroy_node)
        self._executor = SingleThreadedExecutor(context=context)
        self._graph.callback(self._executor.shutdown)
        self._executor.add_node(self._node)
        self._statuses: dict[str, DiagnosticStatus] = {}
        self._excitation: dict[str, Any] = {}
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._keep_statuses, 100)
        self._node.create_subscription(String, "/excitation/state", self._keep_excitation, LATCHED)

    def _spawn(self, name: str, parameters: Mapping[str, object]) -> subprocess.Popen[bytes]:
        words = [word for key, value in parameters.items() for word in ("-p", f"{key}:={_yaml(value)}")]
        command = [sys.executable, "-m", "spacearm_ident.cli.main", "node", name, "--ros-args", *words]
        with (self._logs / f"{name}.log").open("wb") as log:
            process = subprocess.Popen(
                command,
                env=self._environment,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,
                preexec_fn=_end_with_parent,
            )
        if name in IN_TIME:
            come_first(process.pid)
        if name in APART:
            keep_apart(process.pid, APART.index(name))
        return process

    def __enter__(self) -> Chain:
        """The chain."""
        return self

    def __exit__(self, *_: object) -> None:
        """End everything."""
        self.close()

    def call(self, service: str, data: bool | None = None) -> str:
        """Call a Trigger service, or a SetBool service with `data`; returns its reply.

        Raises:
            UserError: It refused, with its reason, or does not answer.
        """
        kind = Trigger if data is None else SetBool
        request = Trigger.Request() if data is None else SetBool.Request(data=data)
        reply = self._request(kind, service, request)
        if not reply.success:
            raise UserError(f"{service} refused: {reply.message}")
        return str(reply.message)

    def set_parameter(self, node: str, name: str, text: str) -> None:
        """Set a text parameter of a running node.

        Args:
            node: Name of the node, without namespace.
            name: Name of the parameter.
            text: Its new value.

        Raises:
            UserError: It is refused.
        """
        value = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=text)
        request = SetParameters.Request(parameters=[Parameter(name=name, value=value)])
        result = self._request(SetParameters, f"/{node}/set_parameters", request).results[0]
        if not result.successful:
            raise UserError(f"{node} refuses {name}={text}: {result.reason}")

    def _request(self, kind: Any, service: str, request: Any) -> Any:
        client = self._node.create_client(kind, service)
        try:
            self.wait(client.service_is_ready, f"the service {service}", STARTED_S)
            future = client.call_async(request)
            self.wait(future.done, f"a reply from {service}", STARTED_S)
            return future.result()
        finally:
            self._node.destroy_client(client)

    def wait(self, condition: Callable[[], object], what: str, longest_s: float) -> None:
        """Spin until a condition holds.

        Args:
            condition: Called after every spin; what it returns is taken as a truth value.
            what: What is waited for, for the error message.
            longest_s: Longest wait, s.

        Raises:
            UserError: It did not within `longest_s`, or a node has ended meanwhile.
        """
        end = time.monotonic() + longest_s
        while not condition():
            self._executor.spin_once(timeout_sec=0.05)
            for name, process in self._processes.items():
                if process.poll() is not None:
                    raise UserError(f"{name} ended with exit code {process.returncode}: {self._last_words(name)}")
            if time.monotonic() > end:
                raise UserError(f"waited {longest_s:.0f} s for {what} in vain: see {self._logs}")

    def status(self, name: str) -> str:
        """The message of a node's latest diagnostics, or empty."""
        found = self._statuses.get(name)
        return str(found.message) if found else ""

    def values(self, name: str) -> Values:
        """The figures of a node's latest diagnostics."""
        found = self._statuses.get(name)
        return {pair.key: pair.value for pair in found.values} if found else {}

    @property
    def domain(self) -> int:
        """The `ROS_DOMAIN_ID` of the nodes."""
        return self._domain.number

    @property
    def processes(self) -> Mapping[str, int]:
        """Process id of each node."""
        return {name: process.pid for name, process in self._processes.items()}

    @property
    def excitation(self) -> Mapping[str, Any]:
        """The latest `/excitation/state`."""
        return self._excitation

    def close(self) -> dict[str, int]:
        """End every process, the mover first; returns their exit codes."""
        for name in filter(self._processes.__contains__, STOP_ORDER):
            process = self._processes[name]
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(ENDED_S)
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        self._graph.close()
        self._sockets.cleanup()
        self._domain.release()
        return {name: process.returncode for name, process in self._processes.items()}

    def _last_words(self, name: str) -> str:
        lines = (self._logs / f"{name}.log").read_text(errors="replace").strip().splitlines()
        return lines[-1] if lines else f"it said nothing; see {self._logs}"

    def _keep_statuses(self, message: DiagnosticArray) -> None:
        self._statuses |= {status.name: status for status in message.status}

    def _keep_excitation(self, message: String) -> None:
        self._excitation = json.loads(message.data)


def _end_with_parent() -> None:
    """Have the kernel send SIGTERM to this process when the one that started it is gone, however that ended."""
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _ENDING)


@contextlib.contextmanager
def _undisturbed() -> Iterator[None]:
    """No interrupt between the birth of a process and its being known, for it would outlive the chain."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _ENDING)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class _Domain:
    """A ROS domain: the user's, or one that no other chain on this machine has."""

    def __init__(self) -> None:
        self._lock = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        given = os.environ.get("ROS_DOMAIN_ID")
        self.number = self._free() if given is None else int(given)

    def _free(self) -> int:
        for number in DOMAINS:
            # An abstract name: no file, and it goes with this process.
            with contextlib.suppress(OSError):
                self._lock.bind(f"\0spacearm_ident/domain/{number}")
                return number
        raise UserError("too many chains run on this machine: stop one, or set ROS_DOMAIN_ID")

    def release(self) -> None:
        """Let another have it."""
        self._lock.close()


def _yaml(value: object) -> str:
    """A parameter value as --ros-args wants it."""
    return json.dumps(value) if isinstance(value, bool | str) else str(value)
