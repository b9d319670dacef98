"""Small arms with planted parameters for tests: URDF text, smooth motion, and torque written a second time.

The torque comes from Pinocchio's Newton-Euler and from friction formulas written out here, not from the package's
own regressor and terms, so that what a test finds again was not put there by the code it tests.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin
from hypothesis import strategies as st
from scipy.signal import lfilter

from spacearm_ident.recording.recording import Recording

INERTIALS = ("m", "mcx", "mcy", "mcz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")


@dataclass(frozen=True)
class Link:
    """One joint and the link it moves; `com` and the inertia about it (ixx ixy ixz iyy iyz izz) in link axes."""

    name: str
    kind: str = "revolute"
    parent: str = "base"
    axis: Sequence[float] = (0.0, 1.0, 0.0)
    xyz: Sequence[float] = (0.0, 0.0, 0.0)
    rpy: Sequence[float] = (0.0, 0.0, 0.0)
    mass: float = 2.0
    com: Sequence[float] = (0.0, 0.0, 0.2)
    inertia: Sequence[float] = (0.03, 0.0, 0.0, 0.03, 0.0, 0.01)
    limit: str = 'lower="-3" upper="3" effort="200" velocity="4"'


def urdf_of(links: Sequence[Link], name: str = "planted") -> str:
    """The URDF of a tree of links; a link's name is its joint's with `_link` added."""

    def words(numbers: Sequence[float]) -> str:
        return " ".join(repr(float(number)) for number in numbers)

    parts = [f'<robot name="{name}"><link name="base"/>']
    for link in links:
        ixx, ixy, ixz, iyy, iyz, izz = link.inertia
        parent = "base" if link.parent == "base" else f"{link.parent}_link"
        parts.append(
            f'<link name="{link.name}_link"><inertial><origin xyz="{words(link.com)}"/><mass value="{link.mass!r}"/>'
            f'<inertia ixx="{ixx!r}" ixy="{ixy!r}" ixz="{ixz!r}" iyy="{iyy!r}" iyz="{iyz!r}" izz="{izz!r}"/>'
            f'</inertial></link><joint name="{link.name}" type="{link.kind}"><parent link="{parent}"/>'
            f'<child link="{link.name}_link"/><origin xyz="{words(link.xyz)}" rpy="{words(link.rpy)}"/>'
            f'<axis xyz="{words(link.axis)}"/>'
            + (f"<limit {link.limit}/>" if link.limit and link.kind != "fixed" else "")
            + "</joint>"
        )
    return "".join(parts) + "</robot>"


TWO_LINKS = (
    Link("shoulder", xyz=(0, 0, 0.4), mass=3.0, com=(0.02, 0.0, 0.25), inertia=(0.06, 0, 0, 0.06, 0, 0.01)),
    Link("elbow", parent="shoulder", xyz=(0, 0, 0.5), mass=2.0, com=(-0.01, 0.0, 0.2)),
)
"""A planar 2R arm in the vertical x-z plane."""

THREE_LINKS = (
    Link("waist", axis=(0, 0, 1), mass=4.0, com=(0.0, 0.0, 0.1)),
    Link(
        "shoulder",
        parent="waist",
        xyz=(0, 0, 0.3),
        mass=3.0,
        com=(0.02, 0.01, 0.25),
        inertia=(0.06, 0, 0, 0.06, 0, 0.01),
    ),
    Link("elbow", parent="shoulder", xyz=(0, 0, 0.5), mass=2.0, com=(-0.01, 0.02, 0.2)),
)


@dataclass(frozen=True)
class Friction:
    """Friction, rotor and other parameters of one joint; `d_s` > 0 is integrated step by step.

    `odd`: k_v2 qd |qd| instead of k_v2 qd^2.
    """

    f_c: float = 5.0
    f_b: float | None = None
    v_b: float = 0.0
    d_s: float = 0.0
    k_v1: float = 4.0
    k_v2: float = 0.3
    k_v3: float = -0.1
    J_m: float = 0.5
    mu: float = 0.0
    offset: float = 0.0
    k_1: float = 0.0
    odd: bool = False

    @property
    def static(self) -> float:
        return self.f_c if self.f_b is None else self.f_b


@dataclass(frozen=True)
class Planted:
    """An arm's truth on one motion: exact signals at `rate_hz`, torque without noise."""

    joints: tuple[str, ...]
    urdf: str
    rate_hz: float
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    rigid: np.ndarray
    torque: np.ndarray
    values: Mapping[str, float] = field(default_factory=dict)

    def recording(
        self, noise: float | Sequence[float] = 0.0, seed: int = 0, ar: float = 0.0, encoder: float = 0.0
    ) -> Recording:
        """Measured with white torque noise of standard deviation `noise`, or AR(1) of the same deviation."""
        rng = np.random.default_rng(seed)
        white = rng.standard_normal((len(self.q) + 200, self.q.shape[1]))
        coloured = lfilter([np.sqrt(1 - ar**2)], [1.0, -ar], white, axis=0)[200:]
        return Recording(
            joints=self.joints,
            time=np.arange(len(self.q)) / self.rate_hz,
            position=self.q + encoder * rng.standard_normal(self.q.shape),
            velocity=None,
            effort=self.torque + np.asarray(noise) * coloured,
            segments=(slice(0, len(self.q)),),
            urdf=self.urdf,
        )


