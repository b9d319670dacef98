"""Units of a log's positions, velocities and effort: as told or written, tested by what the arm makes of the numbers.

Positions by the URDF's limits and by weight, velocities by their factor to the derivative of the positions, effort by
the weight of the CAD's arm. A unit that is written and that the numbers contradict is a question.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..arrays import FloatArray
from ..dynamics.effort_limit import BEYOND_TORQUE
from ..errors import UserError
from ..recording.corrections import JointCorrection
from ..recording.log_mapping import CURRENT_UNITS, TORQUE_UNITS, UNITS
from .groups import Group
from .search import Search
from .signals import DERIVATIVE, LOADED, derivative_of, weight_of
from .words import CURRENT

UNIT_OFF = 0.1
"""Relative error of a measured factor between two units that still is one of them: they are apart by 5 or more."""
BETTER = 0.8
"""Ratio of variances left from which one of two units explains the weight better: with 100 independent rows, fewer than
any usable log has, exp(-50 ln 0.8) is 10^5 to one."""
PAST_LIMIT = 1.1
"""How far past the URDF's limits positions may go, as a factor on the range: zeros are off, and limits are rounded."""
LIKE_WEIGHT = (0.5, 2.0)
"""Slopes of effort on the CAD's weight that say N m: CAD masses are within a factor of two; a joint torque a unit of
another quantity would have to be, at every loaded joint."""
EFFORT_ANSWER = "effort_unit=" + "|".join(repr(unit) if " " in unit else unit for unit in UNITS["effort"])
"""Units of effort that there are to choose from."""


def position_unit_of(log: Search, chosen: Mapping[str, Group]) -> str:
    """Unit of the positions: as told or written, unless the limits forbid it; else as limits and weight have it.

    Args:
        log: The search.
        chosen: Signal -> group; effort, where it is known, decides between units that fit the limits.

    Returns:
        One of `UNITS["position"]`; "rad" while it is open.

    Raises:
        UserError: The unit told is none of positions.
    """
    group = chosen["position"]
    values = group.values(log.table)
    told = log.answers.get("position_unit")
    if told is not None:
        return _known_unit(log, "position", told, group)
    sizes: dict[str, float] = {unit: size for unit, size in UNITS["position"].items() if unit != "counts"}
    fitting = [unit for unit, size in sizes.items() if _within_limits(log, values * log.scale(size))]
    possible = [unit for unit in fitting if unit in ("rad", "deg")]
    if group.unit is not None:
        if group.unit == "counts":
            log.ask(
                f"{group.name} is in counts: write counts_per_turn of each joint into a mapping file",
                "position=NAME",
            )
        elif group.unit not in fitting:
            motor = ""
            if group.motor_side:
                motor = " (of the motors? the position_scale of each joint in the arm YAML's corrections mends it)"
            log.ask(
                f"{group.name} says {group.unit}, but goes beyond the URDF's limits so{motor}",
                f"position_unit={'|'.join(sizes)}",
            )
        else:
            log.tell("position", group.name, group.unit, "written, within the limits")
        return group.unit
    if len(possible) > 1:
        possible = _lighter(log, values, chosen.get("effort"), possible)
        why = "the effort follows the weight of the CAD's arm only so"
    else:
        why = "only so within the URDF's limits"
    if len(possible) != 1:
        log.ask(f"{group.name}: rad or deg fit the limits equally", "position_unit=rad|deg")
        return "rad"
    log.tell("position", group.name, possible[0], why)
    return possible[0]


def _within_limits(log: Search, angle: FloatArray) -> bool:
    """Whether positions (N, n), rad, stay within the URDF's limits; without limits, within two turns.

    What the arm's corrections do to a position later is done to it here.
    """
    names = log.arm.joint_names
    known = [log.arm.corrections.joints.get(name, JointCorrection()) for name in names]
    taken = [one.position_from if one.position_from in names else name for name, one in zip(names, known)]
    source = [names.index(name) for name in taken]
    offset, scale = (
        np.array([getattr(one, key) for one in known]) for key in ("position_offset_rad", "position_scale")
    )
    lowest, highest = np.nanpercentile(angle[:, source] * scale + offset, (0.5, 99.5), axis=0)
    lower = np.array([joint.lower if np.isfinite(joint.lower) else -4 * np.pi for joint in log.arm.joints])
    upper = np.array([joint.upper if np.isfinite(joint.upper) else 4 * np.pi for joint in log.arm.joints])
    slack = (PAST_LIMIT - 1.0) * (upper - lower)
    return bool(np.all(lowest >= lower - slack) and np.all(highest <= upper + slack))


def _lighter(log: Search, values: FloatArray, effort: Group | None, units: list[str]) -> list[str]:
    """The unit in which effort follows the weight clearly better; all where none does."""
    if effort is None:
        return units
    left = {}
    for unit in units:
        fit = weight_of(log.arm, values * log.scale(UNITS["position"][unit]), effort.values(log.table))
        left[unit] = float(np.prod(fit.left))
    best = min(left, key=lambda unit: left[unit])
    return [best] if all(left[best] < BETTER * left[unit] for unit in units if unit != best) else units


