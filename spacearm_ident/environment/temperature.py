"""How friction follows temperature: alpha from the steady-state torque over a temperature sweep (paper §2.2.2).

Least squares on

    F(v_g, T) = F_g + (alpha_c + alpha_v v_g) (T - T_0),        T_0 = 20 °C,

with a level F_g of its own for every speed v_g that was run, so that no law of friction over speed (Stribeck, powers
of speed) is assumed; alpha_v is there where speeds differ by a factor of two. f_c0 (and k_v1) come from the levels:
what the model's friction differs by, where there is a model, else a straight line over the speeds. Errors come from
the scatter of the points about the fit, intervals from Student's t.

The error of alpha falls as the sweep widens. A sweep that leaves more than `WANTED_SHARE` of the level a kelvin
uncertain, or spans less than `LEAST_SPAN_K`, is refused, with the span that would do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import t as student

from ..arrays import FloatArray
from ..dynamics.effects.friction import TemperatureFriction
from ..dynamics.friction import WARM_FROM
from ..dynamics.model import IdentifiedModel
from ..errors import UnfitDataError
from ..recording.recording import Recording
from ..signals.motion import Motion
from ..signals.prepare import require_joints
from ..tracking.rows import with_effects
from .plateaus import SAME_SPEED, FrictionPoint, find_plateaus, friction_points

WANTED_SHARE = 3e-3
"""Half width of the 95 % interval of alpha, as a share of the friction level, 1/K."""
LEAST_SPAN_K = 5.0
SPEED_RATIO = 2.0
LEAST_FREEDOM = 2
SCHEMA = "spacearm_ident/temperature/1"


@dataclass(frozen=True)
class Figure:
    """A value with its standard error and 95 % interval."""

    value: float
    standard_error: float
    half_width: float
    unit: str

    @property
    def interval(self) -> tuple[float, float]:
        """95 %."""
        return self.value - self.half_width, self.value + self.half_width


@dataclass(frozen=True)
class JointTemperature:
    """Friction of one joint over temperature.

    Attributes:
        alpha: dF_c/dT, N·m/K.
        alpha_v: dk_v1/dT, N·m·s/(rad·K); None where all speeds are alike.
        level: F at T_0 and the slowest speed, N·m.
        f_c0: Coulomb friction at T_0, N·m; None where neither a second speed nor a model tells it from viscosity.
        k_v1: Slope of the levels over speed; None with a model or with one speed.
        points: What was fitted.
        residual_Nm: Standard deviation of a point.
    """

    alpha: Figure
    alpha_v: Figure | None
    level: Figure
    f_c0: float | None
    k_v1: float | None
    points: tuple[FrictionPoint, ...]
    residual_Nm: float


@dataclass(frozen=True)
class TemperatureCalibration:
    """Result for an arm: joints fitted, joints refused with the reason, joints without temperature or steady runs."""

    joints: dict[str, JointTemperature]
    refused: dict[str, str]
    no_temperature: tuple[str, ...]
    no_runs: tuple[str, ...]


def calibrate_temperature(
    recordings: Sequence[Recording],
    joints: Sequence[str],
    model: IdentifiedModel | None = None,
    wanted_share: float = WANTED_SHARE,
) -> TemperatureCalibration:
    """Fit alpha of every joint.

    Args:
        recordings: Constant-velocity runs over a temperature sweep.
        joints: Names, in the model's order where there is one.
        model: Takes gravity out; without it, runs forth and back over the same positions do.
        wanted_share: Refuse a joint whose alpha is not known to this share of its friction level a kelvin.

    Raises:
        UserError: A recording lacks a joint.
        UnfitDataError: No joint can be fitted; the message says why and what to record.
    """
    fitted, refused, cold, idle = {}, {}, [], []
    for recording in recordings:
        require_joints(recording, joints)
    ordered = [recording.in_order(tuple(joints)) for recording in recordings]
    for joint in joints:
        points = [
            point
            for recording in ordered
            for point in friction_points(find_plateaus(recording, joint, model), model is not None)
        ]
        if not points:
            idle.append(joint)
            continue
        warm = [point for point in points if np.isfinite(point.temperature) and np.isfinite(point.friction_Nm)]
        if not warm:
            cold.append(joint)
            continue
        result = _fit(warm, model, joint)
        reason = result if isinstance(result, str) else _too_narrow(result, wanted_share)
        if reason is None and not isinstance(result, str):
            fitted[joint] = result
        else:
            refused[joint] = str(reason)
    if not fitted:
        raise UnfitDataError(_why_not(refused, cold, idle))
    return TemperatureCalibration(fitted, refused, tuple(cold), tuple(idle))


def _why_not(refused: dict[str, str], cold: Sequence[str], idle: Sequence[str]) -> str:
    if refused:
        joint, reason = next(iter(refused.items()))
        return f"no joint can be calibrated; {joint}: {reason}"
    if cold:
        return f"no temperature of {', '.join(cold)} in these bags: record /joint_temperatures with the runs"
    return (
        f"no steady run of {', '.join(idle)}: record each joint at constant speed forth and back through the same "
        "postures (spacearm excite --for temperature), or give --model"
    )


def _speed_groups(points: Sequence[FrictionPoint]) -> np.ndarray:
    """(N,) number of the speed and direction a point was taken at; speeds near the first of a group are one."""
    speeds = np.array([point.speed for point in points])
    groups, first, number = np.zeros(len(points), dtype=int), -1.0, -1
    for k in np.argsort(speeds):
        if first < 0 or speeds[k] > (1 + 2 * SAME_SPEED) * first:
            first, number = speeds[k], number + 1
        groups[k] = number
    ways = np.array([point.direction for point in points])
    return np.unique(np.column_stack([groups, ways]), axis=0, return_inverse=True)[1].ravel()


def _fit(points: Sequence[FrictionPoint], model: IdentifiedModel | None, joint: str) -> JointTemperature | str:
    """The fit, or why there is none."""
    groups = _speed_groups(points)
    speed = np.array([point.speed for point in points])
    warm = np.array([point.temperature for point in points]) - WARM_FROM
    friction = np.array([point.friction_Nm for point in points])
    centre = np.array([speed[groups == g].mean() for g in range(groups.max() + 1)])
    several = bool(centre.max() > SPEED_RATIO * centre.min())
    slopes = [warm, warm * speed] if several else [warm]
    matrix = np.column_stack([*slopes, groups[:, None] == np.arange(len(centre))]).astype(float)
    freedom = len(points) - matrix.shape[1]
    span = float(np.ptp(warm))
    if freedom < LEAST_FREEDOM or span < LEAST_SPAN_K:
        return (
            f"{len(points)} steady runs from {warm.min() + WARM_FROM:.1f} to {warm.max() + WARM_FROM:.1f} °C are too "
            f"few or too narrow: record at least {matrix.shape[1] + LEAST_FREEDOM} over {LEAST_SPAN_K:g} K or more"
        )
    values, _, rank, _ = np.linalg.lstsq(matrix, friction, rcond=1e-10)
    if rank < matrix.shape[1]:
        return "speed and temperature change together: run every speed at every temperature"
    scatter = float(np.sqrt(np.sum((friction - matrix @ values) ** 2) / freedom))
    errors = scatter * np.sqrt(np.diag(np.linalg.inv(matrix.T @ matrix)))
    factor = float(student.ppf(0.975, freedom))

    def figure(place: int, unit: str) -> Figure:
        return Figure(float(values[place]), float(errors[place]), factor * float(errors[place]), unit)

    levels = values[len(slopes) :]
    f_c0, k_v1 = _coulomb(levels, centre, several, model, joint)
    return JointTemperature(
        figure(0, "N m/K"),
        figure(1, "N m s/(rad K)") if several else None,
        figure(len(slopes), "N m"),
        f_c0,
        k_v1,
        tuple(points),
        scatter,
    )


def _coulomb(
    levels: FloatArray, speeds: FloatArray, several: bool, model: IdentifiedModel | None, joint: str
) -> tuple[float | None, float | None]:
    """f_c0 and k_v1 from the levels (g,) at T_0."""
    if model is not None:
        row = model.model.arm.joint_names.index(joint)
        both = np.concatenate([speeds, -speeds])
        still = np.zeros((len(both), len(model.model.arm.joints)))
        velocity = still.copy()
        velocity[:, row] = both
        # A second a sample: friction that builds up over a distance has done so.
        steady = Motion.free_of_noise(model.model.arm.joint_names, 1.0, still, velocity, still)
        names = [kind for kind in model.model.friction_kinds if kind != TemperatureFriction.kind]
        torque = model.torque(steady, names)[:, row] * np.sign(both)
        law = 0.5 * (torque[: len(speeds)] + torque[len(speeds) :])
        return model.value("f_c", joint) + float(np.mean(levels - law)), None
    if not several:
        return None, None
    slope, start = np.polyfit(speeds, levels, 1)
    return float(start), float(slope)


def _too_narrow(result: JointTemperature, wanted_share: float) -> str | None:
    """Why a sweep tells too little of alpha, and how wide it should be; None where it is wide enough."""
    wanted = wanted_share * abs(result.level.value)
    if result.alpha.half_width <= wanted:
        return None
    warm = [point.temperature for point in result.points]
    needed = (max(warm) - min(warm)) * result.alpha.half_width / wanted
    return (
        f"temperatures from {min(warm):.1f} to {max(warm):.1f} °C leave alpha uncertain by "
        f"±{result.alpha.half_width:.2g} N m/K: sweep {needed:.0f} K for ±{wanted:.2g}, or make more runs"
    )


def with_temperature(model: IdentifiedModel, calibration: TemperatureCalibration) -> IdentifiedModel:
    """The model with `temperature_friction` at the calibrated joints, and its friction levels as at T_0.

    f_b keeps its excess over f_c.

    Args:
        model: Its friction has f_c at every calibrated joint; terms of temperature that it lacks are added.
        calibration: Slopes alpha, and Coulomb friction at T_0; where that is None the levels of the model stay.
    """
    known = {parameter.name for parameter in model.model.parameters}
    places = []
    for joint, result in calibration.joints.items():
        wanted = {"f_c": "alpha_c", **({"k_v1": "alpha_v"} if result.alpha_v else {})}
        new = [level for level, symbol in wanted.items() if f"{symbol}[{joint}]" not in known]
        if new:
            places.append((TemperatureFriction.kind, {"joint": joint, "of": new}))
    wider = with_effects(model, places)
    values = wider.parameters.copy()
    numbers = {parameter.name: k for k, parameter in enumerate(wider.model.parameters)}
    for joint, result in calibration.joints.items():
        values[numbers[f"alpha_c[{joint}]"]] = result.alpha.value
        if result.alpha_v is not None:
            values[numbers[f"alpha_v[{joint}]"]] = result.alpha_v.value
        if result.f_c0 is not None:
            shift = result.f_c0 - values[numbers[f"f_c[{joint}]"]]
            values[numbers[f"f_c[{joint}]"]] += shift
            if f"f_b[{joint}]" in numbers:
                values[numbers[f"f_b[{joint}]"]] += shift
    return replace(wider, parameters=values)


def calibration_dict(calibration: TemperatureCalibration) -> dict[str, Any]:
    """Plain data of `temperature.json`."""

    def figure(item: Figure | None) -> dict[str, Any] | None:
        if item is None:
            return None
        return {
            "value": item.value,
            "standard_error": item.standard_error,
            "ci95": list(item.interval),
            "unit": item.unit,
        }

    return {
        "schema": SCHEMA,
        "T_0_degC": WARM_FROM,
        "joints": {
            joint: {
                "alpha": figure(result.alpha),
                "alpha_v": figure(result.alpha_v),
                "level_at_T_0": figure(result.level),
                "f_c0_Nm": result.f_c0,
                "k_v1_Nms_per_rad": result.k_v1,
                "residual_Nm": result.residual_Nm,
                "points": [
                    {
                        "speed_rad_s": point.speed,
                        "direction": point.direction,
                        "temperature_degC": point.temperature,
                        "friction_Nm": point.friction_Nm,
                    }
                    for point in result.points
                ],
            }
            for joint, result in calibration.joints.items()
        },
        "refused": calibration.refused,
        "no_temperature": list(calibration.no_temperature),
        "no_steady_runs": list(calibration.no_runs),
    }
