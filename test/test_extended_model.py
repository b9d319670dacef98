"""A model with effects, simulated and identified again: the simulated arm obeys what the effect's term says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import small_arm
from planted_arm import Friction, two_link_run
from simulated_arm import CONFIG, paper_drives, paper_limits

from spacearm_ident.cli.main import main
from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.dynamics.model import IdentifiedModel, TorqueModel, structure_of
from spacearm_ident.dynamics.model_file import load_model, save_model
from spacearm_ident.errors import UserError
from spacearm_ident.excitation.trajectory import FourierTrajectory, random_feasible
from spacearm_ident.excitation.trajectory_file import save_trajectory
from spacearm_ident.identification.identify import Settings, identify
from spacearm_ident.nodes.jobs import IdentifyJob
from spacearm_ident.sessions.bags import Options
from spacearm_ident.signals.motion import Motion
from spacearm_ident.simulation.closed_loop import Truth, simulate_truth
from spacearm_ident.simulation.concealed import Concealment
from spacearm_ident.simulation.concealed.effect import State
from spacearm_ident.simulation.concealed.from_model import simulated_arm
from spacearm_ident.simulation.parameters import PlantParameters
from spacearm_ident.simulation.thermal import ThermalParameters

JOINTS = tuple(f"joint_{k}" for k in range(1, 7))
PAPER = load_model(CONFIG / "paper_arm_model.yaml")
ORBIT = replace(PAPER, model=TorqueModel(PAPER.model.arm.with_gravity(np.zeros(3)), PAPER.model.structure))
ALL, SECOND, THIRD = {"joints": list(JOINTS)}, {"joint": "joint_2"}, {"joint": "joint_3"}
WRIST = {"joint": "joint_6", "with": "joint_5"}
BOTH = ["f_c", "k_v1"]
SETTLED_S, WINDOW_S, SLOW = 0.3, 0.03, 0.03


def extended(kind: str, place: dict, values: dict[str, float], base: IdentifiedModel = PAPER) -> IdentifiedModel:
    """The model with one effect more."""
    model = TorqueModel(base.model.arm, {**base.model.structure, kind: {"at": [place]}})
    (effect,) = (term for term in model.terms if term.kind == kind)
    own = [values[parameter.symbol] for parameter in effect.parameters]
    constants = [values[constant.symbol] for constant in effect.constants]
    return IdentifiedModel(model, np.append(base.parameters, own), np.append(base.constants, constants), 10.0)


def fourier(fundamental_hz: float) -> FourierTrajectory:
    return random_feasible(JOINTS, paper_limits(), seed=2, fundamental_hz=fundamental_hz, harmonics=4, periods=1)


def as_recorded(truth: Truth) -> Motion:
    rest = np.zeros(len(truth.joints))
    return Motion(truth.joints, 1000.0, 0.0, truth.q, truth.qd, truth.qdd, truth.torque, rest + 1e-4, rest)


def in_one_direction(truth: Truth) -> np.ndarray:
    """(N, n) whether a joint moves, and has moved for a while."""
    shifts = np.linspace(-WINDOW_S, WINDOW_S, 5) * 1000
    moving = np.all([np.abs(np.roll(truth.qd, int(shift), axis=0)) > SLOW for shift in shifts], axis=0)
    return moving & (truth.time > SETTLED_S)[:, None]


@pytest.mark.parametrize(
    ("kind", "place", "values", "share"),
    [
        ("torque_ripple", THIRD, {"sin": 0.8, "cos": -0.6, "cycles": 12.0}, 0.01),
        ("torque_ripple", {**THIRD, "number": 2}, {"sin_2": -0.2, "cos_2": 0.6, "cycles_2": 20.0}, 0.01),
        ("position_friction", {**SECOND, "cycles": 2}, {"sin_2": 1.0, "cos_2": 0.7}, 0.01),
        (
            "position_friction",
            {**SECOND, "spot": True},
            {"spot": 3.0, "centre": 1.25, "width": 0.1},
            0.02,
        ),
        ("friction_drift", {**SECOND, "of": BOTH}, {"df_c": 3.0, "dk_v1": 2.0}, 0.01),
        ("friction_drift", {**SECOND, "of": ["k_v1"]}, {"dk_v1": -2.0}, 0.01),
        ("friction_drift", {**SECOND, "of": ["creep"]}, {"creep": 0.3}, 0.01),
        ("load_friction", SECOND, {"mu": 0.08}, 0.01),
        ("load_friction", {**SECOND, "side": "motor"}, {"mu_in": 0.08}, 0.25),
        ("gear_efficiency", SECOND, {"share": 1.0, "eta": 0.9}, 0.01),
        ("presliding_hysteresis", SECOND, {"f": PAPER.value("f_c", "joint_2"), "d_s": 0.01}, 0.01),
        ("asymmetric_friction", {**SECOND, "of": ["level", "viscous"]}, {"a": 1.0, "b": -1.5}, 0.01),
        ("stribeck", SECOND, {"f": 3.0, "v_b": 0.2}, 0.01),
        ("stribeck", {**SECOND, "law": "exponential"}, {"f": 3.0, "v_b": 0.2}, 0.01),
        ("vacuum_friction", ALL, {"share": 0.8}, 0.01),
        ("harness_spring", THIRD, {"stiffness": 5.0, "preload": 1.5}, 0.01),
        ("harness_spring", {**THIRD, "side": "above"}, {"stiffness_above": 5.0, "above": 0.35}, 0.01),
        ("harness_spring", {**THIRD, "side": "below"}, {"stiffness_below": 5.0, "below": 0.35}, 0.01),
        ("current_offset", THIRD, {"offset": -2.0}, 0.01),
        ("torque_constant", SECOND, {"error": 0.08}, 0.01),
        ("time_delay", ALL, {"share": 1.0, "delay": 0.006}, 0.01),
        ("time_delay", {**ALL, "early": True}, {"share": 1.0, "delay": 0.006}, 0.01),
        # From here on the two writings differ: in what is small beside the effect, by as much as is said here.
        ("filter_lag", ALL, {"share": 1.0, "lag": 0.006}, 0.02),
        ("filter_lag", ALL, {"share": 1.5, "lag": 0.002}, 0.25),
        ("filter_lag", {**ALL, "order": 2}, {"share": 1.0, "lag": 0.006}, 0.02),
        ("rotor_coupling", {"joint": "joint_4"}, {"J": 0.4}, 0.02),
        ("rotor_coupling", {"joint": "joint_4"}, {"J": -0.4}, 0.02),
        ("payload", {"joint": "joint_6"}, {"dm": 1.2, "dmcx": 0.03, "dmcy": -0.02, "dmcz": 0.1}, 0.05),
        ("base_tilt", {}, {"tilt_x": 0.01, "tilt_y": -0.02}, 0.15),
        ("motor_saturation", SECOND, {"s": 1e-6}, 0.1),
        ("motor_saturation", {**SECOND, "terms": 2}, {"s": 1.3e-6, "s_5": 3.2e-12}, 0.1),
        (
            "external_contact",
            {"joint": "joint_6"},
            dict(
                force_x=20, force_y=5, force_z=-9, start=0.5, length=2.2, rise=0.1, point_x=0.1, point_y=0, point_z=0.08
            ),
            0.25,
        ),
        ("wrist_coupling", {**WRIST, "ratio": -1.0}, {"J": 0, "k": 1.0, "f": 1.5}, 0.25),
        ("wrist_coupling", {**WRIST, "ratio": 1.0, "moved": True}, {"J": 0, "k": 1.0, "f": 1.5}, 0.25),
    ],
)
def test_the_simulated_arm_obeys_what_the_term_predicts(kind, place, values, share):
    agrees(extended(kind, place, values), PAPER, kind, share)


def test_a_floating_arm_feels_what_the_term_predicts():
    floating = extended("floating_base", {}, {"share": 1.0, "inertia": 24.0, "mass": 150.0, "below": 0.2}, ORBIT)
    agrees(floating, ORBIT, "floating_base", 0.1)


def agrees(model: IdentifiedModel, base: IdentifiedModel, kind: str, share: float) -> None:
    """What the simulated arm needs beyond the base model is what the effect's term says, where that is anything."""
    plant, effects = simulated_arm(model, model.model.arm.urdf)
    truth = simulate_truth(plant, fourier(0.33), drives=paper_drives(), hidden=Concealment(effects))
    motion, moving = as_recorded(truth), in_one_direction(truth)
    found, said = truth.torque - base.torque(motion), model.torque(motion, kinds=[kind])
    size = np.sqrt([np.mean(said[moving[:, k], k] ** 2) for k in range(len(JOINTS))])
    off = np.sqrt([np.mean((found - said)[moving[:, k], k] ** 2) for k in range(len(JOINTS))])
    assert size.max() > 0.05
    felt = size > 0.15 * size.max()
    assert np.all(off[felt] < share * size[felt]), (off / np.maximum(size, 1e-12))[felt]


