"""The identified URDF is the same arm to Pinocchio, and keeps all that was not identified."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_result import STRUCTURE, URDF, arm, identified_model, parsed

from spacearm_ident.dynamics.model import TorqueModel
from spacearm_ident.errors import UserError
from spacearm_ident.results.urdf import identified_urdf
from spacearm_ident.signals.motion import Motion


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000))
def test_urdf_predicts_the_rigid_torque_of_the_model(seed: int) -> None:
    model = identified_model(arm(), seed=seed)
    loaded = pin.buildModelFromXML(identified_urdf(model))
    assert tuple(loaded.names)[1:] == model.model.arm.joint_names
    data = loaded.createData()
    position, velocity, acceleration = np.random.default_rng(seed).uniform(-2, 2, (3, 20, 2))
    zero = np.zeros(2)
    motion = Motion(
        model.model.arm.joint_names, 1.0, 0.0, position, velocity, acceleration, np.zeros((20, 2)), zero, zero
    )
    expected = model.torque(motion, ("rigid_body",))
    torque = [pin.rnea(loaded, data, *state) for state in zip(position, velocity, acceleration)]
    np.testing.assert_allclose(torque, expected, atol=1e-9 * np.abs(expected).max())


def without_what_was_identified(text: str) -> list[tuple[str, dict[str, str], str]]:
    """Every element but inertials of moved links and dynamics, in order."""
    root = parsed(text)
    for parent in root.iter():
        for child in list(parent):
            moved = child.tag == "inertial" and parent.get("name") != "base"
            if moved or child.tag == "dynamics":
                parent.remove(child)
    return [(node.tag, dict(node.attrib), (node.text or "").strip()) for node in root.iter()]


def test_urdf_keeps_everything_else() -> None:
    text = identified_urdf(identified_model(arm()))
    assert without_what_was_identified(text) == without_what_was_identified(URDF)
    assert "<!-- a small arm -->" in text
    assert "<sensor:kind" in text


def test_urdf_has_the_merged_body_on_the_moving_link_alone() -> None:
    model = identified_model(arm())
    root = parsed(identified_urdf(model))
    links = {link.get("name"): link for link in root.findall("link")}
    assert {name for name, link in links.items() if link.find("inertial") is not None} == {"base", "upper", "lower"}
    assert links["base"].find("inertial/mass").get("value") == "9.0"
    assert float(links["lower"].find("inertial/mass").get("value")) == model.value("m", "slide")


def test_urdf_friction_is_not_negative() -> None:
    model = identified_model(arm())
    names = [parameter.name for parameter in model.model.parameters]
    values = model.parameters.copy()
    values[names.index("k_v1[slide]")] = -3.0
    root = parsed(identified_urdf(replace(model, parameters=values)))
    found = {joint.get("name"): joint.findall("dynamics") for joint in root.findall("joint")}
    assert {name: len(dynamics) for name, dynamics in found.items()} == {
        **dict.fromkeys(("stand", "flange", "mount"), 0),
        **dict.fromkeys(("turn", "slide"), 1),
    }
    assert found["turn"][0].attrib == {"damping": "8.0", "friction": "4.0"}
    assert float(found["slide"][0].get("damping")) == 0.0
    assert float(found["slide"][0].get("friction")) == pytest.approx(4.4)


@pytest.mark.parametrize(
    ("urdf", "says"),
    [
        ('<!DOCTYPE robot [<!ENTITY a "b">]>' + URDF.split("?>")[1], "DOCTYPE"),
        ('<!DOCTYPE robot SYSTEM "file:///etc/passwd">' + URDF.split("?>")[1], "DOCTYPE"),
        (URDF.replace("</robot>", ""), "not well-formed"),
    ],
)
def test_urdf_with_entities_or_broken_is_refused(urdf: str, says: str) -> None:
    model = identified_model(arm())
    model = replace(model, model=TorqueModel(replace(model.model.arm, urdf=urdf), STRUCTURE))
    with pytest.raises(UserError, match=says):
        identified_urdf(model)


def test_urdf_of_a_link_without_mass_is_refused() -> None:
    model = identified_model(arm())
    values = model.parameters.copy()
    values[0] = 0.0
    with pytest.raises(UserError, match="'upper' was identified without a positive mass"):
        identified_urdf(replace(model, parameters=values))
