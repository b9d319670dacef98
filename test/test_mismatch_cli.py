"""`spacearm mismatch` as a user meets it: which file is what, exit codes, one-line errors, folder, JSON."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from planted_arm import TWO_LINKS, Friction, incommensurate, plant, two_link_run

from spacearm_ident.cli.main import main
from spacearm_ident.cli.mismatch import sort_bags, summary
from spacearm_ident.conventions.change import Kind
from spacearm_ident.conventions.finding import ConventionReport, Level
from spacearm_ident.conventions.finding import Finding as Mistake
from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.dynamics.effects import EFFECTS
from spacearm_ident.dynamics.model_file import load_model, save_model
from spacearm_ident.errors import UserError
from spacearm_ident.excitation.constraints import limits_for_excitation
from spacearm_ident.excitation.trajectory_file import load_trajectory
from spacearm_ident.mismatch.finding import NO_MISMATCH, Explanation, unfit
from spacearm_ident.mismatch.run_set import RunSet
from spacearm_ident.recording import read_recording, write_recording
from spacearm_ident.recording.corrections import Corrections, JointCorrection
from spacearm_ident.report.mismatch_folder import write_mismatch
from spacearm_ident.sessions.identification import find_arm
from spacearm_ident.sessions.mistakes import mistakes
from spacearm_ident.sessions.next_run import next_run
from spacearm_ident.signals.prepare import prepare

LAWS = (Friction(k_v2=0.0, k_v3=0.0), Friction(f_c=1.5, k_v1=0.8, k_v2=0.0, k_v3=0.0, J_m=0.1))
FEW = ["--without", *(kind for kind in EFFECTS if kind not in ("torque_ripple", "friction_drift", "current_offset"))]
"""A catalogue of three, to be quick."""


def offset(planted):
    return np.tile([0.0, 1.5], (len(planted.q), 1))


def recording(seed, extra=None, seconds=14.0):
    planted = two_link_run(LAWS, seconds=seconds, rate_hz=250.0, seed=seed, speed=1.0)
    if extra is not None:
        planted = replace(planted, torque=planted.torque + extra(planted))
    return planted.recording(noise=[0.3, 0.15], seed=seed + 100)


@pytest.fixture(scope="module")
def bags(tmp_path_factory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("bags")
    field = recording(2, offset)
    made = {
        "reference": recording(1),
        "field": field,
        "unseen": recording(3, offset),
        "still": replace(field, position=np.tile(field.position[:1], (len(field.time), 1))),
        "stranger": replace(field, joints=("a", "b")),
        "no_urdf": replace(field, urdf=None),
    }
    paths = {name: folder / f"{name}.mcap" for name in made}
    for name, one in made.items():
        write_recording(paths[name], one)
    paths["missing"], paths["text"] = folder / "missing.mcap", folder / "text.mcap"
    paths["text"].write_text("this is not a bag")
    return paths


def run(*words, expect, capsys):
    code = main(["mismatch", *(str(word) for word in words)])
    out, err = capsys.readouterr()
    assert code == expect, err
    return out, err


def test_no_mismatch_is_said_of_the_joints_that_were_compared_alone():
    level = np.array([0.1, 0.1])
    healthy = Explanation(NO_MISMATCH, ("shoulder", "elbow"), level, level, level, level)
    assert "every joint" in summary(healthy, Path("page"), "N m")
    half = summary(replace(healthy, before_Nm=np.array([0.1, np.nan])), Path("page"), "N m").splitlines()[0]
    assert "at shoulder" in half and "nothing is known of the others" in half


# --- which file is what ---------------------------------------------------------------------------------------------

R, V, A, B = (Path(name) for name in "rvab")


@pytest.mark.parametrize(
    ("bags", "reference", "validate", "want"),
    [
        ([A], [], [], ([A], [], [])),
        ([A, B], [[R]], [[V]], ([A, B], [R], [V])),
        ([A], [[R], [B]], [], ([A], [R, B], [])),
        ([A], [[R, B]], [], ([A], [R, B], [])),
        ([], [[R, A]], [], ([A], [R], [])),
        ([], [[R, A, B]], [], ([A, B], [R], [])),
        ([], [[R, A, B]], [[V]], ([A, B], [R], [V])),
        ([], [[R]], [[V, A]], ([A], [R], [V])),
        ([], [[B], [R, A]], [], ([A], [B, R], [])),
    ],
)
def test_what_the_options_swallowed_is_given_back(bags, reference, validate, want):
    assert sort_bags(bags, reference, validate) == want


@pytest.mark.parametrize(("reference", "validate"), [([], []), ([[R]], []), ([[R]], [[V]]), ([], [[V]])])
def test_nothing_to_explain_is_an_error(reference, validate):
    with pytest.raises(UserError, match="no bag to explain"):
        sort_bags([], reference, validate)


# --- the folder -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def answered(bags, tmp_path_factory):
    """The contract's own order of words: --reference R BAG --validate V."""
    folder = tmp_path_factory.mktemp("why") / "out"
    words = ["mismatch", "--reference", bags["reference"], bags["field"], "--validate", bags["unseen"], "--out", folder]
    assert main([str(word) for word in [*words, "--quiet", *FEW]]) == 0
    return folder


