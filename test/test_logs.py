"""Logs of any format become recordings by a mapping that is proposed, or asked for in one line."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import small_arm
import yaml
from made_result import Page
from planted_arm import Link, urdf_of
from scipy.io import savemat

from spacearm_ident.cli.main import main
from spacearm_ident.dynamics.arm import load_arm
from spacearm_ident.dynamics.effects import EFFECTS
from spacearm_ident.dynamics.regressor import rigid_body_torque
from spacearm_ident.errors import UnfitDataError, UserError
from spacearm_ident.identification.effort import in_newton_metres
from spacearm_ident.logs.propose import propose
from spacearm_ident.logs.read import propose_for, read_log, recording_by
from spacearm_ident.logs.search import Proposal
from spacearm_ident.logs.words import meaning_of
from spacearm_ident.recording import Recording, read_recording, write_recording
from spacearm_ident.recording.log_mapping import UNITS, LogMapping, mapping_beside, read_mapping, save_mapping
from spacearm_ident.recording.tables import read_table

UR10E = Path(__file__).parents[2] / "shared" / "recordings" / "real" / "ur10e" / "commissioning.mcap"
CONSTANTS = np.array([14.0, 13.5, 11.0, 9.2, 9.1, 9.3])
"""N m for each A, of this test alone: what the recording's publishers took does not matter here."""
RUN = small_arm.recording(8.0)
HEAD = ["t", "q1", "q2", "tau1", "tau2"]


@pytest.fixture(scope="module")
def ur10e() -> Recording:
    if not UR10E.exists():
        pytest.skip("no ur10e/commissioning.mcap in ../shared/recordings/real")
    run = read_recording(UR10E).between(0.0, 40.0)
    return replace(run, command=None, temperatures={})


def arm_file(folder: Path, urdf: str, constants: dict[str, float] | None = None) -> Path:
    """An arm YAML that declares effort in A, or the URDF alone."""
    (folder / "arm.urdf").write_text(urdf, encoding="utf-8")
    if constants is None:
        return folder / "arm.urdf"
    data = {"schema": "spacearm_ident/arm/1", "urdf": "arm.urdf", "effort": {"unit": "A", "constants": constants}}
    (folder / "arm.yaml").write_text(yaml.safe_dump(data))
    return folder / "arm.yaml"


@pytest.fixture
def arm(tmp_path) -> Path:
    """The small arm's URDF."""
    return arm_file(tmp_path, small_arm.URDF)


def german_csv(run: Recording, path: Path, constants: np.ndarray) -> None:
    """Degrees and milliamperes, decimal commas, as a German spreadsheet has them."""
    n = range(1, len(run.joints) + 1)
    head = ["Zeit [ms]", *(f"Gelenk {k} Winkel [Grad]" for k in n), *(f"Gelenk {k} Drehzahl [Grad/s]" for k in n)]
    head += [f"Gelenk {k} Motorstrom [mA]" for k in n]
    rows = np.column_stack(
        [run.time * 1e3, np.degrees(run.position), np.degrees(run.velocity), run.effort / constants * 1e3]
    )
    lines = [";".join(repr(float(cell)).replace(".", ",") for cell in row) for row in rows]
    path.write_text("\n".join([";".join(head), *lines, ""]), encoding="cp1252")


def write_mat(run: Recording, path: Path) -> None:
    """The signals in a struct, time along the second dimension."""
    log = {"t": run.time, "q": run.position.T, "dq": run.velocity.T, "tau": run.effort.T}
    savemat(path, {"log": log, "comment": "made by a test"})


def write_npz(run: Recording, path: Path) -> None:
    stamps = run.start_ns + np.rint(run.time * 1e9).astype(np.int64)
    np.savez(path, timestamp_ns=stamps, joint_angle_deg=np.degrees(run.position), joint_torque_Nm=run.effort)


def write_hdf5(run: Recording, path: Path) -> None:
    h5py = pytest.importorskip("h5py", reason="needs h5py")
    with h5py.File(path, "w") as file:
        group = file.create_group("robot")
        group["time"] = run.time
        group["actual_q"], group["actual_qd"], group["actual_torque"] = run.position, run.velocity, run.effort
        group["target_q"] = run.position + 0.001


def write_lerobot(run: Recording, folder: Path) -> None:
    """Version 2: an episode a file; states by joint, named as LeRobot names them."""
    arrow = pytest.importorskip("pyarrow", reason="needs pyarrow")
    from pyarrow import parquet

    names = [name.removesuffix("_joint") for name in run.joints]
    features = {
        "observation.state": {"dtype": "float64", "names": [f"{name}.pos" for name in names]},
        "observation.effort": {"dtype": "float64", "names": [f"{name}.effort" for name in names]},
    }
    (folder / "meta").mkdir(parents=True)
    (folder / "data" / "chunk-000").mkdir(parents=True)
    rate = 1.0 / np.median(np.diff(run.time))
    (folder / "meta" / "info.json").write_text(json.dumps({"fps": rate, "features": features}))
    half = len(run.time) // 2
    for episode, part in enumerate((slice(0, half), slice(half, 2 * half))):
        columns = {
            "observation.state": list(run.position[part]),
            "observation.effort": list(run.effort[part]),
            "frame_index": np.arange(half),
            "episode_index": np.full(half, episode),
            "timestamp": (np.arange(half) / rate).astype(np.float32),
        }
        parquet.write_table(arrow.table(columns), folder / "data" / "chunk-000" / f"episode_{episode:06d}.parquet")


def same_samples(got: Recording, run: Recording) -> None:
    assert got.joints == run.joints
    assert np.abs(got.time - run.time).max() < 2e-9
    for one, other in ((got.position, run.position), (got.effort, run.effort)):
        assert np.abs(one - other).max() < 1e-9 * (1.0 + np.abs(other).max())
    assert got.segments == run.segments


def test_german_csv_in_degrees_and_milliamperes_gives_the_samples_of_the_bag(ur10e, tmp_path):
    arm = arm_file(tmp_path, ur10e.urdf, dict(zip(ur10e.joints, CONSTANTS.tolist())))
    german_csv(ur10e, tmp_path / "lauf.csv", CONSTANTS)
    got = read_log(tmp_path / "lauf.csv", arm)
    assert got.mapping.units == {"position": "deg", "velocity": "deg/s", "effort": "mA"}
    (run,) = in_newton_metres([got.recording], load_arm(arm))
    same_samples(run, ur10e)
    assert np.abs(run.velocity - ur10e.velocity).max() < 1e-9


