"""Sound recordings: windows of real ones, and arms simulated here from the URDFs of `example-robot-data`.

The simulation shares nothing with the package but the bag format: Pinocchio's RNEA on an arm whose masses and centres
differ from the URDF in the bag, friction with presliding (Dahl's state under one of four laws of speed and load), rotor
inertia, torque constants a few per cent off, encoder steps, torque noise, uneven stamps.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from importlib.metadata import distribution
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from spacearm_ident.recording import Recording, read_recording

Array = NDArray[np.float64]
Rng = np.random.Generator
GRAVITY = np.array([0.0, 0.0, -9.81])
START_NS = 1_760_000_000_000_000_000
"""First stamp of a simulated recording, ns since 1970."""
SIMULATED = {
    "ur5": ("ur_description/urdf/ur5_robot.urdf", r".*"),
    "ur10": ("ur_description/urdf/ur10_robot.urdf", r".*"),
    "panda": ("panda_description/urdf/panda.urdf", r"panda_joint\d"),
    "kinova": ("kinova_description/robots/kinova.urdf", r"j2s6s200_joint_\d"),
    "xarm7": ("xarm_description/urdf/xarm7.urdf", r"joint\d"),
    "z1": ("z1_description/urdf/z1.urdf", r"joint\d"),
    "tiago": ("tiago_description/robots/tiago_no_hand.urdf", r"arm_\d_joint"),
}
"""Arm: its URDF, and the joints that move (every other is fixed)."""
TORQUE_SENSORS = ("panda", "kinova")
"""Arms that measure torque behind the gear: little friction, no rotor inertia."""
REAL = ("ur10e", "tx40", "airbot", "panda", "rokae")
MOUNTS = {
    "floor": (0.0, 0.0, 0.0),
    "ceiling": (np.pi, 0.0, 0.0),
    "wall": (0.0, np.pi / 2, 0.0),
    "wall, turned": (np.pi / 2, 0.0, 0.0),
    "slanted": (0.0, np.pi / 4, 0.0),
}
"""Roll, pitch, yaw of the base in the world, rad."""
MOTIONS = ("fourier", "fourier", "point_to_point", "slow")
LAWS = ("coulomb", "stribeck", "sublinear", "load")
MOST_SAMPLES = 40_000
PRESLIDING_RAD = 0.004
"""Travel over which Dahl's friction turns round; 2 to 10 mrad is usual for harmonic drives."""


@dataclass(frozen=True)
class Sound:
    """A recording without a mistake. `urdf` is that of the arm standing on the floor."""

    arm: str
    simulated: bool
    recording: Recording
    urdf: str
    mount: str = "floor"
    detail: dict[str, Any] = field(default_factory=dict)


def gravity_in_base(mount: str) -> Array:
    """(3,) m/s^2 in the base frame of an arm mounted so."""
    return np.asarray(pin.rpy.rpyToMatrix(np.array(MOUNTS[mount])).T @ GRAVITY)


def mounted(urdf: str, mount: str) -> str:
    """The URDF with a root link that says how the base is mounted."""
    if mount == "floor":
        return urdf
    robot = ET.fromstring(urdf)
    children = {joint.find("child").get("link") for joint in robot.findall("joint")}  # type: ignore[union-attr]
    root = next(link.get("name") for link in robot.findall("link") if link.get("name") not in children)
    ET.SubElement(robot, "link", name="mounting_plate")
    joint = ET.SubElement(robot, "joint", name="mounting", type="fixed")
    ET.SubElement(joint, "parent", link="mounting_plate")
    ET.SubElement(joint, "child", link=str(root))
    ET.SubElement(joint, "origin", xyz="0 0 0", rpy=" ".join(f"{angle:.6f}" for angle in MOUNTS[mount]))
    return ET.tostring(robot, encoding="unicode")


@lru_cache
def arm_urdf(arm: str) -> str:
    """A simulated arm's URDF: no meshes, every joint but the arm's fixed, no unbounded joint."""
    name, moving = SIMULATED[arm]
    folder = Path(str(distribution("example-robot-data").locate_file("cmeel.prefix/share/example-robot-data/robots")))
    robot = ET.parse(folder / name).getroot()
    for child in list(robot):
        if child.tag not in ("link", "joint"):
            robot.remove(child)
        for part in [part for part in child if part.tag in ("visual", "collision", "mimic", "safety_controller")]:
            child.remove(part)
    for joint in robot.findall("joint"):
        free = joint.get("type") != "fixed" and re.fullmatch(moving, joint.get("name", ""))
        joint.set("type", "revolute" if free else "fixed")
    return ET.tostring(robot, encoding="unicode")


