"""Whether this machine can run what it is asked to: packages, ROS, real time, clock, disk."""

from __future__ import annotations

import importlib.util
import math
import os
import platform
import shutil
import sys
import threading
from collections.abc import Iterator, Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Final

from ..canbus.realtime import Pacer, prepare_thread
from .result import CheckResult, fail, ok, warn

PYTHON: Final = (3, 11)
PACKAGES: Final = {
    "can": "python-can",
    "canopen": "canopen",
    "clarabel": "clarabel",
    "jinja2": "jinja2",
    "lz4": "lz4",
    "matplotlib": "matplotlib",
    "mcap": "mcap",
    "numpy": "numpy",
    "pinocchio": "pin",
    "rich": "rich",
    "scipy": "scipy",
    "yaml": "pyyaml",
    "zstandard": "zstandard",
}
"""Module -> distribution, as in setup.py."""
DISTRIBUTION: Final = "jazzy"
MESSAGES: Final = ("diagnostic_msgs", "sensor_msgs", "std_msgs", "std_srvs")
DOMAINS: Final = range(233)
"""ROS_DOMAIN_ID that DDS has ports for."""
PRIORITY: Final = 60
PERIOD_S: Final = 1e-3
SLOTS: Final = 300
LATE_S: Final = 0.3e-3
"""A cycle that begins later than this has not enough of its millisecond left."""
SLOW_CLOCKS: Final = frozenset({"hpet", "acpi_pm", "jiffies"})
SHARED_MEMORY: Final = Path("/dev/shm")
SHARED_BYTES: Final = 64 << 20
DISK_BYTES: Final = 2 << 30
"""Room for about an hour of recording at 1 kHz, compressed."""


def check_machine(folder: Path, environment: Mapping[str, str]) -> list[CheckResult]:
    """All checks of the machine; recordings would go to `folder`.

    Args:
        folder: Whether it can be written and has room; where it does not exist, the nearest folder above it.
        environment: Environment variables, for the ROS distribution, its prefixes and its discovery settings.
    """
    return [*_python(), *_ros(environment), *_real_time(), _clock(), *_disk(folder)]


def _python() -> Iterator[CheckResult]:
    words = f"{platform.python_version()}, {sys.executable}"
    if sys.version_info >= PYTHON:
        yield ok("Python", words)
    else:
        yield fail("Python", words, f"use {'.'.join(map(str, PYTHON))} or newer")
    missing = [name for module, name in PACKAGES.items() if importlib.util.find_spec(module) is None]
    if missing:
        yield fail("packages", f"missing: {', '.join(missing)}", f"pip install {' '.join(missing)}")
    else:
        yield ok("packages", ", ".join(f"{name} {_version(name)}" for name in PACKAGES.values()))


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:  # from a Debian package without metadata
        return "(version not known)"


def _ros(environment: Mapping[str, str]) -> Iterator[CheckResult]:
    missing = [name for name in ("rclpy", *MESSAGES) if importlib.util.find_spec(name) is None]
    if missing:
        yield warn(
            "ROS 2",
            f"missing: {', '.join(missing)}; offline commands work, nodes, demo and watch do not",
            "source a Jazzy setup file, or install spacearm_ident with its extra 'ros'",
        )
        return
    named = environment.get("ROS_DISTRO")
    if named not in (None, DISTRIBUTION):
        yield warn(
            "ROS 2", f"{named} is sourced; this is made for {DISTRIBUTION}", f"source {DISTRIBUTION}'s setup file"
        )
    else:
        yield ok("ROS 2", f"{named or 'from wheels'}, rclpy {_version('rclpy')}")
    yield from _ros_environment(environment)
    prefixes = environment.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    if any((Path(prefix) / "share" / "spacearm_ident").is_dir() for prefix in prefixes if prefix):
        yield ok("ROS package", "ros2 run and ros2 launch find spacearm_ident")
    else:
        yield ok("ROS package", "not in a sourced workspace: start nodes with 'spacearm node NAME'")