@pytest.mark.parametrize("write", [write_mat, write_npz, write_hdf5], ids=[".mat", ".npz", ".h5"])
def test_logs_of_arrays_give_the_samples_of_the_bag(ur10e, tmp_path, write, request):
    path = tmp_path / f"run{request.node.callspec.id}"
    write(ur10e, path)
    same_samples(read_log(path, arm_file(tmp_path, ur10e.urdf)).recording, ur10e)


def test_lerobot_episodes_follow_each_other_with_a_pause(ur10e, tmp_path):
    write_lerobot(ur10e, tmp_path / "set")
    got = read_log(tmp_path / "set", arm_file(tmp_path, ur10e.urdf)).recording
    half = len(ur10e.time) // 2
    assert got.segments == (slice(0, half), slice(half, 2 * half))
    assert np.array_equal(got.position, ur10e.position[: 2 * half])
    assert np.array_equal(got.effort, ur10e.effort[: 2 * half])
    steps = np.diff(got.time[:half])
    assert np.ptp(steps) < 3e-9


def test_a_log_and_its_bag_identify_the_same_parameters(tmp_path, arm):
    """Through the command line: CSV with the mapping that `import` wrote, and the bag that it wrote."""
    pytest.importorskip("clarabel", reason="needs clarabel")
    run = small_arm.recording(12.0)
    german_csv(run, tmp_path / "lauf.csv", np.ones(2))
    constants = ["--constants", "shoulder=1", "elbow=1"]
    log, bag = str(tmp_path / "lauf.csv"), str(tmp_path / "lauf.mcap")
    assert main(["import", log, "--arm", str(arm), "--out", bag, *constants]) == 0
    write_recording(tmp_path / "run.mcap", run)
    found = {}
    for name, path in (("log", log), ("bag", bag), ("itself", str(tmp_path / "run.mcap"))):
        assert main(["identify", path, "--quiet", "--friction", "coulomb-viscous", "--out", str(tmp_path / name)]) == 0
        found[name] = yaml.safe_load((tmp_path / name / "model.yaml").read_text())["terms"]
    for term, *others in zip(found["itself"], found["log"], found["bag"], strict=True):
        for symbol, by_joint in term["values"].items():
            for joint, value in by_joint.items():
                for other in others:
                    assert other["values"][symbol][joint] == pytest.approx(value, rel=1e-6, abs=1e-6)


# --- what is decided, and what is asked ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "quantity", "unit", "number"),
    [
        ("actual_q_0", "position", None, 0),
        ("actual_current_5", "current", None, 5),
        ("tau_J[2]", "torque", None, 2),
        ("AxisTorqueAct_A3", "torque", None, 3),
        ("Gelenk 3 Winkelgeschwindigkeit [°/s]", "velocity", "deg/s", 3),
        ("关节1位置", "position", None, 1),
        ("скорость 2 (rad/s)", "velocity", "rad/s", 2),
        ("momento_articulacion_1", "torque", None, 1),
        ("Achse1_Strom_mA", "current", "mA", 1),
        ("current_position_1", "position", None, 1),
        ("joint1_vel_deg_s", "velocity", "deg/s", 1),
        ("time_ms", "time", "ms", None),
        ("tcp_pose_3", "other", None, 3),
        ("actual_qd_3", "velocity", None, 3),
        ("actual_TCP_pose_0", "other", None, 0),
        ("dq[6]", "velocity", None, 6),
        ("O_T_EE[3]", "other", None, 3),
        ("dtau_J[3]", "other", None, 3),
        ("tau_ext_hat_filtered[0]", "other", None, 0),
        ("AIPos.A1", "position", None, 1),
        ("MACur.A1", "current", None, 1),
        ("$AXIS_ACT.A1", "position", None, 1),
        ("$TORQUE_AXIS_ACT[1]", "torque", None, 1),
        ("$VEL_AXIS_ACT[1]", "velocity", None, 1),
        ("measuredJointPosition_0", "position", None, 0),
        ("externalTorque_2", "other", None, 2),
        ("IPOC", "time", None, None),
        ("torque_percent_1", "torque", "percent", 1),
        ("torque_actual_permille_2", "torque", "permille", 2),
        ("motor_torque_percent[3]", "torque", "percent", 3),
        ("q_rad_4", "position", "rad", 4),
        ("qd_deg_s[5]", "velocity", "deg/s", 5),
        ("velocity joint_3 [m/s]", "velocity", "rad/s", 3),
        ("theta_m_2", "position", None, 2),
    ],
)
def test_names_of_columns_say_quantity_unit_and_joint(name, quantity, unit, number):
    meaning = meaning_of(name)
    assert (meaning.quantity, meaning.unit, meaning.number) == (quantity, unit, number)


@pytest.mark.parametrize("name", ["target_q_0", "q_d[1]", "tau_J_d[2]", "ASPos.A1", "commandedJointPosition_1"])
def test_set_points_of_known_controllers_say_so(name):
    assert meaning_of(name).commanded


def test_log_that_does_not_exist_is_called_so_whatever_else_is_missing(tmp_path, capsys):
    assert main(["identify", str(tmp_path / "nope.csv"), "--out", str(tmp_path / "result")]) == 2
    assert "no such file" in capsys.readouterr().err
    assert not (tmp_path / "result").exists()


LAYOUTS = {
    "UR RTDE": ("timestamp", "actual_q_{}", "actual_qd_{}", "actual_current_as_torque_{}", 0),
    "Franka": ("time", "q[{}]", "dq[{}]", "tau_J[{}]", 0),
    "libfranka": ("time", "state.q[{}]", "state.dq[{}]", "state.tau_J[{}]", 0),
    "KUKA trace": ("time", "$AXIS_ACT[{}]", "$VEL_AXIS_ACT[{}]", "$TORQUE_AXIS_ACT[{}]", 1),
    "KUKA FRI": ("time", "measuredJointPosition_{}", "jointVelocity_{}", "measuredTorque_{}", 0),
}