def velocity_unit_of(log: Search, group: Group, position: FloatArray, seconds: FloatArray) -> str:
    """Unit of the velocities, by their factor to the derivative of the positions.

    Args:
        log: The search.
        group: The velocities.
        position: (N, n) rad or m.
        seconds: (N,) s, or row numbers while the rate is open.

    Returns:
        One of `UNITS["velocity"]`; as written, else "rad/s", while it is open.

    Raises:
        UserError: The unit told is none of velocities.
    """
    told = log.answers.get("velocity_unit")
    if told is not None:
        return _known_unit(log, "velocity", told, group)
    values = group.values(log.table)
    window = log.window(seconds)
    slopes = [derivative_of(position[:, k], values[:, k], seconds, window) for k in range(values.shape[1])]
    follow = [slope.factor for slope in slopes if slope is not None and abs(slope.correlation) > DERIVATIVE]
    timed = not any("rows a second" in question for question in log.found.questions)
    factor = float(np.median(np.abs(follow))) if follow and timed else float("nan")
    fitting = [unit for unit, size in UNITS["velocity"].items() if abs(factor * size - 1.0) < UNIT_OFF]
    if group.unit is not None and (not fitting or group.unit in fitting):
        why = f"written; {factor * UNITS['velocity'][group.unit]:.3g} times the positions' derivative"
        log.tell("velocity", group.name, group.unit, why if follow else "written")
        return group.unit
    if len(fitting) == 1 and group.unit is None:
        why = f"{factor:.4g} times the derivative of the positions"
        log.tell("velocity", group.name, fitting[0], why)
        return fitting[0]
    if timed:
        what = f"says {group.unit} and" if group.unit else "does not say its unit and"
        measured = (
            f"is {factor:.4g} times the derivative of the positions" if follow else "does not follow the positions"
        )
        log.ask(f"{group.name} {what} {measured}", "velocity_unit=rad/s|deg/s|rpm")
    return group.unit or "rad/s"


def effort_unit_of(log: Search, group: Group, position: FloatArray) -> tuple[str, dict[str, float]]:
    """Unit of the effort, and what makes it torque where the arm does not know it.

    Args:
        log: The search.
        group: The effort.
        position: (N, n) rad or m.

    Returns:
        One of `UNITS["effort"]` ("N m" while it is open), and joint -> N·m for each A, or at 100 %.

    Raises:
        UserError: The unit told is none of effort.
    """
    unit = log.answers.get("effort_unit") or group.unit
    if unit is None:
        unit = _torque_by_weight(log, group, position)
        if unit is None:
            return "N m", {}
    else:
        _known_unit(log, "effort", unit, group)
        why = "told" if "effort_unit" in log.answers else "written"
        log.tell("effort", group.name, unit, why)
    if unit in TORQUE_UNITS:
        _require_possible(log, group, unit)
        return unit, {}
    return unit, _constants(log, group, unit)


def _torque_by_weight(log: Search, group: Group, position: FloatArray) -> str | None:
    """The unit of torque in which the effort is the arm's weight; None where none is, which is asked."""
    if group.quantity != CURRENT:
        fit = weight_of(log.arm, position, group.values(log.table))
        loaded = np.abs(fit.correlation) > LOADED
        for unit, size in TORQUE_UNITS.items():
            slopes = np.abs(fit.slope[loaded]) * size
            if loaded.any() and np.all((slopes > LIKE_WEIGHT[0]) & (slopes < LIKE_WEIGHT[1])):
                why = f"{np.median(slopes):.2g} times the weight of the CAD's arm"
                log.tell("effort", group.name, unit, why)
                return unit
    log.ask(
        f"{group.name}: the unit is not written, and the weight of the arm does not decide it",
        EFFORT_ANSWER,
    )
    return None


def _require_possible(log: Search, group: Group, unit: str) -> None:
    """Ask where torque as written is beyond what the joints can have."""
    limits = np.array([joint.effort_limit for joint in log.arm.joints])
    largest = np.nanpercentile(np.abs(group.values(log.table)), 95, axis=0) * TORQUE_UNITS[unit]
    if np.any(largest > BEYOND_TORQUE * limits) and "effort_unit" not in log.answers:
        worst = log.arm.joint_names[int(np.argmax(largest / limits))]
        log.ask(
            f"{group.name} as {unit} is beyond {BEYOND_TORQUE:g} times the limit of {worst}",
            EFFORT_ANSWER,
        )


def _constants(log: Search, group: Group, unit: str) -> dict[str, float]:
    """N·m for each A or at 100 %: as told; else none where the arm declares them; else of its drives."""
    if set(log.constants) >= set(log.arm.joint_names):
        return {joint: log.constants[joint] for joint in log.arm.joint_names}
    kind = "A" if unit in CURRENT_UNITS else "percent"
    if log.declared == kind and not log.constants:
        return {}
    drives = {joint.name: joint.torque_per_ampere for joint in log.arm.joints}
    if unit in CURRENT_UNITS and all(value != 1.0 for value in drives.values()):
        return drives
    what = "N m on the output side for each A" if kind == "A" else "N m on the output side at 100 %"
    log.found.questions.append(
        f"{group.name} is in {unit}: say {what} for each joint, in the arm YAML (effort: unit, constants) given as "
        "--arm, or: --constants JOINT=VALUE ..."
    )
    return {}


def _known_unit(log: Search, signal: str, unit: str, group: Group) -> str:
    if unit not in UNITS[signal]:
        raise UserError(f"{unit!r} is no unit of {signal}: one of {', '.join(UNITS[signal])}")
    if signal in ("position", "velocity"):
        log.tell(signal, group.name, unit, "told")
    return unit
