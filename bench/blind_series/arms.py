"""Healthy arms with dirt: geometry, friction, drives and moderate effects that no recording lacks.

Geometry and inertia of the UR10 and the Panda come from the package example-robot-data (Gepetto). The
Staubli TX40 is written from published dimensions; its friction and rotor inertia follow the values that
Gautier, Janot and Vandanjon report (IEEE Trans. Control Systems Technology 21(2), 2013). The gantry
(`rail4`) is an arm of our own with a horizontal prismatic axis.
"""

from __future__ import annotations

import site
import xml.etree.ElementTree as ET
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pinocchio as pin


@dataclass
class Arm:
    """A healthy arm. Arrays have one entry a joint (n); output-side units (rad, N m; m, N on a rail)."""

    name: str
    urdf: str  #: true inertials; no meshes
    middle: np.ndarray  #: middle of the excitation, rad
    span: np.ndarray  #: largest excursion from the middle, rad
    speed: np.ndarray  #: largest speed, rad/s
    acceleration: np.ndarray  #: largest acceleration, rad/s^2
    rotor: np.ndarray  #: reflected rotor inertia, kg m^2
    gear: np.ndarray  #: gear ratio (motor turns a joint turn)
    coulomb: np.ndarray  #: N m
    viscous: np.ndarray  #: N m s/rad
    breakaway: np.ndarray  #: static level over the Coulomb level, ratio
    stribeck: np.ndarray  #: Stribeck velocity, rad/s
    presliding: np.ndarray  #: Dahl displacement, rad
    limit: np.ndarray  #: torque limit, N m
    resolution: np.ndarray  #: encoder resolution, rad
    noise: np.ndarray  #: standard deviation of current noise, in torque, N m
    rate: float  #: rate of the log, Hz
    antialias: str  #: 'mean' over the log period, 'butter' (causal) or 'none'
    has_velocity: bool
    square: np.ndarray | None = None  #: coefficient of v|v|, N m s^2/rad^2
    cubic: np.ndarray | None = None  #: coefficient of v^3, N m s^3/rad^3
    load: np.ndarray | None = None  #: friction a unit of transmitted torque
    asymmetry: np.ndarray | None = None  #: relative difference of Coulomb level between directions
    wave: np.ndarray | None = None  #: relative change of Coulomb level with angle, first harmonic
    bandwidth: float = 6.0  #: position loop, Hz
    prismatic: np.ndarray = field(default_factory=lambda: np.zeros(0, bool))

    def __post_init__(self) -> None:
        self.model = pin.buildModelFromXML(self.urdf)
        self.n = self.model.nv
        for key in ("square", "cubic", "load", "asymmetry", "wave"):
            if getattr(self, key) is None:
                setattr(self, key, np.zeros(self.n))
        for key, value in vars(self).items():
            if isinstance(value, list):
                setattr(self, key, np.array(value, float))
        self.joints = list(self.model.names)[1:]
        self.prismatic = np.array([j.shortname().startswith("JointModelP") for j in list(self.model.joints)[1:]])


def strip(urdf: str, fixed: tuple[str, ...] = ()) -> str:
    """The URDF without meshes, transmissions and plugins; the named joints fixed."""
    root = ET.fromstring(urdf)
    for element in list(root):
        if element.tag not in ("link", "joint"):
            root.remove(element)
            continue
        for child in list(element):
            if child.tag in ("visual", "collision", "mimic", "safety_controller", "dynamics"):
                element.remove(child)
        if element.tag == "joint" and element.get("name") in fixed:
            element.set("type", "fixed")
    return ET.tostring(root, encoding="unicode")


def cad(urdf: str, rng: np.random.Generator, error: float = 0.04) -> str:
    """The URDF as a maker would deliver it: mass, centre and inertia off by a few per cent.

    Args:
        urdf: true description.
        rng: random generator.
        error: relative standard deviation of a mass; centres of mass move by 4 mm standard deviation.
    """
    root = ET.fromstring(urdf)
    for inertial in root.iter("inertial"):
        factor = 1 + error * rng.standard_normal()
        mass, inertia, origin = inertial.find("mass"), inertial.find("inertia"), inertial.find("origin")
        mass.set("value", f"{float(mass.get('value')) * factor:.5g}")
        factor *= 1 + error * rng.standard_normal()
        for key in inertia.attrib:
            inertia.set(key, f"{float(inertia.get(key)) * factor:.6g}")
        if origin is None:
            origin = ET.SubElement(inertial, "origin", xyz="0 0 0", rpy="0 0 0")
        xyz = [float(x) for x in (origin.get("xyz") or "0 0 0").split()]
        origin.set("xyz", " ".join(f"{x + 0.004 * rng.standard_normal():.5g}" for x in xyz))
    return ET.tostring(root, encoding="unicode")


