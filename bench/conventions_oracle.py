"""Whether a mistake shows in a recording at all: the criterion that marks a draw undeterminable.

Torque: the rigid-body model with every link's ten parameters, and dry friction, viscous friction, rotor inertia and an
offset a joint, is fitted by least squares around the CAD values, friction and rotor inertia not negative. What the
wrong recording costs more than the same recording without the mistake, the priors' part included, is a chi-square
difference: the noise is what the fit of the right one leaves, and one sample a second and joint counts as independent.
The criterion knows the right recording, which no check does; a mistake that it cannot see, no check can.

Torque in another unit: a scale of all torques would be absorbed by the masses, so here the torque of the CAD values is
compared with the recorded one; beyond a factor of `TOLD_SIZE` it tells.

Velocity and limits: positions that are no integral of the velocities, positions outside the URDF's limits, torques
above twice the URDF's, each where the right recording has none of it.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from conventions_arms import Array
from scipy.linalg import qr
from scipy.optimize import lsq_linear
from scipy.signal import butter, sosfiltfilt

from spacearm_ident.recording import Recording

ENOUGH = 10.0
"""Chi-square difference from which torque tells: a likelihood ratio of 150."""
TOLD_SIZE = 1.6
"""Ratio of torques that masses 20 % off, torque constants 10 % off and a tool that the URDF lacks do not explain."""
GRID_HZ = 100.0
CUTOFF_HZ = 4.0
KEPT_HZ = 5.0
INDEPENDENT_HZ = 1.0
"""Samples a second that count as independent: friction models err over strokes, not over samples."""
TRIM_S = 0.5
"""Left out at either end, where the filter has not settled."""
STANDSTILL = 0.01
"""rad/s at which dry friction turns round."""


class Oracle:
    """The criterion for one arm; `rough` widens the priors for a URDF that is not the recorded arm's CAD."""

    def __init__(self, urdf: str, right: Recording, gravity: Array, *, rough: bool) -> None:
        self.model = pin.buildModelFromXML(urdf)
        self.limit = np.where(self.model.effortLimit > 0, self.model.effortLimit, 1e3)
        self._centre, self._width = self._priors(rough)
        self.right = right
        self._seconds = right.time[-1] - 2 * TRIM_S
        self._noise = np.sqrt(np.mean(right.effort**2, axis=0)) * 0.05 + 1e-3
        for _ in range(2):
            rest = self._fit(right, gravity)[1]
            self._noise = np.maximum(rest, 0.01 * np.sqrt(np.mean(right.effort**2, axis=0)) + 1e-3)
        self.base = self._fit(right, gravity)[0]

    def _priors(self, rough: bool) -> tuple[Array, Array]:
        """Centre and standard deviation of every parameter, links first."""
        mass_share, centre_m = (0.3, 0.1) if rough else (0.15, 0.015)
        centre, width = [], []
        for inertia in list(self.model.inertias)[1:]:
            value = inertia.toDynamicParameters()
            mass, about = inertia.mass, abs(value[4:]).max() + inertia.mass * 0.05**2
            first = inertia.mass * centre_m + mass_share * np.abs(value[1:4])
            centre.append(value)
            width.append(np.concatenate([[mass_share * mass + 1e-3], first + 1e-4, np.full(6, 0.5 * about + 1e-4)]))
        n = self.model.nv
        inertia = np.diag(pin.crba(self.model, self.model.createData(), pin.neutral(self.model)))
        joint = [0.1 * self.limit, 0.1 * self.limit, 2.0 * inertia + 0.01, 0.02 * self.limit]
        return np.concatenate([*centre, np.zeros(4 * n)]), np.concatenate([*width, *joint])

    def excess(self, wrong: Recording, gravity: Array) -> float:
        """What `wrong` costs more than the right recording, chi-square, with gravity (3,) as the bag says."""
        return self._fit(wrong, gravity)[0] - self.base

    def told_size(self, wrong: Recording, gravity: Array) -> bool:
        """Whether torque is off the CAD values by more than they may be, and by more than in the right recording."""
        before, after = (abs(np.log(abs(self.size(recording, gravity)))) for recording in (self.right, wrong))
        return bool(after > max(before, np.log(TOLD_SIZE)))

    def size(self, recording: Recording, gravity: Array) -> float:
        """Recorded torque over that of the CAD values, friction, rotor inertia and offsets apart (least squares)."""
        matrix, torque = self._columns(recording, gravity)
        joint = 4 * self.model.nv
        rigid = matrix[:, :, :-joint] @ self._centre[:-joint]
        columns = np.column_stack([rigid.reshape(-1), matrix[:, :, -joint:].reshape(-1, joint)])
        return float(np.linalg.lstsq(columns, torque.reshape(-1))[0][0])

    def _columns(self, recording: Recording, gravity: Array) -> tuple[Array, Array]:
        """Regressor (samples, n, parameters), and torque (samples, n)."""
        q, v, a, torque = _signals(recording)
        n, (samples, _) = self.model.nv, q.shape
        self.model.gravity.linear = gravity
        data = self.model.createData()
        rigid = np.array([pin.computeJointTorqueRegressor(self.model, data, *row).copy() for row in zip(q, v, a)])
        own = np.einsum("ksi,ij->sikj", np.array([np.tanh(v / STANDSTILL), v, a, np.ones_like(v)]), np.eye(n))
        return np.concatenate([rigid, own.reshape(samples, n, 4 * n)], axis=2), torque

    def _fit(self, recording: Recording, gravity: Array) -> tuple[float, Array]:
        """Cost, and RMS residual (n,) N·m."""
        matrix, torque = self._columns(recording, gravity)
        samples, n = torque.shape
        weight = np.sqrt(min(1.0, self._seconds * INDEPENDENT_HZ / samples)) / self._noise
        left = torque - matrix @ self._centre
        rows = (weight[:, None] * matrix * self._width).reshape(samples * n, -1)
        stacked = np.column_stack([rows, (weight * left).reshape(-1)])
        compact = np.atleast_2d(qr(stacked, mode="r")[0][: stacked.shape[1]])
        count = rows.shape[1]
        lower = np.full(count, -np.inf)
        lower[count - 4 * n : count - n] = 0.0
        solved = lsq_linear(
            np.vstack([compact[:, :-1], np.eye(count)]),
            np.concatenate([compact[:, -1], np.zeros(count)]),
            bounds=(lower, np.inf),
            method="trf",
            tol=1e-8,
        )
        rest = left - matrix @ (self._width * solved.x)
        return 2.0 * float(solved.cost), np.sqrt(np.mean(rest**2, axis=0))

    def kinematics(self, wrong: Recording) -> list[str]:
        """Which of `velocity`, `limits` and `torque limits` tell, by the size of what the right one has not."""
        found = []
        before, after = (_velocity_mismatch(recording) for recording in (self.right, wrong))
        if np.any((after > 0.3) & (after > 3.0 * before)):
            found.append("velocity")
        before, after = (self._outside(recording) for recording in (self.right, wrong))
        if np.any((after > 0.05) & (after > before + 0.05)):
            found.append("limits")
        before, after = (np.abs(recording.effort).max(axis=0) / self.limit for recording in (self.right, wrong))
        if np.any((after > 2.0) & (after > 2.0 * before)):
            found.append("torque limits")
        return found

    def _outside(self, recording: Recording) -> Array:
        """How far each joint is outside its limits, rad."""
        q, model = recording.position, self.model
        above, below = (q - model.upperPositionLimit).max(axis=0), (model.lowerPositionLimit - q).max(axis=0)
        return np.asarray(np.maximum(above, below))