@pytest.mark.parametrize(("above", "place"), [(20.0, {}), (25.0, {"above_C": 25.0})])
def test_friction_falls_with_temperature_as_the_term_says(above, place):
    values = {"alpha_c": -0.1, "alpha_v": -0.15}
    plant, (effect,) = simulated_arm(
        extended("temperature_friction", {**SECOND, "of": BOTH, **place}, values), PAPER.model.arm.urdf
    )
    thermal = ThermalParameters(paper_drives().copper_loss)
    concealed = Concealment([effect]).plant(plant, np.zeros(6), thermal)
    assert concealed.housing_temperature[1] == 20.0
    state = State(6)
    state.qd, state.temperature = np.full(6, 0.5), np.full(6, 32.0)
    effect.advance(state, 0.001)
    warmer = 32.0 - above
    assert effect.level(state, np.zeros(6)) == pytest.approx([0, warmer * -0.1, 0, 0, 0, 0])
    assert effect.torque(state) == pytest.approx([0, warmer * -0.15 * 0.5, 0, 0, 0, 0])
    assert not effect.values["rise"].any()


@pytest.mark.parametrize(
    ("kind", "place", "values", "share"),
    [
        ("joint_elasticity", THIRD, {"share": 1.0, "stiffness": 8e3, "damping_ratio": 0.05}, 0.15),
        (
            "joint_elasticity",
            {**THIRD, "hardens": True},
            {"share": 1.0, "stiffness": 4e3, "damping_ratio": 0.05, "doubles_at": 2e-3},
            0.15,
        ),
        ("backlash", THIRD, {"share": 1.0, "gap": 0.01, "stiffness": 3e4, "damping_ratio": 0.3}, 0.25),
        ("encoder_eccentricity", {**THIRD, "cycles": 1}, {"sin": 0.01, "cos": -0.005}, 0.1),
        ("encoder_eccentricity", {**THIRD, "cycles": 2}, {"sin": 0.003, "cos": 0.008}, 0.1),
    ],
)
def test_what_moves_beside_its_encoder_does_so_by_as_much_as_the_term_says(kind, place, values, share):
    # How a gear rings in detail is nobody's prediction; how large it is in the bandwidth of a fit, and its sign, are.
    model = extended(kind, place, values)
    plant, effects = simulated_arm(model, model.model.arm.urdf)
    run = fourier(0.33).run(paper_limits())
    truth = simulate_truth(plant, run, drives=paper_drives(), hidden=Concealment(effects))
    acceleration = np.gradient(truth.qd, truth.time, axis=0)
    motion = replace(
        as_recorded(truth), acceleration=acceleration, cutoff_hz=8.0, stride=10, speed_noise=np.full(6, 0.02)
    )
    found = motion.reduce(truth.torque - PAPER.torque(motion))[:, 2]
    said = motion.reduce(model.torque(motion, kinds=[kind]))[:, 2]
    rows = motion.moving[:, 2]
    assert found[rows] @ said[rows] / (said[rows] @ said[rows]) == pytest.approx(1.0, abs=share)


