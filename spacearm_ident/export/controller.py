"""`ControlLaw`: what a controller's code holds of a model, as numbers a joint; a function of q, q', q'' alone.

    tau = bodies + J_m q'' + k_1 q + offset + friction(q', |bodies|) + coupled motors
    friction = sgn(q') (f_c + (f_b - f_c) exp(-(q'/v_b)^2) + mu |bodies|) + k_v1 q' + k_v2 (.) + k_v3 (.)

It has no memory, so a presliding state (d_s) is taken for gone through, and no temperature, so friction is that of
20 °C. Effects of the catalogue that stand in a model beside these terms are left out; what all that costs is stated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray
from ..dynamics.coupling import CoupledMotor
from ..dynamics.friction import ViscousFriction
from ..dynamics.model import IdentifiedModel
from ..dynamics.regressor import INERTIAL_SYMBOLS
from ..results.formats import CODE, lost_in_code
from ..signals.motion import Motion
from .law import SIMPLE_TERMS, SLOW_SHARE, Nearest

JOINT_NUMBERS = ("J_m", "k_1", "offset", "f_c", "f_b", "v_b", "mu", "k_v1", "k_v2_even", "k_v2_odd", "k_v3", "fastest")
"""What is held of each joint beside its body, SI."""
ZERO_SPEED = 0.01
"""Speed up to which friction compensation rises linearly from zero, rad/s (m/s); the caller may give another. Below it
the sign of a measured velocity is noise on most arms, and a compensation that switched with it would chatter."""


@dataclass(frozen=True)
class ControlLaw:
    """The law in numbers.

    Attributes:
        model: What it is of: physically consistent, reduced to the terms and constants of the law.
        inertials: (n, 10) bodies about their joint frames, kg, kg m, kg m^2.
        joints: (n, 12) `JOINT_NUMBERS`.
        motors: (k, n + 3) ratios of each coupled motor, and its J_m, k_v1, f_c.
    """

    model: IdentifiedModel
    inertials: FloatArray
    joints: FloatArray
    motors: FloatArray


def control_law(model: IdentifiedModel) -> ControlLaw:
    """The law that comes nearest to a model: its own values, without what the law does not have."""
    reduced = _reduced(model.possible)
    arm = reduced.model.arm
    numbers = np.zeros((len(arm.joints), len(JOINT_NUMBERS)))
    numbers[:, JOINT_NUMBERS.index("fastest")] = np.inf
    motors = []
    for term, first, first_constant in reduced.model.numbered():
        values = {p: float(reduced.parameters[first + k]) for k, p in enumerate(term.parameters)}
        if isinstance(term, CoupledMotor):
            assert term.coupling is not None
            ratios = [term.coupling.ratios.get(joint, 0.0) for joint in arm.joint_names]
            motors.append([*ratios, *values.values()])
            continue
        for parameter, value in values.items():
            if parameter.symbol in INERTIAL_SYMBOLS:
                continue
            symbol = parameter.symbol
            if isinstance(term, ViscousFriction) and symbol in ("k_v2", "k_v2_odd"):
                symbol = "k_v2_odd" if term.is_odd(parameter) else "k_v2_even"
            numbers[arm.joint_names.index(parameter.joint), JOINT_NUMBERS.index(symbol)] = value
        for k, constant in enumerate(term.constants):
            if constant.symbol == "v_b":
                row = arm.joint_names.index(constant.joint)
                numbers[row, JOINT_NUMBERS.index("v_b")] = float(reduced.constants[first_constant + k])
        for joint, speed in term.options.get("fastest", {}).items():
            numbers[arm.joint_names.index(joint), JOINT_NUMBERS.index("fastest")] = float(speed)
    inertials = np.array([[reduced.value(symbol, joint) for symbol in INERTIAL_SYMBOLS] for joint in arm.joint_names])
    return ControlLaw(reduced, inertials, numbers, np.array(motors).reshape(-1, len(arm.joints) + 3))


def _reduced(model: IdentifiedModel) -> IdentifiedModel:
    """The model without terms that the law does not have, presliding gone through, at 20 °C."""
    kept = {kind: options for kind, options in model.model.structure.items() if kind in SIMPLE_TERMS}
    smaller = replace(model.model, structure=kept)
    values = {item.name: value for item, value in _valued(model)}
    parameters = np.array([values[item.name] for item in smaller.parameters])
    constants = np.array([0.0 if item.symbol == "d_s" else values[item.name] for item in smaller.constants])
    return replace(model, model=smaller, parameters=parameters, constants=constants)


def _valued(model: IdentifiedModel):  # type: ignore[no-untyped-def]  # parameters and constants share a name alone
    for term, first, first_constant in model.model.numbered():
        if term.kind in SIMPLE_TERMS:
            yield from ((item, model.parameters[first + k]) for k, item in enumerate(term.parameters))
            yield from ((item, model.constants[first_constant + k]) for k, item in enumerate(term.constants))


def code_cost(model: IdentifiedModel, law: ControlLaw, motions: Sequence[Motion]) -> Nearest:
    """What the law costs against the model's prediction along motions, as `law.nearest` has it.

    Args:
        model: Model with values.
        law: What the exported code computes of it.
        motions: Where both are evaluated.
    """
    whole = np.concatenate([model.torque(motion) for motion in motions])
    left = whole - np.concatenate([law.model.torque(motion) for motion in motions])
    speed = np.abs(np.concatenate([motion.velocity for motion in motions]))
    moving = speed > SLOW_SHARE * speed.max(axis=0)
    names = law.model.model.arm.joint_names

    def rms(values: FloatArray, k: int) -> float:
        kept = values[moving[:, k], k]
        return float(np.sqrt(np.mean(kept**2))) if len(kept) else 0.0

    most = {joint: float(np.abs(np.where(moving[:, k], left[:, k], 0.0)).max()) for k, joint in enumerate(names)}
    cost = {joint: rms(left, k) for k, joint in enumerate(names)}
    size = {joint: rms(whole, k) for k, joint in enumerate(names)}
    return Nearest(CODE, {}, cost, most, size, lost_in_code(model))
