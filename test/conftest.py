"""What all tests share. Property-based inputs are the same in every run: a verdict is the code's, not the draw's.

`HYPOTHESIS_PROFILE=search pytest` draws new ones; what it finds becomes a case of its own.
"""

import os

import pytest
from hypothesis import settings

settings.register_profile("same", derandomize=True)
settings.register_profile("search", max_examples=300)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "same"))


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


@pytest.fixture
def graph(tmp_path):
    """Processes to start on a graph, and a node that sees what they say there."""
    pytest.importorskip("rclpy", reason="needs ROS 2 (or its wheels: pip install spacearm_ident[ros])")
    from live_nodes import Probe, Processes

    processes, probe = Processes(tmp_path), Probe()
    yield processes, probe
    probe.close()
    processes.end()