def multisine(
    time: np.ndarray, joints: int, seed: int = 0, fundamental_hz: float = 0.1, harmonics: int = 5, speed: float = 1.5
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, velocity, acceleration (N, n) of a random Fourier series with peak speed about `speed` rad/s."""
    rng = np.random.default_rng(seed)
    omega = 2 * np.pi * fundamental_hz * np.arange(1, harmonics + 1)
    a, b = rng.uniform(-1, 1, (2, harmonics, joints))
    sin, cos = np.sin(time[:, None] * omega), np.cos(time[:, None] * omega)
    velocity = cos @ a + sin @ b
    scale = speed / np.abs(velocity).max(axis=0)
    a, b = a * scale, b * scale
    position = sin @ (a / omega[:, None]) - cos @ (b / omega[:, None])
    return position, cos @ a + sin @ b, cos @ (b * omega[:, None]) - sin @ (a * omega[:, None])


def incommensurate(
    time: np.ndarray, joints: int, seed: int = 0, speed: float = 1.5
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """As `multisine`, of frequencies 0.1 to 0.7 Hz that never repeat together."""
    rng = np.random.default_rng(seed)
    frequency = np.sqrt(rng.uniform(0.1**2, 0.7**2, (5, joints)))
    omega, phase = 2 * np.pi * frequency, rng.uniform(0, 2 * np.pi, (5, joints))
    amplitude = rng.uniform(0.5, 1.0, (5, joints))
    angle = time[:, None, None] * omega + phase
    velocity = (amplitude * np.cos(angle)).sum(axis=1)
    amplitude = amplitude * speed / np.abs(velocity).max(axis=0)
    return (
        (amplitude / omega * np.sin(angle)).sum(axis=1),
        (amplitude * np.cos(angle)).sum(axis=1),
        -(amplitude * omega * np.sin(angle)).sum(axis=1),
    )


def friction_torque(velocity: np.ndarray, rate_hz: float, law: Friction, load: np.ndarray) -> np.ndarray:
    """(N,) the paper's eq. 2, or its bristle state integrated sample by sample where d_s > 0."""
    share = np.exp(-((velocity / law.v_b) ** 2)) if law.v_b > 0 else np.zeros_like(velocity)
    level = (law.f_c + (law.static - law.f_c) * share) * np.sign(velocity)
    sign = np.sign(velocity)
    if law.d_s > 0:
        level, sign = _lagging(level, velocity, rate_hz, law.d_s), _lagging(sign, velocity, rate_hz, law.d_s)
    quadratic = law.k_v2 * velocity * (np.abs(velocity) if law.odd else velocity)
    viscous = law.k_v1 * velocity + quadratic + law.k_v3 * velocity**3
    return level + law.mu * np.abs(load) * sign + viscous + law.offset


def _lagging(target: np.ndarray, velocity: np.ndarray, rate_hz: float, distance: float) -> np.ndarray:
    state, out = 0.0, np.empty_like(target)
    for k, (goal, travel) in enumerate(zip(target, np.abs(velocity) / rate_hz)):
        state = goal + (state - goal) * np.exp(-travel / distance)
        out[k] = state
    return out


def plant(
    links: Sequence[Link],
    friction: Sequence[Friction],
    motion: tuple[np.ndarray, np.ndarray, np.ndarray],
    rate_hz: float,
    gravity: Sequence[float] = (0.0, 0.0, -9.81),
    true_links: Sequence[Link] | None = None,
) -> Planted:
    """Torque of an arm on a motion (q, qd, qdd). `true_links` obey Newton, `links` are what the URDF says."""
    model = pin.buildModelFromXML(urdf_of(true_links or links))
    model.gravity.linear = np.array(gravity, dtype=float)
    data = model.createData()
    q, qd, qdd = motion
    rigid = np.array([pin.rnea(model, data, *state) for state in zip(q, qd, qdd)])
    torque = rigid.copy()
    values: dict[str, float] = {}
    for k, (link, law) in enumerate(zip(links, friction)):
        torque[:, k] += law.J_m * qdd[:, k] + law.k_1 * q[:, k]
        torque[:, k] += friction_torque(qd[:, k], rate_hz, law, rigid[:, k])
        for symbol in ("f_c", "v_b", "d_s", "k_v1", "k_v2", "k_v3", "J_m", "mu", "offset", "k_1"):
            values[f"{symbol}[{link.name}]"] = getattr(law, symbol)
        values[f"f_b[{link.name}]"] = law.static
        for symbol, value in zip(INERTIALS, model.inertias[k + 1].toDynamicParameters()):
            values[f"{symbol}[{link.name}]"] = float(value)
    names = tuple(link.name for link in links)
    return Planted(names, urdf_of(links), rate_hz, q, qd, qdd, rigid, torque, values)


def real(low, high):
    return st.floats(low, high, allow_nan=False, allow_infinity=False)


@st.composite
def axes(draw):
    axis = draw(
        st.one_of(
            st.sampled_from([(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)]),
            st.tuples(*[real(-1, 1)] * 3).filter(lambda a: np.linalg.norm(a) > 0.1),
        )
    )
    return axis


@st.composite
def trees(draw):
    """Two to six links, each on the base or on any link before it."""
    links = []
    for number in range(draw(st.integers(1, 6))):
        parent = "base" if number == 0 else draw(st.sampled_from(["base", *(link.name for link in links)]))
        kind = draw(st.sampled_from(["revolute", "prismatic", "continuous"]))
        vector = st.tuples(*[real(-1, 1)] * 3)
        a, b, c = draw(st.tuples(*[real(0.01, 1)] * 3))
        links.append(
            Link(
                f"j{number}",
                kind=kind,
                parent=parent,
                axis=draw(axes()),
                xyz=draw(vector),
                rpy=tuple(3 * angle for angle in draw(vector)),
                mass=draw(real(0.1, 9)),
                com=draw(vector),
                # Principal moments of a cloud of points: no triangle inequality is violated.
                inertia=(b + c, 0.0, 0.0, a + c, 0.0, a + b),
                limit="" if kind == "continuous" else 'lower="-9" upper="9" effort="9" velocity="9"',
            )
        )
    return tuple(links)


def two_link_run(
    laws: Sequence[Friction],
    seconds: float = 20.0,
    rate_hz: float = 500.0,
    seed: int = 0,
    periodic: bool = False,
    speed: float = 0.6,
) -> Planted:
    """The planar arm on a motion that repeats every 5 s, or never."""
    time = np.arange(0.0, seconds, 1.0 / rate_hz)
    motion = multisine(time, 2, seed, 0.2, 4, speed) if periodic else incommensurate(time, 2, seed, speed)
    return plant(TWO_LINKS, laws, motion, rate_hz)
