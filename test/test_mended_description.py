"""Corrected SDF and URDF: the user's own file, whose torque is the model's when it is read again."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from spacearm_ident.dynamics.model import IdentifiedModel
from spacearm_ident.dynamics.regressor import INERTIAL_SYMBOLS, rigid_body_torque
from spacearm_ident.export.mended import mend
from spacearm_ident.layers.item import Mended
from spacearm_ident.signals.motion import Motion
from spacearm_ident.simulations import Simulation, read_simulation
from spacearm_ident.simulations.simulation import without

JOINTS = ("yaw", "pitch", "lift")
INERTIA = "<inertia><ixx>{0}</ixx><iyy>{1}</iyy><izz>{2}</izz><ixy>0.001</ixy></inertia>"


def _sdf_link(name: str, carrier: str, pose: str, centre: str, mass: float, moments: tuple[float, ...]) -> str:
    inertial = f"<inertial><pose>{centre} 0 0 0</pose><mass>{mass}</mass>{INERTIA.format(*moments)}</inertial>"
    look = f'<visual name="v"><geometry><mesh><uri>{name}.dae</uri></mesh></geometry></visual>'
    placed = f'<pose relative_to="{carrier}">{pose}</pose>'
    return f'<link name="{name}">{placed}<!-- of {name} -->{inertial}{look}<self_collide>1</self_collide></link>'


SDF = f"""<?xml version="1.0"?>
<!-- a cell -->
<sdf version="1.9" xmlns:gz="http://gazebosim.org/schema">
  <world name="lab">
    <gravity>0 0.5 -9.7</gravity>
    <plugin filename="physics" name="Physics"><gz:step>0.001</gz:step></plugin>
    <model name="ground_plane"><static>true</static><link name="link"/></model>
    <model name="arm">
      <pose>0.5 -0.3 0.8 0 0 0</pose>
      <joint name="stand" type="fixed"><parent>world</parent><child>foot</child></joint>
      {_sdf_link("foot", "__model__", "0 0 0.1 0 0 0", "0 0 0", 20, (1, 1, 1))}
      <frame name="mount" attached_to="foot"><pose relative_to="foot">0 0.1 0.3 0 0.2 0</pose></frame>
      {_sdf_link("post", "yaw", "0.02 0 -0.1 0 0.3 0", "0 0.03 0.1", 6, (0.05, 0.06, 0.03))}
      <joint name="yaw" type="revolute"><pose relative_to="mount">0 0 0.05 0 0 0.1</pose><parent>foot</parent>
        <child>post</child><axis><xyz>0 0 1</xyz><limit><lower>-2</lower><upper>2</upper><velocity>3</velocity></limit>
        <dynamics><damping>5</damping><friction>4</friction></dynamics></axis></joint>
      {_sdf_link("boom", "post", "0.1 0.05 0.4 0.4 0 1", "0.2 0 0.03", 4, (0.02, 0.09, 0.1))}
      <joint name="pitch" type="revolute"><pose>0.03 -0.02 0.01 0 0 0</pose><parent>post</parent><child>boom</child>
        <axis><xyz expressed_in="mount">0 1 0.2</xyz></axis></joint>
      {_sdf_link("rod", "boom", "0.4 0 0 0 0.5 0", "0 0.01 0.2", 2, (0.02, 0.02, 0.01))}
      <joint name="lift" type="prismatic"><pose>0 0 0.1 0.2 0 0</pose><parent>boom</parent><child>rod</child>
        <axis><xyz expressed_in="__model__">0.1 0 1</xyz><limit><lower>-0.5</lower><upper>0.5</upper></limit></axis>
      </joint>
      {_sdf_link("tool", "rod", "0.02 0 0.3 0 0.7 0", "0 0 0.05", 0.8, (0.002, 0.003, 0.002))}
      <joint name="flange" type="fixed"><parent>rod</parent><child>tool</child></joint>
      {_sdf_link("finger", "tool", "0 0.03 0.1 0 0 0.2", "0 0 0.02", 0.1, (2e-3, 2e-3, 2e-3))}
      <joint name="grip" type="prismatic"><parent>tool</parent><child>finger</child><axis><xyz>0 1 0</xyz>
        <limit><lower>0</lower><upper>0.05</upper></limit></axis></joint>
      <plugin filename="states" name="JointStatePublisher"/>
    </model>
  </world>
