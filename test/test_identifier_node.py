"""The identifier in its own process on a real graph, fed by another process; its numbers are the command's."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import small_arm

pytest.importorskip("rclpy", reason="needs ROS 2 (or its wheels: pip install spacearm_ident[ros])")
pytest.importorskip("clarabel", reason="needs clarabel in the processes that identify (README.md, ROS 2 Jazzy)")

from diagnostic_msgs.msg import DiagnosticArray
from domains import domain
from live_nodes import LIVE, Probe, Processes, end, output
from rcl_interfaces.srv import GetParameters
from sensor_msgs.msg import JointState

from spacearm_ident.dynamics.model_file import load_model, save_model
from spacearm_ident.nodes.message_buffer import BLOCK_MESSAGES
from spacearm_ident.nodes.runtime import LATCHED, STREAM
from spacearm_ident.recording import RecordingWriter, cdr, read_recording, write_recording
from spacearm_ident.recording.messages import STATES_TOPIC, TOPIC_TYPES

pytestmark = LIVE

QUICK = ("friction:=coulomb-viscous", "bandwidth_hz:=5.0")
AS_QUICK = ("--friction", "coulomb-viscous", "--bandwidth", "5.0")
PATIENCE_S = 120.0
"""An identification on a busy machine."""


@pytest.fixture(autouse=True)
def environment(monkeypatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", domain("clean"))
    # The command's numbers and the node's are compared to the last digit: the same sums in the same order.
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "1")


@pytest.fixture(scope="module")
def bags(tmp_path_factory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("bags")
    made = {
        "first": small_arm.recording(seed=0),
        "second": small_arm.recording(seed=1),
        "third": small_arm.recording(seed=2),
        "still": small_arm.recording(8.0, still=(0, 1)),
    }
    for name, recording in made.items():
        write_recording(folder / f"{name}.mcap", recording)
    return {name: folder / f"{name}.mcap" for name in made}


class Graph(Probe):
    """The test's own eyes on the graph, the identifier, and the arm that plays recordings to it."""

    patience_s = PATIENCE_S

    def __init__(self, processes: Processes) -> None:
        super().__init__()
        self._processes = processes
        self._player: subprocess.Popen[str] | None = None
        self.player_words: tuple[str, ...] = ()
        self.residuals: list[JointState] = []
        self.predicted: list[JointState] = []
        self.node.create_subscription(JointState, "/identifier/residuals", self.residuals.append, STREAM)
        self.node.create_subscription(JointState, "/identifier/predicted", self.predicted.append, STREAM)

    def identifier(self, *parameters: str) -> subprocess.Popen[str]:
        """The node, ready to listen."""
        node = self._processes.node("identifier", *parameters)
        self.wait_for(lambda: "identifier" in self.statuses or node.poll() is not None, "the node")
        assert node.poll() is None, output(node)
        return node

    def tell(self, line: str) -> None:
        """A command to the player, to its end."""
        if self._player is None:
            script = str(Path(__file__).with_name("graph_arm.py"))
            self._player = self._processes.python(script, *self.player_words, stdin=subprocess.PIPE, text=True)
        assert self._player.stdin is not None
        done = output(self._player).count("ok\n")
        self._player.stdin.write(line + "\n")
        self._player.stdin.flush()
        self.wait_for(lambda: output(self._player).count("ok\n") > done, line)

    def said(self, part: str, words: str) -> Callable[[], bool]:
        return lambda: part in self.statuses and words in self.statuses[part].message

    def latched_parameters(self) -> dict[str, dict[str, str]]:
        """What a late subscriber gets."""
        got: list[DiagnosticArray] = []
        subscription = self.node.create_subscription(DiagnosticArray, "/identifier/parameters", got.append, LATCHED)
        self.wait_for(lambda: got, "the latched parameters")
        self.node.destroy_subscription(subscription)
        return {status.name: {pair.key: pair.value for pair in status.values} for status in got[-1].status}


@pytest.fixture
def processes(tmp_path) -> Iterator[Processes]:
    folder = tmp_path / "processes"
    folder.mkdir()
    started = Processes(folder)
    yield started
    started.end()


