"""The three arms: their files, the parameters of the true arm, and files with other parameters.

The UR5e and the iiwa 14 are the MJCF that MuJoCo users have, the Panda is the URDF of example-robot-data with its
fingers fixed. Inertials are the file's. Friction, damping and rotor inertia are the orders of magnitude of published
identifications, because the files hold none (iiwa, Panda) or the damping of their position servo (UR5e, 200 N m s/rad):

* UR5e: friction curves of a few N m at the size-3 and about 1 to 2 N m at the size-1 joints, as in Clochiatti et al.
  (2024), Robotics and Computer-Integrated Manufacturing 89; armature as in the file (0.1 kg m²);
* iiwa 14: rotor inertia and friction of the LWR4+ identified by Jubien, Gautier and Janot (2014), IFAC World Congress;
* Panda: friction of Gaz et al. (2019), IEEE RA-L 4(4), scaled to the motor side.

The numbers are rounded and chosen here, not copied: they only set the scale of a test.
"""

from __future__ import annotations

import copy
import re
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np

MODELS = Path("/work/shared/models")
"""Default folder of `ur5e.xml` and `iiwa14.xml`."""

Table = dict[str, dict[str, dict[str, float | list[float]]]]
"""`{"bodies": {NAME: {"mass" kg, "com" m (3)}}, "joints": {NAME: {"armature" kg m², "damping" N m s/rad,
"frictionloss" N m}}}`."""


@dataclass(frozen=True)
class Arm:
    """One arm.

    Attributes:
        name: name in results.
        urdf: whether `text` is a URDF; else an MJCF.
        text: the file.
        joints: joint names, base to tip (n).
        bodies: the body that each joint moves (n).
        armature: rotor inertia on the output side, kg m² (n).
        damping: viscous friction, N m s/rad (n).
        frictionloss: Coulomb friction, N m (n).
        lower: lower end of the range that excitations use, rad (n).
        upper: upper end, rad (n).
        velocity: velocity limit of the excitations, rad/s (n).
        effort: torque limit, N m (n).
        stiffness: scale of a gear's stiffness, N m/rad (n).
    """

    name: str
    urdf: bool
    text: str
    joints: tuple[str, ...]
    bodies: tuple[str, ...]
    armature: np.ndarray
    damping: np.ndarray
    frictionloss: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    velocity: np.ndarray
    effort: np.ndarray
    stiffness: np.ndarray

    def table(self) -> Table:
        """The true parameters before any change, as `Table`."""
        root = ElementTree.fromstring(self.text)
        bodies: dict[str, dict[str, float | list[float]]] = {}
        for name in self.bodies:
            inertial = _inertial(root, name, self.urdf)
            if self.urdf:
                mass = float(inertial.find("mass").get("value"))  # type: ignore[union-attr, arg-type]
                com = inertial.find("origin").get("xyz")  # type: ignore[union-attr]
            else:
                mass, com = float(inertial.get("mass")), inertial.get("pos")  # type: ignore[arg-type]
            bodies[name] = {"mass": mass, "com": [float(x) for x in str(com).split()]}
        joints: dict[str, dict[str, float | list[float]]] = {
            name: {
                "armature": 0.0 if self.urdf else float(self.armature[i]),
                "damping": float(self.damping[i]),
                "frictionloss": float(self.frictionloss[i]),
            }
            for i, name in enumerate(self.joints)
        }
        return {"bodies": bodies, "joints": joints}

    def write(self, table: Table) -> str:
        """The arm's file with the parameters of `table`.

        Args:
            table: parameters of every body and joint. A URDF holds no armature.

        Returns:
            XML text in the format of `text`.
        """
        root = ElementTree.fromstring(self.text)
        for name, body in table["bodies"].items():
            inertial = _inertial(root, name, self.urdf)
            com = " ".join(f"{x:.9g}" for x in body["com"])  # type: ignore[union-attr]
            if self.urdf:
                inertial.find("mass").set("value", f"{body['mass']:.9g}")  # type: ignore[union-attr]
                inertial.find("origin").set("xyz", com)  # type: ignore[union-attr]
            else:
                inertial.set("mass", f"{body['mass']:.9g}")
                inertial.set("pos", com)
        for name, joint in table["joints"].items():
            element = next(j for j in root.iter("joint") if j.get("name") == name)
            if self.urdf:
                for old in element.findall("dynamics"):
                    element.remove(old)
                dynamics = {"damping": f"{joint['damping']:.9g}", "friction": f"{joint['frictionloss']:.9g}"}
                ElementTree.SubElement(element, "dynamics", dynamics)
            else:
                for key in ("armature", "damping", "frictionloss"):
                    element.set(key, f"{joint[key]:.9g}")
        return ElementTree.tostring(root, encoding="unicode")


def _inertial(root: ElementTree.Element, body: str, urdf: bool) -> ElementTree.Element:
    element = next(b for b in root.iter("link" if urdf else "body") if b.get("name") == body)
    inertial = element.find("inertial")
    if inertial is None:
        raise ValueError(f"body {body} has no inertial")
    return inertial


