"""Mistakes of convention are found on the data, at the right joint; a sound recording raises no alarm."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from planted_arm import Friction, Link, incommensurate, plant, urdf_of

from spacearm_ident.conventions.change import Change, Kind
from spacearm_ident.conventions.check import check_conventions
from spacearm_ident.conventions.clock import clock_error_s
from spacearm_ident.conventions.description import compare_description
from spacearm_ident.conventions.finding import ConventionReport, Finding, Level
from spacearm_ident.conventions.fixed_joints import moving_though_fixed
from spacearm_ident.conventions.plain import read_off, without_motion
from spacearm_ident.conventions.rows import rows_of
from spacearm_ident.conventions.scorer import Scorer
from spacearm_ident.conventions.search import is_testable
from spacearm_ident.conventions.setup import Setup
from spacearm_ident.dynamics.arm import Arm, arm_from_urdf
from spacearm_ident.dynamics.urdf_chain import locked
from spacearm_ident.errors import UnfitDataError
from spacearm_ident.identification.identify import Settings, identify
from spacearm_ident.recording import Recording, read_recording
from spacearm_ident.recording.corrections import Corrections, read_corrections
from spacearm_ident.recording.intake import Samples
from spacearm_ident.recording.interleaved import steps_back
from spacearm_ident.recording.reader import recording_of
from spacearm_ident.recording.recording import BaseSensor, Issue, Source
from spacearm_ident.sessions.identification import find_arm
from spacearm_ident.signals.prepare import prepare

REAL = Path(__file__).parents[2] / "shared" / "recordings" / "real"
LINKS = (
    Link("waist", axis=(0, 0, 1), mass=6.0, com=(0.0, 0.02, 0.1)),
    Link(
        "shoulder",
        parent="waist",
        xyz=(0, 0.1, 0.3),
        mass=5.0,
        com=(0.02, 0.01, 0.25),
        inertia=(0.1, 0, 0, 0.1, 0, 0.02),
    ),
    Link("elbow", parent="shoulder", xyz=(0, 0, 0.5), mass=3.0, com=(0.03, 0.02, 0.2)),
    Link(
        "wrist", parent="elbow", xyz=(0, 0, 0.4), mass=1.5, com=(0.06, 0.02, 0.1), inertia=(0.01, 0, 0, 0.01, 0, 0.005)
    ),
)
LIMITS = np.array([60.0, 200.0, 80.0, 20.0])
LINKS = tuple(
    replace(link, limit=f'lower="-3" upper="3" effort="{limit}" velocity="4"') for link, limit in zip(LINKS, LIMITS)
)
"""What the URDF says; the true links weigh up to 8 % more or less."""
TRUE = tuple(replace(link, mass=link.mass * factor) for link, factor in zip(LINKS, (1.05, 0.95, 1.08, 0.97)))
FRICTION = tuple(Friction(f_c=f, k_v1=0.8 * f, J_m=0.05 * f) for f in (4.0, 5.0, 2.0, 1.0))
NAMES = tuple(link.name for link in LINKS)


def sound(
    seed: int = 0,
    gravity: Sequence[float] = (0.0, 0.0, -9.81),
    share: Sequence[float] = (1.0, 1.0, 1.0, 1.0),
    friction: Sequence[Friction] = FRICTION,
) -> Recording:
    """A run; `share` of its motion is what each joint makes."""
    time = np.arange(0.0, 30.0, 1 / 200)
    motion = tuple(np.asarray(share) * signal for signal in incommensurate(time, 4, seed=seed, speed=1.2))
    made = plant(LINKS, friction, motion, 200.0, gravity, true_links=TRUE)
    recording = made.recording(noise=[0.2, 0.3, 0.1, 0.05], seed=seed, ar=0.5)
    return replace(recording, velocity=motion[1])


PRESLIDING = tuple(replace(law, d_s=0.008) for law in FRICTION)


def gentle(seed: int, zero: float = 0.0) -> Recording:
    """A run at 0.4 rad/s whose friction builds up over 8 mrad after a reversal; the elbow's zero is off, rad."""
    time = np.arange(0.0, 30.0, 1 / 200)
    motion = incommensurate(time, 4, seed=seed, speed=0.4)
    made = plant(LINKS, PRESLIDING, motion, 200.0, true_links=TRUE)
    recording = made.recording(noise=[0.2, 0.3, 0.1, 0.05], seed=seed, ar=0.5)
    return replace(recording, velocity=motion[1], position=recording.position - [0.0, 0.0, zero, 0.0])


@pytest.fixture(scope="module")
def run() -> Recording:
    return sound()


@pytest.fixture(scope="module")
def arm(run) -> Arm:
    return arm_from_urdf(run.urdf)


def scaled(recording: Recording, name: str, joint: int | slice, factor: float) -> Recording:
    values = getattr(recording, name).copy()
    values[:, joint] *= factor
    return replace(recording, **{name: values})


def turned(recording: Recording, joint: int | slice, factor: float) -> Recording:
    return scaled(scaled(recording, "position", joint, factor), "velocity", joint, factor)


def unfit(report: ConventionReport) -> list[tuple[str, tuple[str, ...]]]:
    return [(finding.kind, finding.joints) for finding in report.findings if finding.level is Level.UNFIT]


def exchanged(recording: Recording, *names: str) -> Recording:
    order = [0, 2, 1, 3]
    return replace(recording, **{name: getattr(recording, name)[:, order] for name in names})


def kept(recording: Recording, rows: np.ndarray, **other: object) -> Recording:
    """Those rows of a recording, in one piece, and something else in place of some of it."""
    names = ("time", "position", "velocity", "effort")
    own = {name: getattr(recording, name)[rows] for name in names} | {"segments": (slice(0, len(rows)),)}
    return replace(recording, **(own | other))


def late(recording: Recording, samples: int) -> Recording:
    rows = np.arange(len(recording.time) - samples)
    return kept(recording, rows + samples, time=recording.time[rows], effort=recording.effort[rows])


def of_kind(report: ConventionReport, kind: str) -> list[Finding]:
    return [finding for finding in report.findings if finding.kind == kind]


