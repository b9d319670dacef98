"""`spacearm identify --prior`: a ground result updated by five seconds in orbit, from bags to a result folder."""

from __future__ import annotations

import csv
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from planted_arm import TWO_LINKS, Friction, incommensurate, plant, two_link_run

from spacearm_ident.bayes.from_prior import update
from spacearm_ident.bayes.updated import identify_from_prior
from spacearm_ident.cli.main import main
from spacearm_ident.dynamics.model import IdentifiedModel
from spacearm_ident.estimate.identified import Determination
from spacearm_ident.identification.identify import Settings, identify
from spacearm_ident.identification.validation import validate
from spacearm_ident.nodes.jobs import IdentifyJob
from spacearm_ident.recording import Recording, read_recording, write_recording
from spacearm_ident.results.store import load_prior, load_result
from spacearm_ident.sessions.bags import Options
from spacearm_ident.sessions.identification import find_arm

ON_EARTH = (
    Friction(f_c=5.0, f_b=5.0, k_v1=4.0, k_v2=1.0, k_v3=0.5),
    Friction(f_c=3.0, k_v1=2.0, J_m=0.2, k_v2=0.5, k_v3=0.2),
)
IN_ORBIT = tuple(replace(law, f_c=0.8 * law.f_c, f_b=0.8 * law.static, k_v2=0.0, k_v3=0.0) for law in ON_EARTH)
LEVELS = {"shoulder": 4.0, "elbow": 2.4}


def orbit_run(seed: int, seconds: float, rate: float = 250.0, speed: float = 0.3, gravity=(0.0, 0.0, 0.0)) -> Recording:
    motion = incommensurate(np.arange(0.0, seconds, 1.0 / rate), 2, seed, speed)
    return plant(TWO_LINKS, IN_ORBIT, motion, rate, gravity).recording(0.3, seed)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Bags of the ground and the orbit, the ground's result, and that of five slow seconds in orbit."""
    made = tmp_path_factory.mktemp("prior")
    write_recording(made / "ground.mcap", two_link_run(ON_EARTH, 40.0, 250.0, 1, speed=1.0).recording(0.3))
    write_recording(made / "short.mcap", orbit_run(2, 5.0, 100.0))
    write_recording(made / "next.mcap", orbit_run(4, 5.0))
    ground = ["identify", made / "ground.mcap", "--friction", "paper", "--out", made / "ground"]
    orbit = ["identify", made / "short.mcap", "--gravity", 0, 0, 0, "--prior", made / "ground" / "model.yaml"]
    for words in (ground, [*orbit, "--out", made / "orbit"]):
        assert main([*map(str, words), "--quiet"]) == 0
    return made


def parameters(result: Path) -> dict[tuple[str, str], dict[str, str]]:
    with (result / "parameters.csv").open() as file:
        return {(row["name"], row["joint"]): row for row in csv.DictReader(file)}


def worst(model: IdentifiedModel) -> float:
    """Residual over torque on a faster run than the five seconds had, of the worst joint."""
    validation = validate(model, [orbit_run(3, 20.0, speed=1.0)], "on another run", held_out=True)
    return max(joint.moving.relative_rms for joint in validation.joints.values())


def test_five_seconds_with_the_ground_beat_five_seconds_without(folder):
    run = [read_recording(folder / "short.mcap")]
    prior = load_prior(folder / "ground").under(np.zeros(3))
    updated = identify_from_prior(run, prior)
    vacuum = identify_from_prior(run, prior.in_vacuum())
    alone = identify(run, prior.model.model.arm, Settings(5.0, prior.model.model.structure))
    assert worst(updated.model) < 0.5 * min(worst(alone.model), worst(prior.model))
    assert worst(vacuum.model) < worst(updated.model)
    held = {item.name: item for item in vacuum.estimates}["k_v2[elbow]"]
    assert held.value == 0.0 and held.determination is Determination.FIXED


