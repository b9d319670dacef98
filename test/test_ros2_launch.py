"""`ros2 launch` as documented, with the real tools: start, what a user types meanwhile, failure, Ctrl-C."""

import json
import os
import re
import shutil
import signal
from pathlib import Path

import pytest
import yaml
from driven_arm import PERIOD_S, generous_config
from live_nodes import LIVE
from mcap.reader import make_reader
from ros2_tools import NEEDED

from spacearm_ident.cli.demo import ARM, FAST_PLANS, write_trajectory
from spacearm_ident.config import config_path
from spacearm_ident.dynamics.arm import load_arm
from spacearm_ident.nodes.main import NODES
from spacearm_ident.recording import read_recording
from spacearm_ident.results.store import load_result

pytestmark = [*LIVE, NEEDED]
LAUNCH = ("ros2", "launch", "spacearm_ident", "spacearm.launch.py")
READY = "all nodes are ready"
TRIGGER = ("std_srvs/srv/Trigger",)
SWITCH = "std_srvs/srv/SetBool"
STATE_PUBLISHER = """#!{python}
# Stands for robot_state_publisher: says what it was started with, and waits for its end.
import json, signal, sys, threading
from pathlib import Path
stop = threading.Event()
signal.signal(signal.SIGINT, lambda *_: stop.set())
Path({out!r}).write_text(json.dumps(sys.argv[1:]))
while not stop.wait(0.1): pass
signal.signal(signal.SIGINT, signal.SIG_IGN)
"""


class Launches:
    """The launch without a namespace, shared by the tests until one of them ends it."""

    def __init__(self, workspace):
        self.workspace, self._open, self.running = workspace, None, None

    def __call__(self):
        if self.running is None or not self.running.running:
            self.close()
            self.folder = self.workspace.folder / f"launch-{len(list(self.workspace.folder.iterdir()))}"
            self.folder.mkdir()
            words = (
                f"can:={generous_config(self.folder)}",
                f"recordings:={self.folder / 'bags'}",
                f"results:={self.folder / 'result'}",
            )
            self._open = self.workspace.started(*LAUNCH, *words, cwd=self.folder)
            self.running = self._open.__enter__()
            self.running.wait_until_said(READY)
            self.running.wait_for(self._known, "the nodes are known to the daemon of `ros2`")
        return self.running

    def _known(self):
        return set(self.workspace.run("ros2", "node", "list").stdout.split()) >= {f"/{node}" for node in NODES}

    def close(self):
        if self._open is not None:
            self._open.__exit__(None, None, None)


@pytest.fixture(scope="module")
def launched(workspace):
    launches = Launches(workspace)
    yield launches
    launches.close()


def call(workspace, service, *kind_and_request):
    """Call a service; whether it was granted, and the reply."""
    answer = workspace.run("ros2", "service", "call", service, *kind_and_request)
    found = re.search(r"success=(True|False), message=(['\"])(.*)\2\)", answer.stdout)
    assert found, answer
    return found[1] == "True", found[3]


def ended_well(launch, nodes=NODES):
    """All nodes have ended with exit code 0, and so has the launch, and nothing of it is left."""
    said = launch.said
    assert said.count("process has finished cleanly") == len(nodes), said
    assert "has died" not in said and "Traceback" not in said and "[ERROR]" not in said, said
    assert launch.members() == []


def complete_bag(folder):
    """The one bag in a folder: it has been closed, and can be read."""
    (bag,) = folder.iterdir()
    with next(bag.glob("*.mcap")).open("rb") as stream:
        assert make_reader(stream).get_summary().statistics.message_count > 0
    counted = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert counted["message_count"] > 0
    return bag


def test_launch_says_when_it_is_ready_where_it_records_and_what_to_call_next(launched):
    said = launched().said
    line = next(line for line in said.splitlines() if READY in line)
    assert f"recording to {launched.folder / 'bags'}/run_" in line
    assert f"results go to {launched.folder / 'result'}" in line
    assert "ros2 service call /driver/enable std_srvs/srv/SetBool '{data: true}'" in line
    assert "[ERROR]" not in said, said


