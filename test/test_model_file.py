"""Model files: the same numbers back from every structure, and one line about every broken file."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from effect_torque import assert_same_torque
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from planted_arm import TWO_LINKS, urdf_of

from spacearm_ident.dynamics.arm import Coupling, arm_from_urdf
from spacearm_ident.dynamics.model import FRICTION_LAWS, IdentifiedModel, TorqueModel, structure_of
from spacearm_ident.dynamics.model_file import MODEL_SCHEMA, load_model, save_model
from spacearm_ident.errors import UserError
from spacearm_ident.signals.motion import Motion

PLAIN = arm_from_urdf(urdf_of(TWO_LINKS))
COUPLED = replace(PLAIN, couplings=(Coupling("wrist", {"shoulder": 1.0, "elbow": -1.5}),))

STRUCTURES = {
    **{f"law {law}": (PLAIN, structure_of(PLAIN, law)) for law in FRICTION_LAWS},
    "couplings": (COUPLED, structure_of(COUPLED)),
    "load on one": (PLAIN, {**structure_of(PLAIN), "stribeck_friction": {"load": ["elbow"]}}),
    "load on all": (PLAIN, {**structure_of(PLAIN), "stribeck_friction": {"load": True}}),
    "offset on one": (PLAIN, {**structure_of(PLAIN), "torque_offset": {"joints": ["shoulder"]}}),
    "offsets": (PLAIN, {**structure_of(PLAIN), "torque_offset": {}}),
    "springs": (PLAIN, {**structure_of(PLAIN), "joint_spring": {"free": True}}),
    "both quadratics": (PLAIN, {**structure_of(PLAIN), "viscous_friction": {"quadratic": "both"}}),
    "rigid only": (PLAIN, {"rigid_body": {}}),
}


def identified(arm, structure, numbers):
    model = TorqueModel(arm, structure)
    count = len(model.parameters)
    return IdentifiedModel(model, np.array(numbers[:count]), np.array(numbers[count : count + len(model.constants)]))


def assert_same(one, other):
    np.testing.assert_array_equal(other.parameters, one.parameters)
    np.testing.assert_array_equal(other.constants, one.constants)
    assert [p.name for p in other.model.parameters] == [p.name for p in one.model.parameters]
    assert [c.name for c in other.model.constants] == [c.name for c in one.model.constants]
    assert other.model.structure == one.model.structure
    assert other.cutoff_hz == one.cutoff_hz
    assert dict(other.provenance or {}) == dict(one.provenance or {})
    mine, read = one.model.arm, other.model.arm
    assert (read.name, read.urdf, read.couplings) == (mine.name, mine.urdf, mine.couplings)
    np.testing.assert_array_equal(read.gravity, mine.gravity)
    for known, again in zip(mine.joints, read.joints):
        for field in ("gear_ratio", "torque_constant", "lower", "upper", "velocity_limit", "effort_limit"):
            assert getattr(again, field) == getattr(known, field)
        assert again.acceleration_limit == known.acceleration_limit


def any_motion():
    q, qd, qdd = np.random.default_rng(1).uniform(-1, 1, (3, 50, 2))
    return Motion(PLAIN.joint_names, 100.0, 0.0, q, qd, qdd, np.zeros_like(q), np.zeros(2), np.zeros(2))


@pytest.mark.parametrize("name", STRUCTURES)
@given(numbers=st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=50, max_size=50))
@settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_every_number_comes_back_to_the_last_digit(name, numbers, tmp_path):
    arm, structure = STRUCTURES[name]
    known = identified(arm, structure, numbers)
    save_model(known, tmp_path / "model.yaml")
    assert_same(known, load_model(tmp_path / "model.yaml"))


@pytest.mark.parametrize("name", STRUCTURES)
def test_a_loaded_model_predicts_the_same_torque(name, tmp_path):
    known = identified(*STRUCTURES[name], np.random.default_rng(0).uniform(0.1, 1, 60))
    save_model(known, tmp_path / "model.yaml")
    assert_same_torque(load_model(tmp_path / "model.yaml").torque(any_motion()), known.torque(any_motion()))


def test_arm_data_bandwidth_and_provenance_come_back(tmp_path):
    joints = (
        replace(PLAIN.joints[0], gear_ratio=101.0, torque_constant=0.1, velocity_limit=1.1, effort_limit=55.5),
        replace(PLAIN.joints[1], lower=-0.5, upper=0.5, acceleration_limit=4.0),
    )
    arm = replace(COUPLED, name="2 arms: one", joints=joints, gravity=np.array([0.1, 0.0, -1.62]))
    known = replace(
        identified(arm, structure_of(arm), np.arange(60.0)),
        cutoff_hz=7.25,
        provenance={"sources": [{"path": "a b.mcap", "sha256": "00ff"}], "versions": {"numpy": "2.4"}},
    )
    save_model(known, tmp_path / "model.yaml")
    assert_same(known, load_model(tmp_path / "model.yaml"))


@pytest.mark.parametrize(
    "urdf",
    [
        urdf_of(TWO_LINKS).replace("><", ">\n  <"),
        urdf_of(TWO_LINKS).replace("><", ">\r\n\t<"),
        urdf_of(TWO_LINKS).replace("><", ">  \n<"),
        "<?xml version='1.0'?>\n<!-- Prüfstand: 'a' # \"b\" \\ -->\n" + urdf_of(TWO_LINKS),
    ],
)
def test_a_urdf_comes_back_byte_for_byte(urdf, tmp_path):
    known = identified(arm_from_urdf(urdf), {"rigid_body": {}}, np.arange(60.0))
    save_model(known, tmp_path / "model.yaml")
    assert load_model(tmp_path / "model.yaml").model.arm.urdf == urdf


def test_a_model_may_name_its_urdf_instead(tmp_path):
    config = Path(__file__).parent.parent / "config"
    paper = load_model(config / "paper_arm_model.yaml")
    assert paper.value("f_c", "joint_1") == 14.8791
    assert paper.value("v_b", "joint_3") == 0.0055
    assert paper.model.arm.urdf == (config / "paper_arm.urdf").read_text()
    save_model(paper, tmp_path / "whole.yaml")
    assert_same(paper, load_model(tmp_path / "whole.yaml"))
    with pytest.raises(KeyError, match=r"f_c\[joint_9\]"):
        paper.value("f_c", "joint_9")


@pytest.fixture
def document(tmp_path):
    known = identified(COUPLED, {**structure_of(COUPLED), "torque_offset": {}}, np.arange(60.0) + 0.5)
    save_model(known, tmp_path / "model.yaml")
    return yaml.safe_load((tmp_path / "model.yaml").read_text())


def term(document, kind):
    return next(term for term in document["terms"] if term["kind"] == kind)


def drop_value(document):
    del term(document, "stribeck_friction")["values"]["f_c"]["elbow"]


def drop_symbol(document):
    del term(document, "viscous_friction")["values"]["k_v3"]


def write_words(document):
    term(document, "rotor_inertia")["values"]["J_m"]["elbow"] = "heavy"


def write_nan(document):
    term(document, "rotor_inertia")["values"]["J_m"]["elbow"] = float("nan")


def write_nothing(document):
    term(document, "rotor_inertia")["values"]["J_m"]["elbow"] = None


def unknown_term(document):
    document["terms"].append({"kind": "dark_matter", "values": {}})


def unknown_joint(document):
    term(document, "torque_offset")["options"] = {"joints": ["wrist"]}
    term(document, "torque_offset")["values"] = {"offset": {"wrist": 1.0}}


def words_for_terms(document):
    document["terms"] = "all of them"


def words_for_options(document):
    term(document, "viscous_friction")["options"] = "vacuum"


def unknown_form(document):
    term(document, "viscous_friction")["options"] = {"quadratic": "round"}


def no_gravity(document):
    del document["gravity_m_s2"]


def no_urdf(document):
    del document["urdf"]


def urdf_elsewhere(document):
    del document["urdf"]
    document["urdf_file"] = "gone.urdf"


def broken_urdf(document):
    document["urdf"] = "<robot"


def odd_drive(document):
    document["drives"]["elbow"]["colour"] = "red"


def odd_coupling(document):
    document["couplings"] = [{"name": "w"}]


BROKEN = [
    drop_value,
    drop_symbol,
    write_words,
    write_nan,
    write_nothing,
    unknown_term,
    unknown_joint,
    words_for_terms,
    words_for_options,
    unknown_form,
    no_gravity,
    no_urdf,
    urdf_elsewhere,
    broken_urdf,
    odd_drive,
    odd_coupling,
]


@pytest.mark.parametrize("damage", BROKEN)
def test_an_edited_file_is_refused_in_one_line(document, damage, tmp_path):
    damage(document)
    path = tmp_path / "edited.yaml"
    path.write_text(yaml.safe_dump(document))
    with pytest.raises(UserError) as caught:
        load_model(path)
    assert "\n" not in str(caught.value)


def test_the_missing_value_is_named(document, tmp_path):
    drop_value(document)
    (tmp_path / "edited.yaml").write_text(yaml.safe_dump(document))
    with pytest.raises(UserError, match=r"no value for f_c\[elbow\] of stribeck_friction"):
        load_model(tmp_path / "edited.yaml")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", MODEL_SCHEMA),
        ("- 1", MODEL_SCHEMA),
        ("schema: spacearm_ident/arm/1", MODEL_SCHEMA),
        ("schema: {", "not valid YAML"),
        (f"schema: {MODEL_SCHEMA}", "incomplete"),
    ],
)
def test_what_is_no_model_is_refused_in_one_line(text, says, tmp_path):
    (tmp_path / "model.yaml").write_text(text)
    with pytest.raises(UserError, match=says) as caught:
        load_model(tmp_path / "model.yaml")
    assert "\n" not in str(caught.value)


def test_a_file_that_is_not_there_or_not_text_is_named(tmp_path):
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00")
    for name in ("nothing.yaml", "binary.yaml"):
        with pytest.raises(UserError, match=name):
            load_model(tmp_path / name)
