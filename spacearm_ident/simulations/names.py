"""Joint names of a simulation that are the recordings' with a prefix or a suffix, and models under the other names."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any
from xml.etree import ElementTree

from ..documents import parse_xml
from ..dynamics.arm import Arm
from ..dynamics.model import IdentifiedModel, TorqueModel
from .simulation import Simulation


@dataclass(frozen=True)
class Affix:
    """What one side has before or behind all joint names of the other.

    Attributes:
        text: The prefix or suffix.
        leads: Whether it is a prefix.
        simulated: Whether the simulation has it; otherwise the recordings.
    """

    text: str
    leads: bool
    simulated: bool

    @property
    def words(self) -> str:
        """As a person would name it."""
        owner = "simulation's" if self.simulated else "recordings'"
        return f"the {'prefix' if self.leads else 'suffix'} {self.text!r} of the {owner} joint names"

    def own(self, recorded: str) -> str:
        """The simulation's name of a recorded joint; empty: it has none."""
        if self.simulated:
            return self.text + recorded if self.leads else recorded + self.text
        return recorded.removeprefix(self.text) if self.leads else recorded.removesuffix(self.text)


def affixes(simulated: Collection[str], recorded: Sequence[str]) -> list[Affix]:
    """Every prefix or suffix by which all recorded joints are joints of a simulation; none where names are the same.

    Args:
        simulated: Joint names of the simulation.
        recorded: Those of the recordings.
    """
    if not recorded or set(simulated) & set(recorded):
        return []
    first, found = recorded[0], []
    for name in simulated:
        for longer, shorter, owned in ((name, first, True), (first, name, False)):
            if shorter and longer.endswith(shorter):
                found.append(Affix(longer.removesuffix(shorter), True, owned))
            if shorter and longer.startswith(shorter):
                found.append(Affix(longer.removeprefix(shorter), False, owned))
    # A recorded name without the affix stays as it is, and is no joint of the simulation.
    all_there = (one for one in found if all(one.own(joint) in simulated for joint in recorded))
    return list({tuple(one.own(joint) for joint in recorded): one for one in all_there}.values())


def renamed(simulation: Simulation, names: Mapping[str, str]) -> Simulation:
    """The simulation with other names of some joints.

    Args:
        simulation: The simulation.
        names: Joint -> its other name, none of which another joint has.
    """
    return replace(
        simulation,
        model=renamed_model(simulation.model, names),
        bodies={names.get(joint, joint): simulation.body(joint) for joint in simulation.arm.joint_names},
        parts=tuple(replace(part, joint=names.get(part.joint, part.joint)) for part in simulation.parts),
    )


def renamed_model(identified: IdentifiedModel, names: Mapping[str, str]) -> IdentifiedModel:
    """The model with other names of some joints.

    Args:
        identified: The model, a plain model in it included.
        names: Joint -> its other name, none of which another joint has.
    """
    arm = _arm(identified.model.arm, names)

    def model(one: TorqueModel) -> TorqueModel:
        return replace(one, arm=arm, structure={kind: _replaced(own, names) for kind, own in one.structure.items()})

    plain = identified.plain
    return replace(
        identified,
        model=model(identified.model),
        plain=None if plain is None else replace(plain, model=model(plain.model)),
    )


def _arm(arm: Arm, names: Mapping[str, str]) -> Arm:
    return replace(
        arm,
        joints=tuple(replace(joint, name=names.get(joint.name, joint.name)) for joint in arm.joints),
        urdf=_urdf(arm.urdf, names),
        described=arm.described and _urdf(arm.described, names),
        couplings=tuple(replace(one, ratios=_replaced(dict(one.ratios), names)) for one in arm.couplings),
        locked=tuple(names.get(joint, joint) for joint in arm.locked),
    )


def _urdf(text: str, names: Mapping[str, str]) -> str:
    """The text of a description with other names of some joints."""
    robot = parse_xml(text, "the URDF")
    for element in robot.iter():
        if element.tag == "joint" and element.get("name") in names:
            element.set("name", names[element.attrib["name"]])
        if element.tag == "mimic" and element.get("joint") in names:
            element.set("joint", names[element.attrib["joint"]])
    return ElementTree.tostring(robot, encoding="unicode")


def _replaced(value: Any, names: Mapping[str, str]) -> Any:
    """Options of terms with the other names, wherever a joint's stands, as a key or a value."""
    if isinstance(value, Mapping):
        return {names.get(key, key): _replaced(one, names) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return type(value)(_replaced(one, names) for one in value)
    return names.get(value, value) if isinstance(value, str) else value
