# ruff: noqa: D102  (hooks are documented in the class Law)
"""Changes of a joint or an arm, each from the literature, and the dirt of a healthy arm.

A law works on a batch of R recordings of an n-joint arm at once. `on` (R, bool) says in which recordings it
acts. Hooks: `model` (rigid body), `torque` (joint torque added), `actuate` (reported to true motor torque),
`measure` (true to read position), `log` (time series as logged). Every law has one magnitude `size`, from
which `truth` gives the parameters; `target` of `calibrate.py` sets it.

The equation of motion is  M(q) a + h(q, v) = tau_true - friction + sum of added torques.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin


class Law:
    """A change. Attributes: name, listed (a name of the contract), joint (index or None for the arm), size."""

    name = "none"
    listed = True
    linear = True  #: the torque change is proportional to the size
    start, largest = 1.0, 1e3  #: trial size, largest physical size
    also: tuple[str, ...] = ()  #: names of the contract that describe the same torque as well
    plantable = True  #: has a torque given the motion
    whole = False  #: acts on the whole arm, not at one joint

    def __init__(self, arm, joint: int | None, rng: np.random.Generator) -> None:
        self.arm, self.joint, self.size = arm, None if self.whole else joint, self.start
        self.n = len(arm.joints)
        self.draw(rng)

    def draw(self, rng: np.random.Generator) -> None:
        """Draw what is not the size."""

    def reset(self, on: np.ndarray, dt: float, rng: np.random.Generator) -> None:
        """Prepare for a run. Args: on (R,) bool; dt: integration step, s; rng: randomness within the run."""
        self.on, self.dt, self.rng = on, dt, rng

    def model(self, model: pin.Model) -> None:
        """Change the rigid-body model of one recording in place."""

    def tick(self, s) -> None:
        """Called at 1 kHz before the integration steps."""

    def torque(self, s, out: np.ndarray) -> None:
        """Add joint torque to out (R, n)."""

    def actuate(self, s, tau: np.ndarray) -> None:
        """Turn reported motor torque (R, n) into the true one, in place."""

    def measure(self, s, q: np.ndarray) -> None:
        """Turn true position (R, n) into the read one, in place."""

    def log(self, effort: np.ndarray, dt: float) -> None:
        """Change the logged effort (T, n) of one recording, in place; dt, s."""

    def truth(self) -> dict[str, tuple[float, str]]:
        """Parameters {name: (value, unit)}."""
        return {}

    @property
    def joints(self) -> list[str]:
        """Names of the joints at which the law acts; all for the whole arm."""
        return list(self.arm.joints) if self.joint is None else [self.arm.joints[self.joint]]

    @property
    def unit(self) -> str:
        """Unit of the joint torque."""
        return "N" if self.joint is not None and self.arm.prismatic[self.joint] else "N m"

    @property
    def angle(self) -> str:
        """Unit of the joint position."""
        return "m" if self.joint is not None and self.arm.prismatic[self.joint] else "rad"


def tip(s, r: int) -> tuple[np.ndarray, np.ndarray]:
    """Velocity (3,) and translational Jacobian (3, n) of a point 0.1 m beyond the last joint, world axes."""
    m, d = s.models[r], s.datas[r]
    n = m.njoints - 1
    pin.computeJointJacobians(m, d, s.q[r])
    jac = pin.getJointJacobian(m, d, n, pin.LOCAL_WORLD_ALIGNED)
    arm = d.oMi[n].rotation @ np.array([0, 0, 0.1])
    lin = jac[:3] - pin.skew(arm) @ jac[3:]
    return lin @ s.v[r], lin


# ------------------------------------------------------------------ listed: rigid body and base


class Payload(Law):
    """A mass held at the last link.

    Source: Khalil, Gautier, Lemoine 2007, Identification of the payload inertial parameters.
    """

    name, largest = "payload", 12.0
    whole = True

    def draw(self, rng):
        self.centre = np.array([*rng.uniform(-0.03, 0.03, 2), rng.uniform(0.05, 0.14)])

    def model(self, model):
        model.appendBodyToJoint(
            model.njoints - 1, pin.Inertia.FromSphere(float(self.size), 0.05), pin.SE3(np.eye(3), self.centre)
        )

    def truth(self):
        return {"mass": (self.size, "kg")}


class BaseTilt(Law):
    """The base leans by an angle about a horizontal axis: gravity turns in the base frame.

    Source: Mooring, Roth, Driels 1991, Fundamentals of Manipulator Calibration.
    """

    name, start, largest = "base_tilt", 0.02, 0.3
    whole = True

    def draw(self, rng):
        h = rng.uniform(0, 2 * np.pi)
        self.axis = np.array([np.cos(h), np.sin(h), 0])

    def model(self, model):
        model.gravity.linear = pin.exp3(-self.axis * self.size) @ model.gravity.linear

    def truth(self):
        return {"angle": (self.size, "rad")}


# ------------------------------------------------------------------ listed: friction


class FrictionDrift(Law):
    """Coulomb or viscous level changed (Bittencourt 2014, wear of robot joints raises friction levels)."""

    name = "friction_drift"

    def draw(self, rng):
        self.part = str(rng.choice(["coulomb", "viscous", "both"]))
        self.ratio = self.arm.viscous[self.joint] / self.arm.coulomb[self.joint]

    def torque(self, s, out):
        j = self.joint
        if self.part != "viscous":
            out[:, j] -= self.on * self.size * s.z[:, j]
        if self.part != "coulomb":
            out[:, j] -= self.on * self.size * self.ratio * s.v[:, j]

    def truth(self):
        out = {}
        if self.part != "viscous":
            out["coulomb_change"] = (self.size, self.unit)
        if self.part != "coulomb":
            out["viscous_change"] = (self.size * self.ratio, f"{self.unit} s/{self.angle}")
        return out


class TemperatureFriction(Law):
    """Coulomb level falls with the joint's temperature, a (T - 20 C).

    Source: Simoni, Beschi, Legnani, Visioli 2015. Logged temperatures.
    """

    name, plantable = "temperature_friction", False

    def torque(self, s, out):
        out[:, self.joint] += self.on * self.size * (s.temperature[:, self.joint] - 20.0) * s.z[:, self.joint]

    def truth(self):
        return {"alpha": (-self.size - 0.005 * self.arm.coulomb[self.joint], f"{self.unit}/C")}


class LoadFriction(Law):
    """Friction proportional to transmitted torque, mu |tau| sgn v (Hamon, Gautier, Garrec 2010)."""

    name, also, largest = "load_friction", ("gear_efficiency",), 0.5

    def torque(self, s, out):
        j = self.joint
        out[:, j] -= self.on * self.size * np.abs(s.load[:, j]) * s.z[:, j]

    def truth(self):
        return {"mu": (self.size, "1")}


class GearEfficiency(Law):
    """Efficiency eta of a gear: (1/eta - 1)|tau| is lost when the motor drives, (1 - eta)|tau| when driven.

    Source: Verstraten et al. 2015, Modeling and design of geared DC motors (power-flow definition).
    """

    name, also, start, largest, linear = "gear_efficiency", ("load_friction",), 0.05, 0.5, False

    def torque(self, s, out):
        j, eta = self.joint, 1 - self.size
        load = s.load[:, j]
        share = np.where(load * s.v[:, j] > 0, 1 / eta - 1, 1 - eta)
        out[:, j] -= self.on * share * np.abs(load) * s.z[:, j]

    def truth(self):
        return {"efficiency": (1 - self.size, "1")}


class Presliding(Law):
    """Friction builds up over a long displacement after each reversal (Dahl 1968; Swevers et al. 2000)."""

    name, linear, start, largest = "presliding_hysteresis", False, 0.05, 0.6

    def reset(self, on, dt, rng):
        super().reset(on, dt, rng)
        self.slow = np.zeros(len(on))

    def torque(self, s, out):
        j = self.joint
        sign = np.sign(s.v[:, j])
        self.slow = sign - (sign - self.slow) * np.exp(-np.abs(s.v[:, j]) * self.dt / self.size)
        out[:, j] -= self.on * self.arm.coulomb[j] * (self.slow - s.z[:, j])

    def truth(self):
        return {"displacement": (self.size, self.angle)}


class PositionFriction(Law):
    """Coulomb level that changes with the joint angle, harmonics of a turn (Popovic and Goldenberg 1998)."""

    name = "position_friction"

    def draw(self, rng):
        unit = 4.0 if self.arm.prismatic[self.joint] else 1.0
        self.order, self.phase = unit * rng.integers(1, 4), rng.uniform(0, 2 * np.pi)

    def torque(self, s, out):
        j = self.joint
        out[:, j] -= self.on * self.size * np.sin(self.order * s.q[:, j] + self.phase) * s.z[:, j]

    def truth(self):
        return {"amplitude": (self.size, self.unit)}


class AsymmetricFriction(Law):
    """Coulomb level that differs between the directions (Armstrong-Helouvry 1991)."""

    name, also = "asymmetric_friction", ("current_offset",)

    def torque(self, s, out):
        out[:, self.joint] -= self.on * self.size * np.abs(s.z[:, self.joint])

    def truth(self):
        return {"half_difference": (self.size, self.unit)}


class Stribeck(Law):
    """More friction at low speed, f exp(-(v/vs)^2) sgn v (Stribeck 1902; Bo and Pavelescu 1982)."""

    name = "stribeck"

    def draw(self, rng):
        self.speed = self.arm.speed[self.joint] * rng.uniform(0.03, 0.12)

    def torque(self, s, out):
        j = self.joint
        out[:, j] -= self.on * self.size * np.exp(-((s.v[:, j] / self.speed) ** 2)) * s.z[:, j]

    def truth(self):
        return {"level": (self.size, self.unit), "velocity": (self.speed, f"{self.angle}/s")}


class VacuumFriction(Law):
    """Terms of friction in v|v| and v^3 vanish at all joints.

    Drag of air and churning of lubricant stop; the arm must have the terms. No source but the contract's one line.
    """

    name, largest, plantable = "vacuum_friction", 1.0, False
    whole = True

    def torque(self, s, out):
        out += self.on[:, None] * self.size * (self.arm.square * s.v * np.abs(s.v) + self.arm.cubic * s.v**3)


# ------------------------------------------------------------------ listed: gear, elasticity, cables, coupling


class TorqueRipple(Law):
    """Torque that waves with the joint angle.

    Source: Tuttle 1992; Taghirad and Belanger 1998 (ripple of harmonic drives).
    """

    name = "torque_ripple"

    def draw(self, rng):
        self.order = rng.choice([rng.uniform(12, 60), rng.integers(12, 60)]) * (
            3.0 if self.arm.prismatic[self.joint] else 1.0
        )
        self.phase = rng.uniform(0, 2 * np.pi)

    def torque(self, s, out):
        j = self.joint
        out[:, j] += self.on * self.size * np.sin(self.order * s.q[:, j] + self.phase)

    def truth(self):
        return {
            "amplitude": (self.size, self.unit),
            "cycles": (float(self.order), f"1/{'2 pi m' if self.arm.prismatic[self.joint] else 'rev'}"),
        }


class TwoMass(Law):
    """Motor and link of one joint as two masses with a spring; position is read at the motor."""

    linear, plantable = False, False

    def spring(self, twist: np.ndarray, speed: np.ndarray) -> np.ndarray:
        """Torque (R,) on the link from twist = motor - link (R,) and its rate (R,)."""
        raise NotImplementedError

    def twist(self, tau: np.ndarray) -> np.ndarray:
        """Static twist (T,) that carries torque tau (T,)."""
        raise NotImplementedError


class JointElasticity(TwoMass):
    """Flexible joint, tau = k (theta - q) + d (theta' - q') (Spong 1987); the size is the compliance 1/k."""

    name, start, largest = "joint_elasticity", 1e-4, 1.0

    def draw(self, rng):
        j = self.joint
        self.inertia = self.arm.rotor[j]
        self.largest = 1 / (self.inertia * (2 * np.pi * 7) ** 2)

    def spring(self, twist, speed):
        k = 1 / self.size
        return k * twist + 2 * 0.05 * np.sqrt(k * self.inertia) * speed

    def twist(self, tau):
        return self.size * tau

    def truth(self):
        return {"stiffness": (1 / self.size, f"{self.unit}/{self.angle}")}


class Backlash(TwoMass):
    """A gap of total width b in the gear, then a stiff contact (Nordin and Gutman 2002, dead-zone model)."""

    name, start, largest = "backlash", 1e-3, 0.05

    def draw(self, rng):
        self.inertia = self.arm.rotor[self.joint]
        self.k = self.inertia * (2 * np.pi * 60) ** 2
        self.d = 2 * 0.3 * np.sqrt(self.k * self.inertia)

    def spring(self, twist, speed):
        over = twist - np.clip(twist, -self.size / 2, self.size / 2)
        push = self.k * over + self.d * speed * (over != 0)
        return np.where(push * over > 0, push, 0.0)

    def twist(self, tau):
        return self.size / 2 * np.tanh(tau / (0.05 * np.std(tau) + 1e-9)) + tau / self.k

    def truth(self):
        return {"gap": (self.size, self.angle)}


class HarnessSpring(Law):
    """Cables along the arm pull as a linear spring, -k (q - q0)."""

    name = "harness_spring"

    def draw(self, rng):
        self.zero = self.arm.middle[self.joint] + rng.uniform(-0.2, 0.2) * self.arm.span[self.joint]

    def torque(self, s, out):
        j = self.joint
        out[:, j] -= self.on * self.size * (s.q[:, j] - self.zero)

    def truth(self):
        return {"stiffness": (self.size, f"{self.unit}/{self.angle}")}


class RotorCoupling(Law):
    """Inertia between a joint's rotor and the joint before it: tau_(j-1) = c a_j, tau_j = c a_(j-1).

    Source: De Luca and Book 2016.
    """

    name, also, start = "rotor_coupling", ("wrist_coupling",), 0.1

    def draw(self, rng):
        j = self.joint = max(self.joint, 1)
        r = self.arm.rotor
        self.largest = 0.45 * np.sqrt(r[j] * r[j - 1])

    def torque(self, s, out):
        j = self.joint
        out[:, j] -= self.on * self.size * s.a[:, j - 1]
        out[:, j - 1] -= self.on * self.size * s.a[:, j]

    @property
    def joints(self):
        return [self.arm.joints[self.joint - 1], self.arm.joints[self.joint]]

    def truth(self):
        return {"inertia": (self.size, "kg m^2")}


class WristCoupling(Law):
    """Motor 6 turns with joint 5 too: inertia, viscous and Coulomb terms of v5 + v6 (Gautier, TX40, 2013)."""

    name, also, start = "wrist_coupling", ("rotor_coupling",), 0.1

    def draw(self, rng):
        self.joint = self.n - 1
        j = self.joint
        self.largest = 0.5 * np.sqrt(self.arm.rotor[j] * self.arm.rotor[j - 1]) / (0.1 * self.arm.rotor[j])
        self.base = (0.1 * self.arm.rotor[j], self.arm.viscous[j], self.arm.coulomb[j])

    def torque(self, s, out):
        j = self.joint
        c, fv, fc = (self.size * b for b in self.base)
        total = s.v[:, j] + s.v[:, j - 1]
        friction = fv * total + fc * np.tanh(total / 0.03)
        out[:, j - 1] -= self.on * (c * s.a[:, j] + friction)
        out[:, j] -= self.on * (c * s.a[:, j - 1] + friction - fv * s.v[:, j] - fc * np.tanh(s.v[:, j] / 0.03))

    @property
    def joints(self):
        return [self.arm.joints[self.joint - 1], self.arm.joints[self.joint]]


class ExternalContact(Law):
    """A force at the tip, within a time window, half-sine edges of 50 ms.

    Source: Haddadin, De Luca, Albu-Schaeffer 2017, Robot collisions.
    """

    name = "external_contact"
    whole = True

    def draw(self, rng):
        d = rng.standard_normal(3)
        self.direction, self.at, self.width = d / np.linalg.norm(d), rng.uniform(0.25, 0.65), rng.uniform(1.0, 3.0)

    def reset(self, on, dt, rng):
        super().reset(on, dt, rng)
        self.held = np.zeros((len(on), self.n))

    def tick(self, s):
        x = s.t - self.at * s.duration
        w = np.clip(min(x, self.width - x) / 0.05, 0, 1)
        self.held[:] = 0
        if w:
            for r in np.flatnonzero(self.on):
                self.held[r] = tip(s, r)[1].T @ self.direction * np.sin(w * np.pi / 2)

    def torque(self, s, out):
        out += self.size * self.held

    def truth(self):
        return {"force": (self.size, "N")}


# ------------------------------------------------------------------ listed: drive, sensor, clock


class TorqueConstant(Law):
    """The torque constant is (1 + e) times the one the log uses: demagnetisation, wrong scale.

    Source: Gautier and Briot 2014.
    """

    name, start, largest = "torque_constant", 0.05, 0.45

    def draw(self, rng):
        self.sign = rng.choice([-1.0, 1.0])

    def actuate(self, s, tau):
        tau[:, self.joint] *= 1 + self.on * self.sign * self.size

    def inverse(self, tau):
        """Reported torque (T,) of the joint from the true one (T,)."""
        return tau / (1 + self.sign * self.size)

    def truth(self):
        return {"ratio": (1 + self.sign * self.size, "1")}


class MotorSaturation(Law):
    """Magnetic saturation: true torque L tanh(tau/L) of the reported, linear one.

    Source: Hendershot and Miller 2010. The size is 1/L.
    """

    name, linear, start, largest = "motor_saturation", False, 1e-2, 10.0

    def actuate(self, s, tau):
        j = self.joint
        tau[:, j] = np.where(self.on, np.tanh(tau[:, j] * self.size) / self.size, tau[:, j])

    def inverse(self, tau):
        """Reported torque (T,) of the joint from the true one (T,)."""
        return np.arctanh(np.clip(tau * self.size, -0.95, 0.95)) / self.size

    def truth(self):
        return {"limit": (1 / self.size, self.unit)}


class CurrentOffset(Law):
    """The current sensor has an offset: reported = true + offset."""

    name, also = "current_offset", ("asymmetric_friction",)

    def draw(self, rng):
        self.sign = rng.choice([-1.0, 1.0])

    def actuate(self, s, tau):
        tau[:, self.joint] -= self.on * self.sign * self.size

    def inverse(self, tau):
        """Reported torque (T,) of the joint from the true one (T,)."""
        return tau + self.sign * self.size

    def truth(self):
        return {"offset": (self.sign * self.size, self.unit)}


class EncoderEccentricity(Law):
    """The encoder disc runs out: read = q + e sin(q + phase), once a turn of the joint (Hagiwara et al. 1992)."""

    name, start, largest, plantable = "encoder_eccentricity", 1e-3, 0.15, False

    def draw(self, rng):
        self.phase = rng.uniform(0, 2 * np.pi)

    def measure(self, s, q):
        j = self.joint
        q[:, j] += self.on * self.size * np.sin(q[:, j] + self.phase)

    def truth(self):
        return {"amplitude": (self.size, "rad")}


class TimeDelay(Law):
    """The torque of the joint is logged later than its position by a fixed time."""

    name, linear, start, largest = "time_delay", False, 2e-3, 0.2

    def log(self, effort, dt):
        t = np.arange(len(effort)) * dt
        effort[:, self.joint] = np.interp(t - self.size, t, effort[:, self.joint])

    def truth(self):
        return {"delay": (self.size, "s")}


class FilterLag(Law):
    """The torque of the joint is logged through a first-order low-pass of a fixed time constant."""

    name, linear, also, start, largest = "filter_lag", False, ("time_delay",), 2e-3, 0.2

    def log(self, effort, dt):
        from scipy.signal import lfilter

        b = 1 - np.exp(-dt / self.size)
        x = effort[:, self.joint]
        effort[:, self.joint] = lfilter([b], [1, b - 1], x, zi=[x[0] * (1 - b)])[0]

    def truth(self):
        return {"time_constant": (self.size, "s")}


# ------------------------------------------------------------------ absent from the contract's list


class Absent(Law):
    """A change that the contract does not list: the right answer is `unknown`."""

    listed = False


class DeadZone(Absent):
    """Dead zone of a current controller: true = reported less its clipped part (Tao and Kokotovic 1994)."""

    name, largest = "dead_zone", 1e3

    def actuate(self, s, tau):
        j = self.joint
        tau[:, j] -= self.on * np.clip(tau[:, j], -self.size, self.size)


class RateLimit(Absent):
    """The drive follows its (reported) set-point at a limited rate only; size is the inverse of the rate, s/(N m)."""

    name, linear, start, largest, plantable = "rate_limit", False, 1e-4, 1.0, False

    def reset(self, on, dt, rng):
        super().reset(on, dt, rng)
        self.now = None

    def actuate(self, s, tau):
        j = self.joint
        if self.now is None:
            self.now = tau[:, j].copy()
        step = self.dt / self.size
        self.now += np.clip(tau[:, j] - self.now, -step, step)
        tau[:, j] = np.where(self.on, self.now, tau[:, j])


class BoucWen(Absent):
    """Torque lost in a harmonic drive's flexspline, a Bouc-Wen state driven by the transmitted torque.

    Source: Wen 1976; Ruderman, Hoffmann, Bertram 2009 (harmonic drives).
    """

    name = "bouc_wen"

    def draw(self, rng):
        j = self.joint
        self.width = rng.uniform(0.8, 1.6) * self.arm.coulomb[j]

    def reset(self, on, dt, rng):
        super().reset(on, dt, rng)
        self.x = self.z = None

    def torque(self, s, out):
        load = s.load[:, self.joint]
        if self.x is None:
            self.x, self.z = load.copy(), np.zeros_like(load)
        step = (load - self.x) * min(1, self.dt * 120)
        self.x = self.x + step
        # dz = (dx - 0.5 |dx| z - 0.5 dx |z|) / width, clipped: the classical loop with n = 1
        self.z = np.clip(
            self.z + (step - 0.5 * np.abs(step) * self.z - 0.5 * step * np.abs(self.z)) / self.width, -1, 1
        )
        out[:, self.joint] -= self.on * self.size * self.z


class Slosh(Absent):
    """Liquid that was still and now sloshes: a lightly damped pendulum mass at the tip, total mass unchanged.

    Source: Abramson 1966.
    """

    name = "slosh"
    whole = True

    def draw(self, rng):
        self.largest = 0.3 * sum(i.mass for i in list(self.arm.model.inertias)[-3:])
        self.omega, self.damping = 2 * np.pi * rng.uniform(0.9, 1.8), rng.uniform(0.01, 0.04)

    def reset(self, on, dt, rng):
        super().reset(on, dt, rng)
        n = len(on)
        self.x, self.u, self.last, self.acc = (np.zeros((n, 3)) for _ in range(4))
        self.held = np.zeros((n, self.n))

    def tick(self, s):
        h = s.period
        for r in np.flatnonzero(self.on):
            v, jac = tip(s, r)
            self.acc[r] += ((v - self.last[r]) / h - self.acc[r]) * min(1, h * 150)
            self.last[r] = v
            pull = self.omega**2 * self.x[r] + 2 * self.damping * self.omega * self.u[r]
            self.u[r] += h * (-pull - self.acc[r])
            self.x[r] += h * self.u[r]
            self.held[r] = jac.T @ (pull + self.acc[r])

    def torque(self, s, out):
        out += self.size * self.held


class EddySector(Absent):
    """Eddy-current drag within a sector of the turn, c v/(1 + (v/vc)^2) (Smythe 1942): a magnet near the disc."""

    name = "eddy_sector"

    def draw(self, rng):
        j = self.joint
        self.centre = self.arm.middle[j] + rng.uniform(-0.4, 0.4) * self.arm.span[j]
        self.width, self.critical = 0.3 * self.arm.span[j], 0.3 * self.arm.speed[j]

    def torque(self, s, out):
        j = self.joint
        v = s.v[:, j]
        share = np.exp(-(((s.q[:, j] - self.centre) / self.width) ** 4))
        out[:, j] -= self.on * self.size * share * v / (1 + (v / self.critical) ** 2)


class Bumper(Absent):
    """A one-sided Hertzian stop near the end of the range, k max(0, q - q1)^1.5 (Hunt and Crossley 1975)."""

    name = "bumper"

    def draw(self, rng):
        j = self.joint
        self.side = rng.choice([-1.0, 1.0])
        self.at = self.arm.middle[j] + self.side * rng.uniform(0.3, 0.55) * self.arm.span[j]

    def torque(self, s, out):
        j = self.joint
        out[:, j] -= self.on * self.size * self.side * np.maximum(0, self.side * (s.q[:, j] - self.at)) ** 1.5


class LooseBolt(Absent):
    """A loose part knocks when the joint's acceleration changes sign: a decaying ring of 12 to 25 Hz.

    Source: impact: Gilardi and Sharf 2002.
    """

    name = "loose_bolt"

    def draw(self, rng):
        self.omega, self.decay = 2 * np.pi * rng.uniform(12, 25), rng.uniform(0.04, 0.08)

    def reset(self, on, dt, rng):
        super().reset(on, dt, rng)
        n = len(on)
        self.since, self.side, self.slow, self.amp = np.full(n, 9.0), np.zeros(n), np.zeros(n), np.zeros(n)

    def torque(self, s, out):
        j = self.joint
        self.slow += (s.a[:, j] - self.slow) * min(1, self.dt * 60)
        side = np.where(np.abs(self.slow) > 0.08 * self.arm.acceleration[j], np.sign(self.slow), self.side)
        new = (side != self.side) & (self.since > 0.1)
        self.amp = np.where(new, side, self.amp)
        self.since = np.where(new, 0.0, self.since + self.dt)
        self.side = np.where(new | (self.side == 0), side, self.side)
        out[:, j] += self.on * self.size * self.amp * np.exp(-self.since / self.decay) * np.sin(self.omega * self.since)


class MissingCodes(Absent):
    """An absolute encoder with a bad bit: in every second band of the code the reading jumps by a part of the band.

    Source: Kester 2005.
    """

    name, plantable, start, largest, linear = "missing_codes", False, 1e-3, 0.03, False

    def draw(self, rng):
        self.band = rng.uniform(0.05, 0.12) * self.arm.span[self.joint]

    def measure(self, s, q):
        j = self.joint
        odd = np.floor(q[:, j] / self.band).astype(int) % 2 == 1
        q[:, j] -= self.on * self.size * odd


class Vibration(Absent):
    """A machine nearby shakes the joint at its own, slowly wandering frequency, whatever the arm does."""

    name = "vibration"

    def draw(self, rng):
        self.hertz = rng.uniform(4, 11)

    def reset(self, on, dt, rng):
        super().reset(on, dt, rng)
        self.angle_now = rng.uniform(0, 2 * np.pi, len(on))

    def torque(self, s, out):
        self.angle_now += 2 * np.pi * self.hertz * (1 + 0.05 * np.sin(0.4 * s.t)) * self.dt
        out[:, self.joint] += self.on * self.size * np.sin(self.angle_now)


class VoltageSag(Absent):
    """Torque lost above a speed when the bus voltage sags: true = reported (1 - s max(0, |v|/v0 - 1)).

    Source: field-weakening limit.
    """

    name, largest = "voltage_sag", 2.0

    def draw(self, rng):
        self.base = 0.3 * self.arm.speed[self.joint]

    def actuate(self, s, tau):
        j = self.joint
        tau[:, j] *= 1 - self.on * np.minimum(0.9, self.size * np.maximum(0, np.abs(s.v[:, j]) / self.base - 1))


# ------------------------------------------------------------------ dirt of healthy arms


class HoseTorque(Absent):
    """A hose: cubic spring with a hysteresis of its own."""

    name = "hose"

    def draw(self, rng):
        self.zero = self.arm.middle[self.joint] + rng.uniform(-0.3, 0.3) * self.arm.span[self.joint]

    def torque(self, s, out):
        j = self.joint
        x = (s.q[:, j] - self.zero) / self.arm.span[j]
        out[:, j] -= self.on * self.size * (x + x**3) / 2


class Cogging(Absent):
    """Cogging of the motor: cycles a motor turn times the gear ratio."""

    name = "cogging"

    def draw(self, rng):
        self.order, self.phase = self.arm.gear[self.joint] * rng.choice([1, 2]), rng.uniform(0, 2 * np.pi)

    def torque(self, s, out):
        j = self.joint
        out[:, j] += self.on * self.size * np.sin(self.order * s.q[:, j] + self.phase)


LISTED = [
    Payload,
    BaseTilt,
    FrictionDrift,
    TemperatureFriction,
    LoadFriction,
    GearEfficiency,
    Presliding,
    PositionFriction,
    AsymmetricFriction,
    Stribeck,
    VacuumFriction,
    TorqueRipple,
    JointElasticity,
    Backlash,
    HarnessSpring,
    RotorCoupling,
    WristCoupling,
    ExternalContact,
    TorqueConstant,
    MotorSaturation,
    CurrentOffset,
    EncoderEccentricity,
    TimeDelay,
    FilterLag,
]
ABSENT = [DeadZone, RateLimit, BoucWen, Slosh, EddySector, Bumper, LooseBolt, MissingCodes, Vibration, VoltageSag]


def dirt(arm, rng: np.random.Generator) -> list[Law]:
    """Draw two to four kinds of moderate unmodelled effects, each at one to three joints.

    Sizes are relative to the Coulomb level of the joint: ripple 3-8 %, hose 5-15 %, cogging 2-6 %,
    presliding 3-10 mrad, wave of friction 3-8 %; torque constant off by 1-3 %.
    """
    table = [
        (TorqueRipple, 0.03, 0.08),
        (HoseTorque, 0.05, 0.15),
        (Cogging, 0.02, 0.06),
        (PositionFriction, 0.03, 0.08),
        (TorqueConstant, None, None),
        (Presliding, None, None),
    ]
    out: list[Law] = []
    for k in rng.permutation(len(table))[: rng.integers(2, 5)]:
        kind, low, high = table[k]
        for joint in rng.permutation(arm.n)[: rng.integers(1, 4)]:
            law = kind(arm, int(joint), rng)
            if kind is TorqueConstant:
                law.size = rng.uniform(0.01, 0.03)
            elif kind is Presliding:
                law.size = rng.uniform(0.003, 0.01) * (0.3 if arm.prismatic[joint] else 1)
            else:
                law.size = rng.uniform(low, high) * arm.coulomb[joint]
            out.append(law)
    return out