def test_the_folder_has_what_the_contract_names(answered, bags):
    assert {"mismatch.json", "extended_model.yaml", "report.html"} <= {path.name for path in answered.iterdir()}
    document = json.loads((answered / "mismatch.json").read_text())
    assert document["verdict"] == "mismatch" and document["model"] == "extended_model.yaml"
    assert [(f["effect"], f["joints"]) for f in document["findings"]] == [("current_offset", ["elbow"])]
    same = document["findings"][0]["alternatives"][0]
    assert (same["effect"], same["score"]) == ("asymmetric_friction", 1.0) and "brakes on" in same["why_not"]
    found = document["findings"][0]["parameters"]["offset"]
    assert found["value"] == pytest.approx(1.5, abs=0.1)
    sources = document["provenance"]
    assert [entry["path"] for entry in sources["reference"]] == [str(bags["reference"])]
    assert "current_offset" in (answered / "report.html").read_text()


def test_the_extended_model_loads_and_predicts_what_the_base_does_not(answered, bags):
    model = load_model(answered / "extended_model.yaml")
    (motion,), _ = prepare([read_recording(bags["unseen"])], ("shoulder", "elbow"), 20.0, average=False)
    whole = model.torque(motion)
    base = model.torque(motion, [kind for kind in model.model.structure if kind not in EFFECTS])
    assert np.isfinite(whole).all()
    np.testing.assert_allclose((whole - base)[:, 1], model.value("offset", "elbow"))
    left = [
        np.sqrt(np.mean(motion.reduce(motion.torque - torque)[motion.moving[:, 1], 1] ** 2)) for torque in (whole, base)
    ]
    assert left[0] < 0.2 * left[1]


def test_the_next_experiment_is_a_motion_that_the_arm_can_make(bags, tmp_path):
    field = read_recording(bags["field"])
    arm = find_arm(None, None, [field])
    nothing = unfit(arm.joint_names, ())
    assert next_run(nothing, arm, field) is None
    doubt = replace(nothing, next_experiment="words", next_effect="torque_ripple", next_joints=("elbow",))
    run = next_run(doubt, arm, field)
    motion = run.evaluate(np.arange(0.0, run.duration_s, 0.01))
    limits, _ = limits_for_excitation(arm, field.position[0])
    np.testing.assert_allclose(motion.q[[0, -1]], field.position[[0, 0]])
    assert limits.usage(motion).max() <= 1.0
    assert np.ptp(motion.q[:, 1]) > 1.0 and np.ptp(motion.q[:, 0]) < np.ptp(motion.q[:, 1])
    write_mismatch(doubt, arm, RunSet([field]), run, tmp_path / "why")
    assert load_trajectory(tmp_path / "why" / "next_experiment.yaml").duration_s == pytest.approx(run.duration_s)
    write_mismatch(nothing, arm, RunSet([field]), None, tmp_path / "why")
    assert not (tmp_path / "why" / "next_experiment.yaml").exists()