def test_the_result_says_what_is_the_datas_and_what_the_priors(folder):
    out = folder / "orbit"
    rows, before = parameters(out), parameters(folder / "ground")
    for joint, level in LEVELS.items():
        row = rows["f_c", joint]
        assert row["determined_by"] == "determined by the data" and row["identifiable"] == "yes"
        assert float(row["ci95_low"]) - 0.05 < level < float(row["ci95_high"]) + 0.05
    held = rows["Ixx", "shoulder"]
    assert held["determined_by"] == "from the prior" and held["identifiable"] == "no"
    assert float(held["value"]) == pytest.approx(float(before["Ixx", "shoulder"]["value"]), abs=1e-6)
    # Its weight was known on the ground; in orbit there is none, and what was known stays.
    weighed, then = rows["mcx", "shoulder"], before["mcx", "shoulder"]
    assert then["determined_by"] != "from the prior"
    assert float(weighed["standard_error"]) < 0.05
    assert weighed["determined_by"] == "from the prior"
    result = load_result(out)
    moves = {move.name: move for move in result.identified.moves}
    assert moves["f_c[shoulder]"].before == pytest.approx(5.0, abs=0.3)
    assert moves["f_c[shoulder]"].variance_reduction > 0.95 and moves["f_c[shoulder]"].deviations < -0.4
    page = (out / "report.html").read_text()
    assert "Since the prior" in page and "f_c[shoulder]" in page
    assert not result.validation.held_out and str(folder / "ground") in page


def test_the_intervals_are_the_updates(folder):
    """Those whose coverage `test_from_prior.py` measures, Student's factor included."""
    prior = load_prior(folder / "ground").under(np.zeros(3))
    result = update([read_recording(folder / "short.mcap")], prior)
    rows = parameters(folder / "orbit")
    model = result.model.model
    compared = 0
    for item, (low, high), moved in zip((*model.parameters, *model.constants), result.intervals, result.before > 0):
        row = rows[item.symbol, item.joint]
        if moved:
            assert float(row["ci95_high"]) - float(row["ci95_low"]) == pytest.approx(high - low)
            compared += 1
    assert compared > 20


def test_a_result_is_a_prior_again_and_the_node_takes_it(folder):
    """Five seconds, then five more: the covariance is in the folder, gravity in the model."""
    job = IdentifyJob((folder / "next.mcap",), (), folder / "twice", Options(prior=folder / "orbit"))
    done = job.perform(lambda share, what: None)
    assert f"--prior {folder / 'orbit'}" in job.command
    twice = done.session.identified
    assert not twice.model.model.arm.gravity.any() and twice.moves
    once = load_result(folder / "orbit").identified
    errors = [{e.name: e.standard_error for e in one.estimates}["J_m[elbow]"] for one in (once, twice)]
    assert errors[1] < errors[0]
    assert twice.model.provenance["prior"].startswith(str(folder / "orbit"))
    words = replace(job, options=Options(temperature=("f_c", "k_v1"), estimate_gravity="direction")).command
    assert "--temperature f_c,k_v1 --estimate-gravity direction" in words


def test_bandwidth_is_said_to_be_the_priors_where_none_was_asked_for(folder):
    run = [read_recording(folder / "short.mcap")]
    prior = load_prior(folder / "ground").under(np.zeros(3))
    assert update(run, prior).bandwidth.reason == "the prior's"
    assert update(run, prior, cutoff_hz=4.0).bandwidth.reason == "as asked"


