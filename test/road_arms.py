"""Descriptions as other people write them: a SCARA, a gantry of prismatic joints, a robot with more than an arm."""

from __future__ import annotations

from pathlib import Path


def link(name: str, mass: float, centre: str = "0 0 0", size: tuple[float, float, float] = (0.1, 0.1, 0.1)) -> str:
    """A link with the inertia and the geometry of a box of so many metres."""
    x, y, z = size
    moments = [mass * (a * a + b * b) / 12 for a, b in ((y, z), (x, z), (x, y))]
    inertia = " ".join(f'{key}="{value:.6g}"' for key, value in zip(("ixx", "iyy", "izz"), moments))
    box = f'<origin xyz="{centre}"/><geometry><box size="{x} {y} {z}"/></geometry>'
    return (
        f'<link name="{name}"><inertial><origin xyz="{centre}"/><mass value="{mass}"/>'
        f'<inertia {inertia} ixy="0" ixz="0" iyz="0"/></inertial><collision>{box}</collision></link>'
    )


def joint(name: str, kind: str, parent: str, child: str, origin: str, axis: str, more: str = "") -> str:
    """A joint; `more` holds its limit, or what else it has."""
    axes = "" if kind == "fixed" else f'<axis xyz="{axis}"/>'
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{origin}"/>{axes}{more}</joint>'
    )


def limit(lower: float, upper: float, effort: float, velocity: float) -> str:
    """A limit element."""
    return f'<limit lower="{lower}" upper="{upper}" effort="{effort}" velocity="{velocity}"/>'


SCARA = (Path(__file__).parent.parent / "config" / "scara.urdf").read_text(encoding="utf-8")
"""The tutorial's: two vertical axes, a quill, and a continuous last joint."""

GANTRY = (
    '<robot name="gantry">'
    + link("frame", 200, "0 0 1.2", (2.0, 0.1, 0.1))
    + link("bridge", 40, "0 0.4 0", (0.1, 0.8, 0.1))
    + link("carriage", 12, "0 0 0", (0.15, 0.15, 0.2))
    + link("ram", 8, "0 0 -0.2", (0.08, 0.08, 0.6))
    + joint("x", "prismatic", "frame", "bridge", "0 0.1 1.2", "1 0 0", limit(-0.6, 0.6, 900, 1.0))
    + joint("y", "prismatic", "bridge", "carriage", "0.15 0.1 0", "0 1 0", limit(0.0, 0.6, 300, 1.0))
    + joint("z", "prismatic", "carriage", "ram", "0.15 0 0", "0 0 1", limit(-0.4, 0.0, 400, 0.6))
    + "</robot>"
)
"""Three prismatic joints; only the last one carries weight."""

SERVICE_ROBOT = (
    '<robot name="service">'
    + link("wheels", 30, "0 0 0.1", (0.5, 0.5, 0.2))
    + link("torso", 15, "0 0 0.3", (0.2, 0.2, 0.5))
    + link("head", 2)
    + link("upper", 3, "0 0 -0.15", (0.08, 0.08, 0.3))
    + link("fore", 2, "0 0 -0.12", (0.07, 0.07, 0.25))
    + link("palm", 0.6, "0 0 -0.05", (0.08, 0.05, 0.06))
    + link("left_finger", 0.05, "0 0 -0.03", (0.01, 0.02, 0.05))
    + link("right_finger", 0.05, "0 0 -0.03", (0.01, 0.02, 0.05))
    + joint("wheel", "floating", "wheels", "torso", "0 0 0.2", "0 0 1")
    + joint("head_pan", "revolute", "torso", "head", "0 0 0.75", "0 0 1", limit(-1, 1, 5, 2))
    + joint("shoulder", "revolute", "torso", "upper", "0.25 0 0.6", "0 1 0", limit(-2, 2, 40, 2))
    + joint("elbow", "revolute", "upper", "fore", "0 0 -0.32", "0 1 0", limit(-2.2, -0.2, 20, 2.5))
    + joint("wrist", "revolute", "fore", "palm", "0 0 -0.27", "0 1 0", limit(-1.5, 1.5, 6, 3))
    + joint("finger", "prismatic", "palm", "left_finger", "0.02 0 -0.08", "1 0 0", limit(0, 0.03, 20, 0.1))
    + joint(
        "mirror",
        "prismatic",
        "palm",
        "right_finger",
        "-0.02 0 -0.08",
        "-1 0 0",
        limit(0, 0.03, 20, 0.1) + '<mimic joint="finger" multiplier="1" offset="0"/>',
    )
    + '<transmission name="t"><joint name="shoulder"/><actuator name="m"><mechanicalReduction>1</mechanicalReduction>'
    "</actuator></transmission></robot>"
)
"""A base that floats, a head, an arm of three whose elbow cannot be straight, and a gripper whose fingers mirror."""