def test_parameters_are_listed_described_and_set_within_their_bounds(launched, workspace):
    launched()

    def param(*words):
        return workspace.run("ros2", "param", *words)

    listed = param("list").stdout
    assert all(f"/{node}:" in listed for node in NODES) and "  trajectory_file" in listed
    told = param("describe", "/trajectory", "rate_hz", "trajectory_file").stdout
    assert "set-points a second, Hz" in told and "Min value: 10.0" in told and "Max value: 5000.0" in told
    assert told.count("Read only: true") == 1  # of these two
    assert "Set parameter successful" in param("set", "/trajectory", "trajectory_file", "other.yaml").stdout
    refused = param("set", "/trajectory", "rate_hz", "500.0")
    assert "read-only" in refused.stdout + refused.stderr
    held = yaml.safe_load(param("dump", "/trajectory").stdout)["/trajectory"]["ros__parameters"]
    assert held["trajectory_file"] == "other.yaml" and held["rate_hz"] == 1000.0


def test_topics_are_echoed_and_have_their_rate(launched, workspace):
    launched()
    state = yaml.safe_load(workspace.run("ros2", "topic", "echo", "--once", "/joint_states").stdout.partition("---")[0])
    assert state["name"] == [f"joint_{k}" for k in range(1, 7)] and len(state["position"]) == len(state["effort"]) == 6
    described = workspace.run("ros2", "topic", "echo", "--once", "--full-length", "/robot_description").stdout
    assert "<robot" in described and "</robot>" in described
    with workspace.started("ros2", "topic", "hz", "/joint_states") as counting:

        def rates():
            return [float(rate) for rate in re.findall(r"average rate: ([\d.]+)", counting.said)]

        # It counts in Python, and on a busy machine not always all of them.
        counting.wait_for(lambda: any(0.9 < rate * PERIOD_S < 1.1 for rate in rates()), "the rate of the cycle")


def start(workspace, file):
    """Start a run of this file, from whatever state the drives are in."""
    set_to = workspace.run("ros2", "param", "set", "/trajectory", "trajectory_file", str(file))
    assert "successful" in set_to.stdout, set_to
    done, answer = call(workspace, "/excitation/start", *TRIGGER)
    if not done:
        assert "/driver/enable" in answer
        call(workspace, "/driver/recover", *TRIGGER)  # refused where nothing has been broken off
        done, answer = call(workspace, "/driver/enable", SWITCH, "{data: true}")
        assert done, answer
        done, answer = call(workspace, "/excitation/start", *TRIGGER)
    assert done, answer


def test_services_lead_through_a_run_its_identification_and_its_validation(launched, workspace):
    launch = launched()
    for number, plan in enumerate(FAST_PLANS, start=1):
        before = len(launch.said)
        start(workspace, write_trajectory(plan, launched.folder))

        def outcome(before=before):
            return re.search(r"was stopped early|identified and validated.*", launch.said[before:])

        launch.wait_for(outcome, f"run {number} has been identified")
        assert "stopped early" not in outcome()[0], launch.said
    assert "report.html" in outcome()[0]
    result = load_result(launched.folder / "result")
    assert set(result.validation.joints) == {f"joint_{k}" for k in range(1, 7)}
    bags = [path.name for path in sorted((launched.folder / "result").glob("*.mcap"))]
    assert bags == ["excitation.mcap", "validation.mcap"]


def test_ctrl_c_twice_in_motion_ends_every_node_with_0_and_leaves_a_complete_bag(launched, workspace):
    launch = launched()
    start(workspace, write_trajectory(FAST_PLANS[0], launched.folder))
    assert launch.interrupt(times=2) == 0
    ended_well(launch)
    assert len(read_recording(complete_bag(launched.folder / "bags")).time) > 1000