def _velocity_mismatch(recording: Recording) -> Array:
    """RMS of recorded velocity less differenced position over that of the larger; 0 where a joint rests."""
    if recording.velocity is None:
        return np.zeros(len(recording.joints))
    step = max(1, round(0.05 * recording.rate_hz))
    travel = recording.position[step:] - recording.position[:-step]
    mean = travel / (recording.time[step:] - recording.time[:-step])[:, None]
    said = recording.velocity[step // 2 : step // 2 + len(mean)]
    size = np.maximum(np.sqrt(np.mean(mean**2, axis=0)), np.sqrt(np.mean(said**2, axis=0)))
    return np.where(size > 0.02, np.sqrt(np.mean((mean - said) ** 2, axis=0)) / np.maximum(size, 1e-9), 0.0)


def _signals(recording: Recording) -> tuple[Array, Array, Array, Array]:
    """Position, velocity, acceleration, torque on a grid of `KEPT_HZ`, all through the same filter."""
    grid = np.arange(0.0, recording.time[-1], 1.0 / GRID_HZ)
    bands = butter(3, CUTOFF_HZ, fs=GRID_HZ, output="sos")
    q, torque = (
        sosfiltfilt(bands, np.column_stack([np.interp(grid, recording.time, c) for c in s.T]), axis=0)
        for s in (recording.position, recording.effort)
    )
    v = np.gradient(q, 1.0 / GRID_HZ, axis=0)
    a = np.gradient(v, 1.0 / GRID_HZ, axis=0)
    kept = slice(round(TRIM_S * GRID_HZ), len(grid) - round(TRIM_S * GRID_HZ), round(GRID_HZ / KEPT_HZ))
    return q[kept], v[kept], a[kept], torque[kept]