def test_json_is_all_there_is_on_standard_output(bags, tmp_path, capsys):
    model = tmp_path / "model.yaml"
    words = (bags["field"], "--out", tmp_path / "why", "--json", *FEW)
    out, _ = run(*words, "--reference", bags["reference"], "--validate", bags["unseen"], expect=0, capsys=capsys)
    first = json.loads(out)
    written = json.loads((tmp_path / "why" / "mismatch.json").read_text())
    assert first == {key: value for key, value in written.items() if key != "provenance"}
    # The same with the reference as a model file.
    extended = load_model(tmp_path / "why" / "extended_model.yaml")
    healthy = {kind: options for kind, options in extended.model.structure.items() if kind not in EFFECTS}
    count = len(extended.model.parameters) - 1
    bare = replace(extended, model=replace(extended.model, structure=healthy), parameters=extended.parameters[:count])
    save_model(bare, model)
    out, _ = run(*words, "--reference", model, "--validate", bags["unseen"], expect=0, capsys=capsys)
    assert [f["effect"] for f in json.loads(out)["findings"]] == ["current_offset"]


def test_a_person_reads_a_summary_and_where_the_page_is(bags, tmp_path, capsys):
    words = (bags["unseen"], "--reference", bags["reference"], "--validate", bags["field"], "--out", tmp_path / "why")
    out, _ = run(*words, *FEW, expect=0, capsys=capsys)
    assert out.startswith("mismatch: current_offset at elbow\n")
    assert f"report: {tmp_path / 'why' / 'report.html'}" in out


def test_a_healthy_arm_is_no_mismatch_and_has_no_extended_model(bags, tmp_path, capsys):
    write_recording(tmp_path / "healthy.mcap", recording(4))
    (tmp_path / "why").mkdir()
    (tmp_path / "why" / "extended_model.yaml").write_text("of another run")
    words = (tmp_path / "healthy.mcap", "--reference", bags["reference"], "--out", tmp_path / "why", "--json", *FEW)
    out, _ = run(*words, expect=0, capsys=capsys)
    document = json.loads(out)
    assert document["verdict"] == "no_mismatch" and document["findings"] == [] and document["model"] is None
    assert not (tmp_path / "why" / "extended_model.yaml").exists()
    assert (tmp_path / "why" / "report.html").exists()


def test_model_of_the_ground_is_a_reference_in_orbit(bags, tmp_path, capsys):
    """Nothing but gravity differs: the model is carried over to the gravity that is given."""
    time = np.arange(0.0, 14.0, 1.0 / 250.0)
    for seed in (2, 3):
        planted = plant(TWO_LINKS, LAWS, incommensurate(time, 2, seed, 1.0), 250.0, gravity=(0.0, 0.0, 0.0))
        write_recording(tmp_path / f"orbit_{seed}.mcap", planted.recording(noise=[0.3, 0.15], seed=seed + 100))
    assert main(["identify", str(bags["reference"]), "--out", str(tmp_path / "ground")]) == 0
    words = (tmp_path / "orbit_2.mcap", "--validate", tmp_path / "orbit_3.mcap", "--gravity", 0, 0, 0, "--json")
    capsys.readouterr()
    model = tmp_path / "ground" / "model.yaml"
    out, _ = run(*words, "--reference", model, "--out", tmp_path / "why", *FEW, expect=0, capsys=capsys)
    assert json.loads(out)["verdict"] == "no_mismatch"


# --- conventions ----------------------------------------------------------------------------------------------------


