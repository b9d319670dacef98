"""Commissioned on the ground, sent to orbit: the model falls there, adapts, and names what moved it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from planted_arm import TWO_LINKS, Friction, incommensurate, plant, urdf_of

from spacearm_ident.bayes.adaptation import adapt
from spacearm_ident.bayes.adaptation_causes import causes
from spacearm_ident.bayes.from_prior import GroundPrior
from spacearm_ident.cli import demo_orbit
from spacearm_ident.cli.main import main
from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.dynamics.model import IdentifiedModel, TorqueModel, structure_of
from spacearm_ident.dynamics.model_file import load_model
from spacearm_ident.errors import UserError
from spacearm_ident.estimate.identified import Identified
from spacearm_ident.identification.identify import Settings, identify
from spacearm_ident.recording import Recording, read_recording, write_recording
from spacearm_ident.recording.recording import Series
from spacearm_ident.sessions.orbit import OrbitSession, orbit_session

JOINTS = ("shoulder", "elbow")
RATE = 250.0
# Out of the vertical plane for one joint, so that gravity is felt in all directions.
LINKS = (TWO_LINKS[0], replace(TWO_LINKS[1], axis=(1.0, 0.0, 0.0)))
GROUND = (
    Friction(f_c=5.0, k_v1=4.0, k_v2=0.8, k_v3=-0.3, J_m=0.5),
    Friction(f_c=3.0, k_v1=2.0, k_v2=0.5, k_v3=0.2, J_m=0.2),
)
ALPHA, DRIFT = (-0.03, -0.02), (1.0, 0.5)
ORBIT_C = (-40.0, -10.0, 30.0, 60.0)
WEIGHTLESS = np.zeros(3)


def run(
    seed: int,
    celsius: float = 20.0,
    seconds: float = 10.0,
    orbit: bool = True,
    alpha: Sequence[float] = ALPHA,
    drift: Sequence[float] = DRIFT,
    vacuum: bool = True,
) -> Recording:
    """A run of the arm on the ground or in orbit; torque computed by Pinocchio, friction written out."""
    laws = GROUND
    if orbit:
        gone = {"k_v2": 0.0, "k_v3": 0.0} if vacuum else {}
        laws = tuple(
            replace(law, f_c=law.f_c + d + a * (celsius - 20.0), **gone) for law, a, d in zip(laws, alpha, drift)
        )
    motion = incommensurate(np.arange(0.0, seconds, 1.0 / RATE), 2, seed, 1.5)
    planted = plant(LINKS, laws, motion, RATE, (0.0, 0.0, 0.0) if orbit else (0.0, 0.0, -9.81))
    recording = planted.recording(0.15, seed=1000 + seed, encoder=1e-6)
    clock = np.arange(0.0, seconds, 0.5)
    rng = np.random.default_rng(seed)
    warm = {joint: Series(clock, celsius + 0.05 * rng.standard_normal(len(clock))) for joint in JOINTS}
    return replace(recording, temperatures=warm)


@pytest.fixture(scope="module")
def arm():
    return arm_from_urdf(urdf_of(LINKS))


@pytest.fixture(scope="module")
def settings(arm) -> Settings:
    return Settings(structure=structure_of(arm))


@pytest.fixture(scope="module")
def ground(arm, settings) -> Identified:
    return identify([run(1, seconds=20.0, orbit=False)], arm, settings)


@pytest.fixture(scope="module")
def session(arm, settings, tmp_path_factory) -> OrbitSession:
    return orbit_session(
        ([run(1, seconds=20.0, orbit=False)], [run(2, orbit=False)]),
        ([run(3 + k, celsius) for k, celsius in enumerate(ORBIT_C)], [run(9, -25.0), run(10, 45.0)]),
        arm,
        WEIGHTLESS,
        tmp_path_factory.mktemp("orbit") / "result",
        settings=settings,
    )


def r(validation) -> list[float]:
    return [joint.everything.correlation for joint in validation.joints.values()]


def test_the_model_falls_in_orbit_and_recovers_once_adapted(session):
    assert min(r(session.ground)) > 0.97 and min(r(session.adapted)) > 0.97
    assert min(r(session.unadapted)) < 0.9
    assert session.shortfall is None
    for joint in JOINTS:
        before, after = (one.joints[joint].everything for one in (session.weightless, session.adapted))
        assert after.rmse < 0.5 * before.rmse


def test_every_cause_is_named_with_its_size(session):
    said = {cause.name: cause for cause in causes(session.adaptation)}
    assert [said[name].found for name in ("gravity", "vacuum", "temperature", "friction level", "rigid bodies")] == [
        True,
        True,
        True,
        True,
        False,
    ]
    moved = {(change.symbol, change.joint): change for change in session.adaptation.changes}
    for joint, alpha, drift, law in zip(JOINTS, ALPHA, DRIFT, GROUND):
        slope, level = moved["alpha_c", joint], moved["f_c", joint]
        assert slope.moved and abs(slope.after - alpha) < 4 * slope.after_error < 0.3 * abs(alpha)
        assert level.moved and abs(level.change - drift) < 4 * level.change_error < drift
        # Nothing was planted there.
        assert not moved["k_v1", joint].moved and not moved["alpha_v", joint].moved
        for symbol in ("k_v2", "k_v3"):
            assert abs(moved[symbol, joint].after) < 4 * moved[symbol, joint].after_error
        assert session.adaptation.levels.correlation(JOINTS.index(joint)) < -0.98
        assert law.f_c == pytest.approx(level.before, abs=4 * level.before_error)
    share = session.adaptation.vacuum
    assert abs(share.value - 1.0) < 4 * share.error < 0.5
    assert np.all(np.abs(session.adaptation.gravity) < 4 * session.adaptation.gravity_error)
    assert np.all(session.adaptation.gravity_error < 0.1)


def test_the_page_and_the_files_say_it(session):
    folder = session.page.parent
    page = session.page.read_text()
    assert page.index("Adapted: R is") < page.index("Why it moved") < page.index("What moved, and by how much")
    assert page.count("<svg") == 2 and "alpha_c" in page
    document = json.loads((folder / "orbit.json").read_text())
    assert document["schema"] == "spacearm_ident/orbit/1" and document["adapted"] is True
    assert {cause["cause"] for cause in document["causes"] if cause["found"]} >= {"vacuum", "temperature"}
    model = load_model(folder / "model.yaml")
    assert not model.model.arm.gravity.any()
    assert model.value("alpha_c", "shoulder") == session.adaptation.adapted.value("alpha_c", "shoulder")
    assert (folder / "ground" / "report.html").exists()


def test_what_did_not_happen_is_not_claimed(ground):
    """Zero gravity alone: no temperature law, air, friction as it was."""
    none = (0.0, 0.0)
    runs = [run(3 + k, celsius, alpha=none, drift=none, vacuum=False) for k, celsius in enumerate(ORBIT_C)]
    adaptation = adapt(GroundPrior.of(ground), runs, WEIGHTLESS)
    said = {cause.name: cause.found for cause in causes(adaptation)}
    assert said == {
        "gravity": True,
        "vacuum": False,
        "temperature": False,
        "friction level": False,
        "rigid bodies": False,
    }
    assert not any(change.moved for change in adaptation.changes)


def test_a_wrong_gravity_is_noticed(ground):
    """On the moon while zero gravity was set: the torque says so."""
    wrong = replace(run(3), effort=run(3).effort + moon(3))
    said = causes(adapt(GroundPrior.of(ground), [wrong], WEIGHTLESS))[0]
    assert said.found is None and "check the gravity" in said.why


def moon(seed: int) -> np.ndarray:
    """What lunar gravity adds to the torque of a run."""
    motion = incommensurate(np.arange(0.0, 10.0, 1.0 / RATE), 2, seed, 1.5)
    heavy, none = (plant(LINKS, GROUND, motion, RATE, (0.0, 0.0, g)).torque for g in (-1.62, 0.0))
    return heavy - none


def test_one_temperature_leaves_alpha_out(ground):
    adaptation = adapt(GroundPrior.of(ground), [run(3, -40.0)], WEIGHTLESS)
    assert not any(change.symbol.startswith("alpha") for change in adaptation.changes)
    assert causes(adaptation)[2].found is None


def test_a_model_without_friction_is_refused(arm):
    bare = TorqueModel(arm, {"rigid_body": {}})
    values = np.array([parameter.prior for parameter in bare.parameters])
    prior = GroundPrior(IdentifiedModel(bare, values, np.zeros(0), 10.0), np.eye(len(values)))
    with pytest.raises(UserError, match=r"no f_c\[elbow\]"):
        adapt(prior, [run(3)], WEIGHTLESS)


def test_runs_to_judge_on_are_asked_for(arm, settings, tmp_path):
    with pytest.raises(UserError, match="runs to judge on"):
        orbit_session(([run(1)], []), ([run(3)], [run(4)]), arm, WEIGHTLESS, tmp_path, settings=settings)


def computed(wrong: bool):
    """In place of the demo's simulation: the small arm's bags; `wrong`: judged on noise."""

    def record_runs(out, arm, report):
        unseen = [run(9, -25.0)]
        if wrong:
            unseen = [replace(one, effort=np.random.default_rng(0).standard_normal(one.effort.shape)) for one in unseen]
        groups = {
            "ground": [run(1, seconds=20.0, orbit=False)],
            "ground_unseen": [run(2, orbit=False)],
            "orbit": [run(3 + k, celsius) for k, celsius in enumerate(ORBIT_C)],
            "orbit_unseen": unseen,
        }
        bags = {}
        for group, recordings in groups.items():
            for number, one in enumerate(recordings):
                write_recording(out / f"{group}_{number}.mcap", one)
                bags.setdefault(group, []).append(read_recording(out / f"{group}_{number}.mcap"))
        return bags

    return record_runs


@pytest.mark.parametrize(("wrong", "code"), [(False, 0), (True, 1)])
def test_the_demo_ends_with_what_it_found(arm, tmp_path, monkeypatch, capsys, wrong, code):
    monkeypatch.setattr(demo_orbit, "load_arm", lambda path: arm)
    monkeypatch.setattr(demo_orbit, "record_runs", computed(wrong))
    assert main(["demo", "--orbit", "--quiet", "--out", str(tmp_path)]) == code
    out, err = capsys.readouterr()
    assert "alpha_c[shoulder]" in out and "vacuum: yes" in out and "temperature: yes" in out
    assert json.loads((tmp_path / "orbit.json").read_text())["provenance"]["fitted_on"]
    assert (tmp_path / "report.html").exists()
    if wrong:
        assert "in orbit, adapted, not above 0.97" in err


def test_the_orbit_demo_has_no_short_form(tmp_path, capsys):
    assert main(["demo", "--orbit", "--fast", "--out", str(tmp_path / "out")]) == 2
    assert "no shorter form" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
