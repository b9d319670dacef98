"""`PlantParameters`: the numbers the simulated arm obeys, as plain arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from spacearm_ident.arrays import FloatArray
from spacearm_ident.dynamics.effects import EFFECTS
from spacearm_ident.errors import UserError

RIGID_BODY = ("m", "mcx", "mcy", "mcz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
"""Rigid-body parameters of a joint in Pinocchio's order, inertia about the joint frame's origin."""
FRICTION = ("f_c", "f_b", "v_b", "k_v1", "k_v2", "k_v3")
_KINDS = {
    "rigid_body": RIGID_BODY,
    "rotor_inertia": ("J_m",),
    "joint_spring": ("k_1",),
    "stribeck_friction": ("f_c", "f_b", "v_b"),
    "viscous_friction": ("k_v1", "k_v2", "k_v3"),
    "torque_offset": ("offset",),
}
_OPTIONAL = {"k_v2", "k_v3", "offset"}
"""Zero at a joint for which the model has no value."""
_IGNORED = {"d_s"}
"""Presliding distance: the plant sticks and slips by itself, over no distance."""


@dataclass(frozen=True, eq=False)
class PlantParameters:
    """Truth of a simulated arm. Output side, SI.

    Attributes:
        joints: Names of the n joints, base to tip.
        urdf: Robot description; only its kinematics are used.
        gravity: (3,) m/s², base frame.
        rigid_body: (n, 10) in the order of `RIGID_BODY`.
        rotor_inertia: (n,) J_m, kg·m².
        joint_spring: (n,) k_1, N·m/rad.
        f_c: (n,) Coulomb friction, N·m.
        f_b: (n,) static friction, N·m.
        v_b: (n,) Stribeck velocity, rad/s, above zero.
        k_v1: (n,) N·m·s/rad.
        k_v2: (n,) N·m·s²/rad².
        k_v3: (n,) N·m·s³/rad³.
        quadratic: `even`: k_v2·qd² as the paper prints it; `odd`: k_v2·qd·|qd|; one for all joints, or (n,) names.
        fastest: (n,) speed beyond which k_v2 and k_v3 grow linearly, rad/s; infinite by default.
        offset: (n,) constant torque, N·m; zero by default.
    """

    joints: tuple[str, ...]
    urdf: str
    gravity: FloatArray
    rigid_body: FloatArray
    rotor_inertia: FloatArray
    joint_spring: FloatArray
    f_c: FloatArray
    f_b: FloatArray
    v_b: FloatArray
    k_v1: FloatArray
    k_v2: FloatArray
    k_v3: FloatArray
    quadratic: str | Sequence[str] = "even"
    fastest: FloatArray = field(default_factory=lambda: np.full(1, np.inf))
    offset: FloatArray = field(default_factory=lambda: np.zeros(1))

    def __post_init__(self) -> None:
        n = len(self.joints)
        forms = {self.quadratic} if isinstance(self.quadratic, str) else set(self.quadratic)
        if not forms <= {"even", "odd"}:
            raise UserError(f"quadratic is {self.quadratic!r}; use even or odd")
        if self.gravity.shape != (3,) or self.rigid_body.shape != (n, len(RIGID_BODY)):
            raise ValueError("gravity must be (3,) and rigid_body (n, 10)")
        for name in ("rotor_inertia", "joint_spring", *FRICTION):
            if getattr(self, name).shape != (n,):
                raise ValueError(f"{name} must be ({n},)")
        if np.any(self.v_b <= 0) or np.any(np.minimum(self.f_c, self.f_b) < 0):
            raise UserError("simulated friction needs v_b above zero and f_c, f_b not below zero; correct them")

    @classmethod
    def from_model(cls, document: Mapping[str, Any], urdf: str) -> PlantParameters:
        """From the plain data of a model file (`spacearm_ident/model/1`) and its robot description.

        Terms that are absent count as zero (frictionless, no rotor, no spring); v_b = 0 is plain Coulomb
        friction. Effects are no parameters: `concealed.from_model.simulated_arm` takes a model with them.

        Raises:
            UserError: The model has a term this plant does not simulate, or lacks a value.
        """
        joints = tuple(document["joints"])
        values = {name: np.zeros(len(joints)) for names in _KINDS.values() for name in names}
        values["v_b"] = np.ones(len(joints))
        quadratic, fastest = ["even"] * len(joints), np.full(len(joints), np.inf)
        for term in document["terms"]:
            kind = term["kind"]
            if kind in EFFECTS:
                raise UserError(
                    f"this arm does not simulate the effect {kind!r}, only spacearm simulate does: remove it"
                )
            if kind not in _KINDS:
                raise UserError(f"the simulated arm has no term {kind!r}; remove it from the model")
            if kind == "viscous_friction":
                options = term.get("options", {})
                quadratic = _forms(options.get("quadratic", "even"), joints)
                fastest = np.array([float(options.get("fastest", {}).get(joint, np.inf)) for joint in joints])
            beyond = set(term["values"]) - set(_KINDS[kind]) - _IGNORED
            if beyond:
                raise UserError(f"the simulated arm has no {sorted(beyond)[0]!r} of {kind}; remove it from the model")
            for name in _KINDS[kind]:
                if name in term["values"] or name not in _OPTIONAL:
                    values[name] = _column(term["values"], name, joints)
        plain = values["v_b"] == 0.0
        values["f_b"] = np.where(plain, values["f_c"], values["f_b"])
        values["v_b"] = np.where(plain, 1.0, values["v_b"])
        return cls(
            joints=joints,
            urdf=urdf,
            gravity=np.asarray(document["gravity_m_s2"], dtype=float),
            rigid_body=np.column_stack([values[name] for name in RIGID_BODY]),
            rotor_inertia=values["J_m"],
            joint_spring=values["k_1"],
            quadratic=quadratic,
            fastest=fastest,
            offset=values["offset"],
            **{name: values[name] for name in FRICTION},
        )


def _forms(quadratic: Any, joints: Sequence[str]) -> list[str]:
    """The form of the quadratic friction of every joint.

    Raises:
        UserError: Neither even nor odd.
    """
    forms = [quadratic.get(joint, "even") if isinstance(quadratic, Mapping) else quadratic for joint in joints]
    if not set(forms) <= {"even", "odd"}:
        raise UserError(f"quadratic is {quadratic!r}; use even or odd")
    return forms


def _column(table: Mapping[str, Mapping[str, float]], name: str, joints: Sequence[str]) -> FloatArray:
    try:
        if name in _OPTIONAL:
            return np.array([float(table[name].get(joint, 0.0)) for joint in joints])
        return np.array([float(table[name][joint]) for joint in joints])
    except KeyError as error:
        raise UserError(f"the model gives no {name} for {error}; add it") from None