def real_window(rng: Rng, arm: str, folder: Path) -> Sound:
    """A window of 10 to 60 s out of a real recording; 60 to 100 % of it where it is shorter than 17 s."""
    files = sorted(path for path in (folder / arm).glob("*.mcap") if not path.stem.startswith("simulation"))
    path = files[rng.integers(len(files))]
    recording = _read(path)
    whole = recording.time[-1]
    length = rng.uniform(min(10.0, 0.6 * whole), min(60.0, whole))
    start = rng.uniform(0.0, whole - length)
    part = recording.between(start, start + length)
    shifted = replace(part, time=part.time - part.time[0], command=None, temperatures={}, issues=(), sources=())
    detail = {"file": path.name, "from_s": round(float(start), 2), "length_s": round(float(length), 2)}
    return Sound(arm, False, shifted, str(recording.urdf), detail=detail)


@lru_cache(maxsize=4)
def _read(path: Path) -> Recording:
    return read_recording(path)


def simulate(rng: Rng, arm: str, mount: str = "floor", rest: int | None = None) -> Sound:
    """A simulated recording.

    Args:
        rng: What everything is drawn from.
        arm: Key of `SIMULATED`.
        mount: How the arm is mounted, key of `MOUNTS`.
        rest: A joint that does not move, if any.

    Returns:
        The recording, N samples of n joints.
    """
    urdf = arm_urdf(arm)
    model = pin.buildModelFromXML(urdf)
    sensors = arm in TORQUE_SENSORS
    rate = float(rng.choice([100, 125, 200, 250, 500, 1000]))
    duration = rng.uniform(10.0, min(60.0, MOST_SAMPLES / rate))
    time = np.arange(0.0, duration, 1.0 / rate)
    motion = str(rng.choice(MOTIONS))
    reach = np.where(rng.random(model.nv) < 0.08, rng.uniform(0.0, 0.02, model.nv), 1.0)
    if rest is not None:
        reach[rest] = 0.0
    position, velocity, acceleration = _MOTION[motion](rng, time, model, reach)
    _differ(rng, model)
    model.gravity.linear = gravity_in_base(mount)
    effort, detail = _torque(rng, model, position, velocity, acceleration, sensors=sensors)
    step = 2.0 * np.pi / 2.0 ** rng.integers(15, 20)
    measured = np.round(position / step) * step
    kind = str(rng.choice(["measured", "differenced", "none"], p=[0.6, 0.25, 0.15]))
    if kind == "differenced":
        velocity = uniform_filter1d(np.gradient(measured, 1.0 / rate, axis=0), max(1, round(0.02 * rate)), axis=0)
    else:
        velocity = velocity + rng.normal(0.0, rng.uniform(0.001, 0.008), velocity.shape)
    stamps = time + np.clip(rng.normal(0.0, 0.02 / rate, len(time)), -0.2 / rate, 0.2 / rate)
    recording = Recording(
        joints=tuple(model.names[1:]),
        time=stamps - stamps[0],
        position=measured,
        velocity=None if kind == "none" else velocity,
        effort=effort,
        segments=(slice(0, len(time)),),
        start_ns=START_NS,
        urdf=urdf,
    )
    detail |= {"motion": motion, "rate_hz": rate, "length_s": round(duration, 2), "velocity": kind}
    return Sound(arm, True, recording, urdf, mount, detail)


def _differ(rng: Rng, model: pin.Model) -> None:
    """Makes the true arm: masses within 20 % and centres within 2 cm of the CAD values."""
    for inertia in list(model.inertias)[1:]:
        scale = rng.uniform(0.8, 1.2)
        inertia.lever = inertia.lever + rng.uniform(-0.02, 0.02, 3)
        inertia.inertia = inertia.inertia * scale
        inertia.mass = inertia.mass * scale


def _range(model: pin.Model) -> tuple[Array, Array]:
    """Joint ranges used, each (n,) rad: the limits, at most ±2.6 rad about their middle."""
    middle = (model.upperPositionLimit + model.lowerPositionLimit) / 2
    half = np.minimum((model.upperPositionLimit - model.lowerPositionLimit) / 2, 2.6)
    return middle, 0.95 * half


def _fourier(rng: Rng, time: Array, model: pin.Model, reach: Array) -> tuple[Array, Array, Array]:
    """Five harmonics a joint; at most 30 to 90 % of the speed limits."""
    middle, half = _range(model)
    order = np.arange(1, 6)[:, None]
    angle = 2.0 * np.pi * order * (time + rng.uniform(0.0, 20.0)) / rng.uniform(8.0, 20.0)
    rate = np.diff(angle[:, :2], axis=1) / (time[1] - time[0])
    a, b = rng.normal(size=(2, model.nv, 5)) / order[:, 0]
    position = a @ np.sin(angle) + b @ np.cos(angle)
    velocity = a @ (rate * np.cos(angle)) - b @ (rate * np.sin(angle))
    acceleration = -(a @ (rate**2 * np.sin(angle)) + b @ (rate**2 * np.cos(angle)))
    fastest = rng.uniform(0.3, 0.9, model.nv) * np.minimum(model.velocityLimit, 2.5)
    widest = rng.uniform(0.3, 0.95, model.nv) * half
    scale = reach * np.minimum(widest / np.abs(position).max(axis=1), fastest / np.abs(velocity).max(axis=1))
    free = half - scale * np.abs(position).max(axis=1)
    centre = middle + rng.uniform(-1.0, 1.0, model.nv) * np.minimum(free, 1.0)
    return centre + (scale[:, None] * position).T, (scale[:, None] * velocity).T, (scale[:, None] * acceleration).T