def _data(path: str) -> str:
    for folder in site.getsitepackages():
        file = Path(folder) / "cmeel.prefix/share/example-robot-data/robots" / path
        if file.exists():
            return file.read_text()
    raise FileNotFoundError(f"example-robot-data has no {path}: pip install example-robot-data")


def _chain(name: str, rows: list[tuple]) -> str:
    """A serial URDF.

    Args:
        name: of the robot.
        rows: type, axis, xyz, rpy, mass, centre, (Ixx, Iyy, Izz) kg m^2, effort, speed, lower, upper of each joint.
    """
    text = [f'<robot name="{name}"><link name="base_link"/>']
    parent = "base_link"
    for i, (kind, axis, xyz, rpy, mass, centre, (a, b, c), effort, speed, low, high) in enumerate(rows, 1):
        text.append(
            f'<link name="link_{i}"><inertial><origin xyz="{centre}" rpy="0 0 0"/><mass value="{mass}"/>'
            f'<inertia ixx="{a}" ixy="0" ixz="0" iyy="{b}" iyz="0" izz="{c}"/></inertial></link>'
            f'<joint name="joint_{i}" type="{kind}"><origin xyz="{xyz}" rpy="{rpy}"/><parent link="{parent}"/>'
            f'<child link="link_{i}"/><axis xyz="{axis}"/>'
            f'<limit effort="{effort}" velocity="{speed}" lower="{low}" upper="{high}"/></joint>'
        )
        parent = f"link_{i}"
    return "".join(text) + "</robot>"


H = 1.57079632679


def ur10() -> Arm:
    """UR10: harmonic drives with Stribeck friction and a viscous term that flattens with speed (shear thinning)."""
    return Arm(
        name="ur10",
        urdf=strip(_data("ur_description/urdf/ur10_robot.urdf")),
        middle=[0, -1.2, 1.2, -0.8, 0.9, 0.2],
        span=[1.5, 0.8, 1.0, 1.3, 1.3, 1.8],
        speed=[1.5, 1.3, 1.8, 2.2, 2.2, 2.4],
        acceleration=[4, 3.5, 5, 8, 8, 10],
        rotor=[2.6, 2.6, 1.1, 0.32, 0.32, 0.25],
        gear=[101] * 6,
        coulomb=[14, 15, 8, 3.0, 2.8, 2.2],
        viscous=[28, 30, 14, 3.6, 3.3, 2.6],
        square=[-5, -5, -2, -0.4, -0.4, -0.3],
        breakaway=[1.15, 1.15, 1.2, 1.2, 1.2, 1.15],
        stribeck=[0.06] * 6,
        presliding=[8e-4] * 6,
        load=[0.02] * 6,
        limit=[330, 330, 150, 54, 54, 54],
        resolution=[2e-6] * 6,
        noise=[0.9, 0.9, 0.5, 0.16, 0.16, 0.16],
        rate=125,
        antialias="mean",
        has_velocity=True,
    )


def panda() -> Arm:
    """Panda with locked fingers: LuGre-like friction (presliding with a Stribeck level), 1 kHz log."""
    return Arm(
        name="panda",
        urdf=strip(_data("panda_description/urdf/panda.urdf"), ("panda_finger_joint1", "panda_finger_joint2")),
        middle=[0, 0.1, 0, -1.5, 0, 1.7, 0],
        span=[1.6, 1.1, 1.5, 1.1, 1.5, 1.3, 1.8],
        speed=[1.6, 1.5, 1.6, 1.6, 2.0, 2.0, 2.0],
        acceleration=[5, 4, 5, 5, 8, 8, 9],
        rotor=[0.55, 0.55, 0.45, 0.45, 0.2, 0.18, 0.15],
        gear=[100] * 7,
        coulomb=[3.2, 4.0, 2.8, 3.2, 1.3, 1.1, 0.9],
        viscous=[5, 6.5, 4.5, 5, 1.8, 1.4, 1.2],
        breakaway=[1.3] * 7,
        stribeck=[0.04] * 7,
        presliding=[5e-4] * 7,
        load=[0.01] * 7,
        limit=[87, 87, 87, 87, 12, 12, 12],
        resolution=[3e-6] * 7,
        noise=[0.25, 0.25, 0.25, 0.25, 0.08, 0.08, 0.08],
        rate=1000,
        antialias="none",
        has_velocity=True,
    )