@pytest.mark.parametrize("maker", LAYOUTS)
def test_log_of_a_known_controller_needs_no_answer(tmp_path, maker):
    time, *kinds, first = LAYOUTS[maker]
    head = [time, *(kind.format(first + k) for kind in kinds for k in range(2))]
    distractor = {
        "Franka": ["O_T_EE[3]", "tau_J_d[0]"],
        "UR RTDE": ["actual_TCP_pose_0", "target_q_0"],
        # As `franka::logToCSV` writes them: set-points and estimates of every joint beside what was measured.
        "libfranka": [
            f"{name}[{k}]"
            for name in ("state.q_d", "state.dq_d", "state.tau_ext_hat_filtered", "cmd.q_d", "cmd.dq_d", "cmd.tau_J_d")
            for k in range(2)
        ],
    }
    extra = distractor.get(maker, [])
    columns = [RUN.time, RUN.position, RUN.velocity, RUN.effort, *(0.1 * RUN.time for _ in extra)]
    found = proposal(tmp_path, [*head, *extra], *columns)
    assert not found.questions
    names = [kind.format(first + 1) for kind in kinds]
    command = {"command": "state.q_d[1]"} if maker == "libfranka" else {}
    assert found.mapping.columns["elbow"] == dict(zip(("position", "velocity", "effort"), names)) | command


def asks(found: Proposal, *words: str) -> bool:
    """Whether nothing is proposed and one of the questions has these words."""
    return found.mapping is None and any(all(word in question for word in words) for question in found.questions)


def csv_of(folder: Path, head: list[str], *columns: np.ndarray) -> Path:
    path = folder / "log.csv"
    rows = np.column_stack(columns)
    lines = ["\t".join(f"{cell:.12g}" for cell in row) for row in rows]
    path.write_text("\n".join([*(["\t".join(head)] if head else []), *lines]))
    return path


def proposal(folder: Path, head: list[str], *columns: np.ndarray, **answers: str):
    return propose_for(csv_of(folder, head, *columns), arm_file(folder, small_arm.URDF), answers)[1]


def test_columns_without_names_are_told_by_derivative_and_weight(tmp_path):
    found = proposal(tmp_path, [], RUN.time, RUN.effort, np.degrees(RUN.velocity), np.degrees(RUN.position))
    assert not found.questions
    assert found.mapping.columns["elbow"] == {
        "position": "column 7",
        "velocity": "column 5",
        "effort": "column 3",
    }
    assert found.mapping.units == {"position": "deg", "velocity": "deg/s", "effort": "N m"}


def test_columns_of_joints_that_slide_and_turn_are_one_signal_whatever_their_units_are_written(tmp_path):
    """As a SCARA's recorder writes them; in a mapping rad stands for m of a joint that slides."""
    urdf = urdf_of([Link("lift", "prismatic", axis=(0, 0, 1)), Link("arm", parent="lift", axis=(0, 0, 1))])
    motion = [RUN.time, 0.1 * RUN.position[:, :1], RUN.position[:, 1:], RUN.effort]
    log = csv_of(tmp_path, ["t [s]", "q lift [m]", "q arm [rad]", "tau lift [N]", "tau arm [Nm]"], *motion)
    found = propose_for(log, arm_file(tmp_path, urdf), {})[1]
    assert not found.questions
    assert found.mapping.columns["lift"] == {"position": "q lift [m]", "effort": "tau lift [N]"}
    assert found.mapping.units == {"position": "rad", "effort": "N m"}


def weight(folder: Path, position: np.ndarray) -> np.ndarray:
    """What gravity asks of the small arm's motors."""
    arm = load_arm(arm_file(folder, small_arm.URDF))
    still = np.zeros_like(position)
    return rigid_body_torque(arm, np.array([joint.inertial for joint in arm.joints]), position, still, still)


def test_positions_within_the_limits_in_either_unit_are_told_by_weight(tmp_path):
    """One rad and one degree are both within limits of 3 rad."""
    found = proposal(tmp_path, HEAD, RUN.time, RUN.position, weight(tmp_path, RUN.position))
    assert found.mapping.units["position"] == "rad"
    assert "weight" in found.rows[1].because


def test_units_are_told_by_weight_where_every_other_row_is_empty(tmp_path):
    """As in a log of two topics, whose rows are the stamps of either: no row of the positions has a neighbour."""
    position, effort = RUN.position.copy(), weight(tmp_path, RUN.position)
    position[1::2], effort[1::2] = np.nan, np.nan
    found = proposal(tmp_path, HEAD, RUN.time, position, effort)
    assert found.mapping.units["position"] == "rad" and found.mapping.units["effort"] == "N m"


def test_units_are_asked_where_positions_and_effort_share_no_row(tmp_path):
    position, effort = RUN.position.copy(), weight(tmp_path, RUN.position)
    position[1::2], effort[::2] = np.nan, np.nan
    found = proposal(tmp_path, HEAD, RUN.time, position, effort)
    assert asks(found, "effort_unit=")


def test_a_motion_too_small_to_tell_its_unit_is_asked(tmp_path):
    """Over half a degree, beside noise, weight is linear in the angle and as well explained in either unit."""
    small = np.radians(0.2 * RUN.position)
    noise = 0.05 * np.random.default_rng(0).standard_normal(small.shape)
    head = ["t", "q1", "q2", "tau1 [Nm]", "tau2 [Nm]"]
    found = proposal(tmp_path, head, RUN.time, np.degrees(small), weight(tmp_path, small) + noise)
    assert any("position_unit=" in question for question in found.questions)


def test_a_written_unit_beyond_the_limits_is_asked_and_can_be_told(tmp_path):
    head = ["t", "q1_rad", "q2_rad", "tau1", "tau2"]
    found = proposal(tmp_path, head, RUN.time, np.degrees(RUN.position), RUN.effort)
    assert asks(found, "position_unit=")
    told = proposal(tmp_path, head, RUN.time, np.degrees(RUN.position), RUN.effort, position_unit="deg")
    assert told.mapping.units["position"] == "deg"


@pytest.mark.parametrize("unit", ["turn", "mrad"])
def test_every_written_unit_beyond_the_limits_is_asked(unit, tmp_path):
    """As columns of motors are: a hundred times the joints' positions."""
    size = {"turn": 2 * np.pi, "mrad": 1e-3}[unit]
    head = ["t", f"motor1_pos_{unit}", f"motor2_pos_{unit}", "tau1 [Nm]", "tau2 [Nm]"]
    columns = RUN.time, 100.0 * RUN.position / size, RUN.effort
    found = proposal(tmp_path, head, *columns)
    assert asks(found, "position_unit=", "of the motors?")
    assert proposal(tmp_path, head, *columns, position_unit=unit).mapping.units["position"] == unit
    data = {"schema": "spacearm_ident/arm/1", "urdf": "arm.urdf"}
    (tmp_path / "arm.yaml").write_text(
        yaml.safe_dump(data | {"corrections": {"joints": {"all": {"position_scale": 0.01}}}})
    )
    assert propose_for(tmp_path / "log.csv", tmp_path / "arm.yaml", {})[1].mapping is not None


