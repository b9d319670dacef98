"""The life of a node: parameters, services, diagnostics, signals, exit codes; with real processes."""

import signal
import time

import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from live_nodes import LIVE, output, wait_for

pytestmark = LIVE

NODE = """
import sys, time
from spacearm_ident.errors import UserError
from spacearm_ident.nodes.runtime import Level, LiveNode, Status, run

class Sample(LiveNode):
    def __init__(self):
        super().__init__("sample", "the arm")
        self.rate = self.parameter("rate", 3.0, "how often, Hz", low=1.0, high=10.0)
        self.number = self.parameter("number", 3, "how many", low=0)
        self.names = self.parameter("names", ["a"], "who")
        self.offer("/sample/go", lambda: "gone")
        self.offer("/sample/refuse", self.refuse)
        self.offer("/sample/leave", self.leave)
        self.offer_switch("/sample/switch", lambda on: f"now {on}")
        print("ready", flush=True)
    def refuse(self):
        raise UserError("not now; come again")
    def leave(self):
        self.exit_code = 7
        return "bye"
    def diagnose(self):
        values = {"rate": self.rate, "number": self.number, "names": self.names, "moving": True}
        return Status(Level.OK, "well", values), Status(Level.WARN, "warm", part="motor")
    def close(self):
        print("closing", flush=True)
        self.publish_diagnostics()
        time.sleep(0.5)
        print("closed", flush=True)

sys.exit(run(Sample, sys.argv[1:]))
"""

INTERRUPTED = """
import importlib, os, signal, sys
from spacearm_ident.nodes.main import recorder

def slowly(name, package=None, import_module=importlib.import_module):
    os.kill(os.getpid(), signal.SIGINT)
    return import_module(name, package)

importlib.import_module = slowly
sys.exit(recorder())
"""


def sample(processes, *arguments):
    return processes.python("-c", NODE, *arguments)


def ready(process):
    return wait_for(lambda: "ready" in output(process), "the node is up")


def test_services_and_diagnostics(processes, probe):
    process = sample(processes, "--ros-args", "-p", "rate:=5", "-p", "number:=4")
    assert probe.call("/sample/go") == (True, "gone")
    assert probe.call("/sample/refuse") == (False, "not now; come again")
    assert probe.call("/sample/switch", True) == (True, "now True")
    probe.wait_for(lambda: probe.statuses.keys() >= {"sample", "sample: motor"}, "diagnostics")
    assert probe.values("sample") == {"rate": "5", "number": "4", "names": "['a']", "moving": "true"}
    assert probe.statuses["sample"].hardware_id == "the arm"
    assert (probe.level("sample"), probe.level("sample: motor")) == (0, 1)
    assert probe.call("/sample/leave") == (True, "bye")
    assert process.wait(20) == 7
    assert output(process).splitlines()[-1] == "closed"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_node_closes_once_and_ends_with_0_when_signals_go_on_until_it_is_gone(processes, number):
    process = sample(processes)
    ready(process)
    wait_for(
        lambda: process.poll() is not None, "its end", step=lambda: (process.send_signal(number), time.sleep(0.01))
    )
    assert process.returncode == 0
    first, logged, *rest = output(process).splitlines()
    assert (first, rest) == ("ready", ["closing", "closed"]) and logged.endswith("[sample]: ready: running")


def test_node_ends_with_0_and_without_a_word_when_interrupted_during_its_imports(processes):
    process = processes.python("-c", INTERRUPTED)
    assert process.wait(20) == 0
    assert output(process) == ""


@pytest.mark.parametrize(
    ("argument", "said"),
    [
        ("rate:=50.0", "out of range Min: 1.0, Max: 10.0, value: 50.0"),
        ("rate:=.nan", "parameter rate: "),
        ("rate:=often", "parameter rate: 'often' is not a number"),
        ("number:=-3", "out of range"),
        ("number:=1.5", "parameter number: "),
        ("names:=3", "parameter names: "),
        ("nonsense", "the --ros-args cannot be used"),
    ],
)
def test_a_bad_parameter_is_one_line_and_exit_code_2(processes, argument, said):
    process = sample(processes, "--ros-args", "-p", argument)
    assert process.wait(20) == 2
    lines = [line for line in output(process).splitlines() if "[rcl]" not in line]  # rcl has its own say
    assert len(lines) == 1 and said in lines[0]


WITHOUT_EVENTS_EXECUTOR = """
import sys
sys.modules["rclpy.experimental"] = None  # as in rclpy before 7.1.4
"""


def test_an_older_rclpy_without_events_executor_runs_the_node(processes, probe):
    process = processes.python("-c", WITHOUT_EVENTS_EXECUTOR + NODE)
    assert probe.call("/sample/go") == (True, "gone")
    probe.wait_for(lambda: "sample" in probe.statuses, "diagnostics")
    assert probe.call("/sample/leave") == (True, "bye")
    assert process.wait(20) == 7
    assert output(process).splitlines()[-1] == "closed"


def test_a_node_without_ros_says_what_to_do(processes):
    code = (
        "import sys; sys.modules['rclpy'] = None\nfrom spacearm_ident.nodes.main import recorder; sys.exit(recorder())"
    )
    process = processes.python("-c", code)
    assert process.wait(20) == 2
    assert len(output(process).splitlines()) == 1
    assert "recorder: the Python package 'rclpy' is missing; source a ROS 2 Jazzy setup file" in output(process)
