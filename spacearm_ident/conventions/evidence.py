"""How well the arm of the URDF explains torque and motion under one hypothesis: a log marginal likelihood.

tau_j = g_j Y_j(q, qd, qdd) phi + f_c s + f_p (s - z) + k_v qd + J_m qdd + offset + e_j. The inertials phi have the CAD
values as mean and a relative standard deviation s that the data choose from a grid (the likelihood is summed over it);
a payload may be on the last link. The state z follows the sign s of the velocity over a presliding distance. The gains
g_j have mean 1 and standard deviation `GAIN_SD`. The error e_j is mostly what the model leaves out and therefore slow:
n_j rows with a correlation time of kappa_j rows count as n_j / kappa_j. Its size is unknown, expected near
`MODEL_ERROR` of the torque. Friction takes power from a joint and never gives any: the probability of that under the
posterior multiplies the likelihood, as does that of rotor inertias that are not negative, unless something else looks
like one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotri, dpotrs
from scipy.special import log_ndtr

from ..arrays import FloatArray
from ..dynamics.arm import Arm
from ..dynamics.regressor import regressor
from ..signals.base_motion import BaseMotion

CAD_SCALES = (0.05, 0.15, 0.5, 1.5)
"""Relative standard deviations of the CAD inertials that the data choose from."""
PAYLOAD_SHARE = 0.15
"""Standard deviation of an unknown payload's mass, of the arm's: rated payloads are 0.1 to 0.3 of an arm's mass."""
GAIN_SD = 0.1
"""Standard deviation of a gain: published torque constants are 8 to 10 % off (UR10e)."""
MODEL_ERROR, MODEL_ERROR_WEIGHT = 0.05, 6.0
"""Model error as a share of the joint's torque RMS before any data, and how many samples that belief counts for."""
RANK_TOLERANCE = 1e-7
"""Singular value, relative to the largest, below which a combination of inertials acts on no torque."""
STATIC_POSTURES = 25
"""Postures at which the torque that holds the arm still is compared with CAD's."""
LOADED_SHARE = 0.3
"""Joints whose gravity torque is below this share of the largest joint's may carry mostly payload."""
MASS_SD, MASS_LEAST = 0.3, -20.0
"""Standard deviation of the logarithm of a joint's gravity torque over CAD's (payload, CAD), and what it may cost."""
OWN = 5
"""Columns of a joint's own: Coulomb, presliding, viscous, rotor inertia, offset."""
FRICTION = 3
"""How many of them, the first, are friction."""
OWN_SD = (0.5, 0.5, 0.5, 0.3, 0.1)
"""Standard deviation of what each of them adds to a joint's torque, of its RMS, before any data."""
OFFSET_UNLOADED = 0.3
"""That of the offset where the joint carries little: a drive's offset does not get smaller with the load (Panda:
0.29 N·m at a joint whose torque is 0.24 RMS). At a joint that carries the arm, so wide an offset hides a wrong zero."""
SPRING_LIKE = 1e-3
"""Probability that what the model lacks at a joint, such as a spring, gives the rotor inertia any sign. Without it one
such joint outvotes the torque of all others (AIRBOT joint4: 17 standard errors below zero)."""
OWN_SPREAD = 0.5
"""Relative standard deviation of a joint's own parameters where they are known beforehand. As often they are as good as
not known, for friction of a simulation may be guessed: the likelihood is summed over both."""