def two_arms(workspace):
    """A CAN YAML for each of two arms, on buses of their own; with a slower cycle, for two cores hold one at 1 kHz."""
    for arm in ("arm_1", "arm_2"):
        data = yaml.safe_load(config_path("paper_arm_can.yaml").read_text())
        data["arm"] = str(config_path(ARM))
        data["cycle"] |= {"period_s": 0.005, "heartbeat_timeout_s": 1.5, "stale_feedback_s": 0.5}
        data["buses"] = [{"interface": "local", "channel": f"{arm}_{bus}"} for bus in range(2)]
        file = workspace.folder / f"{arm}.yaml"
        file.write_text(yaml.safe_dump(data))
        folder = workspace.folder / arm
        shutil.rmtree(folder, ignore_errors=True)
        words = (f"namespace:={arm}", f"can:={file}", f"recordings:={folder / 'bags'}", f"results:={folder / 'result'}")
        yield workspace.started(*LAUNCH, *words, cwd=folder, **workspace.apart())


def test_two_arms_on_one_graph_are_launched_enabled_and_ended_apart(workspace):
    own = workspace.apart()
    first, second = two_arms(workspace)
    with first as left, second as right:
        left.wait_until_said(READY, "service call /arm_1/driver/enable", "call /arm_1/excitation/start")
        right.wait_until_said(READY, "service call /arm_2/driver/enable")
        topics = workspace.run("ros2", "topic", "list", "--no-daemon", "--spin-time", "5", **own).stdout.split()
        outside = {name for name in topics if not name.startswith(("/arm_1/", "/arm_2/"))}
        assert outside == {"/diagnostics", "/parameter_events", "/rosout"}
        assert {"/arm_1/joint_states", "/arm_2/joint_states", "/arm_2/excitation/state"} <= set(topics)
        answer = workspace.run("ros2", "service", "call", "/arm_1/driver/enable", SWITCH, "{data: true}", **own).stdout
        assert "success=True" in answer, answer

        def drives(arm):
            seen = workspace.run("spacearm", "watch", "--json", "--wait", "20", "--namespace", arm, **own)
            return {joint["drive"] for joint in json.loads(seen.stdout)["joints"]}

        # Its one frame may come before the driver's own words.
        left.wait_for(lambda: drives("arm_1") == {"operation enabled"}, "the first arm is enabled")
        right.wait_for(lambda: drives("arm_2") == {"switch on disabled"}, "the second arm is not")
        assert left.interrupt() == 0
        assert right.running
        assert right.interrupt() == 0
    for launch in (left, right):
        ended_well(launch)
    for arm in ("arm_1", "arm_2"):
        recording = read_recording(complete_bag(workspace.folder / arm / "bags"))
        assert len(recording.time) > 100 and recording.urdf


def test_a_killed_driver_is_not_said_to_have_ended_for_a_stop_it_had_recovered_from(workspace, tmp_path):
    words, own = (f"can:={generous_config(tmp_path)}", "record:=false"), workspace.apart()
    with workspace.started(*LAUNCH, *words, cwd=tmp_path, **own) as launch:
        launch.wait_until_said(READY)
        for service in ("halt", "recover"):
            answer = workspace.run("ros2", "service", "call", f"/driver/{service}", *TRIGGER, **own).stdout
            assert "success=True" in answer, answer
        launch.wait_until_said("arm recovered, disabled now; it was stopped by: ")
        pid = re.search(r"canopen_driver-\d\]: process started with pid \[(\d+)\]", launch.said)[1]
        os.kill(int(pid), signal.SIGKILL)
        assert launch.wait() == 1, launch.said
        (why,) = (line for line in launch.said.splitlines() if "Caught exception in launch" in line)
        assert "ended with exit code -9: killed by SIGKILL; before that, it said last: " in why
        assert "]: arm recovered, disabled now; it was stopped by: " in why


# --- a launch that cannot be --------------------------------------------------------------------------------------


