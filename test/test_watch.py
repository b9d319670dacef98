"""`spacearm watch`: what the graph says becomes the right screen; and the command listens to a real graph."""

from __future__ import annotations

import io
import json
import math
import os
import pty
import signal
import sys
import time
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console

from spacearm_ident.canbus.cia402 import State
from spacearm_ident.cli.main import main
from spacearm_ident.cli.watch import plain
from spacearm_ident.nodes.watch_screen import screen, spark
from spacearm_ident.nodes.watch_state import SILENT_S, View, WatchState

ENABLED = State.OPERATION_ENABLED.label
DRIVER = {
    "operation_enabled": "true",
    "state": "enabled",
    "connection": "connected",
    "cycles": "81234",
    "missed_cycles": "3",
    "incomplete_cycles": "1",
    "late_frames": "0",
    "lateness_p50_us": "12",
    "lateness_p99_us": "40.5",
    "lateness_p999_us": "350",
    "bus_1_load": "72 % (worst case 81 %)",
    "bus_0_load": "49 % (worst case 56 %)",
    "shoulder": ENABLED,
    "elbow": State.FAULT.label,
}


def heard(state: WatchState, name: str = "canopen_driver", values=DRIVER, now: float = 0.0, level: int = 0) -> None:
    state.hear_status(name, level, f"{name} speaks", "small_arm", values, now)


def printed(view: View, width: int = 110) -> str:
    out = io.StringIO()
    Console(file=out, width=width).print(screen(view))
    return out.getvalue()


def parameter(value: float, error: float) -> dict[str, str]:
    return {"value": repr(value), "standard_error": repr(error), "unit": "N m"}


def test_drives_and_cycle_are_the_drivers_words():
    state = WatchState()
    heard(state)
    view = state.view(1.0)
    assert view.arm == "small_arm"
    assert {joint.name: joint.drive for joint in view.joints} == {"shoulder": ENABLED, "elbow": State.FAULT.label}
    assert (view.cycle.cycles, view.cycle.missed, view.cycle.incomplete) == (81234, 3, 1)
    assert view.cycle.lateness_us == (12.0, 40.5, 350.0)
    assert view.cycle.loads == ("49 % (worst case 56 %)", "72 % (worst case 81 %)")
    text = printed(view)
    assert "81234 cycles, 3 missed, 1 incomplete" in text and "bus 1  72 % (worst case 81 %)" in text
    assert "no joint states" in text


def test_who_falls_silent_is_not_shown_as_it_last_was():
    state = WatchState()
    heard(state)
    heard(state, "recorder", {}, now=SILENT_S)
    state.hear_joints(["shoulder"], [0.1], [2.0], 1, 0.0)
    view = state.view(SILENT_S + 1.0)
    assert {node.name: node.level for node in view.nodes} == {"canopen_driver": "silent", "recorder": "ok"}
    assert view.cycle is None and view.rate_hz is None
    assert [(joint.name, joint.drive, joint.position) for joint in view.joints] == [("shoulder", "", None)]
    assert "silent for 4 s; it last said: canopen_driver speaks" in printed(view)


def test_the_rate_counts_messages_that_were_never_taken():
    state = WatchState()
    for k in range(60):
        state.hear_joints(["a"], [0.0], [0.0], 1000 + 50 * k, 0.05 * k)
    assert state.view(3.0).rate_hz == pytest.approx(1000.0)
    state.hear_joints(["a"], [0.0], [0.0], 3, 3.1)
    assert state.view(3.1).rate_hz is None, "another publisher's numbers are not compared with the first's"
    state.hear_joints(["a"], [0.0], [0.0], 13, 3.2)
    assert state.view(3.2).rate_hz == pytest.approx(100.0)


def test_joints_are_in_the_order_of_the_joint_states_with_what_is_known_of_each():
    state = WatchState()
    heard(state)
    heard(state, "identifier: residual", {"rms_Nm[elbow]": "0.25", "rate_Hz": "50"})
    state.hear_joints(["elbow", "shoulder"], [0.5, -0.25], [], 1, 0.0)
    state.hear_temperature("shoulder", 31.26)
    elbow, shoulder = state.view(0.5).joints
    assert (elbow.name, elbow.position, elbow.torque, elbow.residual_rms) == ("elbow", 0.5, None, 0.25)
    assert (shoulder.position, shoulder.residual_rms, shoulder.temperature) == (-0.25, None, 31.26)
    text = printed(state.view(0.5))
    assert "0.5000" in text and "0.250" in text and "31.3" in text


