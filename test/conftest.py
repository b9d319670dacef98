"""What all tests share. Property-based inputs are the same in every run: a verdict is the code's, not the draw's.

`HYPOTHESIS_PROFILE=search pytest` draws new ones; what it finds becomes a case of its own. A module whose imports are
not all installed is skipped, with the package to install as the reason.
"""

import os
import shutil
import tempfile
from pathlib import Path

import pytest

from spacearm_ident.blas_threads import one_thread

# As the command does: two workers with two threads each wait for one another, and take ten times as long.
one_thread()

try:
    from hypothesis import settings
except ModuleNotFoundError:
    pass
else:
    # A busy machine is not a failure: no deadlines.
    settings.register_profile("same", derandomize=True, deadline=None)
    settings.register_profile("search", max_examples=300, deadline=None)
    settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "same"))

OPTIONAL = {
    "hypothesis": "python3-hypothesis",
    "rosbags": "pip install rosbags",
    "mcap_ros2": "pip install mcap-ros2-support",
    "clarabel": "pip install clarabel: README.md, ROS 2 Jazzy",
}
"""Modules that a machine set up from package.xml may lack, and what brings them."""


@pytest.hookimpl(tryfirst=True)
def pytest_pycollect_makemodule(module_path, parent):
    """Keep launch_testing, a plugin that ROS 2 brings, from importing all modules to see which are its own: none is."""
    return pytest.Module.from_parent(parent, path=module_path)


@pytest.hookimpl(hookwrapper=True)
def pytest_make_collect_report(collector):
    """Turn the collection error of a module that imports what is optional, and not there, into a skip."""
    outcome = yield
    report = outcome.get_result()
    if reason := lacking(report.call.excinfo.value.__cause__ if report.failed and report.call.excinfo else None):
        report.outcome = "skipped"
        report.longrepr = (str(collector.path), 0, f"Skipped: {reason}")


def lacking(error):
    """The reason to skip where an error says that something optional is not installed, else empty."""
    module = (error.name or "").partition(".")[0] if isinstance(error, ModuleNotFoundError) else ""
    return f"needs {module} ({OPTIONAL[module]})" if module in OPTIONAL else ""


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item, call):
    """The same where a test or a fixture imports it, and where a live test failed on a machine that stood still."""
    outcome = yield
    report = outcome.get_result()
    reason = lacking(call.excinfo.value if call.excinfo else None)
    if not reason and report.failed and (watch := item.config.stash.get(WATCH, None)):
        reason = watch.excuse(item, call)
    if reason:
        report.outcome = "skipped"
        report.longrepr = (str(item.path), item.location[1] or 0, f"Skipped: {reason}")


WATCH = pytest.StashKey()
"""The machine's watch, where live tests are run."""


@pytest.fixture(scope="session", autouse=True)
def machine_watch(request, tmp_path_factory):
    """Watches whether the machine keeps time, where a live test is to be run."""
    if not any(item.get_closest_marker("live") for item in request.session.items):
        yield
        return
    from machine_watch import MachineWatch

    watch = request.config.stash[WATCH] = MachineWatch(tmp_path_factory.mktemp("watch"))
    yield
    del request.config.stash[WATCH]
    watch.close()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """What starts processes on a graph keeps time."""
    for item in items:
        if "graph" in item.fixturenames:
            item.add_marker(pytest.mark.live)


@pytest.fixture
def own_buses(tmp_path, monkeypatch):
    """Local buses that no other test is on; their folder."""
    folder = tmp_path / "run"
    monkeypatch.setenv("SPACEARM_RUNTIME_DIR", str(folder))
    return folder


@pytest.fixture(scope="session")
def rippled():
    """What the mismatch engine says of ripple at a joint of the planar arm."""
    from changed_arm import explained, ripple

    return explained(ripple)


@pytest.fixture(scope="session")
def workspace():
    """The checkout built by colcon, with the real `ros2` beside it; on a ROS domain that no other test is on."""
    from ros2_tools import Workspace, environment

    # Short: there are sockets in it.
    folder = Path(tempfile.mkdtemp(prefix="ws-", dir="/tmp"))
    built = Workspace(environment(), folder)
    # It knows the graph already when a command asks.
    built.run("ros2", "daemon", "start")
    yield built
    built.run("ros2", "daemon", "stop")
    shutil.rmtree(folder)


@pytest.fixture
def ros():
    """Skips where there is no ROS 2."""
    pytest.importorskip("rclpy", reason="needs ROS 2 (or its wheels: pip install spacearm_ident[ros])")


@pytest.fixture
def processes(ros, tmp_path):
    """Processes to start on a graph, ended with the test."""
    from live_nodes import Processes

    started = Processes(tmp_path)
    yield started
    started.end()


@pytest.fixture
def probe(ros):
    """A node that sees what is said on the graph."""
    from live_nodes import Probe

    made = Probe()
    yield made
    made.close()


@pytest.fixture
def graph(processes, probe):
    """Processes to start on a graph, and a node that sees what they say there."""
    return processes, probe