def swaying(recording: Recording, joint: int) -> Recording:
    """By a milliradian, at random."""
    position = recording.position.copy()
    position[:, joint] += np.random.default_rng(joint).normal(0.0, 1e-3, len(position))
    return replace(recording, position=position)


@pytest.mark.parametrize("seed", range(6))
def test_a_sound_recording_raises_no_alarm(seed, arm):
    report = check_conventions([sound(seed)], arm)
    assert report.fit and not report.findings


@pytest.mark.parametrize("seed", range(4))
def test_friction_that_builds_up_after_a_reversal_is_no_late_torque(seed, arm):
    """Taken for sliding friction, it is one of 0.11 to 0.13 s."""
    assert not check_conventions([gentle(seed)], arm).findings
    (finding,) = check_conventions([late(gentle(seed), 10)], arm).findings
    assert finding.kind == "delay" and finding.values["value"][0] == pytest.approx(0.05, abs=0.004)


def test_late_torque_makes_data_unfit_where_it_is_more_than_drives_and_recorders_delay_it(run, arm):
    """30 ms may be a drive's filter; what is said of one joint alone may be its friction's hysteresis."""
    assert [(one.kind, one.level) for one in check_conventions([late(run, 6)], arm).findings] == [("delay", Level.NOTE)]
    effort = run.effort.copy()
    effort[20:, 2] = effort[:-20, 2]
    found = check_conventions([replace(run, effort=effort)], arm).findings
    assert [(one.kind, one.joints, one.level) for one in found] == [("delay", ("elbow",), Level.NOTE)]


@pytest.mark.parametrize("seed", range(3))
def test_in_degrees_friction_that_builds_up_is_no_late_torque(seed, arm):
    """The distance over which it does is one in rad: in degrees torque was 0.11 to 0.14 s late."""
    report = check_conventions([turned(gentle(seed), slice(None), 180 / np.pi)], arm)
    assert [(one.kind, one.joints) for one in report.findings] == [("degrees", NAMES)]


@pytest.mark.parametrize("seed", range(4))
def test_behind_friction_that_builds_up_a_zero_is_found(seed, arm):
    report = check_conventions([gentle(seed, zero=0.25)], arm)
    assert unfit(report) == [("encoder_zero", ("elbow",))]
    (zero,) = of_kind(report, "encoder_zero")
    assert zero.values["value"][0] == pytest.approx(0.25, abs=0.05)


def log_likelihood(recording: Recording) -> float:
    """Of a recording as it is."""
    arm = arm_from_urdf(recording.urdf)
    motions, _ = prepare([recording], arm.joint_names)
    return Scorer(arm, rows_of(motions)).score((), Setup.as_recorded(arm)).score


@pytest.mark.parametrize("seed", range(3))
def test_offset_of_a_drive_that_carries_nothing_costs_little(seed):
    """With a prior of a tenth of the torque it cost 36 to 44, more than many a mistake."""
    recording = sound(seed)
    torque = np.sqrt(np.mean(recording.effort**2, axis=0))
    other = replace(recording, effort=recording.effort + 1.2 * torque * np.array([1.0, 0.0, 0.0, 0.0]))
    assert log_likelihood(other) > log_likelihood(recording) - 20.0


@pytest.mark.parametrize("seed", range(3))
def test_what_looks_like_a_rotor_without_inertia_costs_little(seed):
    """As of a spring at one joint; without a bound the sign alone cost 27 to 33 here."""
    spring = (replace(FRICTION[0], J_m=-1.5), *FRICTION[1:])
    assert log_likelihood(sound(seed, friction=spring)) > log_likelihood(sound(seed)) - 15.0


MISTAKES = {
    "torque sign": (lambda r: scaled(r, "effort", 2, -1.0), "effort_sign", ("elbow",)),
    "position sign": (lambda r: turned(r, 1, -1.0), "position_sign", ("shoulder",)),
    "degrees, one joint": (lambda r: turned(r, 3, 180 / np.pi), "degrees", ("wrist",)),
    "degrees, all": (lambda r: turned(r, slice(None), 180 / np.pi), "degrees", NAMES),
    "positions exchanged": (
        lambda r: exchanged(r, "position", "velocity"),
        "positions_exchanged",
        ("shoulder", "elbow"),
    ),
    "torques exchanged": (lambda r: exchanged(r, "effort"), "efforts_exchanged", ("shoulder", "elbow")),
    "joints exchanged": (
        lambda r: exchanged(r, "position", "velocity", "effort"),
        "joints_exchanged",
        ("shoulder", "elbow"),
    ),
    "amperes": (lambda r: replace(r, effort=r.effort / [9.0, 12.0, 10.0, 7.0]), "effort_unit", NAMES),
    "milliamperes": (lambda r: replace(r, effort=100.0 * r.effort / [0.9, 1.2, 1.0, 0.7]), "effort_unit", NAMES),
    "per cent of the limit": (lambda r: replace(r, effort=100.0 * r.effort / LIMITS), "effort_unit", NAMES),
    "encoder zero": (
        lambda r: replace(r, position=r.position + np.array([0.0, 0.0, 0.3, 0.0])),
        "encoder_zero",
        ("elbow",),
    ),
}


@pytest.mark.parametrize("what", MISTAKES)
def test_a_mistake_is_named_with_its_joint(what, run, arm):
    make, kind, joints = MISTAKES[what]
    report = check_conventions([make(run)], arm)
    assert unfit(report) == [(kind, joints)], report.lines()


RATIOS = np.array([100.0, 120.0, 80.0, 50.0])


def test_positions_of_the_motors_are_named_by_the_gear_ratios_and_the_remedy_mends_them(run, arm):
    geared = replace(arm, joints=tuple(replace(one, gear_ratio=r) for one, r in zip(arm.joints, RATIOS)))
    wrong = turned(run, slice(None), RATIOS)
    (finding,) = check_conventions([wrong], geared).findings
    assert (finding.kind, finding.joints, finding.level) == ("motor_side", NAMES, Level.UNFIT)
    assert check_conventions([finding.corrections.applied(wrong)], geared).fit


