"""Joint friction: the paper's improved Stribeck law, its variants, and what happens when the motion reverses.

    F = z + mu |tau_load| z_1 + k_v1 qd + k_v2 qd^2 + k_v3 qd^3
    dz/ds = (g(qd) sgn(qd) - z) / d_s,     g(qd) = f_c + (f_b - f_c) exp(-(qd/v_b)^2),     ds = |dq|

With d_s = 0 this is the paper's eq. 2: z = g sgn(qd). A presliding distance d_s > 0 is the bristle state of LuGre
(Canudas de Wit et al. 1995) over the distance travelled, without its damping: real reversals are not infinitely
sharp, a fit that insists on it finds presliding everywhere, and a joint that has stopped holds the friction it
stopped with, not its breakaway level. z is linear in f_c and f_b. `mu` (off by default) is friction that grows with
the load on the gear. The paper prints k_v2 qd^2, even in qd; `quadratic: odd` gives k_v2 qd |qd|, which resists in
both directions.

v_b may follow the temperature: v_b(T) = v_b Q_10^((T - T_0)/10), Q_10 its ratio over ten kelvin (lubricants thin out
exponentially; never negative, as a straight line would become). f_c and k_v1 over temperature are linear and a term
of their own, `temperature_friction`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from scipy.linalg.lapack import dtbtrs

from ..arrays import FloatArray
from ..errors import UserError
from ..signals.motion import Motion
from .arm import Arm
from .background import Background
from .term import Columns, Constant, Parameter, Term, Values, chosen_joints

STRIBECK_GRID = (0.0, *(float(v) for v in np.geomspace(5e-4, 0.4, 13)))
PRESLIDING_GRID = (0.0, 3e-5, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2)
Q_10_GRID = (0.3, 0.5, 0.75, 1.0, 1.35, 2.0, 3.3)
"""Begins at one, in its middle: beside a v_b of the run's mean temperature no other value gains anything by itself."""
WARM_FROM = 20.0
"""T_0 of the paper's temperature law, °C."""
LOAD_SCALE = 0.1
LARGEST_LOAD_SHARE = 0.4
"""Largest share of its load that a gear loses to friction: strain wave gears at low torque or cold are down to 60 %
efficient. A Stäubli TX40's third joint has 0.28."""


def bristle_state(target: FloatArray, travel: FloatArray, distance: float, cyclic: bool = False) -> FloatArray:
    """The solution of dz/ds = (target - z)/distance along the distance travelled, from rest.

    Args:
        target: (N, k) where the state goes.
        travel: (N,) distance travelled since the sample before, rad.
        distance: d_s, rad; 0 gives the target itself.
        cyclic: Whether the last sample is followed by the first; then the periodic solution.

    Returns:
        (N, k), the linear recurrence z_i = a_i z_(i-1) + (1 - a_i) target_i, a_i = exp(-travel_i/distance): a
        bidiagonal system, solved forwards.
    """
    if distance <= 0.0:
        return target
    decay = np.exp(-travel / distance)
    band = np.ones((2, len(decay)), order="F")
    band[1, :-1] = -decay[1:]
    driven = np.asfortranarray((1.0 - decay)[:, None] * target)
    state = np.asarray(dtbtrs(band, driven, uplo="L", diag="U", overwrite_b=True)[0])
    if cyclic:
        # The state before the first sample is that at the end of the cycle.
        since_first = np.exp(-np.cumsum(travel) / distance)
        state += np.outer(since_first, state[-1] / max(1.0 - since_first[-1], 1e-12))
    return state


def excess_temperature(motion: Motion, row: int, above: float = WARM_FROM) -> FloatArray:
    """(N,) temperature of a joint above T_0, K; zero where none was recorded, as if the joint were at T_0.

    Args:
        motion: N samples.
        row: Number of the joint.
        above: T_0, °C.
    """
    if motion.temperature is None:
        return np.zeros(len(motion.position))
    return np.nan_to_num(motion.temperature[:, row] - above)