</sdf>
"""


def _motion(seed: int = 3) -> Motion:
    position, velocity, acceleration = np.random.default_rng(seed).uniform(-0.4, 0.4, (3, 40, 3)) * [4.0, 4.0, 1.0]
    none = np.zeros(3)
    return Motion(JOINTS, 10.0, 0.0, position, velocity, acceleration, np.zeros((40, 3)), none, none)


def _torque(model: IdentifiedModel, motion: Motion) -> np.ndarray:
    """(N, n) torque of bodies, damping and Coulomb friction."""
    arm = model.model.arm
    bodies = np.array([[model.value(symbol, joint) for symbol in INERTIAL_SYMBOLS] for joint in arm.joint_names])
    rigid = rigid_body_torque(arm, bodies, motion.position, motion.velocity, motion.acceleration)
    damping, friction = (np.array([model.value(s, joint) for joint in arm.joint_names]) for s in ("k_v1", "f_c"))
    return np.asarray(rigid + damping * motion.velocity + friction * np.sign(motion.velocity))


def _identified(simulation: Simulation, heavier: float = 1.3) -> IdentifiedModel:
    """Other bodies and friction: of each body a share, a point mass added beside it, and its own k_v1 and f_c."""
    point = np.array([0.1, -0.2, 0.15])
    tensor = 0.4 * (point @ point * np.eye(3) - np.outer(point, point))
    added = np.concatenate([[0.4], 0.4 * point, tensor[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]])
    values = []
    for parameter, value in zip(simulation.model.model.parameters, simulation.model.parameters):
        number = simulation.arm.joint_names.index(parameter.joint)
        if parameter.symbol in INERTIAL_SYMBOLS:
            value = heavier * value + added[INERTIAL_SYMBOLS.index(parameter.symbol)]
        own = {"k_v1": 2.0 + number, "f_c": 1.0 + 0.5 * number, "f_b": 1.0 + 0.5 * number}
        values.append(own.get(parameter.symbol, value))
    return replace(simulation.model, parameters=np.array(values))


def _mended(path: Path, text: str, heavier: float = 1.3) -> tuple[Mended, IdentifiedModel]:
    path.write_text(text)
    simulation = read_simulation(path)
    simulation = without(simulation, [joint for joint in simulation.arm.joint_names if joint not in JOINTS])
    model = _identified(simulation, heavier)
    mended = mend(simulation, path, model, [_motion()])
    assert mended is not None
    return mended, model


def _read_again(mended: Mended, path: Path) -> Simulation:
    path.write_text(mended.text)
    again = read_simulation(path)
    return without(again, [joint for joint in again.arm.joint_names if joint not in JOINTS])


def _require_torque(mended: Mended, model: IdentifiedModel, folder: Path) -> None:
    """The corrected file, read again, has the torque of the model."""
    again, motion = _read_again(mended, folder / mended.name), _motion(5)
    expected = _torque(model, motion)
    np.testing.assert_allclose(_torque(again.model, motion), expected, atol=1e-7 * np.abs(expected).max())


def test_corrected_sdf_has_the_torque_of_the_model(tmp_path: Path) -> None:
    """Poses relative to other frames, axes in other frames, a fixed tool and a finger that no recording has."""
    mended, model = _mended(tmp_path / "cell.sdf", SDF)
    _require_torque(mended, model, tmp_path)
    before = _torque(_read_again(replace(mended, text=SDF), tmp_path / "old.sdf").model, _motion(5))
    assert np.abs(before - _torque(model, _motion(5))).max() > 1.0


def _without_values(text: str) -> list[tuple[str, dict[str, str], str]]:
    """Every element of an SDF or URDF but inertials and joint dynamics, in order."""
    root = ElementTree.fromstring(text)
    for parent in root.iter():
        for child in [one for one in parent if one.tag in ("inertial", "dynamics")]:
            parent.remove(child)
    return [(one.tag, dict(one.attrib), (one.text or "").strip()) for one in root.iter()]


def test_corrected_sdf_keeps_everything_else(tmp_path: Path) -> None:
    mended, _ = _mended(tmp_path / "cell.sdf", SDF)
    assert _without_values(mended.text) == _without_values(SDF)
    assert re.findall("<!-- (?:of|a) .*?-->", mended.text) == re.findall("<!-- (?:of|a) .*?-->", SDF)
    assert "<gz:step>0.001</gz:step>" in mended.text
    links = {link.get("name"): link for link in ElementTree.fromstring(mended.text).iter("link")}
    mass = {name: float(link.findtext("inertial/mass", "0")) for name, link in links.items()}
    assert (mass["foot"], mass["finger"]) == (20.0, 0.1)
    assert mass["tool"] < 1e-6
    assert mass["rod"] == pytest.approx(1.3 * 2.9 + 0.4 - 0.1, abs=1e-6)


def test_finger_heavier_than_the_whole_identified_body_keeps_a_share_and_every_link_can_be(tmp_path: Path) -> None:
    mended, model = _mended(tmp_path / "cell.sdf", SDF.replace("<mass>0.1<", "<mass>3<"), heavier=0.1)
    _require_torque(mended, model, tmp_path)
    masses = [float(one.text or "0") for one in ElementTree.fromstring(mended.text).iter("mass")]
    assert min(masses) > 0.0


def _urdf_link(name: str, mass: float, centre: str = "0.02 0.01 0.05") -> str:
    inertial = (
        f'<inertial><origin xyz="{centre}" rpy="0 0.3 0"/><mass value="{mass}"/>'
        f'<inertia ixx="{0.02 * mass}" iyy="{0.03 * mass}" izz="{0.02 * mass}" ixy="0.001" ixz="0" iyz="0"/></inertial>'
    )
    mesh = f'<visual><geometry><mesh filename="package://cell/{name}.stl"/></geometry></visual>'
    return f'<link name="{name}"><!-- of {name} -->{inertial}{mesh}</link>'


def _urdf_joint(name: str, kind: str, parent: str, child: str, axis: str = "0 0 1", more: str = "") -> str:
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    limit = '<limit lower="-0.5" upper="0.5" effort="9" velocity="8"/>' if kind != "fixed" else ""
    moves = f'<axis xyz="{axis}"/>{limit}{more}' if kind != "fixed" else ""
    return f'<joint name="{name}" type="{kind}"><origin xyz="0.1 0.2 0.3" rpy="0.1 0.2 0.3"/>{ends}{moves}</joint>'


URDF = "\n".join(
    [
        '<robot name="cell">',
        *(_urdf_link(name, mass) for name, mass in (("foot", 20.0), ("post", 6.0), ("boom", 4.0), ("rod", 2.0))),
        *(_urdf_link(name, mass) for name, mass in (("tool", 0.8), ("left", 0.1), ("pad", 0.05), ("right", 0.1))),
        _urdf_joint("yaw", "revolute", "foot", "post"),
        _urdf_joint("pitch", "revolute", "post", "boom", "0 1 0", '<dynamics damping="7" friction="3"/>'),
        _urdf_joint("lift", "prismatic", "boom", "rod", "0.6 0 0.8"),
        _urdf_joint("flange", "fixed", "rod", "tool"),
        _urdf_joint("grip", "prismatic", "tool", "left", "0 1 0"),
        _urdf_joint("glue", "fixed", "left", "pad"),
        _urdf_joint("follows", "prismatic", "tool", "right", "0 -1 0", '<mimic joint="grip"/>'),
        "</robot>",
    ]
)


def _masses(text: str) -> dict[str, float]:
    links = ElementTree.fromstring(text).findall("link")
    found = {link.get("name", ""): link.find("inertial/mass") for link in links}
    return {name: float(mass.get("value", "0")) for name, mass in found.items() if mass is not None}


def test_corrected_urdf_keeps_joints_that_no_recording_has_and_has_the_torque_of_the_model(tmp_path: Path) -> None:
    mended, model = _mended(tmp_path / "cell.urdf", URDF)
    _require_torque(mended, model, tmp_path)
    assert _without_values(mended.text) == _without_values(URDF)
    assert re.findall("<!-- of .*?-->", mended.text) == re.findall("<!-- of .*?-->", URDF)
    assert "extended_model.yaml" in mended.text
    masses = _masses(mended.text)
    assert (masses["foot"], masses["left"], masses["pad"], masses["right"]) == (20.0, 0.1, 0.05, 0.1)
    assert "tool" not in masses
    assert masses["rod"] == pytest.approx(1.3 * 3.05 + 0.4 - 0.25)


def test_corrected_urdf_of_an_identified_body_lighter_than_its_fingers_has_links_that_can_be(tmp_path: Path) -> None:
    heavy = URDF.replace(_urdf_link("left", 0.1), _urdf_link("left", 3.0))
    assert heavy != URDF
    mended, model = _mended(tmp_path / "cell.urdf", heavy, heavier=0.1)
    _require_torque(mended, model, tmp_path)
    masses = _masses(mended.text)
    assert min(masses.values()) > 0.0 and masses["left"] < 3.0


def test_corrected_urdf_of_an_arm_file_is_the_urdf_that_it_names(tmp_path: Path) -> None:
    (tmp_path / "cell.urdf").write_text(URDF)
    mended, _ = _mended(tmp_path / "arm.yaml", "schema: spacearm_ident/arm/1\nurdf: cell.urdf\n")
    assert mended.name == "mended.urdf" and _without_values(mended.text) == _without_values(URDF)
