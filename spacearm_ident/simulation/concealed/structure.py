"""Concealed masses, springs, gaps, bending links, moving bases, contacts."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np
import pinocchio as pin

from spacearm_ident.arrays import FloatArray
from spacearm_ident.dynamics.urdf_chain import bounded
from spacearm_ident.errors import UserError
from spacearm_ident.simulation.concealed.compliant import Base, Force, Hinge, Spring, Structure, joint_axes
from spacearm_ident.simulation.concealed.effect import Effect, Parameter
from spacearm_ident.simulation.parameters import PlantParameters


class Payload(Effect):
    """Something held by a link: a ball of `radius` at `centre` in the frame of its joint."""

    name = "payload"
    parameters: ClassVar = {
        "mass": Parameter("kg", 0.1, 1.5),
        "centre": Parameter("m", -0.3, 0.3, 0.05, size=3),
        "radius": Parameter("m", 0.01, 0.1, 0.04),
    }
    joints_needed = 1

    def alter(self, parameters: PlantParameters) -> PlantParameters:
        """Add it to the body."""
        body = parameters.rigid_body.copy()
        joint, mass = int(self.joints[0]), self.one("mass")
        ball = pin.Inertia.FromSphere(mass, self.one("radius"))
        held = pin.Inertia(mass, self.values["centre"][0], np.array(ball.inertia))
        body[joint] += held.toDynamicParameters()
        return replace(parameters, rigid_body=body)


class BaseTilt(Effect):
    """The base stands crooked: gravity comes from `angle` off, towards `azimuth` about the base's vertical."""

    name = "base_tilt"
    parameters: ClassVar = {"angle": Parameter("rad", 0.005, 0.09), "azimuth": Parameter("rad", -np.pi, np.pi, 0.0)}

    def alter(self, parameters: PlantParameters) -> PlantParameters:
        """Turn gravity about the horizontal axis square to the azimuth."""
        azimuth = self.one("azimuth")
        axis = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
        return replace(parameters, gravity=pin.exp3(-self.one("angle") * axis) @ parameters.gravity)


class JointElasticity(Effect):
    """Motor and link are two inertias with a spring between; friction is at the motor, and so is the encoder.

    Law `hardening`: three times the stiffness at 2 mrad, or twice that at the twist that `doubles_at` says.
    """

    name = "joint_elasticity"
    parameters: ClassVar = {
        "stiffness": Parameter("N m/rad", 2.5e3, 4e4),
        "damping": Parameter("N m s/rad", 0.5, 40.0, 8.0),
        "doubles_at": Parameter("rad", 5e-4, 2e-2, float(2e-3 / np.sqrt(2.0))),
    }
    laws = ("usual", "hardening")

    def build(self, structure: Structure) -> None:
        """A spring at each joint."""
        for i, joint in enumerate(self.joints):
            stiffness, damping, twist = (float(self.values[name][i]) for name in self.parameters)
            cubic = stiffness / twist**2 if self.law == "hardening" else 0.0
            structure.add_spring(int(joint), self._spring(stiffness, damping, cubic))

    @staticmethod
    def _spring(stiffness: float, damping: float, cubic: float) -> Spring:
        return lambda twist, rate: twist * (stiffness + cubic * twist * twist) + damping * rate


class Backlash(Effect):
    """Motor and link are two inertias whose teeth touch only outside a gap; they push, never pull."""

    name = "backlash"
    parameters: ClassVar = {
        "gap": Parameter("rad", 1e-3, 2e-2),
        "stiffness": Parameter("N m/rad", 1e4, 8e4, 3e4),
        "damping": Parameter("N m s/rad", 1.0, 400.0, 15.0),
    }

    def build(self, structure: Structure) -> None:
        """A pair of flanks at each joint."""
        for i, joint in enumerate(self.joints):
            half, stiffness, damping = (float(self.values[name][i]) for name in ("gap", "stiffness", "damping"))
            structure.add_spring(int(joint), self._flanks(half / 2.0, stiffness, damping))

    @staticmethod
    def _flanks(half: float, stiffness: float, damping: float) -> Spring:
        def torque(twist: float, rate: float) -> float:
            if abs(twist) <= half:
                return 0.0
            if twist > 0:
                return max(0.0, stiffness * (twist - half) + damping * rate)
            return min(0.0, stiffness * (twist + half) + damping * rate)

        return torque


