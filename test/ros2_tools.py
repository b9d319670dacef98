"""The real `ros2`, `ros2 launch` and `colcon` for tests, as a ROS user has them.

They are not on any package registry; their pure-Python packages are in `../shared/tools/ros2cli`, and whatever needs
them is skipped where that folder is absent. `environment` makes a virtual environment with rclpy, this package's
requirements and the tools, once for the versions that the constraints name; `Workspace` builds the checkout with
colcon in an empty workspace and runs commands with it sourced.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import importlib.metadata
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest
from domains import domain

from spacearm_ident.canbus.realtime import come_first

ROOT = Path(__file__).parent.parent
TOOLS = ROOT.parent / "shared" / "tools" / "ros2cli"
NEEDED = pytest.mark.skipif(
    not (TOOLS / "install").is_file(), reason=f"the wheels of ros2cli, launch and colcon are not at {TOOLS}"
)
CONSTRAINTS = (ROOT / "constraints.txt", ROOT / "test" / "ros2_constraints.txt")
OF_ROS = ("ros-jazzy-rclpy[fastrtps]", "ros-jazzy-common-interfaces")
NOT_SOURCES = shutil.ignore_patterns(".git", ".venv", "*.egg-info", "__pycache__", ".*_cache", "demo_result", "build")
PATIENCE_S = 180.0
"""Longest wait for anything that is bound to happen, on a busy machine."""
NOT_INHERITED = frozenset(
    (
        "PYTHONPATH",
        "PYTHONDONTWRITEBYTECODE",  # each of many processes would compile all it imports
        "AMENT_PREFIX_PATH",
        "FASTDDS_BUILTIN_TRANSPORTS",
        "ROS_PYTHON_CHECK_FIELDS",
    )
)
"""Variables of the tests' own process that a user's shell has not."""


def environment() -> Path:
    """A virtual environment with everything but this package; from the user's cache where it has been made before.

    Raises:
        CalledProcessError: A package cannot be installed.
    """
    place = _cache() / f"ros2-{_key()}"
    place.parent.mkdir(parents=True, exist_ok=True)
    with (place.parent / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (place / "ros2.sh").is_file():
            shutil.rmtree(place, ignore_errors=True)
            _make(place)
    return place


def _cache() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "spacearm_ident"


def _inherited() -> dict[str, str]:
    return {key: value for key, value in os.environ.items() if key not in NOT_INHERITED}


def _key() -> str:
    """Changes with everything that the environment is made from."""
    texts = [path.read_bytes() for path in (*CONSTRAINTS, TOOLS / "install")]
    names = [sys.version, *_requirements(), *sorted(path.name for path in (TOOLS / "wheels").iterdir())]
    return hashlib.sha256(b"\0".join([*texts, *map(str.encode, names)])).hexdigest()[:16]


def _requirements() -> list[str]:
    of_package = importlib.metadata.requires("spacearm_ident") or []
    return [*OF_ROS, *(name for name in of_package if "extra ==" not in name)]


def _make(place: Path) -> None:
    settings = _inherited() | {"PIP_CONSTRAINT": " ".join(map(str, CONSTRAINTS)), "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
    subprocess.run([sys.executable, "-m", "venv", place], check=True)
    pip = [place / "bin" / "pip", "install", "--quiet"]
    subprocess.run([*pip, *_requirements()], check=True, env=settings)
    subprocess.run([TOOLS / "install", place], check=True, env=settings)


class Workspace:
    """The checkout, built with colcon in a workspace of its own.

    Attributes:
        folder: The workspace.
        build: What `colcon build` did.
        environment: Variables of a shell that has sourced it, in a ROS domain of its own.
    """

    def __init__(self, tools: Path, folder: Path) -> None:
        """Build it.

        Args:
            tools: The virtual environment.
            folder: An empty folder; its path should be short, for local buses have sockets in it.
        """
        self.folder = folder
        shutil.copytree(ROOT, folder / "src" / "spacearm_ident", ignore=NOT_SOURCES)
        plain = _inherited() | {"ROS_DOMAIN_ID": domain("workspace"), "ROS_LOG_DIR": str(folder / "log" / "ros")}
        self.environment = _sourced(f"{tools}/ros2.sh", plain)
        self.build = self.run("colcon", "build", cwd=folder)
        if self.build.returncode == 0:
            self.environment = _sourced(f"{tools}/ros2.sh {folder}", plain)
        self.environment["SPACEARM_RUNTIME_DIR"] = str(folder / "run")

    def run(self, *words: str, cwd: Path | None = None, **variables: str) -> subprocess.CompletedProcess[str]:
        """Run a command to its end; `variables` are put into its environment."""
        return subprocess.run(
            words,
            env=self.environment | variables,
            cwd=cwd or self.folder,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=PATIENCE_S,
            check=False,
        )

    def apart(self) -> dict[str, str]:
        """Variables of another ROS domain, and of other local buses."""
        return {
            "ROS_DOMAIN_ID": domain("beside the workspace"),
            "SPACEARM_RUNTIME_DIR": str(self.folder / "run-apart"),
        }

    @contextlib.contextmanager
    def started(self, *words: str, cwd: Path | None = None, **variables: str) -> Iterator[Started]:
        """A command that runs meanwhile; it and all it has started are gone at the end."""
        started = Started(words, self.environment | variables, cwd or self.folder)
        try:
            yield started
        finally:
            started.kill()


def _sourced(script: str, variables: dict[str, str]) -> dict[str, str]:
    done = subprocess.run(
        ["bash", "-c", f"source {script} && env -0"], env=variables, capture_output=True, text=True, check=True
    )
    return dict(pair.split("=", 1) for pair in done.stdout.split("\0") if pair)


class Started:
    """A process that leads a group of its own, as a shell starts one: Ctrl-C goes to the whole group."""

    def __init__(self, words: Sequence[str], variables: dict[str, str], folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._log = folder / f"{time.monotonic_ns()}.log"
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(
                words,
                env=variables | {"PYTHONUNBUFFERED": "1"},
                cwd=folder,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )
        come_first(self._process.pid)

    @property
    def said(self) -> str:
        """On both streams, so far."""
        return self._log.read_text(errors="replace")

    @property
    def running(self) -> bool:
        """Whether the process itself is alive."""
        return self._process.poll() is None

    def wait_for(self, condition: Callable[[], object], what: str) -> None:
        """Wait, while it runs, for something that is bound to happen."""
        end = time.monotonic() + PATIENCE_S
        while not condition():
            assert self.running, f"it ended with {self._process.returncode} before {what}:\n{self.said}"
            assert time.monotonic() < end, f"not within {PATIENCE_S:.0f} s: {what}; it said\n{self.said}"
            time.sleep(0.05)

    def wait_until_said(self, *words: str) -> None:
        """Wait for all of these."""
        self.wait_for(lambda: all(word in self.said for word in words), f"{words} are said")

    def interrupt(self, times: int = 1, pause_s: float = 0.3) -> int:
        """Press Ctrl-C; the exit code."""
        for _ in range(times):
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGINT)
            time.sleep(pause_s)
        return self.wait()

    def wait(self) -> int:
        """Wait for its end; the exit code."""
        return self._process.wait(PATIENCE_S)

    def members(self) -> list[str]:
        """Command lines of the processes of its group."""
        found = []
        for place in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                if os.getpgid(int(place.name)) == self._process.pid:
                    found.append((place / "cmdline").read_bytes().replace(b"\0", b" ").decode())
        return [line for line in found if line]

    def kill(self) -> None:
        """End the whole group at once."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
