"""Findings in words: what a change of conventions says of the recording, and the option that mends it."""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray
from ..dynamics.arm import Arm
from ..recording.corrections import Corrections, JointCorrection
from .change import GAIN_KNOWN, TORQUE_SCALES, UNIT_FACTOR, Change, Kind, unit_factors
from .evidence import Evidence


def joint_names(arm: Arm, change: Change) -> tuple[str, ...]:
    """Names of a change's joints.

    Args:
        arm: Whose joints are numbered.
        change: With numbers of joints.
    """
    return tuple(arm.joint_names[k] for k in change.joints)


def statement(arm: Arm, change: Change, evidence: Evidence) -> str:
    """A sentence that says how a recording departs from the conventions.

    Args:
        arm: The arm, for names of joints and the gravity described.
        change: The departure.
        evidence: Of the setup with this change; its gains and their errors are quoted where `change` is a gain.
    """
    names = ", ".join(joint_names(arm, change))
    what = "all positions are" if len(change.joints) == len(arm.joints) > 1 else f"the position of {names} is"
    match change.kind:
        case Kind.EFFORT_SIGN:
            return f"the torque of {names} has the wrong sign for its motion"
        case Kind.POSITION_SIGN:
            return f"the position of {names} has the opposite sign of its axis in the URDF"
        case Kind.AXIS_REVERSED:
            return f"position and torque of {names} have the opposite sign of its axis in the URDF"
        case Kind.DEGREES:
            return f"{what} in degrees, not radians"
        case Kind.MOTOR_SIDE:
            return f"{what} of the motor, not of the joint: larger by the gear ratio"
        case Kind.POSITIONS_EXCHANGED:
            return f"the positions of {names} are exchanged: {_order(arm, change)}"
        case Kind.EFFORTS_EXCHANGED:
            return f"the torques of {names} are exchanged: {_order(arm, change)}"
        case Kind.JOINTS_EXCHANGED:
            return f"{names} are exchanged, position and torque: {_order(arm, change)}"
        case Kind.ENCODER_ZERO:
            off = -change.value[0]
            return f"the encoder zero of {names} is off by {off:+.3f} rad ({np.rad2deg(off):+.1f}°)"
        case Kind.DELAY:
            side = "lags" if change.value[0] > 0 else "leads"
            where = "torque" if len(change.joints) == len(arm.joints) else f"the torque of {names}"
            return f"{where} {side} the motion by {abs(change.value[0]) * 1e3:.0f} ms"
        case Kind.TIME_REVERSED:
            return "time runs backwards: friction would drive every joint"
        case Kind.GRAVITY:
            return gravity_statement(arm, np.array(change.value))
        case Kind.PAYLOAD:
            mass = 0.0 if evidence.body is None else float(evidence.body[0])
            return f"torque as of a body of about {mass:.2g} kg on the last link (of {names})"
        case Kind.FLOATING_BASE:
            return "torque as of an arm on a base that floats: less than on one that is held, as with a gain below 1"
        case _:
            return _gain(arm, change, evidence)


def _order(arm: Arm, change: Change) -> str:
    names = arm.joint_names
    pairs = [f"{names[k]} is recorded as {names[int(change.value[k])]}" for k in change.joints]
    return ", ".join(pairs)


def gravity_statement(arm: Arm, vector: FloatArray) -> str:
    """That the torque is of another gravity than the arm's.

    Args:
        arm: With the gravity that was assumed.
        vector: (3,) gravity of the torque in the base frame, m/s².
    """
    told = " ".join(f"{g:.3g}" for g in arm.gravity)
    if not vector.any():
        return f"the torque contains no gravity, described as {told} m/s² (compensated by the controller, or in orbit?)"
    found = f"gravity in the base frame is {' '.join(f'{g:.3g}' for g in vector)} m/s², not {told}"
    size = float(np.linalg.norm(arm.gravity))
    if not size:
        return f"{found}: recorded on the ground?"
    angle = float(np.degrees(np.arccos(np.clip(vector @ arm.gravity / np.linalg.norm(vector) / size, -1, 1))))
    return f"{found}: the base is mounted {'upside down' if angle > 150 else f'{angle:.0f}° off'}"


def _gain(arm: Arm, change: Change, evidence: Evidence) -> str:
    gains, names = evidence.gains, arm.joint_names
    if change.kind is Kind.EFFORT_RATED:
        share = rated_factors(change, evidence)[0] / arm.joints[0].effort_limit
        return f"the torque is recorded in a share of each joint's torque limit, 1 for {share:.2%} of it, not in N·m"
    if change.kind is Kind.EFFORT_UNIT:
        if change.value:
            return f"the torque is recorded in {_unit(arm, change)}, not N·m"
        listed = ", ".join(f"{names[k]} {gains[k]:.3g}" for k in _with_known_gain(change, evidence))
        guess = _guess(_gains(change, evidence))
        return f"the torque is not in N·m{guess}: recorded over expected from CAD masses is {listed}"
    joint = change.joints[0]
    error = float(evidence.gain_errors[joint])
    where = "that carries the arm" if len(change.joints) > 1 else f"of {names[joint]}"
    text = f"the torque {where} is {gains[joint]:.3g} (± {gains[joint] * error:.2g}) times that of the CAD masses"
    if is_unit(change, evidence):
        return f"{text}: another unit{_guess(gains)}"
    return (
        f"{text}: probably a gain (torque constant, gear ratio) or CAD masses that are off; these data cannot separate"
    )


