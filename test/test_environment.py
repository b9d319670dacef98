"""Temperature, vacuum: what is planted is found again, what is missing is said, tests err as often as they say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planted_arm import TWO_LINKS, Friction, incommensurate, plant, two_link_run, urdf_of

from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.dynamics.base_parameters import base_parameters
from spacearm_ident.dynamics.model import TorqueModel, over_temperature, structure_of, temperature_joints
from spacearm_ident.dynamics.term import Parameter
from spacearm_ident.errors import UserError
from spacearm_ident.estimate.environment import Environment, HighOrder, VacuumTest, holm, judge_vacuum, wald
from spacearm_ident.estimate.identified import Determination
from spacearm_ident.identification.identify import Settings, identify
from spacearm_ident.recording.recording import Recording, Series
from spacearm_ident.sessions.bags import Options

ARM = arm_from_urdf(urdf_of(TWO_LINKS))
BARE = Friction(f_c=0.0, k_v1=0.0, k_v2=0.0, k_v3=0.0)
TRUTH = {
    "shoulder": {"f_c": 5.0, "f_b": 9.0, "v_b": 0.12, "k_v1": 4.0, "alpha_c": -0.04, "alpha_v": -0.05, "Q_10": 0.7},
    "elbow": {"f_c": 3.0, "f_b": 6.0, "v_b": 0.10, "k_v1": 2.0, "alpha_c": 0.03, "alpha_v": -0.03, "Q_10": 1.3},
}
BASE = {
    "rigid_body": {},
    "rotor_inertia": {},
    "stribeck_friction": {"presliding": False},
    "viscous_friction": {"vacuum": True},
}


def warm_run(missing: tuple[str, ...] = (), ratio: bool = True) -> Recording:
    """60 s in which one joint warms up and the other cools down; friction follows as `TRUTH` has it (v_b: `ratio`)."""
    rate = 250.0
    time = np.arange(0.0, 60.0, 1.0 / rate)
    motion = incommensurate(time, 2, 3, 0.5)
    run = plant(TWO_LINKS, (BARE, BARE), motion, rate)
    warm = {"shoulder": 15.0 + 0.5 * time, "elbow": 45.0 - 0.4 * time}
    torque = run.torque.copy()
    for k, (joint, law) in enumerate(TRUTH.items()):
        v, excess = motion[1][:, k], warm[joint] - 20.0
        width = law["v_b"] * (law["Q_10"] if ratio else 1.0) ** (excess / 10.0)
        level = law["f_c"] + law["alpha_c"] * excess + (law["f_b"] - law["f_c"]) * np.exp(-((v / width) ** 2))
        torque[:, k] += level * np.sign(v) + (law["k_v1"] + law["alpha_v"] * excess) * v
    clock = slice(None, None, 50)
    temperatures = {j: Series(time[clock], t[clock]) for j, t in warm.items() if j not in missing}
    return replace(replace(run, torque=torque).recording(0.1, 4), temperatures=temperatures)


def test_friction_over_temperature_is_found_again():
    result = identify([warm_run()], ARM, Settings(20.0, BASE, temperature=("f_c", "k_v1", "v_b")))
    found = {(item.joint, item.symbol): item for item in result.estimates}
    for joint, law in TRUTH.items():
        for symbol, truth in law.items():
            item = found[joint, symbol]
            assert item.determination is Determination.DATA, item
            assert abs(item.value - truth) < 4 * item.standard_error, item
        assert found[joint, "Q_10"].standard_error < 0.1
        assert found[joint, "alpha_c"].standard_error < 0.01
    assert result.environment.no_temperature == ()


def test_temperatures_that_are_missing_are_said_to_be():
    """One joint has none: that one's friction is known as it was in the run, the other's over temperature."""
    settings = Settings(20.0, BASE, temperature=("f_c", "k_v1"))
    result = identify([warm_run(("elbow",), ratio=False)], ARM, settings)
    assert result.environment.no_temperature == ("elbow",)
    assert any("no temperature of elbow" in note and "/joint_temperatures" in note for note in result.notes)
    found = {(item.joint, item.symbol): item for item in result.estimates}
    assert found["elbow", "alpha_c"].determination is Determination.PRIOR and found["elbow", "alpha_c"].value == 0.0
    assert abs(found["shoulder", "alpha_v"].value - TRUTH["shoulder"]["alpha_v"]) < 0.02


def test_terms_over_temperature_are_those_asked_for():
    paper = structure_of(ARM)
    assert over_temperature(paper, ARM, ()) == paper
    wider = TorqueModel(ARM, over_temperature(paper, ARM, ("v_b", "k_v1")))
    assert {p.symbol for p in wider.parameters} - {p.symbol for p in TorqueModel(ARM, paper).parameters} == {"alpha_v"}
    assert {c.symbol for c in wider.constants} == {"v_b", "d_s", "Q_10"}
    assert temperature_joints(wider.structure, ARM) == ARM.joint_names and temperature_joints(paper, ARM) == ()
    with pytest.raises(UserError, match="no v_b"):
        over_temperature(structure_of(ARM, "coulomb-viscous"), ARM, ("v_b",))
    with pytest.raises(UserError, match="choose among f_c"):
        over_temperature(paper, ARM, ("J_m",))


def test_settings_refuse_what_does_not_go_together(tmp_path):
    assert Options(temperature=("f_c",), estimate_gravity="vector").settings(ARM).structure is None
    with pytest.raises(UserError, match="'J_m' over temperature"):
        Options(temperature=("J_m",)).settings(ARM)
    with pytest.raises(UserError, match="leave out temperature f_c"):
        Options(structure=tmp_path / "model.yaml", temperature=("f_c",)).settings(ARM)
    with pytest.raises(UserError, match="choose one of vector"):
        Options(estimate_gravity="size").settings(ARM)
    with pytest.raises(UserError, match="pso-lm does not estimate friction over temperature"):
        identify([warm_run()], ARM, Options(solver="pso-lm", temperature=("f_c",)).settings(ARM))


def test_a_slope_over_temperature_is_a_base_parameter():
    """Some motion shows it: one that is warm."""
    model = TorqueModel(ARM, over_temperature(structure_of(ARM), ARM, ("f_c",)))
    numbers = [k for k, parameter in enumerate(model.parameters) if parameter.symbol == "alpha_c"]
    base = base_parameters(model)
    assert len(numbers) == 2 and all(base.alone(k) for k in numbers)


class TestVacuum:
    @pytest.mark.parametrize("freedom", [5, 40])
    def test_wald_rejects_what_is_zero_as_often_as_it_says(self, freedom):
        """Exactly F: covariance known but for its size, which is estimated with as many degrees of freedom."""
        rng = np.random.default_rng(freedom)
        root = np.array([[1.0, 0.0], [30.0, 4.0]])
        draws = 2000
        size = rng.chisquare(freedom, draws) / freedom
        p = [wald(root @ rng.standard_normal(2), scale * root @ root.T, freedom)[1] for scale in size]
        for level in (0.01, 0.05, 0.3):
            assert np.mean(np.array(p) < level) == pytest.approx(level, abs=4 * np.sqrt(level / draws))

    def test_wald_of_one_value_is_the_square_of_students_t(self):
        assert wald(np.array([3.0]), np.array([[4.0]]), 7.0)[0] == pytest.approx(2.25)

    def test_holm_is_between_one_test_and_bonferroni(self):
        assert holm([0.03]) == [True]
        assert holm([0.02, 0.001, 0.9]) == [True, True, False]
        assert holm([0.02, 0.03, 0.04]) == [False, False, False]

    def test_joints_are_told_apart_and_rest_is_left_open(self):
        parameters = [Parameter(s, j, "") for j in ("a", "b", "c") for s in ("k_v1", "k_v2", "k_v3")]
        values = np.array([5.0, 0.5, 0.1, 5.0, 0.01, 0.01, 5.0, 0.5, 0.5])
        errors = np.array([0.1, 0.02, 0.02, 0.1, 0.02, 0.02, 0.1, 2.0, 2.0])
        freedom = dict.fromkeys("abc", 100.0)
        verdict = judge_vacuum(parameters, values, np.diag(errors**2), np.full(9, 4.0), freedom)
        assert [(one.joint, one.differs) for one in verdict.joints] == [("a", True), ("b", False)]
        assert verdict.unseen == ("c",)
        assert verdict.words.startswith("k_v2, k_v3 differ from 0 at a") and "not at b" in verdict.words
        assert judge_vacuum(parameters[:1], values[:1], np.eye(1), np.ones(1), freedom) is None

    def test_identified_arms_with_and_without_are_told_apart(self):
        """Twenty runs without: denied at about the 5 % that the test says. Three with: never missed."""
        structure = {"rigid_body": {}, "rotor_inertia": {}, "viscous_friction": {}}
        structure["stribeck_friction"] = {"stribeck": False, "presliding": False}

        def verdict(k_v2: float, k_v3: float, seed: int) -> dict[str, HighOrder]:
            elbow = Friction(f_c=2.0, k_v1=2.0, J_m=0.2, k_v2=0.0, k_v3=0.0)
            run = two_link_run((Friction(f_c=4.0, k_v2=k_v2, k_v3=k_v3), elbow), 40.0, 100.0, seed)
            found = identify([run.recording(0.2, seed)], ARM, Settings(5.0, structure)).environment.vacuum
            return {one.joint: one for one in found.joints}

        without = [one.p_value for seed in range(20) for one in verdict(0.0, 0.0, seed).values()]
        assert sum(p < 0.05 for p in without) <= 7, "of 40 two are expected"
        assert 0.33 < np.mean(without) < 0.67
        assert all(verdict(2.0, 1.0, seed)["shoulder"].differs for seed in range(3))


def test_an_environment_is_read_back_as_it_was_written():
    vacuum = VacuumTest((HighOrder("a", 2.0, 0.2, False),), ("b",))
    environment = Environment(vacuum, None, ("a",))
    assert Environment.from_dict(environment.as_dict()) == environment
    assert len(environment.notes) == 2
