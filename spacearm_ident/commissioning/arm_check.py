"""Whether an arm file says what identification and driver need, and says it sanely."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from ..dynamics.arm import DRIVE_KEYS, Arm, arm_from_description, load_arm
from ..dynamics.demand import drawn_postures, gravity_torques
from ..dynamics.mimics import coupled_words, follower_words
from ..errors import UserError
from ..estimate.consistency import pseudo_inertia
from .result import CheckResult, fail, ok, warn
from .yaml_file import empty_keys, read_yaml, to_fill_in

HOLDING_SHARE: Final = 0.9
GRAVITIES: Final = {"Earth": 9.81, "Mars": 3.72, "the Moon": 1.62}
FASTEST: Final = 20.0
"""A joint velocity limit above this, rad/s or m/s, is more likely in degrees."""
FARTHEST: Final = 4.0 * np.pi
"""Position limit, rad, beyond which a joint turns more than two turns from zero, which hardly any does."""
HIGHEST_RATIO: Final = 1000.0


def check_arm(path: Path) -> list[CheckResult]:
    """All checks of a URDF or an arm YAML."""
    results = []
    arm: Arm | None = None
    try:
        if path.suffix in (".yaml", ".yml"):
            data = read_yaml(path)
            empty = empty_keys(data)
            drives = {key: empty.pop(key) for key in DRIVE_KEYS if key in empty}
            if drives:
                lacking = to_fill_in("drives", path, data, drives)
                advice = f"{lacking.advice} for the CANopen driver, or effort in A; else leave them out"
                results.append(warn("drives", lacking.message, advice))
                arm = _without_empty(data, path)
            if empty:
                results.append(to_fill_in("arm file", path, data, empty))
                arm = _without_empty(data, path)
        arm = arm or load_arm(path)
    except UserError as error:
        return [*results, fail("arm file", str(error), "correct it; config/paper_arm.yaml is an example")]
    if (coupled := coupled_words(arm.described, arm.joint_names)) is not None:
        results.append(fail("mimic joints", *coupled))
    results += [
        warn("mimic joints", line, "right for fingers, not for a linkage")
        for line in follower_words(arm.described, arm.joint_names)
    ]
    turning = sum(joint.revolute for joint in arm.joints)
    what = f"{arm.name}: {turning} revolute and {len(arm.joints) - turning} prismatic joints"
    if not any(result.subject == "arm file" for result in results):
        results.append(ok("arm file", what))
    return [*results, *_inertials(arm), *_limits(arm), _gravity(arm), *_holding(arm), *_gears(arm), *_couplings(arm)]


def _without_empty(data: Mapping[str, Any], path: Path) -> Arm:
    """The arm as far as it is known; what the loader would refuse as empty is left out."""
    known = {joint: {k: v for k, v in keys.items() if v is not None} for joint, keys in data["joints"].items()}
    try:
        urdf = (path.parent / str(data.get("urdf"))).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"{path}: cannot read its URDF: {error}") from error
    return arm_from_description(urdf, {**data, "joints": known}, str(path))


def _inertials(arm: Arm) -> Iterator[CheckResult]:
    masses = np.array([joint.inertial[0] for joint in arm.joints])
    massless = [joint.name for joint, mass in zip(arm.joints, masses) if mass == 0]
    impossible = _impossible(arm)
    if impossible:
        yield fail(
            "inertials",
            f"no body can have those moved by {', '.join(impossible)}: a negative mass, or moments of inertia that "
            "break the triangle inequality",
            "correct mass, origin and inertia in the URDF (moments are about the centre of mass)",
        )
    if massless:
        yield warn(
            "inertials",
            f"what {', '.join(massless)} move has no mass in the URDF",
            "give CAD values: they are the prior of what motion does not excite, and the torque check of an excitation",
        )
    if not (massless or impossible):
        yield ok("inertials", f"all bodies are possible, {masses.sum():.4g} kg move")


def _impossible(arm: Arm) -> list[str]:
    """The joints that move what no body can be."""
    smallest = [np.linalg.eigvalsh(pseudo_inertia(joint.inertial))[0] for joint in arm.joints]
    return [
        joint.name
        for joint, low in zip(arm.joints, smallest)
        if joint.inertial[0] < 0 or low < -1e-9 * max(np.abs(joint.inertial).max(), 1.0)
    ]


def _limits(arm: Arm) -> Iterator[CheckResult]:
    wrong = [joint.name for joint in arm.joints if not joint.upper > joint.lower]
    for attribute, key in (
        ("velocity_limit", "velocity_limit_rad_s"),
        ("acceleration_limit", "acceleration_limit_rad_s2"),
        ("effort_limit", "torque_limit_Nm"),
    ):
        values = {joint.name: getattr(joint, attribute) for joint in arm.joints}
        negative = [name for name, value in values.items() if value <= 0]
        missing = [name for name, value in values.items() if np.isinf(value)]
        wrong += negative
        if missing:
            advice = f"give {key} in the arm YAML"
            if attribute == "acceleration_limit":
                advice += "; an excitation assumes the velocity limit in 0.5 s, the driver does not check it"
            yield warn("limits", f"no {attribute.replace('_', ' ')} of {', '.join(missing)}", advice)
    if wrong:
        yield fail(
            "limits",
            f"of {', '.join(dict.fromkeys(wrong))} leave no room to move",
            "lower must be below upper, velocity, acceleration and torque above zero",
        )
    fast = [joint.name for joint in arm.joints if FASTEST < joint.velocity_limit < np.inf]
    if fast:
        yield warn(
            "limits", f"{', '.join(fast)} may move faster than {FASTEST:g} rad/s", "is that in degrees? use rad/s"
        )
    free = [joint.name for joint in arm.joints if not np.isfinite(joint.upper - joint.lower)]
    if free:
        yield warn(
            "limits",
            f"no position limits of {', '.join(free)}",
            "give position_lower_rad and position_upper_rad if cables do not allow any number of turns",
        )
    far = limits_like_degrees(arm)
    if far:
        yield warn(
            "limits",
            f"{', '.join(far)} may turn more than two turns from zero",
            "are the position limits in degrees? use rad",
        )
    if not (wrong or fast or far):
        yield ok("limits", "positions, velocities, accelerations and torques that are given leave room to move")


def limits_like_degrees(arm: Arm) -> list[str]:
    """Joints with a position limit beyond two turns that would be within two turns if it were in degrees.

    Args:
        arm: With its limits in rad; numbers far beyond, such as 1e10, stand for no limit.
    """
    size = {joint.name: max(abs(joint.lower), abs(joint.upper)) for joint in arm.joints if joint.revolute}
    return [name for name, limit in size.items() if FARTHEST < limit <= np.degrees(FARTHEST)]


def _gravity(arm: Arm) -> CheckResult:
    size = float(np.linalg.norm(arm.gravity))
    place = next((name for name, g in GRAVITIES.items() if abs(size - g) < 0.03 * g), None)
    vector = ", ".join(f"{value:g}" for value in arm.gravity)
    if size == 0 or place:
        return ok("gravity", f"[{vector}] m/s² in the base frame, {f'as on {place}' if place else 'free fall'}")
    return warn("gravity", f"[{vector}] is {size:.3g} m/s², that of no usual place", "correct gravity_m_s2")


def _holding(arm: Arm) -> Iterator[CheckResult]:
    """Torque of gravity by the CAD links against the torque limits; of links that no body can be there is none.

    A negative mass may cancel those behind it, and Pinocchio then divides by the sum.
    """
    if _impossible(arm) or not arm.gravity.any() or not all(joint.upper > joint.lower for joint in arm.joints):
        return
    limits = np.array([joint.effort_limit for joint in arm.joints])
    share = np.abs(gravity_torques(arm, drawn_postures(arm))).max(axis=0) / limits
    worst = int(np.argmax(share))
    what = f"gravity takes up to {share[worst]:.0%} of a torque limit ({arm.joint_names[worst]}), by the CAD links"
    if share[worst] > HOLDING_SHARE:
        yield warn(
            "holding torque", what, "check masses, gear ratio and torque limit; excite will refuse such postures"
        )
    else:
        yield ok("holding torque", what)


def _gears(arm: Arm) -> Iterator[CheckResult]:
    odd = [j.name for j in arm.joints if not (j.gear_ratio > 0 and j.torque_constant > 0)]
    if odd:
        yield fail("gears", f"gear ratio or torque constant of {', '.join(odd)} is not above zero", "correct it")
    high = [j.name for j in arm.joints if j.gear_ratio > HIGHEST_RATIO]
    if high:
        yield warn(
            "gears", f"gear ratio of {', '.join(high)} is above {HIGHEST_RATIO:g}", "is it motor turns a joint turn?"
        )


def _couplings(arm: Arm) -> Iterator[CheckResult]:
    for coupling in arm.couplings:
        if not all(np.isfinite(ratio) and ratio for ratio in coupling.ratios.values()):
            yield fail("couplings", f"a ratio of {coupling.name} is zero or infinite", "leave out what is not coupled")
        else:
            yield ok("couplings", f"{coupling.name} turns with {', '.join(coupling.ratios)}")