@dataclass(frozen=True)
class StribeckFriction(Term):
    """The part of one joint's friction that depends on the direction of motion.

    Options, each true, false or names of joints: `load` adds mu; `presliding` (default true) lets d_s be other than 0;
    `stribeck` (default true) lets f_b differ from f_c, without it friction is Coulomb's; `temperature` adds Q_10, how
    v_b follows the joint's temperature.
    """

    kind: ClassVar[str] = "stribeck_friction"
    words: ClassVar[str] = "Stribeck friction f_c, f_b, v_b"
    friction: ClassVar[bool] = True

    @classmethod
    def build(cls, arm: Arm, options: Mapping[str, Any]) -> tuple[Term, ...]:
        """One term a joint: its constants are searched joint by joint."""
        presliding = chosen_joints(arm, options.get("presliding", True))
        loaded = chosen_joints(arm, options.get("load"))
        stribeck = chosen_joints(arm, options.get("stribeck", True))
        warm = chosen_joints(arm, options.get("temperature")) if stribeck else ()
        terms = []
        for joint in arm.joint_names:
            parameters = [
                Parameter("f_c", joint, "N m", lower=0.0),
                Parameter("f_b", joint, "N m", anchor="f_c", lower=0.0, held=joint not in stribeck),
            ]
            if joint in loaded:
                parameters.append(Parameter("mu", joint, "1", scale=LOAD_SCALE, lower=0.0, upper=LARGEST_LOAD_SHARE))
            constants = [
                Constant("v_b", joint, "rad/s", STRIBECK_GRID if joint in stribeck else (0.0,), True),
                Constant("d_s", joint, "rad", PRESLIDING_GRID if joint in presliding else (0.0,)),
            ]
            if joint in warm and joint in stribeck:
                constants.append(Constant("Q_10", joint, "1", Q_10_GRID))
            terms.append(cls(tuple(parameters), tuple(constants), dict(options)))
        return tuple(terms)

    @property
    def loaded(self) -> bool:
        """Whether the load on the gear adds to this joint's friction."""
        return len(self.parameters) == 3

    @property
    def depends(self) -> bool:
        """Friction that grows with the load needs the load."""
        return self.loaded

    def plausible(self, parameters: FloatArray, constants: Values) -> bool:
        """Friction falls from its static to its Coulomb level; a rise is a blurred reversal, or viscous."""
        return constants[0] == 0.0 or parameters[1] >= parameters[0]

    def columns(self, motion: Motion, constants: Values, background: Background | None) -> Columns:
        """Columns of f_c, f_b and mu."""
        row = motion.joints.index(self.parameters[0].joint)
        stribeck_velocity, distance, *ratio = constants
        width: float | FloatArray = stribeck_velocity
        if ratio and ratio[0] > 0:
            width = stribeck_velocity * ratio[0] ** (excess_temperature(motion, row) / 10.0)
        velocity = motion.velocity[:, row]
        speed = np.where(np.abs(velocity) > motion.speed_noise[row], np.abs(velocity), 0.0)
        sign = np.sign(velocity) * (speed > 0)
        # v_b = 0 is Coulomb friction at every speed: the static column is empty, f_b moves no torque.
        share = np.exp(-((velocity / width) ** 2)) if stribeck_velocity > 0 else np.zeros_like(sign)
        target = np.stack([sign, sign * share]).T
        coulomb, static = bristle_state(target, speed / motion.rate_hz, distance, motion.cyclic).T
        columns = [coulomb - static, static]
        if self.loaded:
            columns.append(np.zeros_like(coulomb) if background is None else coulomb * np.abs(background.load[:, row]))
        return {row: (list(range(len(columns))), np.stack(columns).T)}