@dataclass(frozen=True)
class Payload:
    """A body fixed to the last link: mass kg, centre m in the last link's frame (3), rotational inertia kg m² (3)."""

    mass: float
    com: tuple[float, float, float]
    inertia: tuple[float, float, float]


def true_model(
    arm: Arm,
    table: Table,
    elastic: tuple[int, ...] = (),
    payload: Payload | None = None,
    gravity: np.ndarray | None = None,
    timestep: float = 5e-4,
) -> mujoco.MjModel:
    """The true arm as a MuJoCo model without actuators.

    Args:
        arm: the arm.
        table: its parameters.
        elastic: joints (indices) that get a second hinge in series, `NAME_flex`, for the deflection of the gear. The
            first hinge carries motor torque, rotor inertia and friction (Spong 1987, J. Dyn. Sys. Meas. Control 109).
        payload: body at the last link, or none.
        gravity: m/s² in the base frame (3); 0 0 -9.81 when not given.
        timestep: s.

    Returns:
        The compiled model, integrator `implicitfast`, discrete-time inverse off.
    """
    spec = mujoco.MjSpec.from_string(arm.write(table))
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    if arm.urdf:  # the format has no armature; the arm may have
        for name, joint in table["joints"].items():
            spec.joint(name).armature = joint["armature"]
    if payload is not None:
        body = spec.body(arm.bodies[-1]).add_body(name="payload", pos=list(payload.com))
        body.mass, body.ipos, body.inertia = payload.mass, [0, 0, 0], list(payload.inertia)
        body.explicitinertial = True
    for j in elastic:
        joint = spec.joint(arm.joints[j])
        hinge = mujoco.mjtJoint.mjJNT_HINGE
        spec.body(arm.bodies[j]).add_joint(name=f"{arm.joints[j]}_flex", type=hinge, axis=joint.axis, limited=0)
    for joint in spec.joints:
        joint.limited = 0
    model = spec.compile()
    for j in elastic:  # defaults of the file's class do not belong to the deflection
        dof = model.joint(f"{arm.joints[j]}_flex").dofadr[0]
        model.dof_armature[dof] = model.dof_damping[dof] = model.dof_frictionloss[dof] = 0.0
    model.opt.timestep = timestep
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.opt.gravity[:] = (0.0, 0.0, -9.81) if gravity is None else gravity
    return model


def urdf_of(arm: Arm, table: Table) -> str:
    """The URDF that `/robot_description` carries: the simulation's kinematics and inertials, no friction.

    Args:
        arm: the arm.
        table: the simulation's parameters (not the truth).

    Returns:
        URDF text.
    """
    if arm.urdf:
        return arm.write(table)
    model = mujoco.MjModel.from_xml_string(arm.write(table))
    lines = [f'<robot name="{arm.name}">', '  <link name="world_link"/>']
    for b in range(1, model.nbody):
        inertia = np.zeros(9)
        mujoco.mju_quat2Mat(inertia, model.body_iquat[b])
        rotation = inertia.reshape(3, 3)
        full = rotation @ np.diag(model.body_inertia[b]) @ rotation.T
        lines += [
            f'  <link name="{model.body(b).name}"><inertial>',
            f'    <origin xyz="{_numbers(model.body_ipos[b])}" rpy="0 0 0"/><mass value="{model.body_mass[b]:.9g}"/>',
            f'    <inertia ixx="{full[0, 0]:.9g}" ixy="{full[0, 1]:.9g}" ixz="{full[0, 2]:.9g}" iyy="{full[1, 1]:.9g}"'
            f' iyz="{full[1, 2]:.9g}" izz="{full[2, 2]:.9g}"/>',
            "  </inertial></link>",
        ]
        parent = model.body_parentid[b]
        parent_name = model.body(parent).name if parent else "world_link"
        moved = model.body_jntnum[b] > 0
        name = model.joint(model.body_jntadr[b]).name if moved else f"{model.body(b).name}_fixed"
        lines += [
            f'  <joint name="{name}" type="{"revolute" if moved else "fixed"}">',
            f'    <parent link="{parent_name}"/><child link="{model.body(b).name}"/>',
            f'    <origin xyz="{_numbers(model.body_pos[b])}" rpy="{_numbers(_rpy(model.body_quat[b]))}"/>',
        ]
        if moved:
            j, i = model.body_jntadr[b], arm.joints.index(name)
            low, high = model.jnt_range[j]
            lines += [
                f'    <axis xyz="{_numbers(model.jnt_axis[j])}"/>',
                f'    <limit lower="{low:.6g}" upper="{high:.6g}" effort="{arm.effort[i]:.6g}" velocity="3.2"/>',
            ]
        lines += ["  </joint>"]
    return "\n".join([*lines, "</robot>"])


def _numbers(values: np.ndarray) -> str:
    return " ".join(f"{x:.12g}" for x in values)


