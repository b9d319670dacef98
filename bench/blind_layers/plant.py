"""The true arm in MuJoCo under a position controller; what it would log without and with noise."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from .arms import Arm, Payload, Table, true_model
from .laws import ELASTIC, FRICTION, Law, added_torque, damping_level, friction_level, lugre
from .motion import RATE_HZ, rigid_torque

FRICTION_TIME_s = 2e-3
"""Time constant of MuJoCo's friction-loss constraint, s. MuJoCo's default of 20 ms lets friction rise over some
0.05 rad/s; a gear's friction changes sign within thousandths of that (Armstrong-Hélouvry 1991)."""


@dataclass(frozen=True)
class Noise:
    """Noise of one arm.

    Attributes:
        counts: encoder counts a revolution of the joint.
        encoder: standard deviation before quantisation, rad.
        velocity: standard deviation of the logged velocity, rad/s.
        torque: disturbance torque that the current loop leaves, N m (n); it moves the arm and is not measured.
        current: noise of the measured effort, N m (n).
    """

    counts: float
    encoder: float
    velocity: float
    torque: np.ndarray
    current: np.ndarray


@dataclass
class Run:
    """One recording at `RATE_HZ` before wiring faults; arrays (samples, n).

    Attributes:
        t: s (samples).
        command: set-points, rad.
        q: motor position, free of noise, rad.
        v: rad/s.
        a: rad/s².
        torque: torque that acts on the motor side, N m.
        q_measured: rad.
        v_measured: rad/s.
        effort: torque that the drive reports, N m, before gains, signs and delay.
        celsius: °C.
        added: torque of each law by itself, N m (laws, samples, n); zero for elasticity and backlash.
    """

    t: np.ndarray
    command: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    torque: np.ndarray
    q_measured: np.ndarray
    v_measured: np.ndarray
    effort: np.ndarray
    celsius: np.ndarray
    added: np.ndarray


