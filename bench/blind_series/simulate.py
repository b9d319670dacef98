"""Closed-loop simulation of a batch of recordings of one arm.

The controller runs at 1 kHz on quantised, noisy positions; the drive follows with a first-order lag and reports
its current as torque. Rigid-body dynamics: articulated-body algorithm (Featherstone 2008, in pinocchio);
semi-implicit Euler at 0.5 ms, 0.25 ms with a two-mass joint. Friction: a Dahl state (exact step for a held speed)
times a Stribeck level, plus viscous, square and cubic terms, levels falling with temperature.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin
from arms import Arm
from laws import Law, TwoMass
from scipy.signal import butter, lfilter

PERIOD = 1e-3  #: controller period, s


@dataclass
class Day:
    """Conditions of a recording: ambient temperature and how far each joint warms up, C."""

    ambient: float
    rise: np.ndarray
    tau: float

    def at(self, t):
        """Temperature (n,) at time t, s."""
        return self.ambient + self.rise * (1 - np.exp(-t / self.tau))


def day(arm: Arm, rng: np.random.Generator, joint: int | None = None, ramp: float = 0.0) -> Day:
    """Draw a day: 22 +- 2 C, joints warm by 1 to 4 C; `ramp` C are added to the warming of one joint."""
    rise, tau = rng.uniform(1, 4, arm.n), rng.uniform(15, 40)
    if joint is not None:
        rise[joint] += ramp
        tau = 12.0
    return Day(22 + 2 * rng.standard_normal(), rise, tau)


def fourier(arm: Arm, duration: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Draw a Fourier-series motion (Swevers et al. 1997) from rest to rest within the arm's limits.

    Args:
        arm: the arm.
        rng: random generator.
        duration: s; the first and last second hold still, a smooth window of 1.5 s fades in and out.

    Returns:
        Position, velocity, acceleration, each (T, n), at 1 kHz.
    """
    t = np.arange(int(duration / PERIOD)) * PERIOD
    base, harmonics = rng.uniform(0.06, 0.11), 5
    x = np.clip((np.minimum(t - 1.0, duration - 1.0 - t)) / 1.5, 0, 1)
    window = x**3 * (10 - 15 * x + 6 * x**2)
    q = np.empty((len(t), arm.n))
    for j in range(arm.n):
        k = np.arange(1, harmonics + 1)
        a, b = rng.standard_normal((2, harmonics)) / k**0.5
        w = 2 * np.pi * base * k * (1.0 if rng.random() < 0.5 else 1.3)
        q[:, j] = (np.sin(np.outer(t, w)) @ a + np.cos(np.outer(t, w)) @ b) * window
    v = np.gradient(q, PERIOD, axis=0)
    acc = np.gradient(v, PERIOD, axis=0)
    scale = 1 / np.maximum.reduce(
        [np.abs(q).max(0) / arm.span, np.abs(v).max(0) / arm.speed, np.abs(acc).max(0) / arm.acceleration]
    )
    scale *= rng.uniform(0.8, 1.0, arm.n)
    q, v, acc = q * scale, v * scale, acc * scale
    return arm.middle + q, v, acc


@dataclass
class State:
    """What a law sees. Shapes: (R, n) unless said; R recordings, n joints."""

    models: list
    datas: list
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    z: np.ndarray  #: presliding state, -1 to 1
    load: np.ndarray  #: transmitted torque, N m
    temperature: np.ndarray
    duration: float
    t: float = 0.0
    period: float = PERIOD


@dataclass
class Run:
    """A recording: time (T,) s; position, velocity, effort, temperature (T, n)."""

    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    effort: np.ndarray
    temperature: np.ndarray
    clean: dict = field(default_factory=dict)  #: 1 kHz q, v, a, true net torque and added torque, for tests


