"""`spacearm check`: what is sound passes, and each thing that is not is named with what to do about it."""

from __future__ import annotations

import json
import os
import re
import threading
from pathlib import Path

import can
import pytest
import yaml

from spacearm_ident.canbus.local_bus import LocalBus
from spacearm_ident.cli.main import main
from spacearm_ident.commissioning import can_check, machine_check
from spacearm_ident.commissioning.arm_check import check_arm
from spacearm_ident.commissioning.can_check import check_can
from spacearm_ident.commissioning.machine_check import check_machine
from spacearm_ident.commissioning.params_check import check_params, declared_parameters
from spacearm_ident.commissioning.result import CheckResult, Level
from spacearm_ident.driver import arm_can
from spacearm_ident.nodes.main import NODES

CONFIG = Path(__file__).parent.parent / "config"
ARM, CAN, PARAMS = (CONFIG / name for name in ("paper_arm.yaml", "paper_arm_can.yaml", "spacearm.yaml"))


@pytest.fixture(autouse=True)
def quickly(tmp_path_factory, monkeypatch):
    """Buses of the test's own, and no longer a look at buses and clock than it takes to say anything."""
    monkeypatch.setenv("SPACEARM_RUNTIME_DIR", str(tmp_path_factory.mktemp("bus")))
    monkeypatch.setattr(can_check, "LISTEN_S", 0.01)
    monkeypatch.setattr(machine_check, "SLOTS", 10)


def found(results: list[CheckResult], level: Level) -> list[str]:
    return [f"{r.subject}: {r.message}" for r in results if r.level is level]


def edited(source: Path, folder: Path, edit) -> Path:
    """A copy of a configuration whose data `edit` has changed; what it names is still found."""
    data = yaml.safe_load(source.read_text())
    for key, directory in (("urdf", CONFIG), ("arm", CONFIG)):
        if key in data:
            data[key] = str(directory / data[key])
    if "eds" in data:
        (folder / data["eds"]).write_bytes((CONFIG / data["eds"]).read_bytes())
    edit(data)
    path = folder / source.name
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    return path


def test_our_own_configuration_is_sound(capsys):
    assert main(["check", str(ARM), "--can", str(CAN), "--params", str(PARAMS), "--json"]) == 0
    results = json.loads(capsys.readouterr().out)
    assert not [result for result in results if result["level"] == "fail"]
    assert {"Python", "arm file", "CAN file", "EDS", "bus 1 load", "bus 0", "parameters", "disk", "real time"} <= {
        result["subject"] for result in results
    }
    own = [*check_arm(ARM), *check_can(CAN, ARM), *check_params(PARAMS)]
    assert {result.level for result in own} == {Level.OK}


