"""A planar arm with white torque noise, and what an effect changes of it: quick material for the mismatch engine."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from planted_arm import TWO_LINKS, Friction, incommensurate, plant, two_link_run, urdf_of

from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.mismatch.explain import explain
from spacearm_ident.mismatch.run_set import RunSet

LAWS = (
    Friction(f_c=3.0, k_v1=2.0, k_v2=0.0, k_v3=0.0, J_m=0.4),
    Friction(f_c=1.5, k_v1=0.8, k_v2=0.0, k_v3=0.0, J_m=0.1),
)
ARM = arm_from_urdf(urdf_of(TWO_LINKS))
NOISE = (0.3, 0.15)


def run(seed, extra=None, seconds=16.0, speed=1.0, laws=LAWS):
    """A recording of the planar arm with white torque noise; `extra` adds torque (N, 2) to what it needs."""
    planted = two_link_run(laws, seconds=seconds, rate_hz=250.0, seed=seed, speed=speed)
    if extra is not None:
        planted = replace(planted, torque=planted.torque + extra(planted))
    return planted.recording(noise=NOISE, seed=seed + 100)


def loaded_run(seed, com, mass=0.7):
    """The planted arm with a point mass (kg) on the last link, at `com` (m) in its axes."""
    elbow = TWO_LINKS[1]
    total = elbow.mass + mass
    whole = (np.array(elbow.com) * elbow.mass + mass * np.array(com)) / total
    parts = [(elbow.mass, np.array(elbow.com) - whole), (mass, np.array(com) - whole)]
    ixx, iyy, izz = (sum(m * (d @ d - d[k] ** 2) for m, d in parts) + elbow.inertia[j] for k, j in enumerate((0, 3, 5)))
    ixz = elbow.inertia[2] - sum(m * d[0] * d[2] for m, d in parts)
    heavier = replace(elbow, mass=total, com=tuple(whole), inertia=tuple(map(float, (ixx, 0, ixz, iyy, 0, izz))))
    motion = incommensurate(np.arange(0.0, 16.0, 1 / 250.0), 2, seed, 1.0)
    return plant(TWO_LINKS, LAWS, motion, 250.0, true_links=(TWO_LINKS[0], heavier))


def ripple(planted):
    return np.outer(0.8 * np.sin(20.0 * planted.q[:, 1] + 0.4), [0.0, 1.0])


HEALTHY = run(1)


def explained(extra, *excluded):
    return explain(ARM, RunSet([run(2, extra)], [HEALTHY], [run(3, extra)]), excluded)