def _waypoints(rng: Rng, time: Array, model: pin.Model, reach: Array, slow: bool) -> tuple[Array, Array, Array]:
    """Quintic moves from rest to rest, with pauses; slow runs at 2 to 8 % of the speed limits."""
    middle, half = _range(model)
    share = rng.uniform(0.02, 0.08) if slow else rng.uniform(0.2, 0.8)
    limit = share * np.minimum(model.velocityLimit, 2.5)
    here = middle + rng.uniform(-0.7, 0.7, model.nv) * half
    q, v, a = np.zeros((3, len(time), model.nv))
    start = rng.uniform(0.2, 1.0)
    q[:] = here
    while start < time[-1]:
        travel = reach * (middle + rng.uniform(-1.0, 1.0, model.nv) * half - here)
        if slow:
            travel = np.clip(travel, -8.0 * limit, 8.0 * limit)
        lasting = max(0.3, float(np.max(1.875 * np.abs(travel) / limit)))
        s = np.clip((time - start) / lasting, 0.0, 1.0)[:, None]
        q += travel * (10 * s**3 - 15 * s**4 + 6 * s**5)
        v += travel * (30 * s**2 - 60 * s**3 + 30 * s**4) / lasting
        a += travel * (60 * s - 180 * s**2 + 120 * s**3) / lasting**2
        here = here + travel
        start += lasting + rng.uniform(0.1, 1.0)
    return q, v, a


_MOTION = {
    "fourier": _fourier,
    "point_to_point": partial(_waypoints, slow=False),
    "slow": partial(_waypoints, slow=True),
}


def _torque(
    rng: Rng, model: pin.Model, position: Array, velocity: Array, acceleration: Array, *, sensors: bool
) -> tuple[Array, dict[str, Any]]:
    """Recorded torque (N, n), N·m, and what was drawn for it."""
    n, limit = model.nv, model.effortLimit
    data = model.createData()
    rigid = np.array([pin.rnea(model, data, *row) for row in zip(position, velocity, acceleration)])
    inertia = np.mean([np.diag(pin.crba(model, data, q)) for q in position[:: len(position) // 20 + 1]], axis=0)
    rotor = np.zeros(n) if sensors else inertia * rng.uniform(0.1, 1.0, n)
    dry = limit * rng.uniform(*((0.002, 0.008) if sensors else (0.012, 0.05)), n)
    law = str(rng.choice(LAWS))
    speed = np.abs(velocity)
    level = np.tile(dry, (len(velocity), 1))
    if law == "stribeck":
        level = level + dry * rng.uniform(0.1, 0.6, n) * np.exp(-((speed / rng.uniform(0.03, 0.1, n)) ** 2))
    elif law == "load":
        level = level + (0.3 if sensors else 1.0) * rng.uniform(0.02, 0.1, n) * np.abs(rigid)
    power = 0.6 if law == "sublinear" else 1.0
    viscous = dry * rng.uniform(0.2, 1.5, n) * np.sign(velocity) * speed**power
    clean = rigid + rotor * acceleration + level * _dahl(rng, position) + viscous
    scale = rng.uniform(*((0.98, 1.02) if sensors else (0.92, 1.08)), n)
    offset = 0.003 * limit * rng.normal(size=n)
    noise = limit * rng.uniform(*((0.0005, 0.002) if sensors else (0.002, 0.01)), n)
    detail = {"friction": law, "scale": np.round(scale, 3).tolist(), "noise_Nm": np.round(noise, 4).tolist()}
    return scale * clean + offset + noise * rng.normal(size=clean.shape), detail


def _dahl(rng: Rng, position: Array) -> Array:
    """Dahl's friction state (N, n), -1 to 1, exact over each step; at rest it stays what it was."""
    travel = np.diff(position, axis=0)
    keep = np.exp(-np.abs(travel) / PRESLIDING_RAD)
    push = np.sign(travel) * (1.0 - keep)
    state = np.empty_like(position)
    state[0] = rng.uniform(-0.8, 0.8, position.shape[1])
    for k in range(len(travel)):
        state[k + 1] = keep[k] * state[k] + push[k]
    return state
