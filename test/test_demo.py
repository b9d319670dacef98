"""The demo as a user starts it: a process; what it leaves behind, and what it must not leave behind."""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from live_nodes import LIVE

from spacearm_ident.dynamics.model_file import load_model
from spacearm_ident.nodes.main import NODES
from spacearm_ident.recording import read_recording

pytestmark = [*LIVE, pytest.mark.alone]
ROOT = Path(__file__).parent.parent
PATIENCE_S = 300.0
"""Longest wait on a busy machine; the demo takes under one minute on an idle one."""
TAG = "SPACEARM_TEST_DEMO"
"""Environment variable that marks a demo and every process below it."""


def marked(tag: str) -> dict[int, str]:
    """Command lines of the living processes that carry this tag."""
    found = {}
    for place in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if f"{TAG}={tag}".encode() in (place / "environ").read_bytes().split(b"\0"):
                found[int(place.name)] = (place / "cmdline").read_bytes().replace(b"\0", b" ").decode()
    return found


@pytest.fixture
def demo(tmp_path):
    """Starts the demo with its temporary files in a folder of its own; kills whatever is left at the end."""
    tag = f"{os.getpid()}-{tmp_path.name}"
    # Short: sockets are put there.
    scratch = Path(tempfile.mkdtemp(prefix="demo-", dir="/tmp"))
    environment = {
        key: value for key, value in os.environ.items() if key not in ("ROS_DOMAIN_ID", "SPACEARM_RUNTIME_DIR")
    }
    environment |= {TAG: tag, "PYTHONPATH": str(ROOT), "TMPDIR": str(scratch)}

    def start() -> subprocess.Popen[str]:
        code = "import sys; from spacearm_ident.cli.main import main; sys.exit(main())"
        return subprocess.Popen(
            [sys.executable, "-c", code, "demo", "--fast", "--quiet", "--out", str(tmp_path / "result")],
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    start.tag, start.scratch = tag, scratch
    yield start
    for pid in marked(tag):
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
    shutil.rmtree(scratch)


def wait_until(reached, process: subprocess.Popen[str]) -> None:
    end = time.monotonic() + PATIENCE_S
    while not reached():
        if process.poll() is not None:
            pytest.fail("the demo ended by itself: " + "".join(process.communicate()))
        assert time.monotonic() < end
        time.sleep(0.05)


def moving(folder: Path) -> bool:
    """Whether the recording is so long that the run goes on."""
    return any(bag.stat().st_size > 1_000_000 for bag in (folder / "result").glob("recordings/*/*.mcap"))


def domain_of(pid: int) -> str:
    variables = Path(f"/proc/{pid}/environ").read_bytes().split(b"\0")
    return next(each for each in variables if each.startswith(b"ROS_DOMAIN_ID=")).decode().partition("=")[2]


def watched_beside(domain: str) -> set[str]:
    """Names of the nodes that `spacearm watch` hears in a ROS domain."""
    code = "import sys; from spacearm_ident.cli.main import main; sys.exit(main())"
    words = [sys.executable, "-c", code, "watch", "--json", "--wait", "30"]
    variables = {**os.environ, "ROS_DOMAIN_ID": domain, "PYTHONPATH": str(ROOT)}
    answer = subprocess.run(words, env=variables, capture_output=True, text=True, timeout=PATIENCE_S, check=True)
    return {row["name"].partition(":")[0] for row in json.loads(answer.stdout)["nodes"]}


def nothing_left(demo) -> None:
    assert marked(demo.tag) == {}
    assert list(demo.scratch.iterdir()) == []


def test_the_demo_identifies_validates_and_leaves_nothing_running(demo, tmp_path):
    process = demo()
    wait_until(lambda: moving(tmp_path), process)
    # Longer than the drives forgive: the run is broken off, and must be begun again.
    driver = next(pid for pid, command in marked(demo.tag).items() if "node canopen_driver" in command)
    os.kill(driver, signal.SIGSTOP)
    time.sleep(1.0)
    os.kill(driver, signal.SIGCONT)
    domain = domain_of(driver)
    # One look may come before every node has said something: discovery takes its time on a busy machine.
    wait_until(lambda: watched_beside(domain) == set(NODES), process)
    output, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, errors + output
    assert "the excitation run was stopped, to be begun again" in errors
    assert f"ROS_DOMAIN_ID={domain} spacearm watch" in errors
    result = tmp_path / "result"
    for name in ("model.yaml", "parameters.csv", "identified.urdf", "validation.json", "report.html"):
        assert (result / name).stat().st_size > 0
    joints = json.loads((result / "validation.json").read_text())["joints"]
    assert list(joints) == [f"joint_{k}" for k in range(1, 7)]
    assert all(figures["r"] > 0.97 and figures["relative_rms"] < 0.2 for figures in joints.values())
    assert load_model(result / "model.yaml").parameters.size > 0
    # A machine too slow for the cycle has a recording of what was broken off, too.
    bag = max((result / "recordings").iterdir(), key=lambda place: place.stat().st_mtime)
    # Both runs, of 15 s and 10 s, and the way there and back.
    assert read_recording(bag).time[-1] > 25.0
    assert "joint_6" in output and "report.html" in output
    nothing_left(demo)


@pytest.mark.parametrize(
    "moment, number",
    [("starting", signal.SIGINT), ("moving", signal.SIGINT), ("moving", signal.SIGTERM)],
    ids=["starting", "moving", "terminated"],
)
def test_a_signal_ends_every_process(demo, tmp_path, moment, number):
    process = demo()
    wait_until(lambda: moving(tmp_path) if moment == "moving" else len(marked(demo.tag)) > len(NODES), process)
    process.send_signal(number)
    _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130
    assert "Traceback" not in errors
    told = errors.splitlines()[-1]
    assert "interrupted; every node has ended" in told and "there is no result yet" in told
    result = tmp_path / "result"
    names = told.partition(f"{result} has ")[2].partition(" of it;")[0].split(", ")
    assert {"excitation.yaml", "validation.yaml", "logs"} <= set(names)
    assert all((result / name).exists() for name in names)
    bags = [name for name in names if name.startswith("recordings/")]
    assert len(bags) == (moment == "moving")
    for bag in bags:
        assert len(read_recording(result / bag).time) > 0
    nothing_left(demo)


def test_a_killed_demo_takes_its_nodes_with_it(demo):
    process = demo()
    wait_until(lambda: len(marked(demo.tag)) > len(NODES), process)
    process.kill()
    process.communicate()
    end = time.monotonic() + PATIENCE_S
    while marked(demo.tag):
        assert time.monotonic() < end, marked(demo.tag)
        time.sleep(0.1)