def _rpy(quaternion: np.ndarray) -> np.ndarray:
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    r = matrix.reshape(3, 3)
    pitch = np.arctan2(-r[2, 0], np.hypot(r[0, 0], r[1, 0]))
    if np.hypot(r[0, 0], r[1, 0]) < 1e-9:  # roll and yaw turn about one axis: all of it is roll
        return np.array([np.arctan2(-r[1, 2] * np.sign(1), r[1, 1]), pitch, 0.0])
    return np.array([np.arctan2(r[2, 1], r[2, 2]), pitch, np.arctan2(r[1, 0], r[0, 0])])


def _panda_text() -> str:
    import sysconfig

    share = "cmeel.prefix/share/example-robot-data/robots/panda_description/urdf/panda.urdf"
    text = (Path(sysconfig.get_paths()["purelib"]) / share).read_text()
    text = re.sub(r"<visual>.*?</visual>|<collision>.*?</collision>|<!--.*?-->", "", text, flags=re.DOTALL)
    root = ElementTree.fromstring(text)
    for joint in root.iter("joint"):
        for safety in joint.findall("safety_controller"):
            joint.remove(safety)
        if "finger" in str(joint.get("name")):
            joint.set("type", "fixed")
            for tag in ("limit", "mimic", "dynamics", "axis"):
                for element in joint.findall(tag):
                    joint.remove(element)
    for link in root.iter("link"):  # a massless frame has no inertial
        inertial = link.find("inertial")
        if inertial is not None and float(inertial.find("mass").get("value")) == 0.0:  # type: ignore[union-attr, arg-type]
            link.remove(inertial)
    return ElementTree.tostring(root, encoding="unicode")


def arms(models: Path = MODELS) -> dict[str, Arm]:
    """The three arms by name.

    Args:
        models: folder of `ur5e.xml` and `iiwa14.xml`.
    """
    a = np.array
    ur = Arm(
        "ur5e",
        False,
        (models / "ur5e.xml").read_text(),
        ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint"),
        ("shoulder_link", "upper_arm_link", "forearm_link", "wrist_1_link", "wrist_2_link", "wrist_3_link"),
        np.full(6, 0.1),
        a([11.0, 12.0, 9.0, 1.8, 1.6, 1.4]),
        a([7.0, 8.0, 6.0, 1.4, 1.3, 1.1]),
        a([-2.5, -2.6, -2.2, -2.5, -2.5, -2.5]),
        a([2.5, 0.4, 2.2, 2.5, 2.5, 2.5]),
        a([1.6, 1.4, 1.6, 2.2, 2.2, 2.2]),
        a([150.0, 150.0, 150.0, 28.0, 28.0, 28.0]),
        a([9000.0, 9000.0, 7000.0, 2500.0, 2500.0, 2500.0]),
    )
    iiwa = Arm(
        "iiwa14",
        False,
        (models / "iiwa14.xml").read_text(),
        tuple(f"joint{i}" for i in range(1, 8)),
        tuple(f"link{i}" for i in range(1, 8)),
        a([3.2, 3.0, 2.0, 2.0, 0.8, 0.4, 0.4]),
        a([14.0, 15.0, 8.0, 10.0, 5.0, 2.3, 2.1]),
        a([11.0, 11.0, 8.0, 9.0, 5.0, 2.6, 2.4]),
        a([-2.7, -1.9, -2.8, -1.9, -2.8, -1.9, -2.8]),
        a([2.7, 1.9, 2.8, 1.9, 2.8, 1.9, 2.8]),
        a([1.3, 1.3, 1.5, 1.3, 1.8, 2.0, 2.0]),
        a([320.0, 320.0, 176.0, 176.0, 110.0, 40.0, 40.0]),
        a([12000.0, 12000.0, 8000.0, 8000.0, 6000.0, 3000.0, 3000.0]),
    )
    panda = Arm(
        "panda",
        True,
        _panda_text(),
        tuple(f"panda_joint{i}" for i in range(1, 8)),
        tuple(f"panda_link{i}" for i in range(1, 8)),
        a([0.6, 0.6, 0.5, 0.5, 0.15, 0.15, 0.12]),
        a([4.5, 4.8, 3.6, 3.8, 1.2, 1.0, 0.9]),
        a([3.2, 3.6, 2.8, 3.0, 1.0, 0.9, 0.8]),
        a([-2.6, -1.5, -2.6, -2.9, -2.6, 0.2, -2.6]),
        a([2.6, 1.5, 2.6, -0.3, 2.6, 3.5, 2.6]),
        a([1.6, 1.5, 1.7, 1.7, 2.0, 2.0, 2.2]),
        a([87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0]),
        a([7000.0, 7000.0, 7000.0, 7000.0, 3000.0, 3000.0, 3000.0]),
    )
    return {arm.name: arm for arm in (ur, iiwa, panda)}


def changed(table: Table) -> Table:
    """A copy of `table` that may be changed."""
    return copy.deepcopy(table)