def friction(arm: Arm, s: State) -> np.ndarray:
    """Healthy friction torque (R, n) of the state; N m."""
    level = arm.coulomb * (1 + arm.wave * np.sin(s.q + 0.7))
    level = level + arm.coulomb * (arm.breakaway - 1) * np.exp(-((s.v / arm.stribeck) ** 2)) + arm.load * np.abs(s.load)
    warm = s.temperature - 20
    return (
        level * (1 - 0.005 * warm) * (s.z + arm.asymmetry * np.abs(s.z))
        + (arm.viscous * s.v) * (1 - 0.012 * warm)
        + arm.square * s.v * np.abs(s.v)
        + arm.cubic * s.v**3
    )


def simulate(
    arm: Arm,
    laws: list[tuple[Law, np.ndarray]],
    motions: list,
    days: list[Day],
    seed: int,
    noise: bool = True,
    feedforward: pin.Model | None = None,
) -> list[Run]:
    """Simulate R recordings.

    Args:
        arm: the arm.
        laws: pairs of a law and the recordings (R, bool) in which it acts.
        motions: R desired motions from `fourier`, all of one length.
        days: R conditions.
        seed: of noise.
        noise: encoder quantisation, encoder and current noise.
        feedforward: model of the controller; default: the arm's own.

    Raises:
        FloatingPointError: when the loop is unstable.
    """
    rng = np.random.default_rng(seed)
    count, n, steps = len(motions), arm.n, len(motions[0][0])
    two = [(law, on) for law, on in laws if isinstance(law, TwoMass)]
    sub = 4 if two else 2
    dt = PERIOD / sub
    models = []
    for r in range(count):
        m = arm.model.copy()
        m.armature = arm.rotor.copy()
        for law, on in laws:
            if on[r]:
                law.model(m)
                if isinstance(law, TwoMass):
                    arma = m.armature.copy()
                    arma[law.joint] = 1e-3 * arm.rotor[law.joint]
                    m.armature = arma
        models.append(m)
    datas = [m.createData() for m in models]
    for law, on in laws:
        law.reset(on, dt, np.random.default_rng(rng.integers(2**32)))
    want = [np.stack([m[k] for m in motions], 1) for k in range(3)]  # (T, R, n)
    ffmodel = (feedforward or arm.model).copy()
    ffmodel.armature = arm.rotor.copy()
    ffdata = ffmodel.createData()
    ff = np.empty_like(want[0])
    for r in range(count):
        for k in range(0, steps, 2):
            ff[k : k + 2, r] = pin.rnea(ffmodel, ffdata, want[0][k, r], want[1][k, r], want[2][k, r])
    ff += 0.8 * (arm.coulomb * np.tanh(want[1] / 0.02) + arm.viscous * want[1])
    mass = pin.crba(ffmodel, ffdata, arm.middle).diagonal().copy()
    omega = 2 * np.pi * arm.bandwidth
    kp, kd = mass * omega**2, 2 * 0.7 * omega * mass
    q = want[0][0].copy()
    s = State(
        models,
        datas,
        q,
        np.zeros((count, n)),
        np.zeros((count, n)),
        np.zeros((count, n)),
        ff[0].copy(),
        np.zeros((count, n)),
        steps * PERIOD,
    )
    theta, omega_m = {}, {}
    for law, _ in two:
        theta[id(law)], omega_m[id(law)] = q[:, law.joint].copy(), np.zeros(count)
    drive = ff[0].copy()
    lag, smooth = 1 - np.exp(-dt * 2 * np.pi * 300), 1 - np.exp(-PERIOD * 2 * np.pi * 80)
    speed = np.zeros((count, n))
    last = q.copy()
    logs = {k: np.empty((steps, count, n)) for k in ("q", "v", "tau", "temp", "tq", "tv", "ta", "net", "add", "fric")}
    adders = [law for law, _ in laws if type(law).torque is not Law.torque]
    actors = [law for law, _ in laws if type(law).actuate is not Law.actuate]
    readers = [law for law, _ in laws if type(law).measure is not Law.measure]
    tickers = [law for law, _ in laws if type(law).tick is not Law.tick]
    encoder = rng.standard_normal((steps, count, n)) * arm.resolution if noise else np.zeros((steps, count, n))
    current = rng.standard_normal((steps, count, n)) * arm.noise if noise else np.zeros((steps, count, n))
    # a third of the current noise is true torque: the current loop's own noise
    np.seterr(over="ignore", invalid="ignore")  # an unstable loop overflows before it is told
    for k in range(steps):
        s.t = k * PERIOD
        if k % 20 == 0:
            s.temperature = np.stack([d.at(s.t) for d in days])
        read = s.q.copy()
        for law, on in two:
            read[:, law.joint] = np.where(on, theta[id(law)], read[:, law.joint])
        for law in readers:
            law.measure(s, read)
        if noise:
            read = np.round((read + encoder[k]) / arm.resolution) * arm.resolution
        if k == 0:
            last = read
        speed += smooth * ((read - last) / PERIOD - speed)
        last = read
        command = np.clip(ff[k] + kp * (want[0][k] - read) + kd * (want[1][k] - speed), -arm.limit, arm.limit)
        for law in tickers:
            law.tick(s)
        start_add = None
        for _ in range(sub):
            drive += lag * (command - drive)
            true = drive + current[k] / 3
            for law in actors:
                law.actuate(s, true)
            sign = np.sign(s.v)
            speeds = s.v
            if two:
                speeds = s.v.copy()
                for law, on in two:
                    speeds[:, law.joint] = np.where(on, omega_m[id(law)], speeds[:, law.joint])
                sign = np.sign(speeds)
            s.z = sign - (sign - s.z) * np.exp(-np.abs(speeds) * dt / arm.presliding)
            link_v, s.v = s.v, speeds
            drag = friction(arm, s)
            add = np.zeros((count, n))
            for law in adders:
                law.torque(s, add)
            s.v = link_v
            net = true - drag + add
            for law, on in two:
                j = law.joint
                th, om = theta[id(law)], omega_m[id(law)]
                carried = law.spring(th - s.q[:, j], om - s.v[:, j])
                rate = (net[:, j] - carried) / (arm.rotor[j] * 0.999)
                om = np.where(on, om + rate * dt, s.v[:, j])
                omega_m[id(law)] = om
                theta[id(law)] = np.where(on, th + om * dt, s.q[:, j])
                net[:, j] = np.where(on, carried, net[:, j])
            acc = np.empty((count, n))
            for r in range(count):
                acc[r] = pin.aba(models[r], datas[r], s.q[r], s.v[r], net[r])
            if start_add is None:
                start_add = (s.q, s.v, acc, net, add, drag)
            s.load = net - arm.rotor * acc
            s.a = acc
            s.v = s.v + dt * acc
            s.q = s.q + dt * s.v
        logs["q"][k], logs["v"][k], logs["tau"][k], logs["temp"][k] = read, speed, drive + current[k], s.temperature
        for key, value in zip(("tq", "tv", "ta", "net", "add", "fric"), start_add):
            logs[key][k] = value
        if k % 500 == 0 and not np.all(np.abs(s.v) < 50):
            raise FloatingPointError(f"{arm.name}: unstable at {s.t:.2f} s")
    return [
        record(arm, {k: x[:, r] for k, x in logs.items()}, [law for law, on in laws if on[r]]) for r in range(count)
    ]


def record(arm: Arm, log: dict[str, np.ndarray], laws: list[Law]) -> Run:
    """Log at the arm's rate, with its anti-alias filter; laws change the logged effort."""
    effort = log["tau"].copy()
    for law in laws:
        law.log(effort, PERIOD)
    step = round(1 / (arm.rate * PERIOD))
    if arm.antialias == "mean" and step > 1:
        sums = np.cumsum(effort, 0)
        effort = np.vstack([effort[:step], (sums[step:] - sums[:-step]) / step])
    elif arm.antialias == "butter" and step > 1:
        b, a = butter(2, 0.8 * arm.rate / 2 / (0.5 / PERIOD))
        effort = lfilter(b, a, effort - effort[:1], axis=0) + effort[:1]
    pick = slice(0, None, step)
    return Run(
        np.arange(len(effort))[pick] * PERIOD,
        log["q"][pick],
        log["v"][pick],
        effort[pick],
        log["temp"][pick],
        {k: log[k] for k in ("tq", "tv", "ta", "net", "add", "fric", "tau")},
    )
