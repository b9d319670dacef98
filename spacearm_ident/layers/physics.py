"""Layer 2: what the simulation does not have.

Two searches. The catalogue's (`mismatch.explain`), beside the simulation's own terms: every effect competes with its
rivals, and has a card. Then the friction terms that `identify` adds where they predict held-out parts better, at joints
at which the first search named nothing of the kind. What either finds becomes a term of one model, and takes part in
the last joint fit like any other.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np

from ..dynamics.arm import Arm
from ..dynamics.effects import Effect
from ..dynamics.effects.drive import TimeDelay
from ..dynamics.effects.friction import LoadFriction
from ..dynamics.friction import ViscousFriction
from ..dynamics.model import IdentifiedModel, Structure, TorqueModel
from ..dynamics.term import Parameter
from ..estimate.identified import Choice
from ..estimate.optional_terms import OptionalTerm
from ..identification.fit import Fit
from ..mismatch.explain import explain
from ..mismatch.finding import Explanation, Finding
from ..mismatch.rivals import UNKNOWN
from ..mismatch.run_set import RunSet
from ..recording.recording import Recording

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class Optional:
    """A friction term that a joint may have beside the textbook's.

    Attributes:
        symbol: Of its parameter.
        effect: What `mismatch.json` calls it.
        words: For a person.
        rivals: Effects that say much the same.
    """

    symbol: str
    effect: str
    words: str
    rivals: frozenset[str] = frozenset()


EARLIER = ("torque_constant", "base_tilt", "payload", "friction_drift")
"""Effects that belong to the first two layers. They are left out of the search for physics, where they would imitate
other effects. A delay common to all joints is not among them: beside an unknown contact, for example, the first layer
may miss it, and it then masks other effects. It is fitted beside the findings (`is_physics`), then tested in the first
layer again."""
OPTIONAL = (
    Optional("offset", "current_offset", "constant torque", frozenset({"asymmetric_friction", "base_tilt"})),
    Optional("f_b", "stribeck", "Stribeck friction f_b - f_c"),
    Optional("mu", "load_friction", "friction per load", frozenset({"gear_efficiency"})),
    Optional("k_v2", "viscous_second_order", "quadratic friction", frozenset({"asymmetric_friction", "stribeck"})),
    Optional("k_v3", "viscous_third_order", "cubic friction", frozenset({"motor_saturation", "stribeck"})),
)
"""Presliding is not among them: rows beside a reversal do not count in the joint fit. Nor is a spring, which the search
for effects finds."""


@dataclass(frozen=True)
class Added:
    """Physics as parameters of the extended model.

    Attributes:
        effect: Its name.
        joints: Where.
        where: In words.
        columns: Numbers of its parameters in the model.
        finding: The search's card; None for an optional friction term.
    """

    effect: str
    joints: tuple[str, ...]
    where: str
    columns: np.ndarray
    finding: Finding | None = None


def missing_physics(
    arm: Arm,
    structure: Structure,
    fitted: Sequence[Recording],
    held: Sequence[Recording],
    excluded: Sequence[str] = (),
    progress: Progress | None = None,
) -> Explanation:
    """Search for effects beside a simulation's terms.

    Args:
        arm: The arm.
        structure: The simulation's terms.
        fitted: Recordings to explain, their conventions corrected.
        held: Recordings to judge on, likewise.
        excluded: Effects that are not to be considered.
        progress: Called with a share done in 0..1 and what is being done.
    """

    def simulated(fit: Fit) -> tuple[Structure, tuple[Choice, ...]]:
        return structure, ()

    return explain(
        arm,
        RunSet(fitted, validation=held),
        (*excluded, *EARLIER),
        progress=progress,
        choose=simulated,
        is_finding=is_physics,
    )


def is_physics(effect: Effect) -> bool:
    """Whether an effect is physics. Torque that is late at all joints alike is a stamp: a matter of the wiring."""
    return effect.kind != TimeDelay.kind or "joint" in effect.place


def added_terms(model: IdentifiedModel, base: TorqueModel, findings: Sequence[Finding]) -> list[Added]:
    """The terms of an extended model that its base does not have, each with its finding.

    A finding of several joints with one cause may be several terms.

    Args:
        model: The extended model.
        base: The model without effects.
        findings: What the search named; `unknown` is no term.
    """
    known = {parameter.name for parameter in base.parameters}
    terms: list[tuple[Effect, np.ndarray]] = []
    for term, first, _ in model.model.numbered():
        if isinstance(term, Effect) and not {parameter.name for parameter in term.parameters} <= known:
            terms.append((term, first + np.arange(len(term.parameters))))
    added = []
    for finding in findings:
        if finding.effect == UNKNOWN:
            continue
        mine = [
            columns
            for term, columns in terms
            if term.kind == finding.effect and (not term.joints or set(term.joints) <= set(finding.joints))
        ]
        if mine:
            added.append(Added(finding.effect, finding.joints, finding.where, np.concatenate(mine), finding))
    return added


def with_friction_terms(
    extended: IdentifiedModel,
    base: Structure,
    identified: IdentifiedModel,
    findings: Sequence[Finding],
    rubbing: Collection[str] = (),
) -> IdentifiedModel:
    """The extended model with the friction terms that an identification chose, where no finding says the same.

    Args:
        extended: The simulation's terms and the effects that were found, with values.
        base: The simulation's terms; where they have more than the textbook's friction, nothing is added.
        identified: An identification of the same recordings, its structure chosen by prediction.
        findings: What was found.
        rubbing: Joints at which the wiring's search found friction by the load.
    """
    chosen = identified.model.structure
    if base["viscous_friction"] != {"vacuum": True} or base["stribeck_friction"].get("stribeck") is not False:
        return extended
    taken = {(finding.effect, joint) for finding in findings for joint in finding.joints}
    taken |= {(LoadFriction.kind, joint) for joint in rubbing}

    def free(term: Optional, joint: str) -> bool:
        return not any((effect, joint) in taken for effect in (term.effect, *term.rivals))

    by_symbol = {term.symbol: term for term in OPTIONAL}
    viscous = dict(chosen["viscous_friction"])
    joints = extended.model.arm.joint_names
    held = {joint: list(symbols) for joint, symbols in viscous.get("held", {}).items()}
    for joint in joints:
        for symbol in ("k_v2", "k_v3"):
            if not free(by_symbol[symbol], joint) and symbol not in held.setdefault(joint, []):
                held[joint].append(symbol)
    structure: Structure = {
        **extended.model.structure,
        "stribeck_friction": {"presliding": False},
        "viscous_friction": {**viscous, "held": {joint: symbols for joint, symbols in held.items() if symbols}},
    }
    for term in OptionalTerm:
        kind, option = term.row.term.kind, term.row.option
        if not option or term.row.symbol not in by_symbol:
            continue
        having = [j for j in chosen.get(kind, {}).get(option, ()) if free(by_symbol[term.row.symbol], j)]
        if having or kind in base:
            having += base.get(kind, {}).get(option) or ()
            structure[kind] = {**structure.get(kind, {}), option: [*dict.fromkeys(having)]}
    model = TorqueModel(extended.model.arm, structure)
    values = _starting_values(model, extended, identified)
    terms = model.terms
    return IdentifiedModel(
        model,
        np.array([values.get((term.kind, item.name), 0.0) for term in terms for item in term.parameters]),
        np.array([values.get((term.kind, item.name), 0.0) for term in terms for item in term.constants]),
        extended.cutoff_hz,
    )


def _starting_values(
    model: TorqueModel, extended: IdentifiedModel, identified: IdentifiedModel
) -> dict[tuple[str, str], float]:
    """Values by kind of term and name: what the extended model has, and the shape of friction that was identified."""
    here, there = extended.by_term, identified.by_term
    values = {**there, **here}
    friction = "stribeck_friction"
    # Elsewhere a static level held at one value beside a Coulomb friction that is fitted would be Stribeck friction.
    with_level = model.structure[friction]["stribeck"]
    for joint in model.arm.joint_names:
        values[friction, f"v_b[{joint}]"] = there.get((friction, f"v_b[{joint}]"), 0.0) if joint in with_level else 0.0
        values[friction, f"d_s[{joint}]"] = 0.0
        values[friction, f"f_b[{joint}]"] = values[friction, f"f_c[{joint}]"]
    # What a finding stands for is not to stay at the value that it had beside no finding.
    for term in model.terms:
        if term.kind == ViscousFriction.kind:
            values |= {(term.kind, one.name): 0.0 for one in term.parameters if one.held}
    return values


def friction_by_load(model: IdentifiedModel, laws: Collection[str]) -> list[Added]:
    """Friction by the load that the wiring's search found (`conventions.Wired.laws`).

    Args:
        model: A model with those terms.
        laws: Names of their parameters, such as `mu_in[joint_2]`.
    """
    found = []
    for term, first, _ in model.model.numbered():
        if isinstance(term, LoadFriction) and term.parameters[0].name in laws:
            where = term.where(np.array([model.parameters[first]]))
            found.append(Added(term.kind, term.joints, where, np.array([first])))
    return found


def optional_terms(model: IdentifiedModel, base: TorqueModel) -> list[Added]:
    """The friction terms of a model that its base does not have; effects of the catalogue are none of them.

    Args:
        model: A model with values.
        base: The simulation's own terms.
    """
    known = {parameter.name for parameter, in_base in _free(base) if in_base}
    known |= {p.name for term, _, _ in model.model.numbered() if isinstance(term, Effect) for p in term.parameters}
    by_symbol = {term.symbol: term for term in OPTIONAL}
    found = []
    for number, (parameter, is_free) in enumerate(_free(model.model)):
        if is_free and parameter.symbol in by_symbol and parameter.name not in known:
            term = by_symbol[parameter.symbol]
            found.append(
                Added(term.effect, (parameter.joint,), f"{term.words} at {parameter.joint}", np.array([number]))
            )
    return found


def _free(model: TorqueModel) -> list[tuple[Parameter, bool]]:
    """Parameters, and whether each may have a value of its own; the static level only where there is a v_b."""
    stribeck = model.structure.get("stribeck_friction", {}).get("stribeck", True)
    joints = model.arm.joint_names if stribeck is True else stribeck or ()
    return [(p, not p.held and (p.symbol != "f_b" or p.joint in joints)) for p in model.parameters]