def test_an_unknown_unit_of_effort_is_one_question_that_offers_every_unit(tmp_path):
    noise = 1e6 * np.random.default_rng(0).standard_normal(RUN.effort.shape)
    found = proposal(tmp_path, ["t", "q1_rad", "q2_rad", "tau1", "tau2"], RUN.time, RUN.position, noise)
    (question,) = found.questions
    assert all(unit in question for unit in UNITS["effort"])


def test_what_is_told_and_what_is_left_out_is_said_as_it_is(tmp_path, capsys):
    warm = np.full_like(RUN.position, 30.0)
    head = ["t", "q1", "q2", "tau1 [Nm]", "tau2 [Nm]", "temp_1", "temp_2"]
    found = proposal(tmp_path, head, RUN.time, RUN.position, RUN.effort, warm, position_unit="rad")
    row = next(row for row in found.rows if row.signal == "position")
    assert (row.columns, row.unit) == ("q#", "rad")
    assert found.left_out == ["temp_1, temp_2: no position, velocity or effort, left out"]
    recording = recording_by(read_table(tmp_path / "log.csv"), found.mapping, tmp_path / "arm.urdf", "log")
    assert any("position rad, effort N m" in issue.message for issue in recording.issues)


def test_a_number_of_the_row_is_no_time_and_the_rate_is_asked(tmp_path):
    head = ["sample", "q1", "q2", "tau1", "tau2"]
    columns = np.arange(len(RUN.time)), RUN.position, RUN.effort
    found = proposal(tmp_path, head, *columns)
    assert asks(found, "rate_hz=")
    assert proposal(tmp_path, head, *columns, rate_hz="200").mapping.rate_hz == 200.0