def test_positions_of_the_motors_of_unknown_gear_ratios_are_not_called_degrees(run, arm):
    (finding,) = check_conventions([turned(run, slice(None), RATIOS)], arm).findings
    assert (finding.kind, finding.level) == ("position_unit", Level.UNFIT)
    assert "motors" in finding.statement and finding.corrections.none


@pytest.mark.parametrize("truth", [(0.0, 0.0, 9.81), (9.81, 0.0, 0.0), (0.0, -6.94, -6.94)])
def test_the_base_is_found_mounted_otherwise(truth, arm):
    report = check_conventions([sound(gravity=truth)], arm)
    (finding,) = [one for one in report.findings if one.level is Level.UNFIT]
    assert finding.kind == "gravity"
    found = np.array(finding.values["value"])
    assert found @ truth > 0.97 * np.linalg.norm(found) * np.linalg.norm(truth)
    # Directions that the search leads to one are one hypothesis.
    assert finding.probability > 0.9


SCARA = (
    Link("inner", axis=(0, 0, 1), xyz=(0, 0, 0.4), mass=6.0, com=(0.16, 0.01, 0.0)),
    Link("outer", parent="inner", axis=(0, 0, 1), xyz=(0.35, 0, 0.05), mass=5.0, com=(0.13, 0.02, 0.0)),
    Link("quill", "prismatic", parent="outer", axis=(0, 0, 1), xyz=(0.28, 0, 0), mass=2.0, com=(0.02, 0.0, -0.1)),
)
ON_A_WALL = (-9.81, 0.0, 0.0)


@pytest.fixture(scope="module")
def on_a_wall() -> Recording:
    """A SCARA whose base is on a wall; a drive's offset of 4 N at the sliding joint, which gravity does not pull."""
    time = np.arange(0.0, 30.0, 1 / 200)
    motion = tuple(np.array([1.0, 1.0, 0.1]) * signal for signal in incommensurate(time, 3, speed=1.2))
    laws = (Friction(4.0, k_v1=3.0, J_m=0.5), Friction(3.0, k_v1=2.0, J_m=0.3), Friction(20.0, k_v1=60.0, J_m=8.0))
    made = plant(SCARA, (*laws[:2], replace(laws[2], offset=4.0)), motion, 200.0, ON_A_WALL)
    return replace(made.recording(noise=[0.3, 0.2, 0.5], ar=0.5), velocity=motion[1])


def test_an_offset_of_a_sliding_joint_tilts_no_base(on_a_wall):
    report = check_conventions([on_a_wall], arm_from_urdf(on_a_wall.urdf))
    (finding,) = of_kind(report, "gravity")
    np.testing.assert_array_equal(finding.values["value"], ON_A_WALL)
    assert "give or take" in finding.statement and "-0" not in finding.remedy
    assert "direction of gravity (a constant torque at quill looks the same)" in report.undecided


def test_direction_of_gravity_is_decided_where_joints_feel_all_of_it(run, arm):
    assert not any("direction of gravity" in text for text in check_conventions([run], arm).undecided)


def test_gravity_that_is_estimated_is_no_mistake(on_a_wall):
    arm = arm_from_urdf(on_a_wall.urdf)
    assert not of_kind(check_conventions([on_a_wall], arm, gravity_known=False), "gravity")


@pytest.mark.parametrize("rated", [0.4, 1.6])
def test_a_share_of_rated_torques_that_no_file_tells_is_named_and_its_remedy_mends_it(rated, run, arm):
    """As CiA 402's object 0x6077 in per cent: rated torques follow the limits, by an unknown factor."""
    wrong = scaled(run, "effort", slice(None), 100.0 / (rated * LIMITS))
    (finding,) = check_conventions([wrong], arm).findings
    assert (finding.kind, finding.joints, finding.level) == ("effort_unit", NAMES, Level.UNFIT)
    said = re.search(r"share of each joint's torque limit, 1 for ([\d.]+)% of it", finding.statement)
    assert said is not None and float(said[1]) == pytest.approx(rated, rel=0.05)
    np.testing.assert_allclose(finding.values["value"], rated * LIMITS / 100.0, rtol=0.05)
    data = yaml.safe_load(finding.remedy.partition("in the arm YAML: ")[2])["corrections"]
    mended = read_corrections(data, NAMES, "arm.yaml").applied(wrong)
    np.testing.assert_allclose(mended.effort, run.effort, rtol=0.05)


def test_a_corrected_mistake_is_none(run, arm):
    wrong = scaled(turned(run, 1, -180 / np.pi), "effort", 2, -0.5)
    text = {"joints": {"shoulder": {"position_scale": -np.pi / 180}, "elbow": {"effort_scale": -2.0}}}
    mended = read_corrections(text, NAMES, "arm.yaml").applied(wrong)
    np.testing.assert_allclose(mended.position, run.position, atol=1e-12)
    assert check_conventions([mended], arm).fit


def test_a_delay_is_corrected_by_its_own_remedy(run, arm):
    wrong = late(run, 20)
    (finding,) = check_conventions([wrong], arm).findings
    assert (finding.kind, finding.joints, finding.level) == ("delay", NAMES, Level.UNFIT)
    data = {"joints": {"all": {"effort_delay_s": finding.values["value"][0]}}}
    assert finding.values["value"][0] == pytest.approx(0.1, abs=0.01)
    assert not check_conventions([read_corrections(data, NAMES, "arm.yaml").applied(wrong)], arm).findings


def test_a_joint_without_torque_is_said_and_the_others_are_still_checked(run, arm):
    report = check_conventions([scaled(scaled(run, "effort", 3, 0.0), "effort", 1, -1.0)], arm)
    assert ("no_effort", ("wrist",)) in unfit(report)
    assert ("effort_sign", ("shoulder",)) in unfit(report)


def test_a_channel_that_is_mostly_filled_with_zeros_is_no_torque(run, arm):
    """As the wrist of a TIAGo: nine samples in ten, so that degrees or exchanged joints explained it best."""
    gaps = np.where(np.arange(len(run.time)) % 10 == 0, 1.0, 0.0)
    effort = run.effort.copy()
    effort[:, 3] *= gaps
    report = check_conventions([replace(run, effort=effort)], arm)
    assert unfit(report) == [("no_effort", ("wrist",))] and "zero in 90% of the samples" in report.findings[0].statement