def test_a_joint_in_degrees_is_unfit_data_with_its_remedy(bags, tmp_path, capsys):
    field = read_recording(bags["field"])
    write_recording(tmp_path / "wrong.mcap", replace(field, position=field.position * [1.0, np.degrees(1.0)]))
    words = (tmp_path / "wrong.mcap", "--reference", bags["reference"], "--out", tmp_path / "why", *FEW)
    out, _ = run(*words, expect=1, capsys=capsys)
    assert out.startswith("data unfit") and "degrees" in out and "wrong.mcap" in out
    assert "degrees" in (tmp_path / "why" / "report.html").read_text()


def finding_of(kind, log_odds, joints=("elbow",), level=Level.UNFIT, **undo):
    corrections = Corrections({joint: JointCorrection(**undo) for joint in joints} if undo else {})
    return Mistake(
        str(kind), level, joints, f"{kind} found", "mend it", log_odds=log_odds, recordings=("recording",),
        corrections=corrections,
    )  # fmt: skip


def reasons_of(monkeypatch, field, in_field, in_reference):
    """Reasons of `mistakes` where the check says this of field and reference (None: there is no reference)."""

    def check(recordings, arm, progress):
        return ConventionReport(tuple(in_field if recordings[0] is field else in_reference), (), ("recording",))

    monkeypatch.setattr("spacearm_ident.sessions.mistakes.check_conventions", check)
    return mistakes(RunSet([field], [] if in_reference is None else [recording(1)]), arm_from_urdf(field.urdf))


@pytest.mark.parametrize(
    ("in_field", "in_reference", "refused"),
    [
        ([finding_of(Kind.JOINTS_EXCHANGED, 22.0)], [finding_of(Kind.JOINTS_EXCHANGED, 22.0)], 0),
        ([finding_of(Kind.JOINTS_EXCHANGED, 22.0)], None, 0),
        ([finding_of(Kind.JOINTS_EXCHANGED, 60.0)], None, 1),
        ([finding_of(Kind.JOINTS_EXCHANGED, 60.0)], [finding_of(Kind.JOINTS_EXCHANGED, 60.0)], 1),
        ([], [finding_of(Kind.EFFORT_SIGN, 60.0)], 1),
        ([finding_of("robot_description", None)], None, 1),
        ([finding_of("robot_description", None)], [], 1),
        ([finding_of("position_jump", None)], [], 1),
        ([finding_of(Kind.EFFORT_SIGN, 60.0, level=Level.NOTE)], [], 0),
        ([finding_of(kind, 200.0) for kind in (Kind.EFFORT_GAIN, Kind.GRAVITY, Kind.ENCODER_ZERO, Kind.DELAY)], [], 0),
    ],
)
def test_a_mistake_counts_where_it_is_certain_or_the_reference_has_it_not(monkeypatch, in_field, in_reference, refused):
    """What the catalogue names itself, a gain or a tilt, is never a mistake of convention here."""
    reasons = reasons_of(monkeypatch, recording(2), in_field, in_reference)
    assert len(reasons) == refused
    assert all(text.startswith("recording: ") and text.endswith("-> mend it") for text in reasons)


EXCHANGED = replace(recording(2), position=recording(2).position[:, ::-1], effort=recording(2).effort[:, ::-1])
AMPERES = replace(recording(2), effort=recording(2).effort / 20.0)
BOTH = ("shoulder", "elbow")