@pytest.mark.parametrize(
    ("kind", "place", "values", "named"),
    [
        ("payload", {"joint": "joint_6"}, {"dm": -0.5, "dmcx": 0, "dmcy": 0, "dmcz": 0}, "payload at joint_6.*mass"),
        (
            "payload",
            {"joint": "joint_6", "for_a_while": True},
            {"dm": 0.5, "dmcx": 0, "dmcy": 0, "dmcz": 0, "start": 2.0, "length": 3.0},
            "payload at joint_6.*for a while",
        ),
        (
            "friction_drift",
            {**SECOND, "of": ["f_c"], "for_a_while": True},
            {"df_c": 5.0, "start": 2.0, "length": 3.0},
            "friction_drift at joint_2.*for a while",
        ),
        ("encoder_zero", SECOND, {"zero": 0.02}, "encoder_zero at joint_2"),
        ("time_delay", SECOND, {"share": 1.0, "delay": 0.004}, "time_delay at joint_2"),
        ("filter_lag", SECOND, {"share": -0.2, "lag": 0.004}, "filter_lag at joint_2.*share"),
        ("wrist_coupling", WRIST, {"J": 0, "k": 1, "f": 1}, "wrist_coupling"),
        ("rotor_coupling", {"joint": "joint_4", "with": "joint_2"}, {"J": 0.1}, "rotor_coupling"),
        (
            "link_flexibility",
            {**SECOND, "axis": [1, 0, 0]},
            {"share": 1, "stiffness": 4e3, "damping_ratio": 0.05},
            "link_flexibility at joint_2",
        ),
        (
            "base_flexibility",
            {"axis": [1, 0, 0]},
            {"share": 1, "stiffness": 4e3, "damping_ratio": 0.05},
            "base_flexibility",
        ),
        ("floating_base", {}, {"share": 1.0, "inertia": 24.0, "mass": 150.0, "below": 0.2}, "floating_base.*gravity"),
        ("presliding_hysteresis", SECOND, {"f": 1.0, "d_s": 0.01}, "presliding_hysteresis at joint_2"),
        ("harness_spring", SECOND, {"stiffness": 0.0, "preload": 1.0}, "harness_spring at joint_2"),
        ("harness_spring", {**SECOND, "side": "above"}, {"stiffness_above": 0.0, "above": 0.1}, "not above zero"),
    ],
)
def test_what_cannot_be_simulated_is_named_in_one_line(kind, place, values, named):
    with pytest.raises(UserError, match=named) as refused:
        simulated_arm(extended(kind, place, values), PAPER.model.arm.urdf)
    assert "\n" not in str(refused.value)


