"""The simulated arm of a model file whose terms include effects, such as `extended_model.yaml`.

The effects of a model are columns of a regression; those of the simulated arm are physics. Here each is turned into
the other: same thing, other parameters. What is exact and what is not:

- Exact: `torque_ripple`, `position_friction` (a spot near its centre), `friction_drift`, `load_friction`,
  `asymmetric_friction`, `stribeck`, `vacuum_friction`, `harness_spring`, `current_offset`, `torque_constant`,
  `encoder_eccentricity`, `base_tilt` (to first order in the angle), `temperature_friction` (warmed by the arm's own
  losses).
- A fitted `share` other than 1 goes into the constant beside it, to first order: half the lag, half the gap.
- `load_friction` by the load on the motor's side leaves out the viscous part of that load.
- `payload` is a ball: of its inertia only the trace counts. `presliding_hysteresis` takes over all dry friction of its
  joint. `motor_saturation` agrees up to the power of torque that the model has, at half the torque that saturates;
  `torque_constant` of temperature goes by the winding. A spring is damped as the term has it with the arm at zero, a
  gap as gaps usually are.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from spacearm_ident.dynamics.arm import Arm
from spacearm_ident.dynamics.effects import EFFECTS
from spacearm_ident.dynamics.effects import Effect as EffectTerm
from spacearm_ident.dynamics.effects.compliance import DAMPING_RATIO
from spacearm_ident.dynamics.effects.warmth import ABOVE
from spacearm_ident.dynamics.model import IdentifiedModel
from spacearm_ident.dynamics.model_file import model_to_dict
from spacearm_ident.dynamics.rigid_body import TorqueOffset
from spacearm_ident.errors import UserError
from spacearm_ident.simulation.concealed.effect import Effect
from spacearm_ident.simulation.concealed.file import make_effect
from spacearm_ident.simulation.mechanism import rigid_body_model
from spacearm_ident.simulation.parameters import PlantParameters

Values = dict[str, Any]
"""Parameters of a concealed effect."""
LARGEST_CORNER_HZ = 450.0
"""A filter above this cannot be seen in a recording at 1 kHz."""
LEFT_OUT_INERTIA = 0.1
"""Share of a joint's inertia that a wrist's gear stage may have without its being simulated."""
LEAST_RADIUS = 0.01
CREEP_S = 60.0
"""How long a level creeps; the simulated arm's stops then."""


def simulated_arm(identified: IdentifiedModel, urdf: str) -> tuple[PlantParameters, list[Effect]]:
    """What the arm of a model obeys, and the effects to conceal in it.

    Args:
        identified: A model, with effects among its terms or without.
        urdf: Robot description to simulate.

    Raises:
        UserError: A term that cannot be simulated; the line names it.
    """
    document = model_to_dict(identified)
    document["terms"] = [term for term in document["terms"] if term["kind"] not in _CONVERTED]
    plant = PlantParameters.from_model(document, urdf)
    effects: list[Effect] = []
    for term, first, constant in identified.model.numbered():
        own = identified.parameters[first : first + len(term.parameters)]
        if isinstance(term, TorqueOffset) and len(own):
            offsets = {"offset": own.tolist()}
            where = [parameter.joint for parameter in term.parameters]
            effects.append(make_effect(plant.joints, "current_offset", where, offsets))
        elif isinstance(term, EffectTerm):
            symbols = [*(item.symbol for item in term.parameters), *(item.symbol for item in term.constants)]
            constants = identified.constants[constant : constant + len(term.constants)]
            values = dict(zip(symbols, map(float, (*own, *constants)), strict=True))
            effects.append(_convert(_Found(term, values, plant, identified.model.arm)))
    return plant, effects


@dataclass(frozen=True)
class _Found:
    """A term of the model: its place, its values by symbol, the arm it is of."""

    term: EffectTerm
    values: Mapping[str, float]
    plant: PlantParameters
    arm: Arm

    @property
    def place(self) -> Mapping[str, Any]:
        return self.term.place

    @property
    def joints(self) -> tuple[str, ...]:
        return self.term.joints

    def __getitem__(self, symbol: str) -> float:
        """A value; zero where the term has none of that symbol."""
        return self.values.get(symbol, 0.0)

    @property
    def share(self) -> float:
        """How much of the effect there is.

        Raises:
            UserError: None, or less than none.
        """
        share = self.values.get("share", 1.0)
        if share <= 0.0:
            raise self.refused(f"its share is {share:.3g}, not above zero")
        return share

    def of_joint(self, parameter: str) -> float:
        """A number of the arm at the effect's joint."""
        return float(getattr(self.plant, parameter)[self.plant.joints.index(self.joints[0])])

    def inertia(self, joint: str) -> float:
        """Of a joint and all it carries, rotor included, with the arm at zero, kg·m²."""
        model = rigid_body_model(self.plant)
        whole = pin.crba(model, model.createData(), pin.neutral(model))
        return float(np.diag(whole)[self.plant.joints.index(joint)])

    def refused(self, why: str) -> UserError:
        """The one line that says so."""
        where = f" at {', '.join(self.joints)}" if self.joints else ""
        return UserError(f"{self.term.kind}{where} cannot be simulated: {why}; remove it from the model")