@pytest.fixture
def graph(processes) -> Iterator[Graph]:
    made = Graph(processes)
    yield made
    made.close()


def children(pid: int) -> list[int]:
    """Identification workers of a process (its helper that tracks resources is not one)."""
    workers = []
    for task in Path(f"/proc/{pid}/task").iterdir():
        for child in (task / "children").read_text().split():
            if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes():
                workers.append(int(child))
    return workers


def gone(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"
    except OSError:
        return True


def identify_by_command(processes: Processes, *words: object) -> None:
    """`spacearm identify` in a process of its own, as the node's worker is."""
    done = processes.python("-m", "spacearm_ident.cli.main", "identify", *map(str, words), *AS_QUICK, "--quiet")
    assert done.wait(PATIENCE_S) == 0, output(done)


def terms_of(file: Path) -> object:
    model = load_model(file)
    return model.model.structure, model.parameters.tolist(), model.constants.tolist(), model.cutoff_hz


def test_two_runs_give_parameters_residuals_and_a_result_folder(bags, processes, graph, tmp_path):
    out, by_command = tmp_path / "live", tmp_path / "offline"
    node = graph.identifier(f"result_directory:={out}", *QUICK)
    graph.tell(f"run 1 {bags['first']}")
    graph.wait_for(lambda: children(node.pid), "the worker")
    granted, answer = graph.call("/identifier/identify")
    assert not granted and "under way" in answer
    graph.wait_for(graph.said("identifier: identification", "of the fit itself"), "the identification")
    assert graph.values("identifier: identification")["held_out"] == "false"
    parameters = graph.latched_parameters()
    graph.tell(f"run 2 {bags['second']}")
    graph.wait_for(graph.said("identifier: identification", "on other recordings"), "the validation")
    figures = graph.values("identifier: identification")
    graph.residuals.clear()
    graph.tell(f"play {bags['third']}")
    graph.wait_for(lambda: len(graph.residuals) > 600, "residuals")
    live = graph.values("identifier: residual")
    now = graph.latched_parameters()
    assert {name: now[name] for name in parameters} == parameters
    assert set(now) - set(parameters) == {
        f"tracked {symbol}[{joint}]" for symbol in ("f_b", "f_c", "k_v1") for joint in small_arm.JOINTS
    }
    assert end(node) == 0 and "Traceback" not in output(node)

    identify_by_command(processes, bags["first"], "--validate", bags["second"], "--out", by_command)
    offline = load_model(by_command / "model.yaml")
    for items, values in (
        (offline.model.parameters, offline.parameters),
        (offline.model.constants, offline.constants),
    ):
        assert {item.name: value for item, value in zip(items, values)} == {
            item.name: float(parameters[item.name]["value"]) for item in items
        }
    assert (out / "parameters.csv").read_bytes() == (by_command / "parameters.csv").read_bytes()
    assert terms_of(out / "model.yaml") == terms_of(by_command / "model.yaml")
    assert float(parameters["f_c[shoulder]"]["value"]) == pytest.approx(small_arm.COULOMB[0], rel=0.02)
    assert 0 < float(parameters["f_c[shoulder]"]["standard_error"]) < 0.1
    assert parameters["f_c[shoulder]"]["unit"] == "N m"
    names = {path.name for path in out.iterdir()}
    assert {"excitation.mcap", "validation.mcap", "report.html", "validation.json", "identified.urdf"} <= names
    assert not [name for name in names if name.startswith(".")]
    assert read_recording(out / "excitation.mcap").issues == ()

    stamps = np.array([m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec for m in graph.residuals])
    assert np.median(np.diff(stamps)) == pytest.approx(0.02, abs=1e-3)
    residual = np.array([m.effort for m in graph.residuals])
    assert tuple(graph.residuals[0].name) == small_arm.JOINTS
    for joint, column in zip(small_arm.JOINTS, residual.T):
        assert np.sqrt(np.mean(column**2)) < 2.0 * float(figures[f"rmse_Nm[{joint}]"])
        assert float(figures[f"r[{joint}]"]) > 0.999
    assert 0.3 < float(live["delay_s"]) < 0.6


def test_joint_states_published_best_effort_are_identified_and_said(bags, graph, tmp_path):
    graph.player_words = ("best_effort",)
    node = graph.identifier(f"result_directory:={tmp_path / 'live'}", *QUICK)
    graph.tell(f"run 1 {bags['first']}")
    graph.wait_for(graph.said("identifier: identification", "of the fit itself"), "the identification")
    assert "/joint_states is published BEST_EFFORT by /small_arm, and taken so" in output(node)
    assert float(graph.latched_parameters()["f_c[shoulder]"]["value"]) == pytest.approx(small_arm.COULOMB[0], rel=0.05)
    assert end(node) == 0 and "Traceback" not in output(node)


def test_a_second_node_that_publishes_the_arms_joints_is_warned_of_with_both_names(bags, graph, tmp_path):
    """A gripper's driver beside the arm's is none: its joints are its own."""
    node = graph.identifier(f"result_directory:={tmp_path / 'live'}", "auto_identify:=false", *QUICK)
    beside = graph.node.create_publisher(JointState, "/joint_states", 1000)
    hand = JointState(name=["finger"], position=[0.0], velocity=[0.0], effort=[0.0])
    other = JointState(name=list(small_arm.JOINTS), position=[0.5, 0.5], velocity=[0.0, 0.0], effort=[0.0, 0.0])
    told = f"/joint_states is published by /{graph.node.get_name()}, /small_arm"
    sent = hand
    timer = graph.node.create_timer(0.02, lambda: beside.publish(sent))
    graph.tell(f"play {bags['first']}")
    assert "is published by" not in output(node)
    sent = other
    graph.tell(f"play {bags['first']}")
    graph.wait_for(lambda: told in output(node), "the warning")
    graph.wait_for(lambda: graph.level("identifier") == 1 and graph.said("identifier", told)(), "the status")
    graph.node.destroy_timer(timer)
    graph.node.destroy_publisher(beside)
    graph.tell(f"play {bags['first']}")
    graph.wait_for(lambda: graph.level("identifier") == 0, "all is well")
    assert end(node) == 0


@pytest.mark.parametrize("missing", ["nan", "absent"])
def test_joint_states_without_effort_are_said_as_a_run_begins(bags, graph, tmp_path, missing):
    """A ros2_control arm without an effort interface publishes NaN; other drivers leave the array empty."""
    recording = read_recording(bags["first"])
    lacking = tmp_path / "lacking.mcap"
    effort = np.full_like(recording.effort, np.nan)
    effort[:, 0] = recording.effort[:, 0]  # one joint is enough, where the others stand still
    write_recording(tmp_path / "one.mcap", replace(recording, effort=effort))
    with RecordingWriter(lacking) as writer:
        topic = writer.add_topic(STATES_TOPIC, TOPIC_TYPES[STATES_TOPIC], [])
        for stamp, q in zip(recording.start_ns + np.round(1e9 * recording.time).astype(int), recording.position):
            gone = np.full((1, len(q)), np.nan) if missing == "nan" else None
            writer.write(
                topic, int(stamp), cdr.encode_joint_states([int(stamp)], recording.joints, q[None], effort=gone)[0]
            )
    node = graph.identifier(*QUICK, f"result_directory:={tmp_path / 'result'}", "auto_identify:=false")
    graph.tell('say {"state": "approach", "run": "r1", "complete": null}')
    graph.tell(f"play {lacking}")
    words = "/joint_states carries no effort of shoulder, elbow: nothing can be identified from a run"
    graph.wait_for(graph.said("identifier", words), "the warning")
    assert graph.level("identifier") == 1
    graph.wait_for(lambda: f"[identifier]: run r1: {words}" in output(node), "the log")
    graph.tell(f"play {tmp_path / 'one.mcap'}")
    words = "/joint_states carries no effort of elbow, which moves: a model of the other joints would be wrong"
    graph.wait_for(graph.said("identifier", words), "the warning of one joint")
    assert graph.level("identifier") == 1 and "of shoulder" not in graph.statuses["identifier"].message
    graph.tell(f"play {bags['first']}")
    graph.wait_for(lambda: graph.level("identifier") == 0, "all is well")
    assert output(node).count("carries no effort") == 2, output(node)


def test_unfit_data_are_said_before_anything_else_of_their_result(bags, graph, tmp_path):
    recording = read_recording(bags["first"])
    effort = recording.effort.copy()
    effort[:, 1] = np.nan
    write_recording(tmp_path / "one.mcap", replace(recording, effort=effort))
    node = graph.identifier(f"result_directory:={tmp_path / 'live'}", *QUICK)
    graph.tell(f"run 1 {tmp_path / 'one.mcap'}")
    graph.wait_for(graph.said("identifier: identification", "data unfit: fixed joint moves"), "the identification")
    lines = output(node).splitlines()
    first = next(k for k, line in enumerate(lines) if ", as spacearm identify" in line) + 1
    assert "[WARN]" in lines[first] and "data unfit: fixed joint moves" in lines[first]
    assert "fit. Every joint" not in output(node)


def test_a_joint_without_effort_that_stands_still_is_no_warning(bags, graph, tmp_path):
    recording = read_recording(bags["first"])
    effort, position = recording.effort.copy(), recording.position.copy()
    effort[:, 1], position[:, 1] = np.nan, 0.3
    write_recording(tmp_path / "one.mcap", replace(recording, effort=effort, position=position))
    node = graph.identifier(f"result_directory:={tmp_path / 'live'}", "auto_identify:=false", *QUICK)
    graph.tell(f"run 1 {tmp_path / 'one.mcap'}")
    assert graph.level("identifier") == 0 and "carries no effort" not in output(node)


def test_a_field_run_is_explained_where_asked(bags, processes, graph, tmp_path):
    for name, seed in (("field", 3), ("unseen", 4)):
        run = small_arm.recording(seed=seed)
        write_recording(tmp_path / f"{name}.mcap", replace(run, effort=run.effort + np.array([0.0, 2.0])))
    out, by_command = tmp_path / "live", tmp_path / "offline"
    node = graph.identifier(f"result_directory:={out}", f"mismatch_reference:={bags['first']}", *QUICK)
    graph.tell(f"run 1 {tmp_path / 'field.mcap'}")
    graph.wait_for(graph.said("identifier: mismatch", "current_offset at elbow"), "the verdict on the run")
    assert graph.values("identifier: mismatch")["judged_on"].startswith("the last third")
    graph.tell(f"run 2 {tmp_path / 'unseen.mcap'}")
    graph.wait_for(lambda: graph.values("identifier: mismatch")["judged_on"] == "held-out recordings", "the second")
    figures = graph.values("identifier: mismatch")
    assert figures["verdict"] == "mismatch" and graph.level("identifier: mismatch") == 1
    assert end(node) == 0 and "Traceback" not in output(node)

    words = [tmp_path / "field.mcap", "--reference", bags["first"], "--validate", tmp_path / "unseen.mcap"]
    command = processes.python("-m", "spacearm_ident.cli.main", "mismatch", *map(str, words), "--out", str(by_command))
    assert command.wait(PATIENCE_S) == 0, output(command)
    live, offline = (json.loads((place / "mismatch.json").read_text()) for place in (out / "mismatch", by_command))
    live.pop("provenance"), offline.pop("provenance")
    assert live == offline
    found = offline["findings"][0]["parameters"]["offset"]["value"]
    assert f"{found:.4g}" in figures["current_offset[elbow]"] and abs(found - 2.0) < 0.1


def test_a_run_is_compared_with_a_simulation_where_asked(bags, graph, tmp_path):
    """The simulation is the arm's URDF: it has no friction, which the run shows at both joints."""
    sim, out = tmp_path / "arm.urdf", tmp_path / "live"
    sim.write_text(small_arm.URDF)
    node = graph.identifier(f"result_directory:={out}", f"simulation:={sim}", *QUICK)
    graph.tell(f"run 1 {bags['first']}")
    graph.wait_for(graph.said("identifier: mismatch", "parameter"), "the comparison of the run")
    figures = graph.values("identifier: mismatch")
    assert figures["verdict"] == "mismatch" and figures["simulation"] == str(sim)
    assert any(name.startswith("parameters: friction") for name in figures)
    assert end(node) == 0 and "Traceback" not in output(node)
    assert json.loads((out / "mismatch" / "mismatch.json").read_text())["mended_simulation"] == "mended.urdf"


def test_replay_is_the_command(bags, processes, tmp_path):
    replay, by_command = tmp_path / "replay", tmp_path / "offline"
    parameters = (f"replay:={bags['first']}", f"replay_validate:={bags['second']}", "exit_after_replay:=true")
    node = processes.node("identifier", *parameters, f"result_directory:={replay}", *QUICK)
    assert node.wait(PATIENCE_S) == 0, output(node)
    identify_by_command(processes, bags["first"], "--validate", bags["second"], "--out", by_command)
    assert terms_of(replay / "model.yaml") == terms_of(by_command / "model.yaml")
    for name in ("parameters.csv", "base_parameters.csv", "validation.json"):
        assert (replay / name).read_bytes() == (by_command / name).read_bytes()


@pytest.mark.parametrize(
    ("parameters", "code", "words"),
    [
        (("replay:={still}", "exit_after_replay:=true"), 1, "no joint moves"),
        (("replay:=nowhere.mcap",), 2, "nowhere.mcap: no such file"),
        (("model:=nowhere.yaml",), 2, "nowhere.yaml"),
        (("friction:=sticky",), 2, "sticky"),
        (("gravity:=[0.0, 1.0]",), 2, "three numbers"),
        (("buffer_s:=-3.0",), 2, "buffer_s"),
        (("mismatch_on_change:=true", "tracking:=false"), 2, "set tracking to true"),
    ],
)
def test_what_cannot_work_says_so_and_ends(bags, processes, tmp_path, parameters, code, words):
    filled = [text.format(still=bags["still"]) for text in parameters]
    node = processes.node("identifier", *filled, f"result_directory:={tmp_path / 'result'}")
    assert node.wait(PATIENCE_S) == code, output(node)
    assert words in output(node) and "Traceback" not in output(node)
    assert not (tmp_path / "result").exists()


def test_requests_that_cannot_be_met_and_a_service_call_that_can(bags, processes, graph, tmp_path):
    out, by_command = tmp_path / "live", tmp_path / "offline"
    node = graph.identifier(f"result_directory:={out}", "buffer_s:=5.0", *QUICK)
    granted, answer = graph.call("/identifier/identify")
    assert not granted and "no joint states" in answer
    for text in ("not json", "[]", '{"run": 3}', '{"state": "done", "run": "unknown", "complete": true}'):
        graph.tell(f"say {text}")
    graph.tell(f"run broken-off {bags['first']} stopped")
    assert not children(node.pid)  # a run that was stopped early, or never begun, is not identified
    granted, answer = graph.call("/identifier/identify")
    assert granted and "3200 joint states" in answer
    graph.wait_for(graph.said("identifier: identification", "held out of the fit"), "the identification")
    for _ in range(2):
        graph.tell(f"play {bags['first']}")
    graph.wait_for(lambda: int(graph.values("identifier")["dropped"]) > 0, "a full buffer")
    assert int(graph.values("identifier")["buffered_messages"]) < 5000 + 2 * BLOCK_MESSAGES
    assert end(node) == 0 and "Traceback" not in output(node)
    identify_by_command(processes, bags["first"], "--out", by_command)
    assert (out / "parameters.csv").read_bytes() == (by_command / "parameters.csv").read_bytes()


def test_a_killed_worker_is_reported_and_the_node_goes_on(bags, graph, tmp_path):
    node = graph.identifier(f"result_directory:={tmp_path / 'live'}", *QUICK)
    graph.tell(f"run 1 {bags['first']}")
    os.kill(graph.wait_for(lambda: children(node.pid), "the worker")[0], signal.SIGKILL)
    graph.wait_for(graph.said("identifier: identification", "killed by SIGKILL"), "the report")
    assert graph.level("identifier: identification") == 2
    graph.tell(f"run 2 {bags['second']}")
    graph.wait_for(graph.said("identifier: identification", "of the fit itself"), "the next run")
    assert end(node) == 0


@pytest.mark.parametrize("last", [signal.SIGINT, signal.SIGKILL])
def test_nothing_stays_behind_when_the_node_ends_while_identifying(bags, graph, tmp_path, last):
    out = tmp_path / "live"
    node = graph.identifier(f"result_directory:={out}")
    graph.tell(f"run 1 {bags['first']}")
    worker = graph.wait_for(lambda: children(node.pid), "the worker")[0]
    graph.wait_for((out / "excitation.mcap").exists, "the worker at work")
    assert end(node, last) == (0 if last is signal.SIGINT else -last)
    graph.wait_for(lambda: gone(worker), "the end of the worker")
    assert {path.name for path in out.iterdir()} == {"excitation.mcap"}
    cut_off = re.findall(r"\[WARN\].* identification cut off at \d+% \(.+\), without a result: .*", output(node))
    assert len(cut_off) == (1 if last is signal.SIGINT else 0), output(node)


def test_an_identification_cut_off_is_said_with_the_command_that_does_it_off_line(bags, graph, tmp_path):
    out = tmp_path / "live"
    node = graph.identifier(f"result_directory:={out}")
    graph.tell(f"run 1 {bags['first']}")
    graph.wait_for(lambda: float(graph.values("identifier")["progress"]) >= 0.05, "the bag is written")
    os.kill(children(node.pid)[0], signal.SIGSTOP)  # however fast this machine is, it gets no further
    for state, complete in (("running", "null"), ("done", "true")):
        graph.tell(f'say {{"state": "{state}", "run": "2", "complete": {complete}}}')
    graph.wait_for(lambda: graph.values("identifier")["runs_waiting"] == "1", "a run waiting")
    assert end(node) == 0 and "Traceback" not in output(node)
    bag = out / "excitation.mcap"
    (said,) = re.findall(r"\[WARN\].* identification cut off at (.*)", output(node))
    assert f"its recordings are whole, off line it is spacearm identify {bag} --validate {bag} --out {out}" in said
    read_recording(bag)
    assert "run 2 is not identified: the node is ended" in output(node)
    assert "Traceback" not in output(node)


def test_a_model_file_gives_residuals_and_parameters_at_once(bags, processes, graph, tmp_path):
    out = tmp_path / "offline"
    identify_by_command(processes, bags["first"], "--out", out)
    graph.identifier(f"model:={out / 'model.yaml'}")
    parameters = graph.latched_parameters()
    graph.tell(f"play {bags['second']}")
    graph.wait_for(lambda: len(graph.residuals) > 600, "residuals")
    model = load_model(out / "model.yaml")
    for item, value in zip(model.model.parameters, model.parameters):
        assert float(parameters[item.name]["value"]) == value
        assert parameters[item.name]["determination"] == "from a model file"
    assert np.abs([m.effort for m in graph.residuals]).mean() < 0.2
    graph.wait_for(lambda: len(graph.predicted) >= len(graph.residuals), "predictions")
    played = read_recording(bags["second"])
    stamps = np.array([m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in graph.predicted])
    for column, joint in enumerate(graph.predicted[0].name):
        measured = played.effort[:, played.joints.index(joint)]
        predicted = np.array([m.effort[column] for m in graph.predicted])
        measured = np.interp((stamps - played.start_ns) / 1e9, played.time, measured)
        assert np.corrcoef(predicted, measured)[0, 1] > 0.99


def test_a_friction_step_is_found_dated_and_explained(graph, tmp_path):
    save_model(small_arm.identified(), tmp_path / "model.yaml")
    run, at_s = small_arm.recording(45.0), 25.0
    write_recording(tmp_path / "step.mcap", small_arm.with_step(run, at_s))
    out, model = tmp_path / "live", tmp_path / "model.yaml"
    options = (f"result_directory:={out}", "mismatch_on_change:=true", "mismatch_window_s:=15")
    node = graph.identifier(f"model:={model}", *options)
    graph.tell(f"play {tmp_path / 'step.mcap'}")
    graph.wait_for(graph.said("identifier: tracking", "at elbow changed by +0.5"), "the change")
    found = graph.values("identifier: tracking")
    assert graph.level("identifier: tracking") == 1 and found["changes"] == "1"
    assert (found["joint"], found["what"], found["unit"]) == ("elbow", "f_c", "N m")
    assert abs(float(found["time_s"]) - run.start_ns / 1e9 - at_s) < 0.5
    assert 0.0 < float(found["core_share"]) < 1.0
    parameters = graph.latched_parameters()
    tracked = parameters["tracked f_c[elbow]"]
    assert abs(float(tracked["value"]) - 2.0) < 4 * float(tracked["standard_error"]) < 0.5
    assert parameters["f_c[elbow]"]["value"] == tracked["identified"] == "1.5"
    # The parameter services work as well: a node's own names must not hide rclpy's.
    client = graph.node.create_client(GetParameters, "/identifier/get_parameters")
    graph.wait_for(client.service_is_ready, "the parameter services")
    reply = client.call_async(GetParameters.Request(names=["tracking_memory_s"]))
    graph.wait_for(reply.done, "a parameter")
    assert reply.result().values[0].double_value == 60.0

    graph.wait_for(graph.said("identifier: mismatch", "friction_drift at elbow"), "the verdict")
    assert graph.values("identifier: mismatch")["reference"] == str(model)
    explained = read_recording(out / "change.mcap")
    begun = 1e-9 * (explained.start_ns - run.start_ns)
    assert at_s - 0.5 < begun < at_s + 3.0 and 13.0 < explained.time[-1] < 19.0
    assert end(node) == 0 and "Traceback" not in output(node)


def test_a_run_of_an_arm_that_has_changed_does_not_replace_its_model_until_asked(graph, tmp_path):
    out = tmp_path / "live"
    out.mkdir()
    model, kept = out / "model.yaml", out / "model_before_change.yaml"
    save_model(small_arm.identified(), model)  # Where the result of the run goes as well.
    motion = small_arm.with_step(small_arm.recording(65.0), 25.0)
    write_recording(tmp_path / "step.mcap", motion.between(0.0, 45.0))
    write_recording(tmp_path / "later.mcap", motion.between(45.0, 65.0))
    # Longer than what the run has behind the change: it is explained when the run has been identified.
    options = ("mismatch_on_change:=true", "mismatch_window_s:=25", f"model:={model}", f"result_directory:={out}")
    node = graph.identifier(*options, *QUICK)
    graph.tell(f"run 1 {tmp_path / 'step.mcap'}")
    graph.wait_for(graph.said("identifier: identification", "of the fit itself"), "the identification")
    assert "at elbow changed by +0.5" in graph.statuses["identifier: tracking"].message
    assert graph.values("identifier: identification")["model_in_use"] == str(kept)
    assert f"residual and tracking stay those of {kept}; {model} is the arm of this run" in output(node)
    assert load_model(kept).parameters.tolist() == small_arm.identified().parameters.tolist()
    assert load_model(model).parameters.tolist() != small_arm.identified().parameters.tolist()
    assert graph.latched_parameters()["f_c[elbow]"]["value"] == "1.5"

    graph.tell(f"play {tmp_path / 'later.mcap'}")
    graph.wait_for(graph.said("identifier: mismatch", "friction_drift at elbow"), "the explanation of the change")
    assert graph.values("identifier: mismatch")["reference"] == str(kept) and (out / "change" / "report.html").is_file()
    graph.must("/identifier/identify")
    graph.wait_for(lambda: "residual and tracking are those of the model now in" in output(node), "the other model")
    graph.wait_for(lambda: float(graph.latched_parameters()["f_c[elbow]"]["value"]) > 1.6, "its parameters")
    assert "at elbow changed by +0.5" in graph.statuses["identifier: tracking"].message
    assert end(node) == 0 and "Traceback" not in output(node)