def is_unit(change: Change, evidence: Evidence) -> bool:
    """Whether a free gain is so far off that it is another unit.

    Args:
        change: Of the effort.
        evidence: The posterior with it; gains (n,).
    """
    if change.kind is Kind.EFFORT_RATED or (change.kind is Kind.EFFORT_UNIT and change.value):
        return True
    return bool(np.median(np.abs(np.log(_gains(change, evidence)))) > np.log(UNIT_FACTOR))


def _with_known_gain(change: Change, evidence: Evidence) -> list[int]:
    """Those of the change's joints whose gain the data determine; all of them where they determine none.

    A joint that gravity does not load, or that stands still, shows no gain.
    """
    return [k for k in change.joints if evidence.gain_errors[k] < GAIN_KNOWN] or list(change.joints)


def _gains(change: Change, evidence: Evidence) -> FloatArray:
    """Gain of each of the change's joints; of one that the data do not determine, the median of those they do."""
    known = _with_known_gain(change, evidence)
    usual = np.exp(np.median(np.log(evidence.gains[known])))
    return np.array([evidence.gains[k] if k in known else usual for k in change.joints])


def rated_factors(change: Change, evidence: Evidence) -> tuple[float, ...]:
    """(n,) N·m a unit of a torque recorded in shares of rated torques.

    Args:
        change: Of that kind.
        evidence: The posterior with it; its gains have the factor that the joints share.
    """
    return tuple((np.array(change.value) / evidence.gains).tolist())


def _unit(arm: Arm, change: Change) -> str:
    for name, factors in unit_factors(arm).items():
        if np.allclose(factors, change.value):
            return name
    return "another unit"


def _guess(gains: FloatArray) -> str:
    size = float(np.exp(np.median(np.log(gains))))
    if 300 < size < 3000 and np.std(np.log(gains)) < 0.3:
        return " (mN·m?)"
    if size > UNIT_FACTOR:
        return " (mA?)"
    return " (A?)" if size < 1 / UNIT_FACTOR else ""


def corrections(arm: Arm, change: Change, evidence: Evidence) -> Corrections:
    """What undoes a change in the recording; nothing for gravity, a payload or a free base, which are not its mistakes.

    Args:
        arm: The arm, for names of joints.
        change: The departure to correct.
        evidence: Of the setup with this change; its gains are used where `change` is a gain.
    """
    names = joint_names(arm, change)
    match change.kind:
        case Kind.GRAVITY | Kind.PAYLOAD | Kind.FLOATING_BASE:
            return Corrections()
        case Kind.TIME_REVERSED:
            return Corrections(clock="reversed")
        case Kind.EFFORT_GAIN | Kind.EFFORT_UNIT | Kind.EFFORT_RATED:
            factors = _torque_factors(change, evidence)
            return Corrections({name: JointCorrection(effort_scale=scale) for name, scale in zip(names, factors)})
        case Kind.DELAY:
            each = JointCorrection(effort_delay_s=change.value[0])
        case Kind.ENCODER_ZERO:
            each = JointCorrection(position_offset_rad=change.value[0])
        case Kind.DEGREES:
            each = JointCorrection(position_scale=0.01745329252)
        case Kind.MOTOR_SIDE:
            return Corrections({name: JointCorrection(position_scale=one) for name, one in zip(names, change.value)})
        case Kind.EFFORT_SIGN:
            each = JointCorrection(effort_scale=-1.0)
        case Kind.POSITION_SIGN:
            each = JointCorrection(position_scale=-1.0)
        case Kind.AXIS_REVERSED:
            each = JointCorrection(position_scale=-1.0, effort_scale=-1.0)
        case _:
            return _exchange(arm, change)
    return Corrections(dict.fromkeys(names, each))


def remedy(arm: Arm, change: Change, evidence: Evidence) -> str:
    """The command-line option or arm YAML entry that corrects it.

    Args:
        arm: The arm, for names of joints.
        change: The departure to correct.
        evidence: Of the setup with this change; its gains are used where `change` is a gain.
    """
    if change.kind is Kind.GRAVITY:
        return "--gravity " + " ".join(f"{g:.3g}" for g in change.value) + ", or gravity_m_s2 in the arm YAML"
    if change.kind is Kind.PAYLOAD:
        return (
            "if the arm holds a body, spacearm payload weighs it, with a model of the arm without it; if it is part of "
            "the arm, its inertials belong into the URDF"
        )
    if change.kind is Kind.FLOATING_BASE:
        return "record /base_imu: without the base's motion a model takes the smaller torque for smaller bodies"
    text = f"in the arm YAML: corrections: {corrections(arm, change, evidence).as_yaml(arm.joint_names)}"
    if change.kind in TORQUE_SCALES:
        return f"find torque constant, gear ratio and unit of the effort; until then {text}"
    return f"{text}; or reverse the axis in the URDF" if change.kind is Kind.AXIS_REVERSED else text


def _exchange(arm: Arm, change: Change) -> Corrections:
    names, order = arm.joint_names, [int(k) for k in change.value]
    position, effort = change.kind is not Kind.EFFORTS_EXCHANGED, change.kind is not Kind.POSITIONS_EXCHANGED
    return Corrections(
        {
            names[k]: JointCorrection(
                position_from=names[order[k]] if position else "", effort_from=names[order[k]] if effort else ""
            )
            for k in change.joints
        }
    )


def _torque_factors(change: Change, evidence: Evidence) -> list[float]:
    """N·m a recorded unit, of each of the change's joints."""
    if change.kind is Kind.EFFORT_UNIT and change.value:
        return list(change.value)
    if change.kind is Kind.EFFORT_RATED:
        return list(rated_factors(change, evidence))
    factors = 1.0 / _gains(change, evidence)
    if change.kind is Kind.EFFORT_GAIN:
        factors[:] = factors[0]
    return [float(factor) for factor in factors]