def _convert(found: _Found) -> Effect:
    kind = found.term.kind
    converter = _CONVERTERS.get(kind)
    if converter is None:
        raise found.refused("the simulated arm has it in no form that a model can say")
    made = converter(found)
    law = made.pop("law", None)
    joints = made.pop("joints", found.joints)
    return make_effect(found.plant.joints, kind, joints, made, law)


def _wave(sine: float, cosine: float, cycles: float) -> Values:
    return {"amplitude": float(np.hypot(sine, cosine)), "phase": float(np.arctan2(cosine, sine)), "cycles": cycles}


def _ripple(found: _Found) -> Values:
    number = int(found.place.get("number", 1))
    suffix = "" if number == 1 else f"_{number}"
    return _wave(found[f"sin{suffix}"], found[f"cos{suffix}"], found[f"cycles{suffix}"])


def _position_friction(found: _Found) -> Values:
    if found.place.get("spot"):
        # Near its centre the simulated spot is that bell: away from it, to a few per cent where it is widest.
        return {"amplitude": found["spot"], "phase": -found["centre"], "width": found["width"], "law": "bump"}
    cycles = float(found.place["cycles"])
    return _wave(found[f"sin_{cycles:g}"], found[f"cos_{cycles:g}"], cycles)


def _payload(found: _Found) -> Values:
    mass = found["dm"]
    if found.place.get("for_a_while"):
        raise found.refused("it is held for a while, and the simulated arm holds what it does all the time")
    if mass <= 0.0:
        raise found.refused(f"its mass is {mass:.3g} kg, not above zero")
    centre = np.array([found["dmcx"], found["dmcy"], found["dmcz"]]) / mass
    # A ball has 2/5 m r^2 about any axis through its centre; what is left of the trace without m c^2 is three of them.
    own = sum(found[f"dI{axis}{axis}"] for axis in "xyz") - 2.0 * mass * float(centre @ centre)
    radius = float(np.sqrt(max(own / (1.2 * mass), LEAST_RADIUS**2)))
    return {"mass": mass, "centre": centre.tolist(), "radius": radius}


def _temperature_friction(found: _Found) -> Values:
    slopes = {}
    for name, symbol, level in (("coulomb_slope", "alpha_c", "f_c"), ("viscous_slope", "alpha_v", "k_v1")):
        change, cold = found[symbol], found.of_joint(level)
        if change and cold <= 0.0:
            raise found.refused(f"it changes {level}, which is zero there")
        slopes[name] = change / cold if change else 0.0
    neutral = {"neutral": float(found.place[ABOVE])} if ABOVE in found.place else {}
    return {**slopes, **neutral, "rise": 0.0}


def _presliding(found: _Found) -> Values:
    level = found.of_joint("f_c")
    if not 0.5 * level < found["f"] < 2.0 * level:
        raise found.refused(f"it builds up {found['f']:.3g} N m where the joint's dry friction is {level:.3g} N m")
    return {"distance": 3.0 * found["d_s"]}


def _wrist_coupling(found: _Found) -> Values:
    if "ratio" not in found.place:
        raise found.refused("only a gear stage that both joints feel is (ratio 1 or -1)")
    if abs(found["J"]) > LEFT_OUT_INERTIA * max(found.inertia(joint) for joint in found.joints):
        raise found.refused(f"the inertia of its gear stage, {found['J']:.3g} kg m^2, is too large to be left out")
    joints = (found.place["with"], found.place["joint"])
    values = {"joints": joints, "coulomb": found["f"], "viscous": found["k"], "ratio": float(found.place["ratio"])}
    return values | ({"law": "moved"} if found.place.get("moved") else {})


def _rotor_coupling(found: _Found) -> Values:
    arm, joint = found.arm, found.place["joint"]
    carriers = [arm.joint_names[k] for k in arm.supports(arm.joint_names.index(joint))[1:]]
    if found.place.get("with") not in (None, *carriers) or ("with" in found.place and len(carriers) > 1):
        raise found.refused("a rotor couples with every joint that carries it, not with one")
    # A rotor that turns backwards has a negative ratio, not a negative inertia.
    return {"joints": (joint,), "inertia": found["J"], "gear_ratio": float(np.copysign(80.0, found["J"]))}


def _base_tilt(found: _Found) -> Values:
    x, y = found["tilt_x"], found["tilt_y"]
    return {"angle": float(np.hypot(x, y)), "azimuth": float(np.arctan2(-x, y))}


def _floating_base(found: _Found) -> Values:
    if np.any(found.plant.gravity):
        raise found.refused("under gravity a floating arm falls")
    ratio = found["mass"] / found.share / float(found.plant.rigid_body[:, 0].sum())
    radius = float(np.sqrt(found["inertia"] / found["mass"]))
    return {"base_ratio": ratio, "gyration": radius, "below": found["below"] / radius}