def test_an_offset_of_the_base_model_is_simulated_as_that_of_a_sensor():
    structure = {**PAPER.model.structure, "torque_offset": {"joints": ["joint_2", "joint_5"]}}
    model = IdentifiedModel(
        TorqueModel(PAPER.model.arm, structure), np.append(PAPER.parameters, [1.5, -0.5]), PAPER.constants
    )
    _, (effect,) = simulated_arm(model, PAPER.model.arm.urdf)
    assert effect.name == "current_offset"
    assert effect.spread("offset", 6).tolist() == [0, 1.5, 0, 0, -0.5, 0]


def test_who_does_not_simulate_effects_does_not_pass_over_them():
    document = {"joints": ["j"], "gravity_m_s2": [0, 0, 0], "terms": [{"kind": "torque_ripple", "values": {}}]}
    with pytest.raises(UserError, match="torque_ripple"):
        PlantParameters.from_model(document, "")


# The commands


def test_simulate_takes_an_extended_model_and_identify_its_structure(tmp_path, capsys):
    ripple = extended("torque_ripple", THIRD, {"sin": 1.5, "cos": -2.0, "cycles": 12.0})
    save_model(ripple, tmp_path / "extended_model.yaml")
    save_trajectory(fourier(0.1).run(paper_limits()), tmp_path / "run.yaml")
    model, bag = str(tmp_path / "extended_model.yaml"), str(tmp_path / "run.mcap")
    arm = ["--arm", str(CONFIG / "paper_arm.yaml")]
    assert main(["simulate", "--model", model, "--trajectory", str(tmp_path / "run.yaml"), "--out", bag, *arm]) == 0
    command = ["identify", bag, "--out", str(tmp_path / "result"), "--structure", model, *arm, "--quiet"]
    assert main(command) == 0
    found = load_model(tmp_path / "result" / "model.yaml")
    assert found.model.structure == ripple.model.structure
    assert found.value("sin", "joint_3") == pytest.approx(1.5, abs=0.15)
    assert found.value("cos", "joint_3") == pytest.approx(-2.0, abs=0.15)
    assert found.value("cycles", "joint_3") == pytest.approx(12.0, abs=0.05)
    capsys.readouterr()
    assert main([*command, "--friction", "paper"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_an_effect_is_identified_beside_the_base_model(tmp_path):
    arm = arm_from_urdf(small_arm.URDF)
    structure = {**structure_of(arm, "coulomb-viscous"), "harness_spring": {"at": [{"joint": "elbow"}]}}
    model = TorqueModel(arm, structure)
    zero = IdentifiedModel(model, np.zeros(len(model.parameters)), np.zeros(len(model.constants)))
    save_model(zero, tmp_path / "structure.yaml")
    run = small_arm.recording()
    pull = np.column_stack([np.zeros(len(run.time)), 0.5 + 3.0 * run.position[:, 1]])
    settings = Options(cutoff_hz=5.0, structure=tmp_path / "structure.yaml").settings(arm)
    found = identify([replace(run, effort=run.effort + pull)], arm, settings).model
    assert found.value("preload", "elbow") == pytest.approx(0.5, abs=0.05)
    # The paper's joint spring and the harness's are one column: only their sum is known.
    assert found.value("stiffness", "elbow") + found.value("k_1", "elbow") == pytest.approx(3.0, abs=0.2)


def late(torque: np.ndarray, rate_hz: float, seconds: float) -> np.ndarray:
    samples = round(seconds * rate_hz)
    return np.concatenate([np.repeat(torque[:1], samples, axis=0), torque[:-samples]])


def filtered(torque: np.ndarray, rate_hz: float, seconds: float) -> np.ndarray:
    # The exact step response between samples, held linear.
    times = np.arange(8 * round(seconds * rate_hz)) / rate_hz
    weights = np.exp(-times / seconds)
    return np.stack([np.convolve(np.r_[np.full(len(times), c[0]), c], weights / weights.sum())[len(times) :][: len(c)]
                     for c in torque.T], axis=1)  # fmt: skip


@pytest.mark.parametrize(("kind", "symbol", "spoilt"), [("time_delay", "delay", late), ("filter_lag", "lag", filtered)])
def test_torque_that_is_late_does_not_pass_for_viscous_friction(kind, symbol, spoilt):
    """A delay looks much like less viscous friction: the two are told apart, and neither is biased."""
    laws = (Friction(k_v2=0.0, k_v3=0.0), Friction(f_c=1.5, k_v1=0.8, k_v2=0.0, k_v3=0.0, J_m=0.1))
    planted = two_link_run(laws, seconds=20.0, rate_hz=500.0, seed=1, speed=1.0)
    planted = replace(planted, torque=spoilt(planted.torque, 500.0, 0.008))
    arm = arm_from_urdf(planted.urdf)
    structure = {**structure_of(arm), kind: {"at": [{"joints": list(arm.joint_names)}]}}
    result = identify([planted.recording(noise=[0.1, 0.05], seed=3)], arm, Settings(structure=structure))
    found = {(item.symbol, item.joint): item for item in result.estimates}
    wanted = {(symbol, "all"): 0.008, ("k_v1", "shoulder"): 4.0, ("k_v1", "elbow"): 0.8, ("J_m", "elbow"): 0.1}
    for key, value in wanted.items():
        assert found[key].determination.value == "determined by the data"
        assert abs(found[key].value - value) < 3.5 * found[key].standard_error + 1e-3 * (symbol == "lag"), key
    assert found[symbol, "all"].standard_error < 0.001


def test_a_structure_that_does_not_fit_is_refused_in_one_line(tmp_path):
    arm = arm_from_urdf(small_arm.URDF)
    for kind, place in (("torque_ripple", THIRD), ("time_delay", ALL)):
        values = dict.fromkeys(("sin", "cos", "cycles", "share", "delay"), 1.0)
        file = tmp_path / f"{kind}.yaml"
        save_model(extended(kind, place, values), file)
        with pytest.raises(UserError, match=rf"{kind}.*no joint 'joint_"):
            Options(structure=file).settings(arm)
    with pytest.raises(UserError, match="cannot read"):
        Options(structure=tmp_path / "missing.yaml").settings(arm)
    with pytest.raises(UserError, match="own friction law"):
        Options(friction="paper", structure=tmp_path / "torque_ripple.yaml").settings(arm)


def test_the_identifiers_job_says_the_command_with_its_structure(tmp_path):
    job = IdentifyJob((tmp_path / "a.mcap",), (), tmp_path, Options(structure=tmp_path / "extended_model.yaml"))
    assert f"--structure {tmp_path}/extended_model.yaml" in job.command