def test_an_arm_file_without_gravity_leaves_the_priors(folder, tmp_path):
    """A log needs a file of the arm; what that does not say of gravity is no statement."""
    run = [read_recording(folder / "short.mcap")]
    prior = load_prior(folder / "orbit")
    (tmp_path / "arm.urdf").write_text(prior.model.model.arm.urdf)
    silent, stated = tmp_path / "silent.yaml", tmp_path / "stated.yaml"
    silent.write_text("schema: spacearm_ident/arm/1\nurdf: arm.urdf\n")
    stated.write_text(silent.read_text() + "gravity_m_s2: [0, 0, -1.62]\n")
    assert not find_arm(tmp_path / "arm.urdf", None, run, prior).gravity.any()
    assert not find_arm(silent, None, run, prior).gravity.any()
    assert find_arm(stated, None, run, prior).gravity.tolist() == [0.0, 0.0, -1.62]
    assert find_arm(stated, (0.0, 0.0, -3.0), run, prior).gravity.tolist() == [0.0, 0.0, -3.0]


def test_gravity_that_is_unknown_is_told_from_masses_that_are_known(folder):
    """Believed the Earth's: it is none, or little and askew."""
    prior = load_prior(folder / "ground")
    result = identify_from_prior([read_recording(folder / "short.mcap")], prior, gravity="vector")
    found = result.environment.gravity
    assert found.vector == (0.0, 0.0, 0.0) and found.errors[[0, 2]].max() < 0.5
    assert list(found.seen) == [True, False, True] and not result.model.model.arm.gravity.any()
    little = (1.0, 0.0, -1.2)
    found = identify_from_prior(
        [orbit_run(5, 5.0, speed=0.6, gravity=little)], prior, gravity="vector"
    ).environment.gravity
    misses = (np.array(found.vector) - little)[[0, 2]] / found.errors[[0, 2]]
    assert np.abs(misses).max() < 4.0 and found.errors[[0, 2]].max() < 0.3


def test_a_prior_is_refused_where_its_covariance_is_not(folder, tmp_path, capsys):
    def refused(prior: Path, *options: str) -> str:
        words = [
            "identify",
            str(folder / "short.mcap"),
            "--prior",
            str(prior),
            *options,
            "--out",
            str(tmp_path / "out"),
        ]
        assert main([*words, "--quiet"]) == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1 and not (tmp_path / "out").exists()
        return error

    shutil.copy(folder / "ground" / "model.yaml", tmp_path / "model.yaml")
    assert "no covariance beside it (result.json)" in refused(tmp_path / "model.yaml")
    shutil.copytree(folder / "ground", tmp_path / "edited")
    model = tmp_path / "edited" / "model.yaml"
    model.write_text(model.read_text() + "# edited\n")
    assert "not the model that the covariance" in refused(model)
    (tmp_path / "edited" / "result.npz").unlink()
    assert "no covariance beside it (result.npz)" in refused(model)
    assert "cannot read the model" in refused(tmp_path / "absent.yaml")
    assert "a prior has its own structure" in refused(folder / "ground", "--friction", "paper")


def test_a_poor_update_says_what_may_have_changed_since_the_prior(folder, tmp_path, capsys):
    """Six kilograms on the last link, of which the prior knows nothing; and none."""
    heavy = (TWO_LINKS[0], replace(TWO_LINKS[1], mass=8.0, com=(0.1, 0.0, 0.25), inertia=(0.1, 0, 0, 0.1, 0, 0.05)))
    motion = incommensurate(np.arange(0.0, 5.0, 0.004), 2, 6, 1.0)
    write_recording(tmp_path / "held.mcap", plant(heavy, IN_ORBIT, motion, 250.0, (0.0, 0.0, 0.0)).recording(0.3, 6))
    words = ["--prior", str(folder / "ground"), "--gravity", "0", "0", "0", "--quiet", "--out"]
    assert main(["identify", str(tmp_path / "held.mcap"), *words, str(tmp_path / "poor")]) == 3
    said = capsys.readouterr().out
    assert "spacearm payload BAG --model PRIOR" in said and "/base_imu" in said
    assert "--estimate-gravity" not in said, "without gravity no base is tilted"
    assert main(["identify", str(folder / "next.mcap"), *words, str(tmp_path / "good")]) == 0
    assert "spacearm payload" not in capsys.readouterr().out