@pytest.mark.parametrize(
    "said, done, words",
    [
        ({"state": "running", "run": "7", "period": 3, "periods": 5, "complete": None}, 0.4, "running, period 3 of 5"),
        ({"state": "done", "run": "7", "period": 0, "periods": 5, "complete": True}, 1.0, "done"),
        (
            {"state": "stopping", "run": "7", "period": 2, "periods": 4, "reason": "too hot"},
            0.25,
            "period 2 of 4: too hot",
        ),
        ({"state": "idle", "run": None, "period": 0, "periods": 0, "complete": None}, 0.0, "idle"),
    ],
)
def test_progress_of_a_run(said, done, words):
    state = WatchState()
    state.hear_run(json.dumps(said))
    assert state.view(0.0).run.done == pytest.approx(done)
    assert words in printed(state.view(0.0))


def test_nonsense_about_a_run_is_left_out():
    state = WatchState()
    for text in ("", "{", "[]", '"running"', '{"period": "x"}'):
        state.hear_run(text)
        assert state.view(0.0).run is None
    state.hear_run('{"state": "running", "period": "x", "periods": null}')
    assert state.view(0.0).run.done == 0.0


def test_parameters_that_moved_most_come_first_then_those_known_least():
    state = WatchState()
    state.hear_parameters([("a", parameter(1.0, 0.1)), ("b", parameter(1.0, 0.5)), ("c", parameter(2.0, math.nan))])
    view = state.view(0.0)
    assert [row.name for row in view.parameters] == ["b", "a"] and view.parameters[0].change is None
    assert (view.known, view.parameters_total) == (2, 3)
    state.hear_parameters([("a", parameter(1.4, 0.05)), ("b", parameter(1.1, 0.25))])
    first, second = state.view(0.0).parameters
    assert (first.name, first.change) == ("a", pytest.approx(8.0))
    assert (second.change, second.errors) == (pytest.approx(0.4), (0.5, 0.25))
    assert len(state.view(0.0, 1).parameters) == 1
    text = printed(state.view(0.0))
    assert "2 of 2 with a standard error" in text and "+8.0" in text and "█▄" in text.replace("▅", "▄")


def test_identification_under_way_and_done():
    state = WatchState()
    heard(state, "identifier", {"identifying": "true", "progress": "0.42"})
    heard(state, "identifier: identification", {})
    view = state.view(0.0)
    assert view.identifying == 0.42 and view.identification == "identifier: identification speaks"
    assert "42%" in printed(view)
    heard(state, "identifier", {"identifying": "false", "progress": "0"})
    assert state.view(0.0).identifying is None


def test_nothing_heard_is_a_screen_too():
    assert "arm not known yet" in printed(WatchState().view(0.0))


TEXT = st.text(max_size=12)


@settings(deadline=None, max_examples=25)
@given(
    st.lists(st.tuples(TEXT, st.integers(0, 255), TEXT, st.dictionaries(TEXT, TEXT, max_size=4)), max_size=4),
    st.lists(st.tuples(TEXT, st.dictionaries(st.sampled_from(["value", "standard_error", "unit"]), TEXT)), max_size=4),
    TEXT,
)
def test_whatever_is_said_there_is_a_screen_and_json(statuses, parameters, run):
    state = WatchState()
    for name, level, message, values in statuses:
        state.hear_status(name, level, message, message, values, 0.0)
    heard(state, values={key: name for key in DRIVER for name in ("[bold]nan[/]",)})
    state.hear_parameters(parameters)
    state.hear_run(run)
    view = state.view(0.1)
    assert "canopen_driver" in printed(view)
    from dataclasses import asdict

    json.dumps(plain(asdict(view)), allow_nan=False)


@given(st.lists(st.floats(0, 1e9), max_size=20))
def test_a_spark_is_as_long_as_its_values_and_full_where_they_are_largest(values):
    drawn = spark(values)
    if len(values) < 2 or max(values) == 0:
        assert drawn == ""
    else:
        assert len(drawn) == len(values) and drawn[values.index(max(values))] == "█"