class LinkFlexibility(Effect):
    """The link after the joint bends: a sprung hinge `place` of the way to the next joint, which nothing measures.

    It bends square to its length, `direction` rad about the length from the plane its joint moves it in (0: bends in
    that plane, pi/2: sideways).
    """

    name = "link_flexibility"
    parameters: ClassVar = {
        "stiffness": Parameter("N m/rad", 1.5e3, 6e4),
        "damping": Parameter("N m s/rad", 0.2, 30.0, 6.0),
        "place": Parameter("1", 0.1, 0.9, 0.5),
        "direction": Parameter("rad", -np.pi, np.pi, 0.0),
    }
    joints_needed = 1

    def alter(self, parameters: PlantParameters) -> PlantParameters:
        """Find the axis; the parameters stay.

        Raises:
            UserError: No link follows.
        """
        joint = int(self.joints[0])
        if joint + 1 >= len(parameters.joints):
            raise UserError(f"link_flexibility: no link follows {parameters.joints[joint]}; choose a joint before it")
        model = pin.buildModelFromXML(bounded(parameters.urdf))
        along = model.jointPlacements[joint + 2].translation
        own = joint_axes(model)[joint]
        along = along / np.linalg.norm(along) if np.linalg.norm(along) > 1e-9 else np.array([0.0, 0.0, 1.0])
        square = own - (own @ along) * along
        if np.linalg.norm(square) < 1e-3:
            square = np.cross(along, [1.0, 0.0, 0.0] if abs(along[0]) < 0.9 else [0.0, 1.0, 0.0])
        self._axis = pin.exp3(self.one("direction") * along) @ (square / np.linalg.norm(square))
        return parameters

    def build(self, structure: Structure) -> None:
        """One hinge."""
        hinge = Hinge(self._axis, self.one("place"), self.one("stiffness"), self.one("damping"))
        structure.hinges[int(self.joints[0])] = hinge


class FloatingBase(Effect):
    """The arm stands on a free body, as on a satellite: every motion of the arm moves the base.

    Under gravity the whole falls, and the joints feel none. `base_ratio`: mass of the base over that of the arm; the
    base's radius of gyration is `gyration`, its centre that far below the arm's foot times `below`.
    """

    name = "floating_base"
    parameters: ClassVar = {
        "base_ratio": Parameter("1", 3.0, 50.0),
        "gyration": Parameter("m", 0.2, 0.8, 0.4),
        "below": Parameter("1", 0.0, 1.5, 0.8),
    }

    def alter(self, parameters: PlantParameters) -> PlantParameters:
        """Weigh the arm; the parameters stay."""
        self._mass = self.one("base_ratio") * float(parameters.rigid_body[:, 0].sum())
        return parameters

    def build(self, structure: Structure) -> None:
        """A free-flyer under the arm."""
        radius = self.one("gyration")
        centre = np.array([0.0, 0.0, -radius * self.one("below")])
        structure.base = Base(self._mass, self._mass * radius**2, centre)


class RotorCoupling(Effect):
    """The fast rotor of a joint feels every turn of the links before it, and they feel it.

    `inertia`: rotor inertia times gear ratio, which is what couples (kg·m²); `gear_ratio` splits the two.
    """

    name = "rotor_coupling"
    parameters: ClassVar = {"inertia": Parameter("kg m2", 0.01, 1.5), "gear_ratio": Parameter("1", 20.0, 160.0, 80.0)}

    def build(self, structure: Structure) -> None:
        """A spinning body at each joint."""
        for joint, coupling, ratio in zip(self.joints, self.values["inertia"], self.values["gear_ratio"], strict=True):
            structure.rotors[int(joint)] = (float(ratio), float(coupling / ratio))


class ExternalContact(Effect):
    """For `duration` seconds from `start` something pushes the link with `force`, with soft edges.

    `direction`: towards where, in the base frame (only its direction counts); `point`: in the joint's frame.
    Law `rubbing`: the push trembles at 3 Hz by 30 %.
    """

    name = "external_contact"
    parameters: ClassVar = {
        "force": Parameter("N", 3.0, 40.0),
        "direction": Parameter("1", -1.0, 1.0, 1.0, size=3),
        "point": Parameter("m", -0.3, 0.3, 0.0, size=3),
        "start": Parameter("s", 0.0, 3600.0, 6.0),
        "duration": Parameter("s", 1.0, 4.0, 2.0),
    }
    laws = ("usual", "rubbing")
    joints_needed = 1
    _EDGE_S = 0.1

    def build(self, structure: Structure) -> None:
        """One force."""
        direction = self.values["direction"][0]
        push = self.one("force") * direction / max(float(np.linalg.norm(direction)), 1e-12)
        start, stop = self.one("start"), self.one("start") + self.one("duration")

        def value(time: float) -> FloatArray | None:
            if not start < time < stop:
                return None
            edge = min(1.0, (time - start) / self._EDGE_S, (stop - time) / self._EDGE_S)
            tremble = 1.0 + 0.3 * np.sin(6 * np.pi * time) if self.law == "rubbing" else 1.0
            return np.asarray(push * (0.5 - 0.5 * np.cos(np.pi * edge)) * tremble)

        structure.forces.append(Force(int(self.joints[0]), self.values["point"][0], value))
