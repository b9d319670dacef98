"""A two-joint arm whose recordings are computed, not simulated: quick material for tests of the whole path."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin

from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.dynamics.model import FRICTION_LAWS, IdentifiedModel, TorqueModel
from spacearm_ident.recording import Recording, cdr

JOINTS = ("shoulder", "elbow")
URDF = """<robot name="small_arm">
<link name="base"/>
<link name="upper"><inertial><origin xyz="0.02 0.01 0.2"/><mass value="4"/>
<inertia ixx="0.06" ixy="0.001" ixz="0.002" iyy="0.07" iyz="0.001" izz="0.02"/></inertial></link>
<link name="fore"><inertial><origin xyz="0.01 -0.02 0.15"/><mass value="2"/>
<inertia ixx="0.02" ixy="0" ixz="0.001" iyy="0.02" iyz="0" izz="0.005"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 0.3"/>
<axis xyz="0 1 0"/><limit lower="-3" upper="3" velocity="3" effort="100"/></joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/><origin xyz="0 0.05 0.4"/>
<axis xyz="0 1 0"/><limit lower="-3" upper="3" velocity="3" effort="50"/></joint>
</robot>"""
COULOMB, VISCOUS, ROTOR = np.array([3.0, 1.5]), np.array([2.0, 0.8]), np.array([0.4, 0.1])


def recording(
    duration_s: float = 16.0,
    rate_hz: float = 200.0,
    seed: int = 0,
    noise: float = 0.02,
    still: tuple[int, ...] = (),
    urdf: str | None = URDF,
) -> Recording:
    """A run that never repeats: sines of incommensurate frequencies; the joints in `still` stay where they are."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, duration_s, 1.0 / rate_hz)
    frequency = np.array([[0.21, 0.37 + 0.01 * seed], [0.29, 0.47 + 0.01 * seed]]) * 2 * np.pi
    size = np.array([[0.7, 0.4], [0.8, 0.3]])
    size[list(still)] = 0.0
    phase = rng.uniform(0, 2 * np.pi, (2, 2))
    angle = time[:, None, None] * frequency + phase
    q = (size * np.sin(angle)).sum(axis=2)
    qd = (size * frequency * np.cos(angle)).sum(axis=2)
    qdd = -(size * frequency**2 * np.sin(angle)).sum(axis=2)
    model = pin.buildModelFromXML(URDF)
    data = model.createData()
    rigid = np.array([pin.rnea(model, data, *state) for state in zip(q, qd, qdd)])
    torque = rigid + COULOMB * np.sign(qd) + VISCOUS * qd + ROTOR * qdd
    torque += noise * rng.standard_normal(torque.shape) * np.array([10.0, 5.0])
    return Recording(JOINTS, time, q, qd, torque, (slice(0, len(time)),), 1_700_000_000_000_000_000, urdf=urdf)


def identified() -> IdentifiedModel:
    """What the small arm is, as if it had been identified to the last digit."""
    arm = arm_from_urdf(URDF)
    model = TorqueModel(arm, {"rigid_body": {}, "rotor_inertia": {}, **FRICTION_LAWS["coulomb-viscous"]})
    levels = {"f_c": COULOMB, "f_b": COULOMB, "k_v1": VISCOUS, "J_m": ROTOR}
    values = [levels[p.symbol][JOINTS.index(p.joint)] if p.symbol in levels else p.prior for p in model.parameters]
    return IdentifiedModel(model, np.array(values), np.zeros(len(model.constants)), 10.0)


def with_step(run: Recording, from_s: float, size: float = 0.5) -> Recording:
    """The elbow's Coulomb friction is larger from `from_s` on."""
    assert run.velocity is not None and run.effort is not None
    more = size * np.sign(run.velocity[:, 1]) * (run.time >= from_s)
    return replace(run, effort=run.effort + np.column_stack([np.zeros_like(more), more]))


def payloads(run: Recording, order: tuple[int, ...] = (0, 1), after_s: float = 0.0) -> list[bytes]:
    """Joint states of a run as messages, joints in an order of their own, `after_s` later than recorded."""
    assert run.effort is not None
    stamps = run.start_ns + np.round((run.time + after_s) * 1e9).astype(np.int64)
    columns = list(order)
    names = [run.joints[k] for k in columns]
    return cdr.encode_joint_states(stamps, names, run.position[:, columns], effort=run.effort[:, columns])
