"""A planar arm with white torque noise, and what an effect changes of it: quick material for the mismatch engine."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from planted_arm import TWO_LINKS, Friction, two_link_run, urdf_of

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


def ripple(planted):
    return np.outer(0.8 * np.sin(20.0 * planted.q[:, 1] + 0.4), [0.0, 1.0])


HEALTHY = run(1)


def explained(extra, *excluded):
    return explain(ARM, RunSet([run(2, extra)], [HEALTHY], [run(3, extra)]), excluded)