def tx40() -> Arm:
    """Staubli TX40: asymmetric Coulomb friction, viscous and cubic terms; no velocity in the log, 500 Hz."""
    rows = [
        (
            "revolute",
            "0 0 1",
            "0 0 0.32",
            "0 0 0",
            10.5,
            "0 0.02 -0.043",
            (0.055, 0.047, 0.035),
            131.8,
            5.0,
            -3.14,
            3.14,
        ),
        (
            "revolute",
            "0 0 1",
            "0 0 0",
            f"{-H} 0 0",
            3.6,
            "0.109 -0.002 0.134",
            (0.009, 0.038, 0.040),
            131.8,
            5.0,
            -2.18,
            2.18,
        ),
        (
            "revolute",
            "0 0 1",
            "0.225 0 0.035",
            "0 0 0",
            4.07,
            "0.006 -0.008 0.041",
            (0.012, 0.012, 0.004),
            103.5,
            7.5,
            -2.4,
            2.4,
        ),
        (
            "revolute",
            "0 0 1",
            "0 -0.225 0",
            f"{H} 0 0",
            3.62,
            "0.002 0.004 -0.107",
            (0.013, 0.014, 0.004),
            46.1,
            7.1,
            -4.7,
            4.7,
        ),
        (
            "revolute",
            "0 0 1",
            "0 0 0",
            f"{-H} 0 0",
            1.02,
            "-0.003 0.004 -0.001",
            (0.001, 0.001, 0.001),
            43.2,
            5.6,
            -2.09,
            2.3,
        ),
        (
            "revolute",
            "0 0 1",
            "0 0 0",
            f"{H} 0 0",
            0.45,
            "0.004 0.006 0.055",
            (0.0006, 0.0006, 0.0003),
            30.7,
            12.2,
            -4.7,
            4.7,
        ),
    ]
    return Arm(
        name="tx40",
        urdf=_chain("tx40", rows),
        middle=[0, 0.2, 0.3, 0, 0.3, 0],
        span=[1.6, 1.2, 1.2, 2.0, 1.3, 2.4],
        speed=[2.8, 2.4, 3.0, 3.6, 3.0, 4.5],
        acceleration=[9, 8, 11, 16, 14, 20],
        rotor=[0.37, 0.37, 0.11, 0.033, 0.05, 0.012],
        gear=[40, 40, 40, 48, 45, 32],
        coulomb=[6.0, 7.4, 5.8, 2.4, 2.9, 1.2],
        viscous=[8.0, 5.6, 2.0, 1.1, 1.8, 0.6],
        cubic=[0.25, 0.2, 0.1, 0.04, 0.06, 0.012],
        breakaway=[1.0] * 6,
        stribeck=[0.1] * 6,
        presliding=[1e-3] * 6,
        asymmetry=[0.05, -0.04, 0.06, 0.03, -0.05, 0.04],
        limit=[131, 131, 103, 46, 43, 30],
        resolution=[5e-6] * 6,
        noise=[0.4, 0.4, 0.3, 0.12, 0.12, 0.08],
        rate=500,
        antialias="butter",
        has_velocity=False,
    )


def rail4() -> Arm:
    """Four axes: a horizontal prismatic rail, shoulder, elbow and tool roll; position-dependent friction."""
    rows = [
        ("prismatic", "1 0 0", "0 0 0.5", "0 0 0", 32.0, "0 0.02 0.05", (0.6, 0.8, 0.7), 1500, 1.5, -1.2, 1.2),
        ("revolute", "0 1 0", "0 0.12 0.15", "0 0 0", 9.0, "0.18 0.03 0.01", (0.03, 0.18, 0.17), 300, 3.0, -2.6, 2.6),
        ("revolute", "0 1 0", "0.45 0 0", "0 0 0", 5.0, "0.14 -0.02 0.01", (0.02, 0.07, 0.07), 150, 3.5, -2.6, 2.6),
        ("revolute", "1 0 0", "0.38 0 0", "0 0 0", 1.6, "0.06 0.03 0.02", (0.004, 0.005, 0.005), 40, 5.0, -3.1, 3.1),
    ]
    return Arm(
        name="rail4",
        urdf=_chain("rail4", rows),
        middle=[0, -0.5, 0.8, 0],
        span=[0.6, 0.9, 1.1, 1.8],
        speed=[0.8, 1.8, 2.2, 3.0],
        acceleration=[3, 5, 7, 12],
        rotor=[28.0, 1.5, 0.6, 0.08],
        gear=[62.8, 80, 80, 50],
        coulomb=[55, 11, 6, 1.4],
        viscous=[120, 14, 6, 1.3],
        cubic=[40, 0.8, 0.3, 0.05],
        breakaway=[1.1, 1.2, 1.2, 1.1],
        stribeck=[0.03, 0.06, 0.06, 0.08],
        presliding=[3e-4, 8e-4, 8e-4, 1e-3],
        load=[0, 0.03, 0.03, 0.02],
        wave=[0.08, 0.06, 0.05, 0.05],
        limit=[1500, 300, 150, 40],
        resolution=[1e-6, 3e-6, 3e-6, 5e-6],
        noise=[3.5, 0.6, 0.35, 0.1],
        rate=250,
        antialias="butter",
        has_velocity=True,
    )


ARMS = {"ur10": ur10, "panda": panda, "tx40": tx40, "rail4": rail4}
