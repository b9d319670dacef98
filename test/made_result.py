"""A result that nobody identified: quick material for tests of its folder, its page and its index."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pinocchio as pin

from spacearm_ident.dynamics.arm import Arm, arm_from_urdf
from spacearm_ident.dynamics.base_parameters import base_parameters
from spacearm_ident.dynamics.model import IdentifiedModel, TorqueModel
from spacearm_ident.estimate.identified import (
    Choice,
    Determination,
    Estimate,
    Fit,
    Identified,
    JointValidation,
    LackOfFit,
    Trace,
    Validation,
)
from spacearm_ident.recording.recording import Recording, Source
from spacearm_ident.report.html import report_html
from spacearm_ident.results.store import Result
from spacearm_ident.signals.bandwidth import Bandwidth

FILES = {
    *("model.yaml", "parameters.csv", "base_parameters.csv", "identified.urdf"),
    *("validation.json", "torque.csv", "covariance.json", "report.html", "result.json", "result.npz"),
}
STRUCTURE = {
    "rigid_body": {},
    "rotor_inertia": {},
    "joint_spring": {},
    "stribeck_friction": {},
    "viscous_friction": {"quadratic": "even"},
}

INERTIAL = """<inertial><origin xyz="{0} 0.02 0.1" rpy="0.1 0.2 0.3"/><mass value="{1}"/>
    <inertia ixx="0.02" ixy="0.001" ixz="0" iyy="0.03" iyz="0.002" izz="0.015"/></inertial>"""
# A stand fixed to the base, a turning and a sliding joint, and two links merged into the last by fixed joints.
URDF = f"""<?xml version="1.0" encoding="utf-8"?>
<!-- a small arm -->
<robot name="small">
  <link name="world"/>
  <joint name="stand" type="fixed"><parent link="world"/><child link="base"/>
    <origin xyz="0 0 0.3" rpy="0 0 0.4"/></joint>
  <link name="base">{INERTIAL.format(0.0, 9.0)}</link>
  <joint name="turn" type="revolute">
    <parent link="base"/><child link="upper"/><origin xyz="0 0.1 0.2" rpy="1.2 0 0.3"/><axis xyz="0 0.6 0.8"/>
    <limit lower="-2" upper="2.5" effort="80" velocity="1.5"/>
    <dynamics damping="99" friction="98"/>
  </joint>
  <link name="upper">{INERTIAL.format(0.05, 4.0)}
    <visual><geometry><mesh filename="package://small/upper.stl"/></geometry></visual>
  </link>
  <joint name="slide" type="prismatic">
    <parent link="upper"/><child link="lower"/><origin xyz="0.4 0 0" rpy="0 0.5 0"/><axis xyz="1 0 0"/>
    <limit lower="-0.1" upper="0.3" effort="60" velocity="0.5"/>
  </joint>
  <link name="lower">{INERTIAL.format(0.1, 2.0)}
    <collision><geometry><sphere radius="0.1"/></geometry></collision></link>
  <joint name="flange" type="fixed"><parent link="lower"/><child link="tool"/>
    <origin xyz="0.2 0 0" rpy="0 1 0"/></joint>
  <link name="tool">{INERTIAL.format(-0.03, 1.0)}</link>
  <joint name="mount" type="fixed"><parent link="tool"/><child link="camera"/>
    <origin xyz="0 0 0.05" rpy="0 0 0"/></joint>
  <link name="camera">{INERTIAL.format(0.0, 0.3)}<sensor:kind value="rgb"/></link>