def _ros_environment(environment: Mapping[str, str]) -> Iterator[CheckResult]:
    domain = environment.get("ROS_DOMAIN_ID", "0")
    reach = environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    if not domain.isdecimal() or int(domain) not in DOMAINS:
        yield fail(
            "ROS environment",
            f"ROS_DOMAIN_ID={domain!r} is no domain",
            f"use a number from 0 to {DOMAINS[-1]}; 0 to 101 is safe everywhere",
        )
    elif "ROS_LOCALHOST_ONLY" in environment:
        yield warn(
            "ROS environment",
            "ROS_LOCALHOST_ONLY is set, which Jazzy replaces",
            "unset it and set ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST",
        )
    elif reach.upper() == "OFF":
        yield warn(
            "ROS environment",
            "ROS_AUTOMATIC_DISCOVERY_RANGE=OFF: nodes do not find each other",
            "set it to LOCALHOST, or to SUBNET for several machines",
        )
    else:
        yield ok("ROS environment", f"domain {domain}, discovery {reach}")
    if SHARED_MEMORY.is_dir() and (free := shutil.disk_usage(SHARED_MEMORY).free) < SHARED_BYTES:
        yield warn(
            "shared memory",
            f"{free >> 20} MiB free in {SHARED_MEMORY}, which DDS uses",
            "run 'fastdds shm clean', or give the container more (--shm-size)",
        )


def _real_time() -> Iterator[CheckResult]:
    """Whether a thread gets a real-time priority, and how well it keeps a millisecond, tried for a moment."""
    pacer = Pacer(PERIOD_S)
    warning: list[str | None] = []

    def cycle() -> None:
        warning.append(prepare_thread(PRIORITY))
        for _ in range(SLOTS):
            pacer.wait()

    thread = threading.Thread(target=cycle)
    thread.start()
    thread.join()
    if warning[0] is None:
        yield ok("real time", f"SCHED_FIFO {PRIORITY} is permitted")
    else:
        message, _, advice = warning[0].partition("; ")
        yield warn("real time", message, advice)
    late = pacer.lateness(0.99)
    words = f"99 % of {SLOTS} cycles of 1 ms began within {1e6 * late:.0f} µs, {pacer.missed} were missed"
    if late > LATE_S or pacer.missed:
        yield warn("cycle", words, "end what else runs, isolate a core, or use a longer cycle period on the arm")
    else:
        yield ok("cycle", words)
    cores = len(os.sched_getaffinity(0))
    if cores < 2:
        yield warn("cores", f"{cores}: driver and identifier share it", "give the driver a core of its own")


def _clock() -> CheckResult:
    file = Path("/sys/devices/system/clocksource/clocksource0/current_clocksource")
    try:
        source = file.read_text(encoding="ascii").strip()
    except OSError:
        return ok("clock", "the kernel does not report its source")
    if source in SLOW_CLOCKS:
        return warn(
            "clock", f"{source}: reading it takes microseconds", "boot with clocksource=tsc if the CPU allows it"
        )
    return ok("clock", source)


def _disk(folder: Path) -> Iterator[CheckResult]:
    there = next((place for place in (folder, *folder.resolve().parents) if place.is_dir()), Path("/"))
    free = shutil.disk_usage(there).free
    words = f"{_bytes(free)} free at {there}"
    if free < DISK_BYTES:
        yield warn("disk", words, f"an hour of recording may take {_bytes(DISK_BYTES)}: make room")
    else:
        yield ok("disk", words)
    if not os.access(there, os.W_OK):
        yield fail("disk", f"{there} cannot be written", "work in another folder, or name one with --out")


def _bytes(count: int) -> str:
    power = min(int(math.log(max(count, 1), 1024)), 4)
    return f"{count / 1024**power:.3g} {('B', 'KiB', 'MiB', 'GiB', 'TiB')[power]}"