def test_counts_come_first_then_the_next_step_then_a_line_each(tmp_path, capsys):
    main(["new-arm", str(CONFIG / "paper_arm.urdf"), "--interface", "socketcan", "--out", str(tmp_path)])
    capsys.readouterr()
    assert main(["check", str(tmp_path)]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert all(re.match(r"(ok|warn|fail) ", line) for line in lines[2:])
    counts = [sum(line.startswith(f"{level} ") for line in lines[2:]) for level in ("ok", "warn", "fail")]
    assert lines[0] == f"{counts[0]} ok, {counts[1]} warn, {counts[2]} fail" and lines[1].startswith("next: apply")
    empty = [line for line in lines if "still empty" in line]
    assert len(empty) == 2 and "gear_ratio of every joint" in empty[0] and str(tmp_path / "arm.yaml") in empty[0]


def test_a_file_that_is_not_there_is_a_mistake_of_usage(tmp_path, capsys):
    for words in (["nowhere.yaml"], ["--can", "nowhere.yaml"], [str(tmp_path)]):
        assert main(["check", *words]) == 2
        assert "there is no file" in capsys.readouterr().err


# --- the arm ----------------------------------------------------------------------------------------------------


def joint(data, **keys):
    data["joints"]["joint_2"] |= keys


@pytest.mark.parametrize(
    "edit, level, said",
    [
        (lambda d: joint(d, gear_ratio=None), Level.WARN, "gear_ratio of joint_2"),
        (lambda d: joint(d, gear_ratio=0), Level.FAIL, "gears: gear ratio or torque constant of joint_2"),
        (lambda d: joint(d, gear_ratio=16000), Level.WARN, "gears: gear ratio of joint_2"),
        (lambda d: joint(d, velocity_limit_rad_s=57), Level.WARN, "limits: joint_2 may move faster"),
        (lambda d: joint(d, velocity_limit_rad_s=-1), Level.FAIL, "limits: of joint_2"),
        (lambda d: joint(d, position_lower_rad=2, position_upper_rad=1), Level.FAIL, "limits: of joint_2"),
        (lambda d: joint(d, position_upper_rad=float("inf")), Level.WARN, "limits: no position limits of joint_2"),
        (lambda d: joint(d, torque_limit_Nm=float("inf")), Level.WARN, "limits: no effort limit of joint_2"),
        (lambda d: joint(d, torque_limit_Nm=20), Level.WARN, "holding torque: gravity takes up to"),
        (lambda d: d.update(gravity_m_s2=[0, 0, -981]), Level.WARN, "gravity: [0, 0, -981]"),
        (
            lambda d: d.update(couplings=[{"name": "m", "ratios": {"joint_5": 1, "joint_6": 0}}]),
            Level.FAIL,
            "couplings",
        ),
        (lambda d: d.update(urdf="nowhere.urdf"), Level.FAIL, "arm file: "),
        (lambda d: d.update(color="red"), Level.FAIL, "arm file: "),
    ],
)
def test_what_is_wrong_with_an_arm_is_named(tmp_path, edit, level, said):
    results = check_arm(edited(ARM, tmp_path, edit))
    assert any(said in line for line in found(results, level)), results
    assert all(result.advice for result in results if result.level is not Level.OK)


@pytest.mark.parametrize("limit, warned", [(160.0, True), (12.0, False), (1e10, False)])
def test_position_limits_that_look_like_degrees_are_warned_of(limit, warned, tmp_path, capsys):
    text = re.sub(r'upper="[\d.]+"', f'upper="{limit}"', (CONFIG / "paper_arm.urdf").read_text())
    path = tmp_path / "arm.urdf"
    path.write_text(text)
    assert any("are the position limits in degrees" in result.advice for result in check_arm(path)) == warned
    assert main(["new-arm", str(path), "--out", str(tmp_path / "arm")]) == 0
    assert ("limits in degrees?" in capsys.readouterr().out) == warned


@pytest.mark.parametrize(
    "old, new, level",
    [
        ('<mass value="5.2760"/>', '<mass value="-5.2760"/>', Level.FAIL),
        ('ixx="0.016461"', 'ixx="1.6461"', Level.FAIL),
        ('<mass value="5.2760"/>', '<mass value="0"/>', Level.WARN),
    ],
)
def test_bodies_that_cannot_be_are_named(tmp_path, old, new, level):
    text = (CONFIG / "paper_arm.urdf").read_text()
    assert old in text
    text = text.replace(old, new)
    if level is Level.WARN:
        text = re.sub(
            r'(<mass value="0"/>\s*)<inertia [^>]*>',
            r'\1<inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/>',
            text,
        )
    path = tmp_path / "arm.urdf"
    path.write_text(text)
    results = check_arm(path)
    lines = [line for line in found(results, level) if line.startswith("inertials")]
    assert len(lines) == 1 and "joint_1" in lines[0] and "joint_2" not in lines[0]
    # Of links that no body can be no torque is told: it was 1e33 per cent of the limit where masses cancelled.
    assert any(result.subject == "holding torque" for result in results) == (level is Level.WARN)


# --- drives and buses -------------------------------------------------------------------------------------------


def cycle(data, **keys):
    data["cycle"] |= keys


@pytest.mark.parametrize(
    "edit, level, said",
    [
        (lambda d: joint(d, rated_current_A=None), Level.FAIL, "rated_current_A of joint_2"),
        (lambda d: joint(d, rated_current_A=6000), Level.WARN, "torque scale: "),
        (lambda d: joint(d, velocity_limit_rad_s=9), Level.WARN, "CAN and arm: limits of joint_2 are wider"),
        (lambda d: cycle(d, heartbeat_s=0.002), Level.WARN, "bus 0 load: "),
        (lambda d: cycle(d, period_s=0.0005), Level.FAIL, "CAN file: bus 0 with 3 axes at 2000 Hz"),
        (lambda d: d["buses"][1].update(interface="nosuch"), Level.FAIL, "bus 1: CAN interface 'nosuch'"),
        (lambda d: d["joints"].pop("joint_2"), Level.FAIL, "CAN file: "),
        (lambda d: d.update(eds="nowhere.eds"), Level.FAIL, "EDS: there is no EDS 'nowhere.eds'"),
    ],
)
def test_what_is_wrong_with_a_can_configuration_is_named(tmp_path, edit, level, said):
    results = check_can(edited(CAN, tmp_path, edit), ARM)
    assert any(said in line for line in found(results, level)), results
    assert all(result.advice for result in results if result.level is not Level.OK)


def section(text: str, name: str) -> tuple[int, int]:
    start = text.index(f"[{name}]\n")
    end = text.find("\n[", start)
    return start, len(text) if end < 0 else end


def with_key(text: str, name: str, key: str, value: str) -> str:
    start, end = section(text, name)
    return text[:start] + re.sub(rf"(?m)^{key}=.*$", f"{key}={value}", text[start:end]) + text[end:]


@pytest.mark.parametrize(
    "change, level, said",
    [
        (lambda t: with_key(t, "6077", "PDOMapping", "0"), Level.FAIL, "0x6077:0 in a PDO (PDOMapping=0)"),
        (lambda t: with_key(t, "607A", "DataType", "0x0003"), Level.FAIL, "0x607A:0 in a PDO (16 bits, not 32)"),
        (lambda t: with_key(t, "1A00sub1", "AccessType", "ro"), Level.FAIL, "0x1A00:1 (ro)"),
        (lambda t: with_key(t, "6060", "DataType", "0x0003"), Level.FAIL, "0x6060:0 (16 bits, not 8)"),
        (lambda t: with_key(t, "1000", "DefaultValue", "0x00000191"), Level.FAIL, "of a CiA 401 device"),
        (lambda t: t.replace("[6065]", "[5065]").replace("=0x6065", "=0x5065"), Level.WARN, "0x6065:0 (missing)"),
        (lambda t: with_key(t, "6502", "DefaultValue", "3"), Level.WARN, "does not list mode 8"),
        (lambda t: t[:3000] + "[1018]\nrubbish", Level.FAIL, "EDS: "),
    ],
)
def test_what_a_data_sheet_lacks_is_named(tmp_path, change, level, said):
    path = edited(CAN, tmp_path, lambda data: None)
    eds = tmp_path / "spacearm_drive.eds"
    before = eds.read_text()
    eds.write_text(change(before))
    assert eds.read_text() != before
    results = [result for result in check_can(path) if result.subject == "EDS"]
    assert any(said in line for line in found(results, level)), results


def test_without_a_data_sheet_of_ones_own_it_is_said(tmp_path):
    path = edited(CAN, tmp_path, lambda data: None)
    (tmp_path / "spacearm_drive.eds").unlink()
    assert any("is not beside the CAN file" in line for line in found(check_can(path), Level.WARN))


def test_a_bus_is_opened_at_the_bit_rates_of_the_file(tmp_path, monkeypatch):
    asked = []

    def opened(interface, channel, **options):
        asked.append(options)
        return LocalBus(channel)

    monkeypatch.setattr(arm_can, "open_bus", opened)
    path = edited(CAN, tmp_path, lambda data: data.update(bitrate=500_000, data_bitrate=2_000_000))
    check_can(path)
    assert asked and all(one == {"bitrate": 500_000, "fd": True, "data_bitrate": 2_000_000} for one in asked)


def test_who_is_on_a_bus_is_heard(monkeypatch):
    monkeypatch.setattr(can_check, "LISTEN_S", 0.5)

    def talk(stop: threading.Event) -> None:
        with LocalBus("arm0") as drives, LocalBus("arm1") as master:
            while not stop.wait(0.005):
                for bus, can_id in ((drives, 0x703), (drives, 0x701), (master, 0x77F)):
                    try:
                        bus.send(can.Message(arbitration_id=can_id, data=b"\5", is_extended_id=False))
                    except can.CanError:  # nobody listens yet
                        continue

    stop = threading.Event()
    thread = threading.Thread(target=talk, args=(stop,))
    thread.start()
    try:
        results = check_can(CAN)
    finally:
        stop.set()
        thread.join()
    assert any("found nodes 1, 3" in line for line in found(results, Level.OK)), results
    assert any("bus 1: " in line and "another master" in line for line in found(results, Level.WARN)), results


# --- parameters of the nodes, machine ---------------------------------------------------------------------------


def params(folder: Path, text: str) -> list[CheckResult]:
    path = folder / "params.yaml"
    path.write_text(text)
    return check_params(path)


@pytest.mark.parametrize(
    "text, level, said",
    [
        ("recorder: {ros__parameters: {directry: x}}", Level.FAIL, "recorder has no parameter 'directry'"),
        ("recoder: {ros__parameters: {}}", Level.FAIL, "there is no node 'recoder'"),
        ("recorder: {directory: x}", Level.FAIL, "recorder has no 'ros__parameters:'"),
        ("trajectory: {ros__parameters: {arm: /no/where.yaml}}", Level.WARN, "there is no /no/where.yaml"),
        (
            f"{{trajectory: {{ros__parameters: {{arm: {CONFIG / 'paper_arm.urdf'}}}}}, "
            f"canopen_driver: {{ros__parameters: {{can_config: {CAN}}}}}}}",
            Level.FAIL,
            "configured for different arms",
        ),
        ("/**: {ros__parameters: {buffer_mb: 8, use_sim_time: false}}", Level.OK, "every parameter exists"),
        (
            "/right/recorder: {ros__parameters: {buffer_mb: 8}}",
            Level.OK,
            "/right/recorder: every parameter exists; for the namespace /right alone",
        ),
        ("/recorder: {ros__parameters: {}}", Level.OK, "exists; for nodes outside any namespace alone"),
        ("recorder: {ros__parameters: {}}", Level.OK, "recorder: every parameter exists; for any namespace"),
        ("/**: {ros__parameters: {bufer_mb: 8}}", Level.FAIL, "** has no parameter 'bufer_mb'"),
        ("/arm_1/recorder: {ros__parameters: {directry: x}}", Level.FAIL, "recorder has no parameter 'directry'"),
        (
            f"{{/a/identifier: {{ros__parameters: {{arm: {CONFIG / 'paper_arm.urdf'}}}}}, "
            f"/b/identifier: {{ros__parameters: {{arm: {ARM}}}}}}}",
            Level.OK,
            "every parameter exists",
        ),
        ("trajectory: {ros__parameters: {rate_hz: fast}}", Level.FAIL, "rate_hz: 'fast' is not a number"),
        ("/b/trajectory: {ros__parameters: {rate_hz: 5}}", Level.FAIL, "rate_hz: 5 is not from 10 to 5000"),
        ("trajectory: {ros__parameters: {path_tolerance: -1}}", Level.FAIL, "-1 is not from 0.001 to 3.2"),
        ("trajectory: {ros__parameters: {enabled_from: controller}}", Level.FAIL, "'controller' is not a list"),
        ("trajectory: {ros__parameters: {arm: 5}}", Level.FAIL, "arm: 5 is not a text"),
        ("identifier: {ros__parameters: {model: 5}}", Level.FAIL, "model: 5 is not a text"),
        ("recorder: {ros__parameters: {start_immediately: 1}}", Level.FAIL, "1 is not true or false"),
        ("recorder: {ros__parameters: {buffer_mb: 8.0}}", Level.FAIL, "8.0 is not a whole number"),
        ("identifier: {ros__parameters: {friction: papr}}", Level.FAIL, "friction: no 'papr': one of auto, "),
        ("identifier: {ros__parameters: {friction: ''}}", Level.FAIL, "friction: no '': one of auto, "),
        ("identifier: {ros__parameters: {friction: 5}}", Level.FAIL, "friction: 5 is not a text"),
        ("identifier: {ros__parameters: {solver: magic}}", Level.FAIL, "solver: no 'magic': one of separable, "),
        ("/**: {ros__parameters: {temperature: 'f_c, k'}}", Level.FAIL, "temperature: no 'k': one of f_c, "),
        ("/a/identifier: {ros__parameters: {estimate_gravity: up}}", Level.FAIL, "no 'up': one of vector, "),
        ("trajectory: {ros__parameters: {output: topic}}", Level.FAIL, "output: no 'topic': one of joint_command, "),
        ("trajectory: {ros__parameters: {enabled_from: [driver, me]}}", Level.FAIL, "no 'me': one of driver, "),
        ("trajectory: {ros__parameters: {enabled_from: []}}", Level.FAIL, "no '': one of driver, "),
        (
            "identifier: {ros__parameters: {friction: $(var law), temperature: 'f_c, k_v1,', estimate_gravity: ''}}",
            Level.OK,
            "every parameter exists",
        ),
        ("trajectory: {ros__parameters: {enabled_from: [topic, driver]}}", Level.OK, "every parameter exists"),
        ("/**: {ros__parameters: {noise: loud}}", Level.FAIL, "noise: 'loud' is not a number"),
        # A whole number does for a number, an exponent without a point is a text to YAML 1.1, a launch file fills in.
        (
            "trajectory: {ros__parameters: {rate_hz: 500, path_tolerance: 1e-2, feedback_timeout_s: $(var late)}}",
            Level.OK,
            "every parameter exists",
        ),
        ("[a, list]", Level.FAIL, "holds no 'key: value' pairs"),
    ],
)
def test_what_is_wrong_with_parameters_is_named(tmp_path, text, level, said):
    assert any(said in line for line in found(params(tmp_path, text), level))


def test_every_parameter_a_node_declares_is_known():
    folder = CONFIG.parent / "spacearm_ident" / "nodes"
    for node in NODES:
        source = "".join(path.read_text() for path in folder.glob(f"{node}*.py"))
        assert declared_parameters(node).keys() == set(re.findall(r'parameter\(\s*"(\w+)"', source))


NO_INPUT = {"controller", "controller_manager", "enabled_topic", "output_topic", "directory"}
"""Text parameters that name no file to read."""


def test_a_file_that_does_not_exist_is_named_for_every_parameter_that_reads_one(tmp_path):
    for node in NODES:
        declared = declared_parameters(node).items()
        texts = {name for name, one in declared if one.kind is str and not one.several and one.choices is None}
        for name in texts - NO_INPUT:
            results = params(tmp_path, f"{node}: {{ros__parameters: {{{name}: /no/where.yaml}}}}")
            assert any("there is no /no/where.yaml" in line for line in found(results, Level.WARN)), (node, name)
            results = params(tmp_path, f"{node}: {{ros__parameters: {{{name}: $(var file)}}}}")
            assert not found(results, Level.WARN), (node, name)


@pytest.mark.parametrize(
    "environment, level, said",
    [
        ({"ROS_DOMAIN_ID": "300"}, Level.FAIL, "ROS_DOMAIN_ID='300'"),
        ({"ROS_LOCALHOST_ONLY": "1"}, Level.WARN, "ROS_LOCALHOST_ONLY is set"),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"}, Level.WARN, "nodes do not find each other"),
        ({"ROS_DISTRO": "foxy"}, Level.WARN, "foxy is sourced"),
        ({"ROS_DOMAIN_ID": "7"}, Level.OK, "domain 7"),
    ],
)
def test_the_ros_environment(tmp_path, environment, level, said):
    pytest.importorskip("rclpy")
    assert any(said in line for line in found(check_machine(tmp_path, environment), level))


def test_a_machine_without_ros_or_a_package_or_room_is_told_what_to_do(tmp_path, monkeypatch):
    import importlib.util
    import shutil
    from collections import namedtuple

    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name in ("rclpy", "clarabel") else find(name))
    monkeypatch.setattr(shutil, "disk_usage", lambda path: namedtuple("Usage", "free")(1 << 20))
    results = check_machine(tmp_path / "not" / "made", os.environ)
    assert any("packages: missing: clarabel" in line for line in found(results, Level.FAIL))
    assert any("ROS 2: missing: rclpy" in line for line in found(results, Level.WARN))
    assert any(line.startswith(f"disk: 1 MiB free at {tmp_path}") for line in found(results, Level.WARN))


def test_every_package_that_is_required_is_looked_for():
    required = re.search(r"install_requires=\[(.*?)\]", (CONFIG.parent / "setup.py").read_text(), re.S)
    assert set(re.findall(r'"(\S+)"', required[1])) - {"setuptools"} == set(machine_check.PACKAGES.values())
