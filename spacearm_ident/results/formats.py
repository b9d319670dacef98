"""What each format of `spacearm export` holds of a joint beside its body, and what of a model it has no place for."""

from __future__ import annotations

from dataclasses import dataclass

from ..dynamics.effects.position import HarnessSpring
from ..dynamics.model import CATALOGUE, IdentifiedModel
from ..dynamics.rigid_body import JointSpring, RigidBody, RotorInertia, TorqueOffset

ARMATURE, DAMPING, FRICTION, STIFFNESS, REST = "armature", "damping", "friction", "stiffness", "rest"
RIGID = RigidBody.kind


@dataclass(frozen=True)
class Format:
    """What a format's joint can hold beside its body.

    Attributes:
        name: As users write it.
        holds: Some of `ARMATURE`, `DAMPING`, `FRICTION`, `STIFFNESS`; who holds a stiffness holds `REST`, the position
            where the spring is free.
    """

    name: str
    holds: frozenset[str]


MJCF = Format("mjcf", frozenset({ARMATURE, DAMPING, FRICTION, STIFFNESS}))
"""MuJoCo's joint: armature q'' + damping q' + frictionloss sgn(q') + stiffness (q - springref)."""
SDF = Format("sdf", frozenset({DAMPING, FRICTION, STIFFNESS}))
"""SDF's `<dynamics>`, with spring_stiffness and spring_reference; there is no place for the inertia of a rotor."""
URDF = Format("urdf", frozenset({DAMPING, FRICTION}))
"""URDF's `<dynamics damping friction>`; there is no place for the inertia of a rotor or a spring."""
USD = Format("usd", frozenset({ARMATURE, DAMPING, FRICTION}))
"""PhysX's joint: armature q'' + viscous q' + dynamic friction sgn(q')."""

SPRINGS = (JointSpring.kind, HarnessSpring.kind, TorqueOffset.kind)
"""Terms that are a spring about some position, k q + c; a one-sided harness spring is none, no format has it."""
PARTS = {
    "stribeck_friction": (
        ("f_b", "Stribeck friction"),
        ("d_s", "presliding"),
        ("mu", "friction that grows with the load"),
    ),
    "viscous_friction": (("k_v2", "k_v2"), ("k_v2_odd", "k_v2"), ("k_v3", "k_v3")),
}


@dataclass(frozen=True)
class Spring:
    """The terms `SPRINGS` of a joint.

    Attributes:
        stiffness: N m/rad (N/m).
        constant: Torque at position zero, N m (N).
    """

    stiffness: float
    constant: float

    @property
    def fits(self) -> bool:
        """Whether a format's spring can be this: it does not push away, and has no constant without a stiffness."""
        return self.stiffness > 0.0 or (self.stiffness == 0.0 and self.constant == 0.0)

    @property
    def rest(self) -> float:
        """Where it is free, rad (m); zero where there is no spring."""
        return -self.constant / self.stiffness if self.stiffness > 0.0 else 0.0


def spring_of(model: IdentifiedModel, joint: str) -> Spring:
    """What the springs and the offset of a joint are together.

    Args:
        model: With values.
        joint: Its name.
    """

    def total(*names: tuple[str, str]) -> float:
        return sum(model.by_term.get((kind, f"{symbol}[{joint}]"), 0.0) for kind, symbol in names)

    return Spring(
        total((JointSpring.kind, JointSpring.symbol), (HarnessSpring.kind, "stiffness")),
        total((TorqueOffset.kind, TorqueOffset.symbol), (HarnessSpring.kind, "preload")),
    )


def lost_words(model: IdentifiedModel, form: Format) -> tuple[str, ...]:
    """Names of the parts of a model that a format cannot hold.

    Args:
        model: As identified: its shares of unbounded least squares and of a plain model are lost in every format.
        form: What the joint of the format holds.

    Returns:
        Each name once. A spring counts as lost where it pushes away from its rest or is a constant torque, also in a
        format that holds a stiffness.
    """
    words: list[str] = []
    for term, first, first_constant in model.model.numbered():
        values = {p.symbol: model.parameters[first + k] for k, p in enumerate(term.parameters)}
        values |= {c.symbol: model.constants[first_constant + k] for k, c in enumerate(term.constants)}
        one_sided = isinstance(term, HarnessSpring) and term.one_sided
        if term.kind in SPRINGS and STIFFNESS in form.holds and not one_sided:
            here = {p.joint for k, p in enumerate(term.parameters) if model.parameters[first + k] != 0.0}
            if all(spring_of(model, joint).fits for joint in here):
                continue
        elif term.kind == RIGID or (term.kind == RotorInertia.kind and ARMATURE in form.holds):
            continue
        if term.kind in PARTS:
            for symbol, what in PARTS[term.kind]:
                there = values.get(symbol, 0.0) != (values.get("f_c") if symbol == "f_b" else 0.0)
                if there and (symbol != "f_b" or values.get("v_b", 0.0) > 0.0):
                    words.append(what)
        elif any(values.values()):
            words.append(HarnessSpring.beyond if one_sided else CATALOGUE[term.kind].words)
    if model.unbounded is not None:
        words.append("the share of least squares without physical bounds")
    if model.plain is not None:
        words.append("the share of a plain model")
    return tuple(dict.fromkeys(words))


CODE = Format("code", frozenset())
_IN_CODE = frozenset(
    {
        "Stribeck friction",
        "friction that grows with the load",
        "k_v2",
        "k_v3",
        "rotor inertia J_m",
        "joint spring k_1",
        "torque offset",
        "coupled motors",
    }
)
"""Words of `lost_words` for what a controller's code holds all the same."""


def lost_in_code(model: IdentifiedModel) -> tuple[str, ...]:
    """What of the model has values and no place in a controller's code, whose law has no memory, in words."""
    return tuple(word for word in lost_words(model, CODE) if word not in _IN_CODE)
