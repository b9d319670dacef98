"""Chains of point masses, and what is concealed in them."""

from dataclasses import replace

import numpy as np
import pinocchio as pin

from spacearm_ident.simulation.closed_loop import Truth
from spacearm_ident.simulation.concealed import Concealment, make_effect
from spacearm_ident.simulation.parameters import PlantParameters
from spacearm_ident.simulation.servo import DriveData
from spacearm_ident.simulation.thermal import ThermalParameters

MASS, LENGTH, G, ROTOR = 2.0, 0.5, 9.81, 0.3
INERTIA = MASS * LENGTH**2
SIX = tuple(f"joint_{k}" for k in range(1, 7))


def chain(axes: str = "y", *, gravity: float = G, centre: float = LENGTH, **changes) -> PlantParameters:
    """Frictionless links with a point mass each, `centre` beyond their joint along x; joints LENGTH apart."""
    n = len(axes)
    rows, links = [], ['<link name="b"/>']
    for k, axis in enumerate(axes):
        vector = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}[axis]
        at = f"{LENGTH if k else 0} 0 0"
        links.append(
            f'<link name="l{k}"/><joint name="j{k}" type="revolute"><parent link="{f"l{k - 1}" if k else "b"}"/>'
            f'<child link="l{k}"/><origin xyz="{at}"/><axis xyz="{vector}"/>'
            '<limit lower="-9" upper="9" effort="99" velocity="9"/></joint>'
        )
        body = pin.Inertia(MASS, np.array([centre, 0.0, 0.0]), 0.01 * np.eye(3))
        rows.append(body.toDynamicParameters())
    flat = dict.fromkeys(("joint_spring", "f_c", "f_b", "k_v1", "k_v2", "k_v3"), np.zeros(n))
    base = PlantParameters(
        joints=tuple(f"j{k}" for k in range(n)),
        urdf=f'<robot name="r">{"".join(links)}</robot>',
        gravity=np.array([0.0, 0.0, -gravity]),
        rigid_body=np.array(rows),
        rotor_inertia=np.full(n, ROTOR),
        v_b=np.full(n, 1e-3),
        **flat,
    )
    return replace(base, **{name: np.broadcast_to(np.asarray(v, float), (n,)).copy() for name, v in changes.items()})


def effect(parameters: PlantParameters, name: str, joints=(), law=None, **values):
    return make_effect(parameters.joints, name, joints, values, law)


def plant_with(parameters, *effects, position=None):
    position = np.zeros(len(parameters.joints)) if position is None else np.asarray(position, float)
    return Concealment(effects).plant(parameters, position, ThermalParameters(0.0))


def stepped(plant, torque, seconds, h=2.5e-4):
    torque = np.atleast_1d(np.asarray(torque, float))
    for _ in range(round(seconds / h)):
        plant.step(torque, h)
    return plant


def truth_of(torque, qd=None) -> Truth:
    torque = np.asarray(torque, float)
    zeros = np.zeros_like(torque)
    qd = zeros if qd is None else qd
    time = np.arange(len(torque)) * 1e-3
    n = torque.shape[1]
    return Truth(
        tuple(f"j{k}" for k in range(n)), time, zeros, qd, zeros, torque, zeros, time[:1], zeros[:1], "",
        DriveData.plain(n),
    )  # fmt: skip
