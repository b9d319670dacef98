"""Random arms and motions for the blind trial: like the recordings in the field, never twice the same."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from spacearm_ident.excitation.trajectory import FourierTrajectory, Motion, Quintic, Rest, Trajectory
from spacearm_ident.simulation.closed_loop import SensorNoise
from spacearm_ident.simulation.parameters import PlantParameters
from spacearm_ident.simulation.servo import DriveData

JOINTS = tuple(f"joint_{k}" for k in range(1, 7))
SPEED = np.array([0.85, 0.85, 1.02, 1.36, 1.36, 1.7])
FORMS = {
    # seconds of: rest, approach, period, way to the slow part, slow part; and the number of periods
    "two": ((0.3, 2.0, 8.0, 1.2, 5.0), 2),
    "three": ((0.3, 2.0, 5.5, 1.2, 4.5), 3),
    "plain": ((0.3, 4.2, 10.0, 0.0, 0.0), 2),
}
VALIDATION = {
    "two": ((0.3, 2.2, 8.0, 1.0, 3.0), 1),
    "three": ((0.3, 2.2, 8.0, 1.0, 3.0), 1),
    "plain": ((0.3, 4.2, 10.0, 0.0, 0.0), 1),
}


@dataclass(frozen=True, eq=False)
class DrawnArm:
    """An arm: what it obeys, what its drives are, how noisy its sensors.

    Attributes:
        parameters: The truth, with the CAD description that goes into the recording.
        drives: Torque limits far above what the motions need.
        noise_std: (n,) N·m, of the white noise.
        noise: In units of `noise_std`.
        slip: (n,) rad over which friction builds up at a reversal, 0: at once.
    """

    parameters: PlantParameters
    drives: DriveData
    noise_std: np.ndarray
    noise: SensorNoise
    slip: np.ndarray

    def summary(self) -> dict[str, Any]:
        """For the answer."""
        p = self.parameters
        names = ("f_c", "f_b", "v_b", "k_v1", "k_v2", "k_v3", "rotor_inertia")
        return {name: np.round(getattr(p, name), 5).tolist() for name in names} | {
            "gravity_m_s2": p.gravity.tolist(),
            "mass_kg": p.rigid_body[:, 0].tolist(),
            "friction_builds_up_over_rad": self.slip.tolist(),
        }


def draw_arm(rng: np.random.Generator, *, weightless: bool) -> DrawnArm:
    """A six-joint arm whose CAD inertials are some percent off."""
    lengths = np.array([0.18, 0.1, 0.62, 0.55, 0.11, 0.12]) * rng.uniform(0.8, 1.2, 6)
    masses = np.array([5.6, 6.5, 4.4, 2.4, 2.2, 1.2]) * rng.uniform(0.75, 1.25, 6)
    reach = np.array([0.1, 0.62, 0.55, 0.11, 0.12, 0.12])
    bodies = [_body(rng, mass, length) for mass, length in zip(masses, reach)]
    cad = [_as_drawn(rng, body) for body in bodies]
    n, uniform = 6, rng.uniform
    f_c = np.array([15.0, 12.0, 12.0, 4.0, 4.5, 3.5]) * uniform(0.6, 1.4, n)
    parameters = PlantParameters(
        joints=JOINTS,
        urdf=_urdf(lengths, cad, rolls=bool(rng.integers(2))),
        gravity=np.array([0.0, 0.0, 0.0 if weightless else -9.81]),
        rigid_body=np.array([body.toDynamicParameters() for body in bodies]),
        rotor_inertia=np.array([3.0, 3.5, 1.6, 0.5, 0.35, 0.2]) * uniform(0.6, 1.5, n),
        joint_spring=np.zeros(n),
        f_c=f_c,
        f_b=f_c * (1.0 + uniform(0.05, 0.4, n)),
        v_b=np.exp(uniform(np.log(0.01), np.log(0.08), n)),
        k_v1=np.array([18.0, 26.0, 13.0, 6.0, 5.0, 4.0]) * uniform(0.6, 1.3, n),
        k_v2=np.array([1.5, 1.5, 1.0, 0.5, 0.4, 0.3]) * uniform(-0.5, 1.0, n),
        k_v3=np.array([-2.0, -2.5, -1.2, -0.4, -0.3, -0.2]) * uniform(0.1, 1.0, n),
        quadratic="odd",
    )
    slip = np.exp(uniform(np.log(2e-4), np.log(8e-4), n)) if rng.random() < 0.5 else np.zeros(n)
    noise = SensorNoise(
        effort_white=1.0,
        effort_coloured=float(uniform(0.2, 0.6)),
        effort_correlation_s=float(uniform(0.008, 0.04)),
        velocity_noise=float(uniform(2e-4, 1e-3)),
    )
    noise_std = np.array([0.27, 0.32, 0.25, 0.13, 0.09, 0.07]) * uniform(0.8, 1.5, n) * uniform(0.8, 1.3)
    drives = DriveData.plain(n, torque_limit=np.array([300.0, 500.0, 300.0, 120.0, 90.0, 70.0]))
    return DrawnArm(parameters, drives, noise_std, noise, slip)


def draw_motion(rng: np.random.Generator, form: tuple[tuple[float, ...], int]) -> Trajectory:
    """Rest, approach, some periods of a Fourier series and, where the form has one, slow reversals."""
    (rest, approach, period, way, slow_s), periods = form
    fast = _series(rng, SPEED * rng.uniform(0.8, 1.0, 6), rng.uniform(-0.25, 0.25, 6), 1.0 / period, 5, periods)
    home = Motion(np.zeros(6), np.zeros(6), np.zeros(6))
    begin = fast.evaluate(0.0).at(0)
    segments = [Rest(np.zeros(6), rest), Quintic(home, begin, approach), fast]
    if slow_s:
        end = fast.evaluate(fast.duration_s).at(0)
        # On along the way it was going, so that the short brake does not swing back.
        centre = end.q + 0.5 * way * end.qd
        slow = _series(rng, rng.uniform(0.03, 0.09, 6), centre, 1.0 / slow_s, 6, 1)
        segments += [Quintic(end, slow.evaluate(0.0).at(0), way), slow]
    return Trajectory(JOINTS, tuple(segments))


def _series(
    rng: np.random.Generator, speed: np.ndarray, centre: np.ndarray, fundamental: float, harmonics: int, periods: int
) -> FourierTrajectory:
    """A random series with this largest speed, within about a radian and 4 rad/s²."""
    # Less speed in the higher harmonics: the arm uses its range.
    a, b = rng.standard_normal((2, 6, harmonics)) / np.arange(1, harmonics + 1) ** 0.7
    motion = FourierTrajectory(JOINTS, np.zeros(6), a, b, fundamental, 1).evaluate(
        np.linspace(0.0, 1.0 / fundamental, 400)
    )
    worst = np.max(
        [np.abs(motion.qd).max(0) / speed, np.abs(motion.qdd).max(0) / 4.0, np.abs(motion.q).max(0) / 1.2], axis=0
    )
    return FourierTrajectory(JOINTS, centre, a / worst[:, None], b / worst[:, None], fundamental, periods)


def _body(rng: np.random.Generator, mass: float, length: float) -> pin.Inertia:
    """A box about as long as its link, its centre of mass well inside."""
    size = np.array([0.1, 0.1, 0.06 + length]) * rng.uniform(0.8, 1.2, 3)
    centre = np.array([0.0, 0.0, 0.45 * length]) + rng.uniform(-1, 1, 3) * np.array([0.01, 0.04, 0.03])
    x, y, z = size**2
    return pin.Inertia(mass, centre, mass / 12.0 * np.diag([y + z, x + z, x + y]))


def _as_drawn(rng: np.random.Generator, body: pin.Inertia) -> pin.Inertia:
    """The same body as the CAD program has it."""
    mass = body.mass * (1.0 + rng.uniform(-0.1, 0.1))
    centre = body.lever + rng.uniform(-0.008, 0.008, 3)
    return pin.Inertia(mass, centre, np.array(body.inertia) * (1.0 + rng.uniform(-0.15, 0.15)))


def _urdf(lengths: np.ndarray, bodies: list[pin.Inertia], *, rolls: bool) -> str:
    fourth = "0 0 1" if rolls else "0 1 0"
    last = "0 0 1" if rolls else "0 1 0"
    fifth = "0 1 0" if rolls else "0 0 1"
    axes = ("0 0 1", "0 1 0", "0 1 0", fourth, fifth, last)
    side = ("0 0", "0 0.12", "0 -0.02", "0 0.02", "0 0.11" if not rolls else "0 0", "0 0")
    reach = ("2.6", "1.6", "2.2", "2.4", "2.2", "2.8")
    lines = ['<robot name="arm">', '<link name="base_link"/>']
    for k, body in enumerate(bodies):
        I, c = body.inertia, body.lever  # noqa: E741
        parent = "base_link" if k == 0 else f"link_{k}"
        lines.append(
            f'<link name="link_{k + 1}"><inertial><origin xyz="{c[0]:.6f} {c[1]:.6f} {c[2]:.6f}" rpy="0 0 0"/>'
            f'<mass value="{body.mass:.5f}"/><inertia ixx="{I[0, 0]:.6f}" ixy="{I[0, 1]:.6f}" ixz="{I[0, 2]:.6f}" '
            f'iyy="{I[1, 1]:.6f}" iyz="{I[1, 2]:.6f}" izz="{I[2, 2]:.6f}"/></inertial></link>'
        )
        lines.append(
            f'<joint name="joint_{k + 1}" type="revolute"><parent link="{parent}"/><child link="link_{k + 1}"/>'
            f'<origin xyz="{side[k]} {lengths[k]:.4f}" rpy="0 0 0"/><axis xyz="{axes[k]}"/>'
            f'<limit lower="-{reach[k]}" upper="{reach[k]}" velocity="{SPEED[k] * 1.2:.2f}" effort="250"/></joint>'
        )
    return "\n".join([*lines, "</robot>"])