@pytest.mark.parametrize("noise", [0.0, 0.005])
def test_seconds_in_which_the_arm_is_carried_are_named(run, noise):
    """Drives off: no torque but the noise of currents, half a per cent of the limits, while every joint moves."""
    start, stop = 3.0, 5.0
    rows = (run.time - run.time[0] >= start) & (run.time - run.time[0] < stop)
    effort = run.effort.copy()
    effort[rows] = noise * np.array(LIMITS) * np.random.default_rng(0).standard_normal((rows.sum(), len(NAMES)))
    (finding,) = of_kind(read_off(replace(run, effort=effort)), "drives_off")
    ((first, last),) = finding.values["from_to_s"]
    assert finding.level is Level.UNFIT and abs(first - start) < 0.3 and abs(last - stop) < 0.3
    assert f"from {first:.1f} to {last:.1f} s" in finding.statement
    # At rest and weightless they are a pause.
    held = run.position.copy()
    held[rows] = held[rows][0]
    assert not of_kind(read_off(replace(run, effort=effort, position=held, velocity=None)), "drives_off")


def test_torque_of_one_joint_that_stays_is_no_drive_that_is_off(run):
    effort = run.effort.copy()
    effort[500:900, 1:] = 0.0
    assert not of_kind(read_off(replace(run, effort=effort)), "drives_off")


def test_a_joint_at_rest_is_a_note(run, arm):
    report = check_conventions([turned(run, 0, 0.0)], arm)
    assert ("at_rest", ("waist",), Level.NOTE) in [(f.kind, f.joints, f.level) for f in report.findings]


@pytest.mark.parametrize("effort", [0.0, 40.0])
def test_a_joint_at_rest_whose_effort_is_constant_is_a_note_and_may_be_locked(effort, run, arm):
    still = turned(run, 0, 0.0)
    constant = still.effort.copy()
    constant[:, 0] = effort
    report = check_conventions([replace(still, effort=constant)], arm)
    assert [(f.kind, f.joints, f.level) for f in report.findings] == [("at_rest", ("waist",), Level.NOTE)]
    assert "spacearm new-arm" in report.findings[0].remedy


@pytest.mark.parametrize("joint", [0, 3])
def test_a_joint_that_only_sways_is_a_note_and_hides_no_other_behind_it(arm, joint):
    run = sound(share=[float(k != joint) for k in range(4)])
    report = check_conventions([swaying(run, joint)], arm)
    assert ("at_rest", (NAMES[joint],), Level.NOTE) in [(f.kind, f.joints, f.level) for f in report.findings]
    assert not unfit(report)


def test_a_joint_that_only_sways_is_found_exchanged_with_one_that_moves(arm):
    run = exchanged(sound(share=(1.0, 0.0, 1.0, 1.0)), "position", "velocity", "effort")
    report = check_conventions([swaying(run, 2)], arm)
    assert unfit(report) == [("joints_exchanged", ("shoulder", "elbow"))], report.lines()


def test_stamps_that_tear_a_recording_apart_are_named_as_the_cause(run, arm):
    number = np.arange(len(run.time))
    batches = replace(run, time=run.time[number // 40 * 40] + 1e-5 * (number % 40))
    report = check_conventions([batches], arm)
    assert unfit(report) == [("clock_jitter", ())]


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda v: v * 180 / np.pi, "degrees/s"),
        (lambda v: v * 60 / (2 * np.pi), "rpm"),
        (lambda v: -v, "opposite sign"),
        (lambda v: np.roll(v, 20, axis=0), "late against its position"),
        (lambda v: np.random.default_rng(0).standard_normal(v.shape), "not the derivative"),
    ],
)
def test_a_velocity_that_is_not_the_derivative_is_noted(make, says, run, arm):
    velocity = run.velocity.copy()
    velocity[:, 2] = make(velocity)[:, 2]
    report = check_conventions([replace(run, velocity=velocity)], arm)
    assert report.fit
    (finding,) = report.findings
    assert (finding.kind, finding.joints) == ("velocity", ("elbow",))
    assert says in finding.statement


def test_stamps_that_jitter_where_the_samples_are_even_are_found(run, arm):
    jitter = np.clip(0.002 * np.random.default_rng(1).standard_normal(len(run.time)), -0.0024, 0.0024)
    report = check_conventions([replace(run, time=run.time + jitter)], arm)
    assert [f.kind for f in report.findings if f.kind.startswith("clock")] == ["clock_jitter"]