def refused(workspace, tmp_path, *words):
    """What a launch says that ends by itself, with exit code 1."""
    with workspace.started(*LAUNCH, "sim:=false", *words, cwd=tmp_path, **workspace.apart()) as launch:
        assert launch.wait() == 1, launch.said
        assert launch.members() == []
        (why,) = (line for line in launch.said.splitlines() if "Caught exception in launch" in line)
        return why, launch.said


@pytest.mark.parametrize("name", ["arm", "can", "params"])
def test_launch_refuses_a_file_that_is_not_there_before_any_node_starts(workspace, tmp_path, name):
    why, said = refused(workspace, tmp_path, f"{name}:=nowhere.yaml")
    assert f"{name}:=nowhere.yaml: no such file" in why and "process started" not in said


def test_launch_refuses_what_is_neither_true_nor_false_by_the_name_of_its_argument(workspace, tmp_path):
    why, said = refused(workspace, tmp_path, "record:=yes")
    assert 'Argument "record" provided value "yes" is not valid' in why and "process started" not in said


def test_launch_ends_with_1_and_the_reason_when_a_node_cannot_read_its_parameters(workspace, tmp_path):
    bad = tmp_path / "bad.yaml"
    bad.write_text("recorder: [")
    why, said = refused(workspace, tmp_path, f"params:={bad}")
    assert "ended with exit code 2: " in why and str(bad) in why and READY not in said


def test_launch_ends_with_1_and_the_reason_when_there_is_no_arm(workspace, tmp_path):
    hasty = tmp_path / "hasty.yaml"
    hasty.write_text(yaml.safe_dump({"canopen_driver": {"ros__parameters": {"connect_timeout_s": 1.0}}}))
    why, said = refused(workspace, tmp_path, f"params:={hasty}")
    assert re.search(r"canopen_driver-\d ended with exit code 2: .*no one else is on it", why), why
    # Whoever had started was ended as by Ctrl-C.
    assert said.count("process has finished cleanly") == 3 and said.count("has died") == 1, said


def test_launch_says_that_robot_state_publisher_is_not_installed(workspace, tmp_path):
    why, said = refused(workspace, tmp_path, "robot_state_publisher:=true")
    assert "robot_state_publisher is not installed: apt install ros-jazzy-robot-state-publisher" in why
    assert "process started" not in said


def test_robot_state_publisher_gets_the_description_and_the_namespace(workspace, tmp_path):
    prefix, out = tmp_path / "prefix", tmp_path / "argv.json"
    marker = prefix / "share/ament_index/resource_index/packages/robot_state_publisher"
    script = prefix / "lib/robot_state_publisher/robot_state_publisher"
    for file in (marker, script):
        file.parent.mkdir(parents=True)
        file.write_text(STATE_PUBLISHER.format(python=shutil.which("python3"), out=str(out)))
    script.chmod(0o755)
    path = f"{workspace.environment['AMENT_PREFIX_PATH']}:{prefix}"
    words = ("robot_state_publisher:=true", "sim:=false", "namespace:=arm_1", "record:=false")
    with workspace.started(*LAUNCH, *words, cwd=tmp_path, AMENT_PREFIX_PATH=path, **workspace.apart()) as launch:
        launch.wait_for(lambda: launch.said.count("]: ready: ") == 3 and out.exists(), "all but the driver are ready")
        argv = json.loads(out.read_text())
        assert "__ns:=/arm_1" in argv and "robot_description:=robot_state_publisher/robot_description" in argv
        given = yaml.safe_load(Path(argv[argv.index("--params-file") + 1]).read_text())
        (parameters,) = (each["ros__parameters"] for each in given.values())
        assert parameters == {"robot_description": load_arm(config_path(ARM)).urdf, "frame_prefix": "arm_1/"}
        assert launch.interrupt() == 0, launch.said
        ended_well(launch, (*NODES[:4], "robot_state_publisher"))