def inertial_belief(arm: Arm, torque: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(10 n,) mean, spread and fixed part of the inertials; torque stands in for masses that are not given.

    Args:
        arm: With the inertials of its description.
        torque: (n,) RMS, N·m.

    Returns:
        Mean; standard deviation for a scale of 1, as large as the inertials themselves; and one that is there at every
        scale, of a payload at the last link. In the order and units of the inertial parameters.
    """
    n = len(arm.joints)
    lengths = [float(np.linalg.norm(joint.translation)) for joint in arm.joints]
    length = float(np.median([one for one in lengths if one > 0.01] or [0.3]))
    masses = np.array([joint.inertial[0] for joint in arm.joints])
    if not masses.sum() > 0:
        masses = np.full(n, float(torque.max()) / (9.81 * length * n))
    least = 0.1 * masses.mean()
    mean, spread, fixed = np.zeros((3, n, 10))
    for k, joint in enumerate(arm.joints):
        mass = max(float(masses[k]), least)
        moment = max(float(np.linalg.norm(joint.inertial[1:4])), 0.5 * mass * length)
        inertia = max(float(joint.inertial[4] + joint.inertial[6] + joint.inertial[9]) / 2, 0.25 * mass * length**2)
        mean[k] = joint.inertial
        spread[k] = [mass, *(moment,) * 3, *(inertia,) * 6]
    load = PAYLOAD_SHARE * float(masses.sum())
    fixed[-1] = [load, *(0.5 * load * length,) * 3, *(0.25 * load * length**2,) * 6]
    return mean.ravel(), spread.ravel(), fixed.ravel()


@dataclass(frozen=True)
class ArmMotion:
    """Motion of the URDF's joints under one hypothesis.

    Attributes:
        position, velocity, acceleration, direction, unbuilt, moving: (M, n) as of `Rows`, corrected.
        gravity: (3,) m/s^2, base frame.
        base: How the base moves; None: not at all.
    """

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    direction: FloatArray
    unbuilt: FloatArray
    moving: np.ndarray
    gravity: FloatArray
    base: BaseMotion | None = None


@dataclass(frozen=True)
class Measured:
    """Torque under one hypothesis.

    Attributes:
        torque: (M, n) N·m.
        counts: (n,) how many independent samples each joint's torque counts for.
        gain_sd: (n,) standard deviation of the logarithm of each joint's gain.
        common_gain_sd: The same of a gain that all joints share; 0: none.
        payload_kg: Standard deviation of the mass of a body on the last link, kg; 0: `PAYLOAD_SHARE` of the arm's.
    """

    torque: FloatArray
    counts: FloatArray
    gain_sd: FloatArray
    common_gain_sd: float = 0.0
    payload_kg: float = 0.0


@dataclass(frozen=True)
class Evidence:
    """What came of it.

    Attributes:
        log_likelihood: Marginal, effective samples only.
        scale: CAD scale that the data prefer.
        gains: (n,) most probable gains.
        gain_errors: (n,) standard errors of their logarithms.
        parameters: (p,) posterior mean at that scale.
        precision: (p, p) inverse of their posterior covariance.
        weight: (n,) of a row's squared residual: effective samples a row over the error's variance, 1/(N·m)^2.
        body: (10,) most probable inertials of a body on the last link about its joint; None where none was asked for.
        body_kg_error: Standard error of its mass, kg.
    """

    log_likelihood: float
    scale: float
    gains: FloatArray
    gain_errors: FloatArray
    parameters: FloatArray
    precision: FloatArray
    weight: FloatArray
    body: FloatArray | None = None
    body_kg_error: float = 0.0


class Frame:
    """What all hypotheses about an arm share: the combinations of inertials that any motion can reveal.

    The joint-torque regressor has fewer independent columns than inertials whatever the motion (Gautier 1991): only
    their combinations `basis.T @ (phi / unit)` act. The basis is orthonormal, found on random motions under random
    gravity, so that it holds for any mounting of the base; of a base that moves, on random motions of it as well.

    Attributes:
        own: (n, OWN) what is known of the joints' own parameters, SI; zero where nothing is.
    """

    def __init__(
        self, arm: Arm, torque: FloatArray, own: FloatArray | None = None, *, base_moves: bool = False
    ) -> None:
        """Find the basis.

        Args:
            arm: With CAD inertials.
            torque: (n,) RMS of each joint.
            own: As the attribute; None: nothing is known.
            base_moves: Whether the base moves.
        """
        self.arm = arm
        self.own = np.zeros((len(arm.joints), OWN)) if own is None else own
        self.mean, self.spread, self.fixed = inertial_belief(arm, torque)
        self.unit = self.spread
        rng = np.random.default_rng(0)
        n = len(arm.joints)
        blocks = []
        for vector in np.vstack([np.eye(3) * 9.81, arm.gravity]):
            q, qd, qdd = rng.uniform(-2.0, 2.0, (3, 4 * n + 8, n))
            base = BaseMotion(*rng.uniform(-2.0, 2.0, (3, 4 * n + 8, 3))) if base_moves else None
            blocks.append(regressor(arm.with_gravity(vector), q, qd, qdd, base).reshape(-1, 10 * n) * self.unit)
        _, sizes, directions = np.linalg.svd(np.vstack(blocks), full_matrices=False)
        self.basis = directions[sizes > RANK_TOLERANCE * sizes[0]].T
        self._beliefs: dict[tuple[float, float], tuple[FloatArray, float]] = {}

    @cached_property
    def rough(self) -> bool:
        """Whether the URDF's inertials are placeholders: none, or every centre of mass in its joint's origin."""
        return not any(np.abs(joint.inertial[1:4]).max() > 1e-6 for joint in self.arm.joints)

    @cached_property
    def centre(self) -> FloatArray:
        """(r,) combinations of the CAD inertials."""
        return np.asarray(self.basis.T @ (self.mean / self.unit))

    def belief(self, scale: float, payload_kg: float = 0.0) -> tuple[FloatArray, float]:
        """Precision (r, r) of the combinations at a CAD scale, and half the logarithm of its determinant.

        Args:
            scale: Relative standard deviation of the CAD inertials.
            payload_kg: As of `Measured`.
        """
        key = scale, payload_kg
        if key not in self._beliefs:
            variance = ((scale * self.spread) ** 2 + self._payload(payload_kg) ** 2) / self.unit**2
            covariance = self.basis.T @ (variance[:, None] * self.basis)
            self._beliefs[key] = np.linalg.inv(covariance), -0.5 * float(np.linalg.slogdet(covariance)[1])
        return self._beliefs[key]

    def _payload(self, payload_kg: float) -> FloatArray:
        """(10 n,) standard deviations of what a payload adds to the inertials."""
        usual = float(self.fixed[-10])
        return self.fixed * (max(payload_kg, usual) / usual)

    def body(
        self, scale: float, payload_kg: float, combinations: FloatArray, covariance: FloatArray
    ) -> tuple[FloatArray, float]:
        """Most probable inertials (10,) of the body on the last link, and the standard error of its mass, kg.

        What the data say of the combinations is shared between CAD's error and the body as their variances are.

        Args:
            scale: As of `belief`.
            payload_kg: As of `belief`.
            combinations: (r,) posterior mean.
            covariance: (r, r) of it.
        """
        variance = self._payload(payload_kg)[-10:] ** 2
        along = (variance / self.unit[-10:])[:, None] * self.basis[-10:]
        share = along @ self.belief(scale, payload_kg)[0]
        mass = float(variance[0] - share[0] @ along[0] + share[0] @ covariance @ share[0])
        return share @ (combinations - self.centre), float(np.sqrt(max(mass, 0.0)))

    def inertials(self, combinations: FloatArray) -> FloatArray:
        """(n, 10) inertials that give these combinations (r,)."""
        return np.asarray((self.unit * (self.basis @ combinations)).reshape(-1, 10))


class Design:
    """Columns and normal matrices of one motion; of every joint the r of the rigid arm, then its `OWN`.

    Attributes:
        columns: (n, M, r + OWN), zero where the joint stands still.
        grams: (n, r + OWN, r + OWN).
        rows: (n,) rows in which each joint moves.
    """

    def __init__(self, frame: Frame, motion: ArmMotion) -> None:
        arm = frame.arm.with_gravity(motion.gravity)
        rigid = regressor(arm, motion.position, motion.velocity, motion.acceleration, motion.base)
        one = np.ones_like(motion.position)
        signals = (motion.direction, motion.unbuilt, motion.velocity, motion.acceleration, one)
        columns = np.concatenate([(rigid * frame.unit) @ frame.basis, np.stack(signals, axis=2)], axis=2)
        self.frame, self.motion, self.rigid = frame, motion, frame.basis.shape[1]
        self.columns = np.ascontiguousarray((columns * motion.moving[:, :, None]).transpose(1, 0, 2))
        self.grams = self.columns.transpose(0, 2, 1) @ self.columns
        self.rows = motion.moving.sum(axis=0)

    @cached_property
    def static(self) -> FloatArray:
        """(n, k, r) columns of the torque that holds the arm still at some of its postures."""
        postures = self.motion.position[:: max(1, len(self.motion.position) // STATIC_POSTURES)]
        still = np.zeros_like(postures)
        rigid = regressor(self.frame.arm.with_gravity(self.motion.gravity), postures, still, still)
        return np.asarray(((rigid * self.frame.unit) @ self.frame.basis).transpose(1, 0, 2))

    @cached_property
    def loaded(self) -> np.ndarray:
        """(n,) whether CAD's gravity torque is a large part of what the joint carries: no payload would be more."""
        size = rms((self.static @ self.frame.centre).T)
        return np.asarray((size > LOADED_SHARE * size.max()) & (size > 1e-6))

    def mass_ratios(self, evidence: Evidence) -> FloatArray:
        """(n,) torque that holds the arm still without a body it holds, over CAD's; NaN where that is small."""
        combinations = evidence.parameters[: self.rigid]
        if evidence.body is not None:
            combinations = combinations - self.frame.basis[-10:].T @ (evidence.body / self.frame.unit[-10:])
        cad, found = self.static @ self.frame.centre, self.static @ combinations
        ratios = np.sum(cad * found, axis=1) / np.maximum(np.sum(cad**2, axis=1), 1e-12)
        return np.where(self.loaded, ratios, np.nan)

    def times_cad(self, joint: int, torque: FloatArray) -> tuple[float, FloatArray]:
        """The factor on the CAD inertials' torque that fits a joint's torque best beside its own parameters.

        Args:
            joint: Its number, in the arm's order.
            torque: (M,) N·m; zero where the joint stands still, as the columns are.

        Returns:
            The factor, and what both leave (M,), N·m.
        """
        columns = self.columns[joint]
        whole = np.column_stack([columns[:, : self.rigid] @ self.frame.centre, columns[:, self.rigid :]])
        size = np.linalg.norm(whole, axis=0) + 1e-12
        values = np.linalg.lstsq(whole / size, torque, rcond=1e-8)[0] / size
        return float(values[0]), torque - whole @ values

    def own_belief(self, torque: FloatArray, known: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean (n, OWN) and inverse variances of the joints' own parameters.

        Args:
            torque: (n,) RMS.
            known: (n, OWN) what is known of them; zero: nothing.
        """
        speed, push = rms(self.motion.velocity) + 1e-9, rms(self.motion.acceleration) + 1e-9
        size = np.stack([torque, torque, torque / speed, torque / push, torque], axis=1)
        deviation = size * OWN_SD
        deviation[:, -1] = torque * np.where(self.loaded, OWN_SD[-1], OFFSET_UNLOADED)
        deviation = np.where(known != 0.0, OWN_SPREAD * np.abs(known), deviation)
        return known, np.asarray(1.0 / (deviation + 1e-12) ** 2)


def rms(signal: FloatArray) -> FloatArray:
    """(n,) root mean square of each column."""
    return np.asarray(np.sqrt(np.mean(signal**2, axis=0)))


def weigh(design: Design, measured: Measured, scales: Sequence[float] = CAD_SCALES, iterations: int = 8) -> Evidence:
    """The evidence of a motion and torque, summed over CAD scales.

    Args:
        design: Columns of the motion.
        measured: Torque.
        scales: CAD scales.
        iterations: Alternations between parameters, gains and error size, for every scale.
    """
    problem = _Problem(design, measured)
    found = [problem.at_scale(scale, iterations, own) for scale in scales for own in problem.own_beliefs]
    logs = np.array([one.log_likelihood for one in found])
    total = float(np.logaddexp.reduce(logs) - np.log(len(logs)))
    return replace(found[int(np.argmax(logs))], log_likelihood=total)


@dataclass
class _Sums:
    """Per joint: squared residual, what the parameters' spread adds to it, and moments of the rigid part."""

    lost: FloatArray
    spread: FloatArray
    rigid_squared: FloatArray
    rigid_product: FloatArray


@dataclass(frozen=True)
class _OwnBelief:
    """Mean and inverse variances (n, OWN) of the joints' own parameters, and the log probability of their signs."""

    mean: FloatArray
    precision: FloatArray
    signs: float


class _Problem:
    """Alternation between parameters, gains and error size (expectation maximisation) at one CAD scale.

    The unknowns are the r combinations of inertials, then `OWN` of every joint.
    """

    def __init__(self, design: Design, measured: Measured) -> None:
        self.design, self.measured = design, measured
        torque = np.where(design.motion.moving, measured.torque, 0.0).T
        self.products = np.einsum("jmc,jm->jc", design.columns, torque, optimize=True)
        self.squares = np.sum(torque**2, axis=1)
        self.rows = np.maximum(design.rows, 1)
        size = rms(measured.torque)
        nothing = np.zeros_like(design.frame.own)
        beliefs = [nothing, design.frame.own] if design.frame.own.any() else [nothing]
        self.floor = MODEL_ERROR * size + 1e-9
        self.first_gains = self._first_gains(torque)
        self.signs = _Signs(design)
        self.own_beliefs = []
        for known in beliefs:
            mean, precision = design.own_belief(size, known)
            signs = self.signs.log_probability(mean.ravel(), np.diag(1.0 / precision.ravel()))
            self.own_beliefs.append(_OwnBelief(mean, precision, signs))

    def _first_gains(self, torque: FloatArray) -> FloatArray:
        """(n,) gains that CAD and free friction fit best where gains are wide open; 1 elsewhere."""
        design, measured = self.design, self.measured
        gains = np.ones(len(torque))
        for j in range(len(torque)):
            if (measured.gain_sd[j] <= GAIN_SD and not measured.common_gain_sd) or not design.rows[j]:
                continue
            share = design.times_cad(j, torque[j])[0]
            gains[j] = share if share > 1e-6 else 1.0
        return np.full(len(gains), np.exp(np.median(np.log(gains)))) if measured.common_gain_sd else gains

    def at_scale(self, scale: float, iterations: int, own: _OwnBelief) -> Evidence:
        """The evidence at one CAD scale and one belief about the joints' own parameters."""
        counts, r = self.measured.counts, self.design.rigid
        rigid_precision, half_log = self.design.frame.belief(scale, self.measured.payload_kg)
        prior = np.diag(np.append(np.zeros(r), own.precision.ravel()))
        prior[:r, :r] = rigid_precision
        half_log += 0.5 * float(np.log(own.precision).sum())
        prior_mean = np.append(self.design.frame.centre, own.mean)
        better, next_weight = self.first_gains, counts / self.rows / self.floor**2
        diagonal = np.arange(len(prior))
        for _ in range(iterations):
            gains, weight = better, next_weight
            matrix, vector = self._system(prior, prior @ prior_mean, gains, weight)
            factor, broken = dpotrf(matrix, lower=1)
            if broken:
                # Gains that run away: no explanation.
                return Evidence(-np.inf, scale, gains, np.ones_like(gains), prior_mean, prior, weight)
            mean = dpotrs(factor, vector, lower=1)[0]
            half = dpotri(factor, lower=1)[0]
            covariance = half + half.T
            covariance[diagonal, diagonal] *= 0.5
            sums = self._sums(mean, covariance, gains)
            variance = (sums.lost + sums.spread) * counts / self.rows + MODEL_ERROR_WEIGHT * self.floor**2
            inverse = (counts + MODEL_ERROR_WEIGHT) / variance
            next_weight = inverse * counts / self.rows
            better = self._better_gains(gains, next_weight * sums.rigid_squared, next_weight * sums.rigid_product)
        off = mean - prior_mean
        value = half_log - float(np.log(np.diag(factor)).sum())
        value += 0.5 * float(np.sum(counts * np.log(inverse) - next_weight * sums.lost) - off @ prior @ off)
        size = inverse * self.floor**2
        value += 0.5 * MODEL_ERROR_WEIGHT * float(np.sum(np.log(size) - size))
        gain_value, gain_errors = self._gain_evidence(gains, next_weight * sums.rigid_squared)
        value += gain_value + self.signs.log_probability(mean[r:], covariance[r:, r:]) - own.signs
        found = Evidence(value, scale, gains, gain_errors, mean, matrix, weight)
        return self._with_body(found, covariance[:r, :r]) if self.measured.payload_kg else found

    def _with_body(self, found: Evidence, covariance: FloatArray) -> Evidence:
        """The same with the body on the last link, and the probability that its mass is positive beside one half."""
        frame, payload_kg = self.design.frame, self.measured.payload_kg
        body, error = frame.body(found.scale, payload_kg, found.parameters[: self.design.rigid], covariance)
        positive = float(log_ndtr(body[0] / max(error, 1e-9)) + np.log(2.0))
        return replace(found, log_likelihood=found.log_likelihood + positive, body=body, body_kg_error=error)

    def _system(
        self, prior: FloatArray, pull: FloatArray, gains: FloatArray, weight: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Normal matrix and vector of prior and data."""
        r, n = self.design.rigid, len(gains)
        matrix, vector = prior.copy(), pull.copy()
        grams = weight[:, None, None] * self.design.grams
        matrix[:r, :r] += np.tensordot(gains**2, grams[:, :r, :r], axes=1)
        cross = gains[:, None, None] * grams[:, :r, r:]
        matrix[:r, r:] += cross.transpose(1, 0, 2).reshape(r, -1)
        matrix[r:, :r] = matrix[:r, r:].T
        for j in range(n):
            own = slice(r + OWN * j, r + OWN * (j + 1))
            matrix[own, own] += grams[j, r:, r:]
        vector[:r] += (weight * gains) @ self.products[:, :r]
        vector[r:] += (weight[:, None] * self.products[:, r:]).ravel()
        return matrix, vector

    def _sums(self, mean: FloatArray, covariance: FloatArray, gains: FloatArray) -> _Sums:
        """Sums over rows under a posterior."""
        r, n = self.design.rigid, len(gains)
        grams = self.design.grams
        own = np.stack([covariance[r + OWN * j : r + OWN * (j + 1), r + OWN * j : r + OWN * (j + 1)] for j in range(n)])
        cross = covariance[:r, r:].reshape(r, n, OWN).transpose(1, 0, 2)
        x, y = mean[:r], mean[r:].reshape(n, OWN)
        rigid_spread = np.tensordot(grams[:, :r, :r], covariance[:r, :r], axes=2)
        cross_spread = np.sum(grams[:, :r, r:] * cross, axis=(1, 2))
        own_spread = np.sum(grams[:, r:, r:] * own, axis=(1, 2))
        rigid_square = grams[:, :r, :r] @ x @ x
        cross_square = np.sum((x @ grams[:, :r, r:]) * y, axis=1)
        own_square = np.sum((y[:, None, :] @ grams[:, r:, r:])[:, 0] * y, axis=1)
        along = self.products[:, :r] @ x
        lost = self.squares - 2 * (gains * along + np.sum(self.products[:, r:] * y, axis=1))
        lost += gains**2 * rigid_square + 2 * gains * cross_square + own_square
        spread = gains**2 * rigid_spread + 2 * gains * cross_spread + own_spread
        return _Sums(np.maximum(lost, 0.0), spread, rigid_square + rigid_spread, along - cross_square - cross_spread)

    def _better_gains(self, gains: FloatArray, squared: FloatArray, product: FloatArray) -> FloatArray:
        """One Newton step on the logarithms of the gains."""
        logs, common = np.log(gains), self.measured.common_gain_sd
        slope, curvature = gains * product - gains**2 * squared, gains**2 * squared
        if common:
            step = (slope.sum() - logs[0] / common**2) / (curvature.sum() + 1 / common**2)
            return np.asarray(np.exp(logs + np.clip(step, -1.0, 1.0)))
        spread = self.measured.gain_sd
        step = (slope - logs / spread**2) / (curvature + 1 / spread**2)
        return np.asarray(np.exp(logs + np.clip(step, -1.0, 1.0)))

    def _gain_evidence(self, gains: FloatArray, squared: FloatArray) -> tuple[float, FloatArray]:
        """Log of prior times posterior width of the gains (Laplace), and the widths (n,)."""
        logs, common, curvature = np.log(gains), self.measured.common_gain_sd, gains**2 * squared
        if common:
            width = 1.0 / np.sqrt(curvature.sum() + 1 / common**2)
            return float(np.log(width / common) - 0.5 * (logs[0] / common) ** 2), np.full(len(gains), width)
        spread = self.measured.gain_sd
        widths = 1.0 / np.sqrt(curvature + 1 / spread**2)
        return float(np.sum(np.log(widths / spread) - 0.5 * (logs / spread) ** 2)), widths


class _Signs:
    """Friction takes power from a joint, and rotors have inertia."""

    def __init__(self, design: Design) -> None:
        self.moves = design.rows > 0
        columns = design.columns[:, :, design.rigid : design.rigid + FRICTION]
        rows = np.maximum(design.rows, 1)
        self.power = np.einsum("mj,jmc->jc", design.motion.velocity, columns) / rows[:, None]

    def log_probability(self, own: FloatArray, covariance: FloatArray) -> float:
        """Log of the probability of both at every joint, own parameters (n OWN,) being known so well."""
        total = 0.0
        for j in np.flatnonzero(self.moves):
            first, power = OWN * j, self.power[j]
            friction = slice(first, first + FRICTION)
            lost = power @ own[friction] / np.sqrt(power @ covariance[friction, friction] @ power)
            rotor = first + FRICTION
            inertia = own[rotor] / np.sqrt(covariance[rotor, rotor])
            total += float(log_ndtr(lost) + np.logaddexp(log_ndtr(inertia), np.log(SPRING_LIKE)))
        return total


def mass_likelihood(design: Design, evidence: Evidence) -> float:
    """Log-likelihood that all masses together are off CAD as much as they are; 0 where CAD says nothing of them.

    Args:
        design: Columns of the joints under a setup.
        evidence: The posterior under that setup.
    """
    if design.frame.rough:
        return 0.0
    ratios = design.mass_ratios(evidence)
    return float(log_mass(ratios[np.isfinite(ratios)]).sum())


def log_mass(ratios: FloatArray) -> FloatArray:
    """Log-likelihood of masses that are so many times CAD's, `MASS_LEAST` at least; of the shape of `ratios`."""
    off = np.log(np.clip(ratios, 1e-3, 1e3)) / MASS_SD
    return np.asarray(np.maximum(-0.5 * off**2, MASS_LEAST))


def predicted(design: Design, evidence: Evidence) -> FloatArray:
    """(M, n) torque under the posterior mean, N·m; zero where a joint stands still.

    Args:
        design: Columns of the joints under a setup.
        evidence: The posterior under that setup.
    """
    r = design.rigid
    own = evidence.parameters[r:].reshape(len(design.columns), OWN)
    rigid = design.columns[:, :, :r] @ evidence.parameters[:r]
    return np.asarray((evidence.gains[:, None] * rigid + np.einsum("jmc,jc->jm", design.columns[:, :, r:], own)).T)