def taken_unevenly(run: Recording, error_s: float = 0.0) -> Recording:
    """Half the samples, so that no even clock is right, stamped with an error of so many seconds RMS."""
    rng = np.random.default_rng(0)
    keep = np.sort(rng.choice(len(run.time), len(run.time) // 2, replace=False))
    time = np.sort(run.time[keep] + error_s * rng.standard_normal(len(keep)))
    return kept(run, keep, time=time, velocity=None)


def on_arrival(run: Recording) -> Recording:
    """Samples at uneven times, each stamped when it arrives: in bursts, behind pauses of 40 ms; no header stamps."""
    few = taken_unevenly(run)
    burst = np.floor(few.time / 0.04)
    time = 0.04 * (burst + 1.0) + 3e-6 * np.arange(len(few.time))
    return replace(few, time=time, issues=(Issue("log_time_used", "the stamps carry no time", len(time)),))


@pytest.mark.parametrize("error_s", [3e-4, 1e-3])
def test_the_error_of_stamps_is_measured_where_samples_are_uneven(error_s, run):
    assert clock_error_s(taken_unevenly(run, error_s)) == pytest.approx(error_s, rel=0.3)


def test_noise_of_encoders_and_a_slow_motion_are_no_error_of_the_clock(run):
    uneven = taken_unevenly(run)
    noise = 1e-3 * np.random.default_rng(3).standard_normal(uneven.position.shape)
    for recording in (
        uneven,
        replace(uneven, position=uneven.position + noise),
        replace(uneven, position=0.02 * uneven.position + noise),
    ):
        assert clock_error_s(recording) == 0.0


@pytest.mark.parametrize("times", [2, 4, 8])
def test_positions_that_are_published_oftener_than_they_are_sampled_are_no_error_of_the_clock(times, run, arm):
    held = np.arange(len(run.time)) // times * times
    repeated = replace(run, position=run.position[held], velocity=None)
    assert clock_error_s(repeated) == 0.0
    assert check_conventions([repeated], arm).fit


def test_times_of_arrival_that_spoil_the_speeds_are_the_reason_and_not_rest(run, arm):
    report = check_conventions([on_arrival(run)], arm)
    assert unfit(report) == [("clock_jitter", ())] and report.certain
    assert not of_kind(report, "at_rest")
    (found,) = of_kind(report, "clock_jitter")
    assert "times of arrival" in found.statement and "header stamps" in found.remedy


def test_missing_stamps_are_the_note_that_comes_first_and_a_right_velocity_is_not_blamed(run, arm):
    """Times of arrival: a machine that is held up for half a second now and then takes all messages of it at once."""
    arrived = np.array(run.time)
    for first in range(200, len(arrived) - 200, 400):
        arrived[first : first + 100] = arrived[first + 100] - 1e-6 * np.arange(100, 0, -1)
    issue = Issue("log_time_used", "the stamps carry no time", len(arrived))
    late = replace(run, time=arrived, issues=(issue,))
    wrong = replace(late, velocity=late.velocity * np.array([1.0, -1.0, 1.0, 1.0]))
    assert of_kind(check_conventions([replace(late, issues=())], arm), "velocity"), "there is something to explain"
    for recording, blamed in ((late, []), (wrong, [("shoulder",)])):
        plain = read_off(recording)
        assert plain.findings[0].kind == "no_stamps" and "header stamps" in plain.findings[0].remedy
        assert [one.joints for one in plain.findings if one.kind == "velocity"] == blamed
    assert not [one for one in read_off(run).findings if one.kind == "no_stamps"]


def test_messages_that_are_stamped_together_once_make_no_velocity_early(run, arm):
    time = np.array(run.time)
    time[1000:1030] = time[1030] - 1e-7 * np.arange(30, 0, -1)
    assert not of_kind(check_conventions([replace(run, time=time)], arm), "velocity")


def test_joints_that_move_for_a_hundredth_of_a_recording_are_not_said_to_hardly_move(run, arm):
    """Ten minutes at rest before and after ten seconds of motion: as good as the motion by itself."""
    begin, end = np.searchsorted(run.time, (10.0, 20.0))
    lead = 120_000
    rest = np.concatenate((np.full(lead, begin), np.arange(begin, end), np.full(lead, end - 1)))
    whole = kept(run, rest, time=np.arange(len(rest)) / 200.0, velocity=None)
    report = check_conventions([whole], arm)
    assert report.fit and not of_kind(report, "at_rest") and not of_kind(report, "position_noise")


@pytest.mark.parametrize(
    ("share", "error_s", "found"),
    [
        (1.0, 5e-4, ("clock_jitter", (), Level.UNFIT)),
        (1.0, 1e-4, ("position_noise", ("elbow",), Level.NOTE)),
        (0.003, 5e-4, ("at_rest", ("elbow",), Level.NOTE)),
    ],
)
def test_a_joint_without_motion_is_at_rest_only_if_its_position_is(share, error_s, found, run):
    recording = replace(run, position=run.position * np.array([1.0, 1.0, share, 1.0]))
    (said,) = without_motion(recording, ["elbow"], error_s)
    assert (said.kind, said.joints, said.level) == found


def test_joints_whose_speed_is_lost_are_not_said_to_be_at_rest(run):
    lost = replace(run, position=run.position + 0.3 * np.random.default_rng(4).standard_normal(run.position.shape))
    with pytest.raises(UnfitDataError, match=r"joints move .*nowhere stand out of the noise.*sampling instant"):
        prepare([lost], NAMES)
    issue = Issue("log_time_used", "the stamps carry no time")
    with pytest.raises(UnfitDataError, match=r"times of arrival.*publish joint states with header stamps"):
        prepare([replace(lost, issues=(issue,))], NAMES)


@pytest.mark.parametrize(
    ("share", "factor", "told"), [(0.01, 180.0 / np.pi, False), (0.2, 180.0 / np.pi, True), (0.2, 1.0, False)]
)
def test_a_joint_that_would_hardly_have_moved_in_degrees_tells_no_unit(share, factor, told, arm):
    """A position that is 57 times smaller takes the motion out of all torques: beside wrong CAD that explains more."""
    run = sound(share=(share,) * 4)
    motions, _ = prepare([scaled(run, "position", 0, factor)], arm.joint_names)
    scorer = Scorer(arm, rows_of(motions))
    start = scorer.score((), Setup.as_recorded(arm))
    assert 0 not in scorer.idle
    for joints in ((0,), (0, 1, 2, 3)):
        assert is_testable(scorer, start, Change(Kind.DEGREES, joints)) == told


def test_stamps_in_batches_are_found_though_the_positions_are_noisy(run, arm):
    number = np.arange(len(run.time))
    noisy = run.position + 1e-3 * np.random.default_rng(2).standard_normal(run.position.shape)
    batches = replace(run, time=run.time[number // 10 * 10] + 2e-5 * (number % 10), position=noisy)
    assert unfit(check_conventions([batches], arm)) == [("clock_jitter", ())]


def test_effort_beyond_the_limits_is_noted_where_the_inertials_tell_no_unit(run, arm):
    rough = replace(arm, joints=tuple(replace(joint, inertial=np.zeros(10)) for joint in arm.joints))
    assert not of_kind(check_conventions([run], rough), "effort_unit")
    (finding,) = of_kind(check_conventions([scaled(run, "effort", slice(None), 30.0)], rough), "effort_unit")
    assert finding.level is Level.NOTE and "shoulder" in finding.joints


def test_a_unit_of_torque_is_one_by_the_joints_that_show_it(run, arm):
    """Those that stand still, or carry nothing, have the gain that was assumed: the unit was a note beside them."""
    rest = sound(share=(0.0, 1.0, 0.0, 0.0))
    report = check_conventions([scaled(rest, "effort", slice(None), [60.0, 90.0, 110.0, 75.0])], arm)
    (finding,) = [one for one in report.findings if one.level is Level.UNFIT]
    assert finding.kind == "effort_unit"
    factors = [finding.corrections.joints[name].effort_scale for name in NAMES]
    assert max(factors) < 1 / 40.0 and factors[1] == pytest.approx(1 / 90.0, rel=0.2)


def test_samples_that_are_uneven_by_their_stamps_are_sound(arm):
    base = sound(seed=3)
    uneven = kept(base, np.sort(np.random.default_rng(0).choice(len(base.time), 3500, replace=False)))
    assert not [f for f in check_conventions([uneven], arm).findings if f.kind.startswith("clock")]


def test_time_that_runs_backwards_is_found_by_friction(run, arm):
    backwards = Corrections(clock="reversed").applied(run)
    assert unfit(check_conventions([replace(backwards, velocity=None)], arm)) == [("time_reversed", ())]


def by_turns(run: Recording, late: Recording, every: int) -> Samples:
    """Joint states of one source with those of another behind each `every`-th of them."""
    places = np.arange(len(run.time))
    order = np.argsort(np.concatenate((places, places[::every] + 0.5)), kind="stable")
    stamps = np.round(1e9 * np.concatenate((run.time, late.time[::every] + 1e-3))).astype(np.int64)
    position, velocity, effort = (
        np.concatenate((getattr(run, name), getattr(late, name)[::every]))[order]
        for name in ("position", "velocity", "effort")
    )
    return Samples(run.joints, stamps[order] + 10**18, position, velocity, effort)


@pytest.mark.parametrize(("late_s", "every"), [(0.3, 1), (0.05, 1), (0.3, 10), (None, 4)])
def test_joint_states_of_two_sources_by_turns_are_the_one_cause_that_is_named(late_s, every, run, arm):
    """The same motion begun later, or (None) a node that knows nothing and publishes zeros."""
    first = 0 if late_s is None else round(200 * late_s)
    here = kept(run, np.arange(first, len(run.time)))
    late = kept(run, np.arange(len(run.time) - first), time=run.time[first:])
    if late_s is None:
        late = replace(run, position=0.0 * run.position, velocity=0.0 * run.velocity, effort=0.0 * run.effort)
    mixed = recording_of(by_turns(here, late, every), None, (Source("mixed.csv", 1, ""),), run.urdf)
    report = check_conventions([mixed], arm)
    (found,) = report.findings
    assert (found.kind, found.level) == ("two_sources", Level.UNFIT) and report.certain
    assert "one node" in found.remedy and "two sources" in found.statement


def test_positions_of_one_source_are_not_of_two(run):
    rng = np.random.default_rng(0)
    noise = rng.standard_normal(run.position.shape)
    slow = run.position[::20]  # 10 Hz
    glitch = run.position.copy()
    glitch[::10, 1] = 0.0  # a false reading of one joint
    coarse = np.round(run.position[:, :1] / 2e-3 + rng.uniform(-0.3, 0.3, (len(noise), 4))) * 2e-3
    one_at_a_time = np.where(np.arange(4) == (np.arange(len(noise)) * 4 // len(noise))[:, None], run.position, 0.0)
    swaps = np.arange(len(noise)).reshape(-1, 2)[:, ::-1].ravel()  # delivered in the wrong order
    for position in (
        run.position,
        run.position + 0.05 * noise,
        slow,
        np.repeat(run.position, 4, axis=0),
        glitch,
        coarse,
        one_at_a_time + 2e-3 * (noise > 1.0),
        run.position[swaps],
    ):
        assert steps_back(position) == 0


def test_temperatures_in_kelvin_are_a_note_and_refused_where_friction_is_to_follow_them(run, arm):
    issue = Issue("temperature_unit", "/joint_temperatures: 9 of 9 readings left out: the unit is °C", 9)
    kelvin = replace(run, issues=(issue,))
    (found,) = check_conventions([kelvin], arm).findings
    assert (found.kind, found.level) == ("temperature_unit", Level.NOTE) and "Celsius" in found.remedy
    with pytest.raises(UnfitDataError, match=r"the unit is °C; publish degrees Celsius"):
        identify([kelvin], arm, Settings(temperature=("f_c",)))


def test_another_arm_than_the_bag_describes_is_said(run):
    longer = tuple(replace(link, xyz=(0, 0, 0.7)) if link.name == "elbow" else link for link in LINKS)
    other = arm_from_urdf(plant(longer, FRICTION, (run.position[:9],) * 3, 200.0).urdf)
    report = check_conventions([run], other)
    said = of_kind(report, "robot_description")[0]
    assert said.joints == ("elbow",) and "200 mm" in said.statement and said.level is Level.UNFIT


def sliding(name: str) -> str:
    """The URDF of the arm on a prismatic torso, whose elbow's origin is turned; `name` is a link that is 0.2 m off."""
    torso = Link(
        "torso",
        kind="prismatic",
        xyz=(0, 0, 0.2),
        axis=(0, 0, 2),
        limit='lower="0" upper="1" effort="900" velocity="1"',
        mass=9.0,
    )
    links = [replace(link, parent="torso") if link.name == "waist" else link for link in LINKS]
    links = [replace(link, rpy=(0.3, -0.2, 0.4)) if link.name == "elbow" else link for link in links]
    return urdf_of(
        [replace(one, xyz=np.add(one.xyz, (0, 0.2, 0))) if one.name == name else one for one in (torso, *links)]
    )


LOCKED = {"torso": 0.35, "shoulder": -0.7}
"""Joints of `sliding` before the arm and within it, and where they are locked."""


def test_an_arm_with_locked_joints_is_the_one_that_the_bag_describes_without_them(run):
    for at in ({}, {"torso": 0.35}, LOCKED, {"wrist": 1.2}):
        arm = arm_from_urdf(locked(sliding(""), at, at))
        assert compare_description(replace(run, urdf=sliding("")), arm) == [], at


@pytest.mark.parametrize(("moved", "joint"), [("torso", "waist"), ("waist", "waist"), ("shoulder", "elbow")])
def test_another_geometry_is_found_behind_joints_that_are_locked(run, moved, joint):
    arm = arm_from_urdf(locked(sliding(moved), LOCKED, LOCKED))
    (said,) = compare_description(replace(run, urdf=sliding("")), arm)
    assert (said.joints, said.level) == ((joint,), Level.UNFIT) and "200 mm" in said.statement


def fixed_in(recording: Recording, *names: str) -> Arm:
    return arm_from_urdf(locked(recording.urdf, names))


@pytest.mark.parametrize(
    ("names", "level"),
    [
        (("waist", "shoulder"), Level.UNFIT),
        (("shoulder",), Level.UNFIT),
        (("wrist",), Level.NOTE),
        (("elbow", "wrist"), Level.NOTE),
    ],
)
def test_a_joint_that_moves_and_is_fixed_in_the_arm_is_found_with_what_it_does_to_the_arm(names, level, run):
    (finding,) = moving_though_fixed(run, fixed_in(run, *names))
    assert (finding.kind, finding.joints, finding.level) == ("fixed_joint_moves", names, level)
    size = np.ptp(run.position[:, NAMES.index(names[0])])
    assert f"{names[0]} by {size:.2g}" in finding.statement and "whole URDF" in finding.remedy


def without_effort(run: Recording, joint: str) -> Recording:
    """The run as it is read where the effort of a joint is NaN in every message."""
    rest = run.in_order(tuple(name for name in run.joints if name != joint))
    own = run.position[:, run.joints.index(joint)]
    return replace(rest, effortless={joint: (float(own.min()), float(own.max()))})


@pytest.mark.parametrize("joint", ["shoulder", "wrist"])
def test_a_joint_that_moves_without_effort_makes_the_data_unfit_wherever_it_is(joint, run):
    bare = without_effort(run, joint)
    report = check_conventions([bare], find_arm(None, None, [bare]))
    assert unfit(report) == [("fixed_joint_moves", (joint,))] and report.certain
    (found,) = report.findings
    assert f"{joint} by" in found.statement and "effort" in found.remedy


def test_a_gripper_that_moves_without_effort_is_a_payload_that_changes(run):
    renamed = replace(run, urdf=run.urdf.replace('name="wrist"', 'name="gripper_jaw"'))
    bare = without_effort(renamed, "wrist")
    bare = replace(bare, effortless={"gripper_jaw": bare.effortless["wrist"]})
    (found,) = moving_though_fixed(bare, find_arm(None, None, [bare]))
    assert (found.joints, found.level) == (("gripper_jaw",), Level.NOTE)


def test_a_joint_that_stands_still_without_effort_is_fixed_where_it_was_recorded(run):
    bare = replace(without_effort(run, "wrist"), effortless={"wrist": (0.699, 0.701)})
    fixed = find_arm(None, None, [bare])
    assert fixed.locked == ("wrist",) and moving_though_fixed(bare, fixed) == []
    expected = arm_from_urdf(locked(run.urdf, ("wrist",), {"wrist": 0.7}))
    assert np.allclose(fixed.joints[-1].inertial, expected.joints[-1].inertial, atol=1e-9)
    assert not np.allclose(fixed.joints[-1].inertial, fixed_in(run, "wrist").joints[-1].inertial, atol=1e-3)


def test_joints_that_move_below_the_arm_make_the_data_unfit_and_nothing_is_inferred_of_them(run):
    report = check_conventions([scaled(run, "effort", 2, -1.0)], fixed_in(run, "waist", "shoulder"))
    assert unfit(report) == [("fixed_joint_moves", ("waist", "shoulder"))] and report.certain
    assert any("carry the arm" in text for text in report.undecided)


def test_a_fixed_joint_that_rests_or_is_of_another_robot_is_not_mentioned(run):
    arm = fixed_in(run, "waist")
    assert not moving_though_fixed(scaled(run, "position", 0, 0.01 / np.ptp(run.position[:, 0])), arm)
    assert not moving_though_fixed(replace(run, joints=("gripper", *NAMES[1:])), arm)


def test_wheels_that_turn_are_asked_about_where_no_sensor_is_on_the_base(run, arm):
    """The bag describes them; the arm's own file, as `new-arm` writes it, has them fixed."""
    wheel = '<joint name="WHEEL" type="TYPE"><parent link="LINK"/><child link="WHEEL_link"/><axis xyz="0 1 0"/></joint>'

    def beside(kind: str, link: str) -> list[Finding]:
        robot = run.urdf
        for name in ("left", "right"):
            own = wheel.replace("WHEEL", name).replace("TYPE", kind).replace("LINK", link)
            robot = robot.replace("</robot>", f'<link name="{name}_link"/>{own}</robot>')
        there = replace(run, urdf=robot, effortless={"left": (0.0, 6.5), "right": (0.0, 6.3)})
        return moving_though_fixed(there, arm_from_urdf(locked(robot, ("left", "right"))))

    (finding,) = beside("continuous", "base")
    assert (finding.joints, finding.level) == (("left", "right"), Level.NOTE)
    assert "drive the base" in finding.statement and "/base_imu" in finding.remedy
    # A pair of slides beside the arm, or what the arm carries, is none.
    assert not beside("prismatic", "base")
    assert all("drive the base" not in one.statement for one in beside("continuous", "wrist_link"))


def test_another_arm_on_the_same_base_may_move(run):
    beside = [*(replace(one, parent="base") if one.name == "elbow" else one for one in LINKS)]
    there = replace(run, urdf=urdf_of(beside))
    assert not moving_though_fixed(there, fixed_in(there, "elbow", "wrist"))


def test_motion_of_a_carrying_joint_that_a_sensor_behind_it_records_is_known(run):
    one = np.zeros((1, 3))
    base = BaseSensor("/imu", "waist_link", time=np.zeros(1), rate=one, force=one, runs=(slice(0, 1),))
    measured = replace(run, base=base)
    assert not moving_though_fixed(measured, fixed_in(run, "waist"))
    (finding,) = moving_though_fixed(measured, fixed_in(run, "waist", "shoulder"))
    assert finding.joints == ("shoulder",)


def test_a_gain_is_called_a_gain_or_a_mass_and_no_broken_convention(run, arm):
    report = check_conventions([scaled(run, "effort", slice(None), 1.7)], arm)
    (finding,) = report.findings
    assert finding.kind in ("effort_gain", "effort_unit") and finding.level is Level.NOTE
    assert "cannot separate" in finding.statement or "CAD" in finding.statement


def test_what_no_data_can_tell_is_listed(run, arm):
    text = " ".join(check_conventions([run], arm).undecided)
    assert "encoder zero of waist" in text


def interrupted(run: Recording, start: float, stop: float, jump: float = 0.0, joint: int = 2) -> Recording:
    """Without what lies between two times, s, and with one joint's position `jump` rad off after it."""
    place = int(np.searchsorted(run.time, start))
    after = int(np.searchsorted(run.time, stop))
    position = run.position.copy()
    position[after:, joint] += jump
    rows = np.r_[0:place, after : len(run.time)]
    cut = kept(replace(run, position=position), rows)
    return replace(cut, velocity=None, segments=(slice(0, place), slice(place, len(rows))))


@pytest.mark.parametrize("joint", [1, 2])
def test_a_zero_that_is_another_one_after_a_gap_makes_the_data_unfit(joint, run, arm):
    report = check_conventions([interrupted(run, 8.0, 13.0, 0.5, joint)], arm)
    (found,) = of_kind(report, "position_jump")
    assert unfit(report) == [("position_jump", (NAMES[joint],))] and report.certain
    assert found.values["jump_rad"] == pytest.approx(0.5, abs=0.05)
    assert found.values["at_s"] == pytest.approx(8.0, abs=0.01)


@pytest.mark.parametrize("seed", [0, 5])
def test_an_arm_that_was_moved_in_a_gap_has_the_zeros_it_had(seed, arm):
    report = check_conventions([interrupted(sound(seed), 8.0, 13.0)], arm)
    assert report.fit and of_kind(report, "position_jump") == []


def test_a_zero_after_a_gap_that_the_motion_there_does_not_tell_is_listed(run, arm):
    cut = interrupted(run, 8.0, 28.5)
    assert any("same before and after the gap" in text for text in check_conventions([cut], arm).undecided)


@pytest.mark.parametrize("segments", [1, 2])
def test_a_step_that_no_speed_covers_is_read_off_with_joint_time_and_size(segments, run, arm):
    """Between two samples, and over a gap of 50 ms, at a joint that may move by 4 rad/s."""
    jumped = interrupted(run, 10.0, 10.05 if segments > 1 else 10.0, -0.5)
    whole = jumped if segments > 1 else replace(jumped, segments=(slice(0, len(jumped.time)),))
    report = check_conventions([whole], arm)
    assert unfit(report)[0] == ("position_jump", ("elbow",)) and report.certain
    assert re.search(r"elbow jumps by -0\.[45]\d+ rad within .* at (9\.99|10\.0)", report.findings[0].statement)
    assert report.findings[0].values["jump_rad"] == pytest.approx(-0.5, abs=0.1)


def test_positions_that_are_wrapped_at_a_turn_are_no_lost_zero(run, arm):
    wrapped = interrupted(run, 10.0, 10.0, 2 * np.pi)
    found = of_kind(check_conventions([replace(wrapped, segments=(slice(0, len(run.time)),))], arm), "position_jump")
    assert "beyond a turn" in found[0].remedy


def test_samples_that_are_lost_while_the_clock_goes_on_are_no_jump_of_an_encoder(run, arm):
    """A third of a second of all joints is missing, and no stamp tells."""
    lost = kept(run, np.r_[0:2000, 2060 : len(run.time)])
    report = check_conventions([replace(lost, velocity=None, time=run.time[: len(lost.time)])], arm)
    assert of_kind(report, "position_jump") == []


def real(name: str) -> Recording:
    """A recording of a real arm, joints in its order."""
    path = REAL / f"{name}.mcap"
    if not path.exists():
        pytest.skip(f"no {path.name} in ../shared/recordings/real")
    recording = read_recording(path)
    return recording.in_order(arm_from_urdf(recording.urdf).joint_names)


@pytest.mark.parametrize(
    "name", ["ur10e/commissioning", "ur10e/field", "tx40/excitation", "airbot/run_1", "panda/run_2"]
)
def test_a_real_recording_is_sound_and_a_torque_sign_in_it_is_found(name):
    ordered = real(name)
    arm = arm_from_urdf(ordered.urdf)
    assert check_conventions([ordered], arm).fit
    found = unfit(check_conventions([scaled(ordered, "effort", 2, -1.0)], arm))
    assert ("effort_sign", (arm.joint_names[2],)) in found


def test_amperes_that_the_masses_take_up_are_another_unit():
    """Lighter links explain a tenth of the torque as well as a unit does; no CAD is wrong by so much."""
    recording = real("ur10e/field").between(2.68, 35.5)
    arm = arm_from_urdf(recording.urdf)
    per_Nm = np.array([0.0797, 0.0772, 0.0892, 0.1166, 0.105, 0.1119])
    report = check_conventions([scaled(recording, "effort", slice(None), per_Nm)], arm)
    assert unfit(report) == [("effort_unit", arm.joint_names)]
    assert "CAD masses: another unit (A?)" in report.findings[0].statement
    assert not unfit(check_conventions([scaled(recording, "effort", slice(None), 0.4)], arm))


def test_torque_sign_is_found_where_the_joint_is_all_residual_and_slow():
    """A wrong sign leaves all of a joint's torque, as slow as the motion: it must not count for less for that."""
    recording = real("panda/run_1").between(0.0, 36.0)
    found = unfit(check_conventions([scaled(recording, "effort", 2, -1.0)], arm_from_urdf(recording.urdf)))
    assert found == [("effort_sign", ("panda_joint3",))]


def test_gravity_along_another_axis_of_a_real_arm_has_figures_that_are_numbers():
    """Under it the gain of all joints runs away in one of the rival explanations."""
    recording = real("tx40/excitation").between(0.47, 8.88)
    report = check_conventions([recording], arm_from_urdf(recording.urdf).with_gravity(np.array([0.0, -9.81, 0.0])))
    assert unfit(report) == [("gravity", ())]
    assert 0.9 < report.findings[0].probability <= 1.0
    json.dumps(report.as_dict(), allow_nan=False)