def simulate(
    arm: Arm,
    table: Table,
    laws: list[Law],
    reference: np.ndarray,
    noise: Noise,
    rng: np.random.Generator,
    nominal: mujoco.MjModel,
    payload: Payload | None = None,
    gravity: np.ndarray | None = None,
    celsius: np.ndarray | None = None,
    warming: float = 0.0,
) -> Run:
    """Simulate one recording, closed loop.

    The controller is feed-forward of the nominal model plus PID on the measured position and its filtered difference
    (60 Hz), at 1 kHz with zero-order hold. Encoder quantisation and noise are therefore inside the loop.

    Args:
        arm: the arm.
        table: its true parameters.
        laws: its concealed physics, with the numbers of this recording.
        reference: position, velocity, acceleration (3, samples, n).
        noise: its noise.
        rng: random numbers of this recording.
        nominal: rigid model of the feed-forward (the controller's, not the truth).
        payload: body at the last link.
        gravity: m/s² in the base frame (3).
        celsius: joint temperatures at the start, °C (n).
        warming: °C/s.

    Returns:
        The recording.
    """
    elastic = tuple(sorted({law["joint"] for law in laws if law["effect"] in ELASTIC}))
    per_tick = 4 if elastic else 2
    step = 1.0 / RATE_HZ / per_tick
    model = true_model(arm, table, elastic, payload, gravity, step)
    model.dof_solref[:] = (FRICTION_TIME_s, 1.0)
    # The integrator solves (M + h D) dv = h (f - D v) with v half a step older than the recorded positions: the arm
    # would be heavier than its table says by h D / 2.
    armature = model.dof_armature.copy()
    model.dof_armature -= 0.5 * step * model.dof_damping
    data = mujoco.MjData(model)
    n, count = len(arm.joints), reference.shape[1]
    dof = np.array([model.joint(name).dofadr[0] for name in arm.joints])
    flex = {j: model.joint(f"{arm.joints[j]}_flex").dofadr[0] for j in elastic}
    data.qpos[dof] = reference[0, 0]
    start_C = np.full(n, 30.0) if celsius is None else celsius

    friction: dict[int, list[tuple[int, Law]]] = {}
    bristle = {k: 0.0 for k, law in enumerate(laws) if law["effect"] == "presliding_hysteresis"}
    adding = [
        (k, law)
        for k, law in enumerate(laws)
        if law["effect"] in ("torque_ripple", "harness_spring") or law["effect"].startswith("absent:")
    ]
    for k, law in enumerate(laws):
        if law["effect"] in FRICTION:
            friction.setdefault(law["joint"], []).append((k, law))
        if k in bristle:
            model.dof_frictionloss[dof[law["joint"]]] = 0.0
    hidden = {k: _hose(law, count, rng) for k, law in adding if law["effect"] == "absent:hose"}
    contacts = [(k, law) for k, law in enumerate(laws) if law["effect"] == "external_contact"]
    springs = [law for law in laws if law["effect"] in ELASTIC]
    tip = model.body(arm.bodies[-1]).id

    feed = rigid_torque(nominal, mujoco.MjData(nominal), *reference)
    inertia = _mean_inertia(model, data, dof)
    omega = 2 * np.pi * 5.0
    kp, kd, ki = inertia * omega**2, 1.4 * inertia * omega, inertia * omega**3 * 0.3
    lsb = 2 * np.pi / noise.counts
    smooth = 1.0 - np.exp(-2 * np.pi * 60.0 / RATE_HZ)

    shape = (count, n)
    out = Run(
        np.arange(count) / RATE_HZ, reference[0], *(np.zeros(shape) for _ in range(8)), np.zeros((len(laws), *shape))
    )
    previous, velocity, integral = data.qpos[dof].copy(), np.zeros(n), np.zeros(n)
    jacobian = np.zeros((3, model.nv))
    encoder = rng.normal(0.0, noise.encoder, shape)
    disturbance = rng.normal(0.0, 1.0, shape) * noise.torque
    current = rng.normal(0.0, 1.0, shape) * noise.current
    rates = rng.normal(0.0, noise.velocity, shape)
    mujoco.mj_forward(model, data)
    for i in range(count):
        t = i / RATE_HZ
        q, v = data.qpos[dof].copy(), data.qvel[dof].copy()
        measured = np.round((q + encoder[i]) / lsb) * lsb
        velocity += smooth * ((measured - previous) * RATE_HZ - velocity)
        previous = measured
        error = reference[0, i] - measured
        integral += error / RATE_HZ
        command = feed[i] + kp * error + kd * (reference[1, i] - velocity) + ki * integral
        command = np.clip(command, -arm.effort, arm.effort)
        torque = command + disturbance[i]
        warm = start_C + warming * t
        out.q[i], out.v[i], out.torque[i] = q, v, torque
        out.q_measured[i], out.v_measured[i], out.effort[i] = measured, v + rates[i], command + current[i]
        out.celsius[i] = warm

        applied = np.zeros(model.nv)
        applied[dof] = torque
        for k, law in adding:
            j = law["joint"]
            value = added_torque(law, q[j], t, hidden[k][i] if k in hidden else 0.0)
            applied[dof[j]] += value
            out.added[k, i, j] = value
        data.xfrc_applied[tip] = 0.0
        for k, law in contacts:
            force = np.array(law["force"]) * _window(t, law["start"], law["length"])
            if force.any():
                data.xfrc_applied[tip, :3] = force
                mujoco.mj_kinematics(model, data)
                mujoco.mj_comPos(model, data)
                mujoco.mj_jacBodyCom(model, data, jacobian, None, tip)
                out.added[k, i] = (jacobian.T @ force)[dof]
        for j, levels in friction.items():
            level, name = float(table["joints"][arm.joints[j]]["frictionloss"]), arm.joints[j]  # type: ignore[arg-type]
            damping = float(table["joints"][name]["damping"])  # type: ignore[arg-type]
            load = torque[j] - armature[dof[j]] * data.qacc[dof[j]]
            for k, law in levels:
                new = friction_level(law, level, q[j], v[j], load, warm[j])
                change = -(new - level) * np.tanh(v[j] / 2e-3)
                if law["effect"] == "temperature_friction":
                    less = damping_level(law, damping, warm[j])
                    change -= (less - damping) * v[j]
                    model.dof_damping[dof[j]] = less
                    model.dof_armature[dof[j]] = armature[dof[j]] - 0.5 * step * less
                out.added[k, i, j] = change
                level = new
            model.dof_frictionloss[dof[j]] = max(level, 1e-6)
        for s in range(per_tick):
            total = applied.copy()
            for k in bristle:
                law = laws[k]
                j = law["joint"]
                bristle[k], value = lugre(law, bristle[k], data.qvel[dof[j]], step)
                total[dof[j]] += value
                if s == 0:
                    out.added[k, i, j] = value + law["level"] * np.tanh(v[j] / 2e-3)
            for law in springs:
                total[flex[law["joint"]]] += _spring(law, data.qpos, data.qvel, flex[law["joint"]])
            data.qfrc_applied[:] = total
            mujoco.mj_step(model, data)
            if s == 0:
                out.a[i] = (data.qvel[dof] - v) / step
        if not np.all(np.isfinite(data.qpos)):
            raise FloatingPointError(f"{arm.name}: the simulation diverged at {t:.3f} s")
    return out


def _spring(law: Law, qpos: np.ndarray, qvel: np.ndarray, dof: int) -> float:
    """Torque of the gear's compliance on its deflection, N m: a spring, with a dead zone for backlash."""
    half = law.get("gap", 0.0) / 2
    deflection = qpos[dof]
    beyond = deflection - np.clip(deflection, -half, half)
    return float(-law["stiffness"] * beyond - law["damping"] * qvel[dof] * (1.0 if beyond or not half else 0.05))


def _hose(law: Law, count: int, rng: np.random.Generator) -> np.ndarray:
    """A stationary Ornstein-Uhlenbeck process with the law's `deviation` (N m) and `correlation` (s) (samples)."""
    keep = np.exp(-1.0 / RATE_HZ / law["correlation"])
    drive = rng.normal(0.0, law["deviation"] * np.sqrt(1 - keep**2), count)
    value = np.zeros(count)
    value[0] = rng.normal(0.0, law["deviation"])
    for i in range(1, count):
        value[i] = keep * value[i - 1] + drive[i]
    return value


def _window(t: float, start: float, length: float) -> float:
    """Raised cosine that is 1 at the middle of the window and 0 outside."""
    x = (t - start) / length
    return float(0.5 - 0.5 * np.cos(2 * np.pi * x)) if 0.0 < x < 1.0 else 0.0


def _mean_inertia(model: mujoco.MjModel, data: mujoco.MjData, dof: np.ndarray) -> np.ndarray:
    """Diagonal of the mass matrix at the start, kg m² (n); the controller's gains scale with it."""
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    return np.diag(full)[dof] + 0.02