# --- on a real graph --------------------------------------------------------------------------------------------


def speak(probe):
    """What a driver and an identifier would say, once for the latched ones, again and again for the others."""
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
    from sensor_msgs.msg import JointState

    from spacearm_ident.nodes.runtime import LATCHED, STREAM

    def array(name, values, message=""):
        pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
        return DiagnosticArray(
            status=[DiagnosticStatus(level=b"\1", name=name, message=message, hardware_id="small_arm", values=pairs)]
        )

    node = probe.node
    parameters = node.create_publisher(DiagnosticArray, "/identifier/parameters", LATCHED)
    parameters.publish(array("f_c[shoulder]", parameter(3.0, 0.01)))
    diagnostics = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
    joints = node.create_publisher(JointState, "/joint_states", STREAM)

    def again():
        diagnostics.publish(array("canopen_driver", DRIVER, "enabled, warm"))
        joints.publish(JointState(name=["shoulder", "elbow"], position=[0.5, 0.25], effort=[7.0, 8.0]))
        probe.spin(0.02)

    return again


def test_one_frame_of_a_real_graph(graph):
    processes, probe = graph
    from live_nodes import PATIENCE_S, output

    again = speak(probe)
    words = ("-m", "spacearm_ident.cli.main", "watch", "--once", "--wait", str(PATIENCE_S))
    asked = [processes.python(*words), processes.python(*words, "--json")]
    end = time.monotonic() + 6 * PATIENCE_S
    while any(process.poll() is None for process in asked) and time.monotonic() < end:
        again()
    assert [process.poll() for process in asked] == [0, 0], "".join(map(output, asked))
    text, view = output(asked[0]), json.loads(output(asked[1]))
    assert "small_arm" in text and "enabled, warm" in text and "81234 cycles" in text
    assert view["arm"] == "small_arm" and view["nodes"][0]["level"] == "warn" and view["rate_hz"] > 0
    joint = view["joints"][0]
    assert (joint["name"], joint["position"], joint["torque"], joint["drive"]) == ("shoulder", 0.5, 7.0, ENABLED)
    assert [row["name"] for row in view["parameters"]] == ["f_c[shoulder]"]


def test_the_screen_is_kept_and_the_terminal_given_back(graph):
    _, probe = graph
    from live_nodes import PATIENCE_S, ROOT

    again = speak(probe)
    pid, terminal = pty.fork()
    if pid == 0:  # in the child: nothing but the command
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "TERM": "xterm", "COLUMNS": "120", "LINES": "40"}
        os.execve(sys.executable, [sys.executable, "-m", "spacearm_ident.cli.main", "watch"], environment)
    shown, end = b"", time.monotonic() + 6 * PATIENCE_S
    os.set_blocking(terminal, False)
    try:
        while b"81234 cycles" not in shown and time.monotonic() < end:
            again()
            shown += drain(terminal)
        assert b"81234 cycles" in shown and b"\x1b[?1049h" in shown, shown.decode(errors="replace")
        os.kill(pid, signal.SIGINT)
        while os.waitpid(pid, os.WNOHANG) == (0, 0) and time.monotonic() < end:
            time.sleep(0.02)
            shown += drain(terminal)
        assert b"\x1b[?1049l" in shown + drain(terminal) and b"Traceback" not in shown
    finally:
        try:
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
        except (ProcessLookupError, ChildProcessError):
            pass
        os.close(terminal)


def drain(terminal: int) -> bytes:
    """What the other end has written so far."""
    try:
        return os.read(terminal, 1 << 20)
    except (BlockingIOError, OSError):
        return b""


def test_without_ros_or_terminal_or_nodes_it_is_said(monkeypatch, capsys):
    import importlib.util

    assert main(["watch", "--rate", "0"]) == 2
    assert "above zero" in capsys.readouterr().err
    assert main(["watch"]) == 2
    assert "use --once" in capsys.readouterr().err
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert main(["watch", "--once"]) == 2
    assert "needs ROS 2" in capsys.readouterr().err


def test_the_views_know_neither_ros_nor_each_other():
    nodes = Path(__file__).parent.parent / "spacearm_ident" / "nodes"
    for name in ("watch_state.py", "watch_screen.py"):
        assert not any(word in (nodes / name).read_text() for word in ("rclpy", "_msgs", "runtime"))