@dataclass(frozen=True)
class ViscousFriction(Term):
    """The part of friction that grows with speed: k_v1 qd + k_v2 qd^2 + k_v3 qd^3.

    Options:
        quadratic: `even` (as printed in the paper), `odd` (qd |qd|), or `both` (to compare them: the odd one is then a
            parameter of its own); or one of the first two for each joint, {joint: form}.
        vacuum: true leaves k_v2 and k_v3 out (paper §2.2.2).
        held: {joint: [symbols]}, parameters of a joint that are zero and not estimated.
        fastest: {joint: rad/s}, largest speed at which the terms were identified. Beyond it k_v2 and k_v3 grow linearly
            with speed: a polynomial fitted below a speed says nothing about friction at three times that speed.
    """

    kind: ClassVar[str] = "viscous_friction"
    words: ClassVar[str] = "viscous friction k_v1, k_v2, k_v3"
    friction: ClassVar[bool] = True
    pointwise: ClassVar[bool] = True
    ODD: ClassVar[str] = "k_v2_odd"

    @classmethod
    def build(cls, arm: Arm, options: Mapping[str, Any]) -> tuple[Term, ...]:
        """One term for all joints."""
        quadratic = options.get("quadratic", "even")
        forms = set(quadratic.values()) if isinstance(quadratic, Mapping) else {quadratic}
        if not forms <= {"even", "odd", "both"} or (isinstance(quadratic, Mapping) and "both" in forms):
            raise UserError(f"quadratic friction is 'even' or 'odd', not {quadratic!r}")
        held, fastest = options.get("held", {}), options.get("fastest", {})
        for named in (quadratic if isinstance(quadratic, Mapping) else {}, held, fastest):
            chosen_joints(arm, tuple(named))
        if not all(np.isfinite(speed) and speed > 0 for speed in fastest.values()):
            raise UserError(f"viscous_friction: fastest is a positive speed for each joint, not {dict(fastest)!r}")
        orders = {"k_v1": 1} if options.get("vacuum") else {"k_v1": 1, "k_v2": 2, "k_v3": 3}
        if quadratic == "both":
            orders[cls.ODD] = 2
        units = {1: "N m s/rad", 2: "N m s^2/rad^2", 3: "N m s^3/rad^3"}
        parameters = tuple(
            Parameter(
                symbol,
                joint,
                units[order],
                dimension=(0, order, 0),
                held=symbol in held.get(joint, ()),
            )
            for joint in arm.joint_names
            for symbol, order in orders.items()
        )
        return (cls(parameters, options=dict(options)),)

    def is_odd(self, parameter: Parameter) -> bool:
        """Whether a quadratic term, qd |qd|, resists in both directions."""
        quadratic = self.options.get("quadratic", "even")
        form = quadratic.get(parameter.joint, "even") if isinstance(quadratic, Mapping) else quadratic
        return parameter.dimension[1] == 2 and (form == "odd" or parameter.symbol == self.ODD)

    def multiplied(self, parameter: Parameter) -> str:
        """What k_v2 or k_v3 is multiplied by, in words: a symbol alone does not say it. Empty of k_v1."""
        if not self.high_order(parameter):
            return ""
        power = "qd^3" if parameter.dimension[1] == 3 else "qd |qd|" if self.is_odd(parameter) else "qd^2"
        fastest = self.options.get("fastest", {}).get(parameter.joint)
        return f"times {power}" + (f", beyond {fastest:.3g} rad/s linear in speed" if fastest else "")

    @classmethod
    def high_order(cls, parameter: Parameter) -> bool:
        """Whether a parameter is k_v2, in either form, or k_v3."""
        return parameter.symbol in ("k_v2", cls.ODD, "k_v3")

    def columns(self, motion: Motion, constants: Values, background: Background | None) -> Columns:
        """Powers of each joint's own velocity."""
        rows: dict[int, tuple[list[int], list[FloatArray]]] = {}
        for index, parameter in enumerate(self.parameters):
            row = motion.joints.index(parameter.joint)
            velocity = motion.velocity[:, row]
            order = parameter.dimension[1]
            signed = velocity if order == 3 or self.is_odd(parameter) else np.abs(velocity)
            slower = np.minimum(np.abs(velocity), self.options.get("fastest", {}).get(parameter.joint, np.inf))
            indices, columns = rows.setdefault(row, ([], []))
            indices.append(index)
            columns.append(velocity if order == 1 else slower ** (order - 1) * signed)
        return {row: (indices, np.stack(columns, axis=1)) for row, (indices, columns) in rows.items()}