</robot>
"""


def arm(*names: str) -> Arm:
    """The small arm, its two joints renamed."""
    text = URDF
    for old, new in zip(("turn", "slide"), names):
        text = text.replace(f'"{old}"', f'"{new}"')
    return arm_from_urdf(text)


def inertials(seed: int, count: int) -> np.ndarray:
    """Parameters of random bodies that can exist."""
    pin.seed(seed)
    return np.array([pin.Inertia.Random().toDynamicParameters() for _ in range(count)])


VALUES = {
    **{"J_m": 2.0, "k_1": 0.0, "f_c": 4.0, "f_b": 6.0, "k_v1": 8.0, "k_v2": -0.5, "k_v3": 0.25},
    **{"v_b": 0.02, "d_s": 1e-3, "mu": 0.06, "offset": -0.3},
}


def identified_model(of: Arm, structure: dict = STRUCTURE, seed: int = 1) -> IdentifiedModel:
    """Values that differ from symbol to symbol and from joint to joint."""
    model = TorqueModel(of, structure)
    bodies = inertials(seed, len(of.joints))
    values, body = [], dict(zip(of.joint_names, bodies))
    places = {name: k for k, name in enumerate(model_joints(model))}
    for number_, parameter in enumerate(model.parameters):
        if number_ < 10 * len(of.joints):
            values.append(body[parameter.joint][number_ % 10])
        else:
            values.append(VALUES[parameter.symbol] * (1 + 0.1 * places[parameter.joint]))
    constants = [VALUES[constant.symbol] for constant in model.constants]
    return IdentifiedModel(model, np.array(values), np.array(constants), 7.5, {})


def model_joints(model: TorqueModel) -> list[str]:
    return list(dict.fromkeys(parameter.joint for parameter in model.parameters))


def identification(model: IdentifiedModel, **changes: object) -> Identified:
    """An `Identified` with every determination in it."""
    kinds = list(Determination)
    estimates = []
    items = [*zip(model.model.parameters, model.parameters), *zip(model.model.constants, model.constants)]
    for k, (item, value) in enumerate(items):
        kind = kinds[k % len(kinds)]
        error = 0.01 * abs(value) + 1e-4 if kind is Determination.DATA else math.nan
        note = "" if kind is Determination.DATA else f"because of {kind.name.lower()}"
        estimates.append(Estimate(item.symbol, item.joint, item.unit, float(value), error, kind, note))
    base = base_parameters(model.model)
    values = base.regrouping @ model.parameters
    count = len(items)
    joints = len(model.model.arm.joints)
    result = Identified(
        model=model,
        estimates=tuple(estimates),
        base=base,
        base_values=values,
        base_errors=(0.01 * np.abs(values) + 1e-3) * (np.arange(len(values)) > 0),
        covariance=np.diag(np.arange(count) * 1e-6),
        consistency_shift=0.4,
        residual_sigma_Nm=np.linspace(0.1, 0.2, joints),
        rows=np.arange(joints) + 500,
        bandwidth=Bandwidth(7.5, 9.0, 1.5, np.full(joints, 1e-5), "five times the 1.5 Hz"),
        choices=(Choice("torque offset", 0.8, False), Choice("load friction", 120.0, True)),
        solver="separable: converged after 3 steps",
        notes=("recording 1: 5 periods of 20 s averaged",),
    )
    return replace(result, **changes)


def fit(relative: float = 0.05, rows: int = 400) -> Fit:
    return Fit(rows, 1.5, 1.1, 6.25, 0.9987, relative)


def trace(joints: int, rows: int = 400, source: str = "validation.mcap", seed: int = 3) -> Trace:
    rng = np.random.default_rng(seed)
    time = np.linspace(0.0, 20.0, rows)
    velocity = np.sin(time[:, None] * np.arange(1, joints + 1) * 0.7)
    torque = 10 * np.sign(velocity) + 5 * velocity
    moving = np.abs(velocity) > 0.1
    residual = 0.3 * rng.normal(size=torque.shape)
    return Trace(source, time, np.cos(velocity), velocity, torque, torque - residual, moving)


def validation(names: tuple[str, ...], **changes: object) -> Validation:
    joints = {
        name: JointValidation(fit(0.05 + 0.02 * k), fit(0.03 + 0.02 * k, 300), fit(0.08), LackOfFit(1.1, 0.3, 0.2))
        for k, name in enumerate(names)
    }
    result = Validation(joints, (trace(len(names)),), "validation.mcap, another recording", True)
    return replace(result, **changes)


def recording(path: str) -> Recording:
    empty = np.zeros((2, 2))
    return Recording(("turn", "slide"), np.arange(2.0), empty, None, empty, (), sources=(Source(path, 12, "ab" * 32),))


def page_of(identified: Identified, figures: Validation) -> str:
    return report_html(Result(identified, figures, "2025-01-31T12:05:00+00:00"))


class Page(HTMLParser):
    """Elements, references and text of a page; fails on an element that is closed wrongly or not at all."""

    VOID = frozenset({"meta", "br", "wbr", "col", "link", "img", "input", "hr"})

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.references: list[str] = []
        self.drawings: list[str] = []
        self.words: list[str] = []
        self._open: list[str] = []
        self.feed(text)
        self.close()
        assert not self._open, f"never closed: {self._open}"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_startendtag(tag, attrs)
        if tag not in self.VOID:
            self._open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        for name, value in attrs:
            if name in ("src", "href", "xlink:href", "action", "data", "srcset"):
                self.references.append(value or "")
            if (tag, name) == ("svg", "aria-label"):
                self.drawings.append(value or "")
            assert not name.startswith("on"), f"<{tag}> would run a script: {name}"

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words.append(data)

    @property
    def text(self) -> str:
        """Its words, one space between."""
        return " ".join(" ".join(self.words).split())


def parsed(text: str) -> ET.Element:
    """A URDF's root; the prefix that the small arm does not declare is taken off."""
    return ET.fromstring(text.replace("sensor:kind", "kind"))