@pytest.mark.parametrize(
    ("names", "key", "size_ns"),
    [
        (("header.stamp.sec", "header.stamp.nanosec"), "nanoseconds", 1),
        (("sec", "nsec"), "nanoseconds", 1),
        (("secs", "nsecs"), "nanoseconds", 1),
        (("timestamp_sec", "timestamp_nanosec"), "nanoseconds", 1),
        (("/joint_states/header/stamp/sec", "/joint_states/header/stamp/nanosec"), "nanoseconds", 1),
        (("stamp [s]", "stamp [ns]"), "nanoseconds", 1),
        (("tv_sec", "tv_usec"), "microseconds", 1000),
        (("seconds", "microseconds"), "microseconds", 1000),
        (("secs", "msecs"), "milliseconds", 1_000_000),
    ],
)
def test_seconds_and_the_rest_of_the_second_in_two_columns_are_one_time(tmp_path, arm, names, key, size_ns):
    stamps = 1_732_958_860_900_000_123 // size_ns * size_ns + np.rint(RUN.time * 1e9).astype(np.int64)
    rest = stamps % 10**9 // size_ns
    log = csv_of(tmp_path, [*names, "q1", "q2", "tau1", "tau2"], stamps // 10**9, rest, RUN.position, RUN.effort)
    got = read_log(log, arm)
    save_mapping(got.mapping, tmp_path / "m.yaml")
    assert yaml.safe_load((tmp_path / "m.yaml").read_text())["time"] == {"column": names[0], "unit": "s", key: names[1]}
    again = read_log(log, arm, tmp_path / "m.yaml").recording
    assert again.start_ns == stamps[0]
    assert np.array_equal(np.rint(again.time * 1e9), stamps - stamps[0])


def test_a_row_without_its_nanoseconds_is_left_out_alone(tmp_path, arm):
    stamps = np.rint(RUN.time * 1e9)
    nanoseconds = np.where(np.arange(len(stamps)) == 50, np.nan, stamps % 1e9)
    head = ["sec", "nsec", "q1", "q2", "tau1", "tau2"]
    log = csv_of(tmp_path, head, stamps // 1e9, nanoseconds, RUN.position, RUN.effort)
    assert len(read_log(log, arm).recording.time) == len(RUN.time) - 1


def test_microseconds_that_go_on_beyond_the_second_are_not_its_rest(tmp_path):
    """A time in two units, each whole: the finer one is the time."""
    head = ["t_sec", "t_usec", "q1", "q2", "tau1", "tau2"]
    found = proposal(tmp_path, head, np.floor(RUN.time), np.rint(RUN.time * 1e6), RUN.position, RUN.effort)
    assert (found.mapping.time, found.mapping.time_unit, found.mapping.fraction) == ("t_usec", "us", None)


@pytest.mark.parametrize("name", ["header.stamp.nanosec", "nsec", "n", "column"])
def test_nanoseconds_that_begin_again_every_second_are_no_time(tmp_path, name):
    head = [name, "q1", "q2", "tau1", "tau2"]
    columns = np.rint(RUN.time * 1e9) % 1e9, RUN.position, RUN.effort
    for answers in ({}, {"time": name}, {"time_unit": "ns"}):
        found = proposal(tmp_path, head, *columns, **answers)
        assert asks(found, "begins again every second")
    assert proposal(tmp_path, head, *columns, rate_hz="200").mapping.rate_hz == 200.0


@pytest.mark.parametrize(
    "time",
    [
        "{column: t, unit: ms, microseconds: n}",
        "{unit: s, nanoseconds: n}",
        "{column: t, nanoseconds: n, microseconds: n}",
    ],
    ids=["not in s", "no seconds", "twice"],
)
def test_nanoseconds_without_whole_seconds_are_no_mapping(tmp_path, time):
    text = f"schema: spacearm_ident/log_mapping/1\ntime: {time}\njoints: {{a: {{position: q, effort: u}}}}\n"
    (tmp_path / "m.yaml").write_text(text)
    with pytest.raises(UserError, match="time"):
        read_mapping(tmp_path / "m.yaml")


def dates_csv(path: Path, dates: list[str]) -> Path:
    rows = np.column_stack([RUN.position, RUN.effort])
    lines = [";".join([date, *(f"{cell:.12g}" for cell in row)]) for date, row in zip(dates, rows, strict=True)]
    path.write_text("\n".join(["datetime;q1;q2;tau1;tau2", *lines]))
    return path


@pytest.mark.parametrize(
    ("form", "ahead_h"),
    [
        ("{day}T{clock}", 0.0),
        ("{day} {clock}", 0.0),
        ("{day}T{clock}Z", 0.0),
        ("{day} {clock}+00:00", 0.0),
        ("{day}T{clock}+01:30", 1.5),
        ("{day}T{clock}-0800", -8.0),
        ('"{day} {clock}"', 0.0),
        ("{year}/{month}/{date} {clock}", 0.0),
        ("{date}.{month}.{year} {clock}", 0.0),
        ("{date}.{month}.{year} {comma}", 0.0),
        ("{date}/{month}/{year} {clock}", 0.0),
        ("{month}/{date}/{year} {clock}", 0.0),
    ],
)
def test_dates_with_times_in_text_are_a_time_of_utc(tmp_path, arm, form, ahead_h):
    stamps = 1_732_958_860_900_000_123 + np.rint(RUN.time * 1e9).astype(np.int64)
    texts = [str(stamp).split("T") for stamp in stamps.astype("datetime64[ns]")]
    year, month, date = texts[0][0].split("-")
    parts = {"year": year, "month": month, "date": date}
    lines = [form.format(day=day, clock=clock, comma=clock.replace(".", ","), **parts) for day, clock in texts]
    log = dates_csv(tmp_path / "log.csv", lines)
    got = read_log(log, arm)
    assert (got.mapping.time, got.mapping.time_unit) == ("datetime", "ns")
    assert got.recording.start_ns == stamps[0] - round(ahead_h * 3600e9)
    assert np.array_equal(np.rint(got.recording.time * 1e9), stamps - stamps[0])
    assert not [issue for issue in got.recording.issues if issue.kind == "cell"]


def test_days_and_months_without_leading_zeros_are_read(tmp_path, arm):
    """Midnight from 9 to 10 December, which with day and month exchanged would be a month."""
    stamps = np.datetime64("2024-12-09T23:59:59.9", "ns").astype(np.int64) + np.rint(RUN.time * 1e9).astype(np.int64)
    texts = [str(stamp).split("T") for stamp in stamps.astype("datetime64[ns]")]
    lines = [f"{int(day[-2:])}.12.2024 {clock.removeprefix('0')}" for day, clock in texts]
    got = read_log(dates_csv(tmp_path / "log.csv", lines), arm).recording
    assert got.start_ns == stamps[0] and np.abs(got.time - RUN.time).max() < 1e-9


@pytest.mark.parametrize(
    ("cell", "why"),
    [
        ("03/04/2026 09:00:{:09.6f}", "may be day/month or month/day"),
        ("03-04-2026 09:00:{:09.6f}", "may be day/month or month/day"),
        ("Fri Apr  3 09:00:{:09.6f} 2026", "is in a format that is not read"),
        ("3.4.26 09:00:{:09.6f}", "is in a format that is not read"),
    ],
)
def test_a_time_that_is_not_read_is_named_with_the_reason_and_what_is_read(tmp_path, arm, cell, why):
    log = dates_csv(tmp_path / "log.csv", [cell.format(t) for t in RUN.time])
    found = propose_for(log, arm)[1]
    assert found.mapping is None
    (question,) = found.questions
    assert "'datetime' looks like a time" in question and repr(cell.format(RUN.time[0])) in question
    assert why in question and "YYYY-MM-DD hh:mm:ss" in question and "--set rate_hz=HZ" in question


@pytest.mark.parametrize("out", ["bag.yaml", "bag.csv", "bag.db3"])
def test_a_bag_is_not_written_under_the_name_of_another_file(tmp_path, arm, out, capsys):
    log = csv_of(tmp_path, HEAD, RUN.time, RUN.position, RUN.effort)
    before = {*tmp_path.iterdir()}
    assert main(["import", str(log), "--arm", str(arm), "--out", str(tmp_path / out)]) == 2
    assert "NAME.mcap" in capsys.readouterr().err
    assert {*tmp_path.iterdir()} == before


def test_text_that_is_no_time_is_not_taken_for_one(tmp_path, arm):
    states = [f"192.168.0.{k % 7}" for k in range(len(RUN.time))]
    assert "no column is a time" in propose_for(dates_csv(tmp_path / "log.csv", states), arm)[1].questions[0]


@pytest.mark.parametrize("mark", [".", ","])
@pytest.mark.parametrize("first_s", [49_502.123, 86_398.0, 3_599.5], ids=["day", "midnight", "1 o'clock"])
def test_a_time_of_the_day_is_a_time_that_goes_on_after_midnight(tmp_path, arm, first_s, mark):
    start = round(first_s * 1e9)
    stamps = start + np.rint(RUN.time * 1e9).astype(np.int64)
    clocks = [str(stamp).split("T")[1][:12].lstrip("0").replace(".", mark) for stamp in stamps.astype("datetime64[ns]")]
    clocks = [f"0{clock}" if clock.startswith(":") else clock for clock in clocks]  # 9:59:59 and 0:00:00
    log = dates_csv(tmp_path / "log.csv", clocks)
    got = read_log(log, arm).recording
    assert got.start_ns == start and len(got.time) == len(RUN.time)
    assert np.abs(got.time - RUN.time).max() < 1e-9
    assert [issue.kind for issue in got.issues] == ["log"]


def test_a_row_whose_date_is_none_is_left_out_and_counted(tmp_path, arm):
    dates = [str(stamp) for stamp in np.rint(RUN.time * 1e9).astype("datetime64[ns]")]
    dates[50] = "1970-13-01T00:00:00"
    got = read_log(dates_csv(tmp_path / "log.csv", dates), arm).recording
    assert len(got.time) == len(RUN.time) - 1
    assert [issue.count for issue in got.issues if issue.kind == "cell"] == [1]


@pytest.mark.parametrize("unit", ["ms", "us", "ns"])
def test_timestamps_of_parquet_are_a_time(tmp_path, arm, unit):
    arrow = pytest.importorskip("pyarrow", reason="needs pyarrow")
    from pyarrow import parquet

    stamps = (1_732_958_860_900_000_000 + np.rint(RUN.time * 1e9).astype(np.int64)).astype("datetime64[ns]")
    instants = arrow.array(stamps.astype(f"datetime64[{unit}]"), arrow.timestamp(unit, "Europe/Berlin"))
    columns = {"recorded": instants, "position": list(RUN.position), "effort": list(RUN.effort)}
    parquet.write_table(arrow.table(columns), tmp_path / "log.parquet")
    got = read_log(tmp_path / "log.parquet", arm)
    assert (got.mapping.time, got.mapping.time_unit) == ("recorded", "ns")
    assert got.recording.start_ns == stamps[0].astype(np.int64)
    assert np.abs(got.recording.time - RUN.time).max() < 1e-9


def test_dates_of_numpy_are_a_time_and_one_that_is_missing_leaves_its_row_out(tmp_path, arm):
    stamps = np.rint(RUN.time * 1e9).astype("datetime64[ns]")
    stamps[[0, 50]] = np.datetime64("NaT")
    np.savez(tmp_path / "log.npz", stamps=stamps, q=RUN.position, tau=RUN.effort)
    got = read_log(tmp_path / "log.npz", arm)
    assert (got.mapping.time, got.mapping.time_unit) == ("stamps", "ns")
    assert len(got.recording.time) == len(RUN.time) - 2


def test_a_slow_log_of_dates_is_called_slow_not_asked_for_its_unit(tmp_path, arm):
    stamps = (np.arange(len(RUN.time)) * 50_000_000).astype("datetime64[ns]")
    with pytest.raises(UnfitDataError, match="20 rows a second"):
        read_log(dates_csv(tmp_path / "log.csv", list(map(str, stamps))), arm)


def test_currents_without_constants_are_asked_for(tmp_path):
    found = proposal(tmp_path, ["t", "q1", "q2", "I1 [A]", "I2 [A]"], RUN.time, RUN.position, RUN.effort / 20.0)
    assert asks(found, "each A")


def test_two_positions_alike_are_asked_and_measured_beats_motor_side(tmp_path):
    columns = RUN.time, RUN.position, 1.01 * RUN.position, RUN.effort
    alike = proposal(tmp_path, ["t", "qa_1", "qa_2", "qb_1", "qb_2", "tau_1", "tau_2"], *columns)
    assert alike.mapping is None and alike.questions
    head = ["t", "motor_pos_1", "motor_pos_2", "link_pos_1", "link_pos_2", "tau_1", "tau_2"]
    assert proposal(tmp_path, head, *columns).mapping.columns["elbow"]["position"] == "link_pos_2"


def test_velocity_of_another_joint_is_not_taken_for_its_own(tmp_path):
    head = ["t", "q1", "q2", "dq1", "dq2", "tau1", "tau2"]
    found = proposal(tmp_path, head, RUN.time, RUN.position, RUN.velocity[:, ::-1], RUN.effort)
    assert asks(found, "does not follow the positions")


def test_slow_logs_and_logs_without_torque_are_refused_with_what_they_are_good_for(tmp_path):
    slow = slice(None, None, 10)
    for time in ("t [s]", "t"):
        with pytest.raises(UnfitDataError, match=r"20 rows a second, below 90 Hz.*can still show"):
            proposal(tmp_path, [time, "q1", "q2", "tau1", "tau2"], RUN.time[slow], RUN.position[slow], RUN.effort[slow])
    with pytest.raises(UnfitDataError, match=r"no torque or current.*can still show"):
        proposal(tmp_path, ["t", "q1", "q2"], RUN.time, RUN.position)


@pytest.mark.parametrize(
    "units",
    ["ms\tdeg\tdeg\tNm\tNm", "[ms]\t[deg]\t[deg]\t[Nm]\t[Nm]", '"(ms)"\t"(deg)"\t"(deg)"\t"(Nm)"\t"(Nm)"'],
)
def test_a_line_of_units_below_the_names_gives_the_units(tmp_path, arm, units):
    log = csv_of(tmp_path, HEAD, RUN.time * 1e3, np.degrees(RUN.position), RUN.effort)
    names, *rows = log.read_text().split("\n")
    log.write_text("\n".join([names, units, *rows]))
    got = read_log(log, arm)
    assert got.mapping.columns["elbow"] == {"position": "q2 [deg]", "effort": "tau2 [Nm]"}
    assert (got.mapping.time, got.mapping.time_unit) == ("t [ms]", "ms")
    assert all("written" in row.because for row in got.proposal.rows)
    same_samples(got.recording, RUN)


@pytest.mark.parametrize("above", ["made\tby\tan\told\trobot", "log\t\t\t\t"])
def test_a_line_above_the_names_is_not_taken_for_them(tmp_path, above):
    log = csv_of(tmp_path, HEAD, RUN.time, RUN.position, RUN.effort)
    log.write_text(f"{above}\n{log.read_text()}")
    assert list(read_table(log).columns) == HEAD


@pytest.mark.parametrize("above", ["", "# made by a robot\n\n"], ids=["header", "header and a line above"])
@pytest.mark.parametrize("head", ["t", "n"], ids=["time", "rate told"])
def test_logs_one_after_the_other_in_a_file_are_read_whole_with_a_pause(tmp_path, arm, above, head):
    time = RUN.time if head == "t" else np.arange(len(RUN.time))
    log = csv_of(tmp_path, [head, "q1", "q2", "tau1", "tau2"], time, RUN.position, RUN.effort)
    log.write_text(above + log.read_text() + "\n" + above + log.read_text() + "\n")
    table, found = propose_for(log, arm, {} if head == "t" else {"rate_hz": "200"})
    got = recording_by(table, found.mapping, arm, "log")
    n = len(RUN.time)
    assert got.segments == (slice(0, n), slice(n, 2 * n))
    assert np.abs(got.position - np.tile(RUN.position, (2, 1))).max() < 1e-9
    assert got.time[n] - got.time[n - 1] == pytest.approx(1.0)
    assert {issue.kind: issue.count for issue in got.issues if issue.kind not in ("log", "gap")} == {
        "repeated_header": 1
    }


def test_logs_of_dates_one_after_the_other_keep_their_dates(tmp_path, arm):
    stamps = 1_732_958_860_900_000_000 + np.rint(RUN.time * 1e9).astype(np.int64)
    parts = [dates_csv(tmp_path / "log.csv", list(map(str, s.astype("datetime64[ns]")))).read_text()
             for s in (stamps, stamps + 60 * 10**9)]  # fmt: skip
    (tmp_path / "log.csv").write_text("\n".join(parts))
    got = read_log(tmp_path / "log.csv", arm).recording
    assert len(got.time) == 2 * len(RUN.time) and got.time[len(RUN.time)] == pytest.approx(60.0)


def test_joints_are_told_by_name_in_any_order(tmp_path):
    head = ["t", "elbow_pos", "shoulder_pos", "elbow_torque", "shoulder_torque"]
    found = proposal(tmp_path, head, RUN.time, RUN.position[:, ::-1], RUN.effort[:, ::-1])
    assert found.mapping.columns["shoulder"] == {"position": "shoulder_pos", "effort": "shoulder_torque"}


def listed_csv(path: Path, run: Recording, cells: list[str], joints: int = 2) -> Path:
    """A log as bagpy writes joint states: the names in a cell of each row, arrays by number; further joints are 0."""
    nothing = np.zeros((len(run.time), joints - 2))
    rows = np.column_stack([run.time, run.position[:, ::-1], nothing, run.effort[:, ::-1], nothing])
    head = ["Time", *(f"position_{k}" for k in range(joints)), *(f"effort_{k}" for k in range(joints)), "name"]
    lines = [
        ",".join([*(f"{cell:.12g}" for cell in row), f'"{names}"']) for row, names in zip(rows, cells, strict=True)
    ]
    path.write_text("\n".join([",".join(head), *lines]))
    return path


@pytest.mark.parametrize(
    ("cell", "joints"), [("['elbow', 'shoulder']", 2), ("[elbow; shoulder]", 2), ("('elbow', 'shoulder', 'finger')", 3)]
)
def test_joints_that_each_row_lists_are_those_of_the_numbers(tmp_path, arm, cell, joints):
    log = listed_csv(tmp_path / "log.csv", RUN, [cell] * len(RUN.time), joints)
    got = read_log(log, arm)
    assert got.mapping.columns["shoulder"] == {"position": "position_1", "effort": "effort_1"}
    assert np.abs(got.recording.position - RUN.position).max() < 1e-9
    assert "in the order of 'name'" in next(row.because for row in got.proposal.rows if row.signal == "position")


def test_joints_listed_in_another_order_later_are_asked(tmp_path, arm):
    cells = ["['elbow', 'shoulder']"] * 100 + ["['shoulder', 'elbow']"] * (len(RUN.time) - 100)
    assert asks(propose_for(listed_csv(tmp_path / "log.csv", RUN, cells), arm)[1], "'name' changes")


def test_a_list_that_lacks_a_joint_of_the_arm_is_asked(tmp_path, arm):
    log = listed_csv(tmp_path / "log.csv", RUN, ["['elbow', 'waist']"] * len(RUN.time))
    assert asks(propose_for(log, arm)[1], "not each joint")


def test_a_list_of_other_names_leaves_the_order_to_the_arm_and_is_told(tmp_path, arm):
    run = replace(RUN, position=RUN.position[:, ::-1], effort=RUN.effort[:, ::-1])
    log = listed_csv(tmp_path / "log.csv", run, ["['j_a', 'j_b']"] * len(RUN.time))
    _, found = propose_for(log, arm)
    assert found.mapping.columns["shoulder"]["position"] == "position_0"
    assert any("j_a, j_b, none of them a joint" in line for line in found.left_out)


def numpy_cell(row: np.ndarray) -> str:
    """An array as numpy prints it, which breaks it into lines."""
    return np.array2string(row, precision=17, max_line_width=30)


@pytest.mark.parametrize("cell", [lambda row: str(row.tolist()), numpy_cell, lambda row: f"array('d', {row.tolist()})"],
                         ids=["list", "numpy", "array"])  # fmt: skip
@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize("listed", [True, False])
def test_an_array_in_a_cell_is_a_column_for_each_number(tmp_path, arm, cell, separator, listed):
    order = slice(None, None, -1) if listed else slice(None)
    with (tmp_path / "log.csv").open("w", newline="") as file:
        writer = csv.writer(file, delimiter=separator)
        writer.writerow(["time", "position", "velocity", "effort", *(["name"] if listed else [])])
        for k, time in enumerate(RUN.time):
            arrays = (cell(values[k, order]) for values in (RUN.position, RUN.velocity, RUN.effort))
            writer.writerow([repr(float(time)), *arrays, *(["['elbow', 'shoulder']"] if listed else [])])
    got = read_log(tmp_path / "log.csv", arm)
    place = 1 if listed else 0
    columns = {signal: f"{signal}[{place}]" for signal in ("position", "velocity", "effort")}
    assert got.mapping.columns["shoulder"] == columns
    same_samples(got.recording, RUN)
    assert [issue.kind for issue in got.recording.issues] == ["log"]


def test_a_row_whose_array_is_short_is_left_out_alone(tmp_path, arm):
    lines = [
        f'{t},"{list(q)}","{list(tau)}"' for t, q, tau in zip(RUN.time, RUN.position.tolist(), RUN.effort.tolist())
    ]
    lines[50] = f'{RUN.time[50]},"[0.1]","{RUN.effort[50].tolist()}"'
    (tmp_path / "log.csv").write_text("\n".join(["time,position,effort", *lines]))
    got = read_log(tmp_path / "log.csv", arm).recording
    assert np.array_equal(got.position, np.delete(RUN.position, 50, axis=0))
    assert [issue.count for issue in got.issues if issue.kind == "cell"] == [2]


def echoed(path: Path, frame: str = "", signals=("position", "velocity", "effort")) -> Path:
    """What `ros2 topic echo --csv /joint_states` prints, joints in another order than the arm's."""
    stamps = RUN.start_ns + np.rint(RUN.time * 1e9).astype(np.int64)
    rows = np.column_stack([getattr(RUN, signal)[:, ::-1] for signal in signals]).tolist()
    head = f"{frame},elbow,shoulder"
    lines = [f"{s // 10**9},{s % 10**9},{head},{','.join(map(repr, row))}" for s, row in zip(stamps.tolist(), rows)]
    path.write_text("\n".join([*lines, ""]))
    return path


@pytest.mark.parametrize("frame", ["", "base_link"])
def test_what_ros2_topic_echo_prints_of_joint_states_is_known_by_its_shape(tmp_path, arm, frame):
    got = read_log(echoed(tmp_path / "log.csv", frame), arm)
    same_samples(got.recording, RUN)
    assert got.recording.start_ns == RUN.start_ns and np.array_equal(got.recording.velocity, RUN.velocity)
    assert got.mapping.units == {"position": "rad", "velocity": "rad/s", "effort": "N m"}


@pytest.mark.parametrize("signal", ["velocity", "effort"])
def test_which_second_signal_ros2_topic_echo_printed_is_told_by_the_numbers(tmp_path, arm, signal):
    log = echoed(tmp_path / "log.csv", signals=("position", signal))
    if signal == "velocity":
        with pytest.raises(UnfitDataError, match="no torque or current"):
            read_log(log, arm)
    else:
        same_samples(read_log(log, arm).recording, RUN)


def test_joints_that_ros2_topic_echo_printed_in_another_order_later_are_asked(tmp_path, arm):
    log = echoed(tmp_path / "log.csv")
    lines = log.read_text().split("\n")
    log.write_text(
        "\n".join([*lines[:100], *(line.replace("elbow,shoulder", "shoulder,elbow") for line in lines[100:])])
    )
    assert asks(propose_for(log, arm)[1], "'name' changes")


def listed_npz(path: Path) -> None:
    np.savez(path, joint_names=np.array(["elbow", "shoulder"]), **REVERSED)


def listed_mat(path: Path) -> None:
    """The names in cells; structs beside them do not matter."""
    notes = np.array([{"a": 1.0}, {"a": 2.0}], dtype=object)
    savemat(path, REVERSED | {"joints": np.array(["elbow", "shoulder"], dtype=object), "notes": notes})


def listed_parquet(path: Path) -> None:
    arrow = pytest.importorskip("pyarrow", reason="needs pyarrow")
    from pyarrow import parquet

    lists = {name: list(values) for name, values in REVERSED.items()}
    parquet.write_table(arrow.table(lists | {"name": [["elbow", "shoulder"]] * len(RUN.time)}), path)


REVERSED = {"t": RUN.time, "q": RUN.position[:, ::-1], "tau": RUN.effort[:, ::-1]}


@pytest.mark.parametrize("write", [listed_npz, listed_mat, listed_parquet], ids=[".npz", ".mat", ".parquet"])
def test_arrays_are_in_the_order_of_the_names_beside_them(tmp_path, arm, write, request):
    path = tmp_path / f"log{request.node.callspec.id}"
    write(path)
    assert read_log(path, arm).mapping.columns["shoulder"] == {"position": "q[1]", "effort": "tau[1]"}


def test_the_command_asks_writes_nothing_and_exits_2(tmp_path, arm, capsys):
    log = csv_of(tmp_path, ["n", "q1", "q2", "tau1", "tau2"], np.arange(len(RUN.time)), RUN.position, RUN.effort)
    assert main(["import", str(log), "--arm", str(arm)]) == 2
    assert "open: " in capsys.readouterr().out
    assert mapping_beside(log) is None
    assert main(["import", str(log), "--arm", str(arm), "--set", "rate_hz=200", "--quiet"]) == 0
    assert read_log(log).recording.rate_hz == pytest.approx(200.0)
    assert main(["check", str(log), "--quiet"]) in (0, 1)


def test_the_page_beside_the_mapping_shows_columns_units_and_every_joint_and_loads_nothing(tmp_path, arm, capsys):
    head = ["t [s]", "q1 <b>", "q2 <b>", "tau1", "tau2"]
    log = csv_of(tmp_path, head, RUN.time, np.degrees(RUN.position), RUN.effort)
    words = ["import", str(log), "--arm", str(arm), "--quiet"]
    assert main(words) == 0
    assert f"picture: {tmp_path / 'log.csv.mapping.html'}" in capsys.readouterr().out
    page = Page((tmp_path / "log.csv.mapping.html").read_text())
    assert page.tags.count("svg") == len(small_arm.JOINTS)
    assert all(reference.startswith("#") for reference in page.references)
    text = " ".join(page.words)
    assert all(joint in text for joint in small_arm.JOINTS) and "q# <b>" in text and "deg" in text
    for file in tmp_path.glob("*.mapping.*"):
        file.unlink()
    open_question = csv_of(tmp_path, ["n", *head[1:]], np.arange(len(RUN.time)), RUN.position, RUN.effort)
    assert main([words[0], str(open_question), *words[2:]]) == 2
    assert not list(tmp_path.glob("*.mapping.*"))


def test_a_log_without_an_arm_is_refused_in_one_line(tmp_path):
    with pytest.raises(UserError, match="--arm FILE"):
        read_log(csv_of(tmp_path, HEAD, RUN.time, RUN.position, RUN.effort))


def test_a_log_without_an_arm_is_of_the_urdf_that_it_is_compared_with(tmp_path, capsys):
    log = csv_of(tmp_path, HEAD, RUN.time, RUN.position, RUN.effort)
    simulation = tmp_path / "simulation.urdf"
    simulation.write_text(small_arm.URDF)
    words = ["mismatch", str(log), "--simulation", str(simulation), "--out", str(tmp_path / "out")]
    assert main([*words, "--without", *EFFECTS]) == 0
    assert f"no arm is named: taken to be that of {simulation}" in capsys.readouterr().err


def test_the_arm_of_a_mapping_goes_before_another_one(tmp_path, arm):
    log = csv_of(tmp_path, HEAD, RUN.time, RUN.position, RUN.effort)
    assert main(["import", str(log), "--arm", str(arm), "--quiet"]) == 0
    assert read_log(log, otherwise=tmp_path / "none.urdf").recording.joints == small_arm.JOINTS


def test_a_mapping_survives_its_file(tmp_path, arm):
    columns = {"shoulder": {"position": "Winkel ä", "effort": "τ", "command": "soll"}}
    units = {"position": "counts", "velocity": "rpm", "effort": "percent"}
    mapping = LogMapping(columns, units, "t", "us", None, {"shoulder": 80.0}, {"shoulder": -65536.0}, arm)
    save_mapping(mapping, tmp_path / "m.yaml")
    assert read_mapping(tmp_path / "m.yaml") == mapping


def test_epoch_nanoseconds_in_text_keep_every_digit(tmp_path):
    stamps = 1_700_000_000_123_456_789 + 1_000_003 * np.arange(5)
    (tmp_path / "log.csv").write_text("\n".join(["stamp,q", *(f"{stamp},1.5" for stamp in stamps)]))
    assert np.array_equal(read_table(tmp_path / "log.csv").columns["stamp"], stamps)


def test_empty_cells_and_words_are_missing_values_and_counted(tmp_path):
    (tmp_path / "log.csv").write_text("t,q1,tau\n0.1,1,2\n0.2,,3\n0.3,bad,4\n0.4,7,8\n")
    table = read_table(tmp_path / "log.csv")
    assert np.array_equal(np.isnan(table.columns["q1"]), [False, True, True, False])
    assert table.issues[0].count == 2


def test_propose_asks_rather_than_guesses_where_nothing_is_known(tmp_path, arm):
    rng = np.random.default_rng(0)
    path = csv_of(tmp_path, ["t", *"abcd"], np.arange(500) * 0.005, rng.standard_normal((500, 4)))
    with pytest.raises(UserError, match="no columns of the positions"):
        propose(read_table(path), load_arm(arm), "log")