@pytest.mark.parametrize(
    ("field", "in_field", "refused"),
    [
        (EXCHANGED, [replace(finding_of(Kind.JOINTS_EXCHANGED, 22.0, BOTH), corrections=Corrections({
            "shoulder": JointCorrection(position_from="elbow", effort_from="elbow"),
            "elbow": JointCorrection(position_from="shoulder", effort_from="shoulder"),
        }))], True),
        (recording(2), [finding_of(Kind.EFFORT_SIGN, 22.0, effort_scale=-1.0)], False),
        (recording(2), [finding_of(Kind.EFFORT_UNIT, 200.0, BOTH, effort_scale=20.0)], False),
        (AMPERES, [finding_of(Kind.EFFORT_UNIT, 200.0, BOTH, effort_scale=9.0)], True),
    ],
    ids=["exchanged", "sound, called a sign", "sound, called amperes", "amperes, by another factor"],
)  # fmt: skip
def test_what_cad_makes_look_like_a_mistake_is_tested_on_the_healthy_arm(monkeypatch, field, in_field, refused):
    reasons = reasons_of(monkeypatch, field, in_field, [])
    assert len(reasons) == refused
    assert all("mend it; the reference does not need it" in reason for reason in reasons)


def test_torque_in_another_unit_than_the_reference_s_is_told_whatever_cad_says(monkeypatch):
    (reason,) = reasons_of(monkeypatch, AMPERES, [], [])
    data = yaml.safe_load(reason.partition("arm YAML: corrections: ")[2].partition("; the reference")[0])
    assert {name: one["effort_scale"] for name, one in data["joints"].items()} == pytest.approx(
        {"shoulder": 20.0, "elbow": 20.0}, rel=0.1
    )
    # Three times the torque is a heavier arm, or a torque constant.
    assert not reasons_of(monkeypatch, replace(recording(2), effort=recording(2).effort * 3.0), [], [])


def test_reference_under_another_gravity_than_the_field_is_refused_with_what_to_do(monkeypatch):
    tilted = finding_of(Kind.GRAVITY, 60.0)
    (reason,) = reasons_of(monkeypatch, recording(2), [], [tilted])
    assert "identify the reference by itself with mend it, and give its model.yaml as the reference" in reason
    assert not reasons_of(monkeypatch, recording(2), [tilted], [tilted]), "both stand alike"
    assert not reasons_of(monkeypatch, recording(2), [], [replace(tilted, log_odds=40.0)]), "identify would not refuse"


# --- what goes wrong ------------------------------------------------------------------------------------------------


def test_data_that_cannot_carry_the_question_end_with_one_and_a_reason(bags, tmp_path, capsys):
    words = (bags["still"], "--reference", bags["reference"], "--out", tmp_path / "why")
    out, _ = run(*words, expect=1, capsys=capsys)
    assert "data unfit" in out and f"{bags['still']}: no joint moves" in out
    document = json.loads((tmp_path / "why" / "mismatch.json").read_text())
    assert document["verdict"] == "data_unfit" and document["findings"] == []
    assert not (tmp_path / "why" / "extended_model.yaml").exists()
    assert "no joint moves" in (tmp_path / "why" / "report.html").read_text()


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        ("--out OUT", "no bag to explain"),
        ("--reference reference --out OUT", "no bag to explain"),
        ("field --out OUT --without gremlins", "no effect 'gremlins'"),
        ("missing --out OUT", "missing.mcap"),
        ("text --out OUT", "text.mcap"),
        ("no_urdf --out OUT", "--arm"),
        ("field --reference stranger --out OUT", "shoulder"),
        ("field --reference reference nowhere.yaml --out OUT", "not both"),
        ("field --reference nowhere.yaml --out OUT", "nowhere.yaml"),
    ],
)
def test_errors_are_one_line_and_leave_no_folder(words, complaint, bags, tmp_path, capsys):
    named = [bags.get(word, tmp_path / "out" if word == "OUT" else word) for word in words.split()]
    # --quiet: on a busy machine the progress lines, one each ten seconds, would stand before the error.
    out, err = run(*named, "--quiet", expect=2, capsys=capsys)
    assert complaint in err and err.count("\n") == 1 and "Traceback" not in err
    assert out == "" and not (tmp_path / "out").exists()


def test_the_arm_of_the_planted_runs_is_the_one_in_their_bags(bags):
    assert tuple(link.name for link in TWO_LINKS) == read_recording(bags["field"]).joints