def _contact(found: _Found) -> Values:
    force = np.array([found[f"force_{axis}"] for axis in "xyz"])
    size = float(np.linalg.norm(force))
    direction = force / size if size else np.ones(3)
    point = [found[f"point_{axis}"] for axis in "xyz"]
    window = {"start": found["start"], "duration": found["length"]}
    return {"force": size, "direction": direction.tolist(), "point": point, **window}


def _torque_constant(found: _Found) -> Values:
    if found.place.get("of") == "temperature":
        return {"law": "warming", "scale": 1.0, "slope": -found["error_per_K"]}
    return {"scale": 1.0 / (1.0 + found["error"])}


def _saturation(found: _Found) -> Values:
    third, fifth = found["s"], found["s_5"]
    if min(third, fifth) < 0.0:
        raise found.refused("its curve bends the wrong way")
    # tau = T artanh(true / T) = true + true^3 / (3 T^2) + true^5 / (5 T^4) + ..., as many terms as the model has, at
    # true = T / 2.
    excess = 1.0 / 12.0 + ("s_5" in found.values) / 80.0
    square = 2.0 * excess / max(third + np.sqrt(third**2 + 4.0 * fifth * excess), 1e-18)
    return {"torque": 2.0 * np.sqrt(square)}


def _delay(found: _Found) -> Values:
    if set(found.joints) != set(found.plant.joints):
        raise found.refused("only a delay of all joints alike is")
    return {"delay": found.share * found["delay"], "law": "early" if found.place.get("early") else "usual"}


def _lag(found: _Found) -> Values:
    corner = found.term.shown(np.array([*found.values.values()]))["corner"][0] / found.share
    law = "second_order" if found.place.get("order") == 2 else "usual"
    return {"corner": min(corner, LARGEST_CORNER_HZ), "law": law}


def _friction_drift(found: _Found) -> Values:
    if found.place.get("for_a_while"):
        raise found.refused("it is so for a while, and the simulated arm has it all the time")
    if not found["creep"]:
        return {"coulomb": found["df_c"], "viscous": found["dk_v1"]}
    if len(found.values) > 1:
        raise found.refused("a level that creeps and has changed as well is two places of it")
    return {"coulomb": CREEP_S * found["creep"], "over": CREEP_S, "law": "creeping"}


def _load_friction(found: _Found) -> Values:
    if found.place.get("side") == "motor":
        return {"mu": found["mu_in"], "law": "input"}
    return {"mu": found["mu"]}


def _elasticity(found: _Found) -> Values:
    stiffness = found["stiffness"] / found.share
    link = found.inertia(found.joints[0]) - found.of_joint("rotor_inertia")
    values: Values = {"stiffness": stiffness, "damping": 2.0 * DAMPING_RATIO * float(np.sqrt(stiffness * link))}
    if found["doubles_at"]:
        values |= {"doubles_at": found["doubles_at"] * found.share, "law": "hardening"}
    return values


def _harness(found: _Found) -> Values:
    side = found.place.get("side")
    stiffness = found[f"stiffness_{side}" if side else "stiffness"]
    if stiffness <= 0.0:
        raise found.refused("its stiffness is not above zero")
    if side:
        return {"stiffness": stiffness, "centre": found[side], "law": side}
    return {"stiffness": stiffness, "centre": -found["preload"] / found["stiffness"]}


_CONVERTERS: dict[str, Callable[[_Found], Values]] = {
    "payload": _payload,
    "friction_drift": _friction_drift,
    "temperature_friction": _temperature_friction,
    "load_friction": _load_friction,
    "gear_efficiency": lambda found: {"efficiency": 1.0 - found.share * (1.0 - found["eta"])},
    "presliding_hysteresis": _presliding,
    "position_friction": _position_friction,
    "asymmetric_friction": lambda found: {"coulomb": found["a"], "viscous": found["b"]},
    "stribeck": lambda found: {
        "amplitude": found["f"],
        "velocity": found["v_b"],
        "law": found.place.get("law", "usual"),
    },
    "vacuum_friction": lambda found: {"fraction": found["share"]},
    "torque_ripple": _ripple,
    "joint_elasticity": _elasticity,
    "backlash": lambda found: {"gap": found["gap"] * found.share, "stiffness": found["stiffness"]},
    "harness_spring": _harness,
    "rotor_coupling": _rotor_coupling,
    "wrist_coupling": _wrist_coupling,
    "base_tilt": _base_tilt,
    "floating_base": _floating_base,
    "external_contact": _contact,
    "torque_constant": _torque_constant,
    "motor_saturation": _saturation,
    "current_offset": lambda found: {"offset": found["offset"]},
    "encoder_eccentricity": lambda found: _wave(found["sin"], found["cos"], float(found.place.get("cycles", 1))),
    "time_delay": _delay,
    "filter_lag": _lag,
}
_CONVERTED = {*EFFECTS, TorqueOffset.kind}
