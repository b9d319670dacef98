"""`signals_of`: which group of columns is the position, velocity, effort and command.

By its name. Without a name, by derivative (a group whose differences another follows is the position, the other the
velocity) and by weight (effort follows the weight of the CAD's arm). Several of a kind: the one that says to be
measured, on the joint side, torque rather than current; several alike are a question.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..arrays import FloatArray
from ..errors import UnfitDataError, UserError
from .groups import Group
from .search import Search
from .signals import DERIVATIVE, LOADED, derivative_of, weight_of
from .words import CURRENT, POSITION, TORQUE, VELOCITY


def signals_of(log: Search, seconds: FloatArray) -> dict[str, Group]:
    """The group of each signal; what is open is asked.

    Args:
        log: The search.
        seconds: (N,) s, or row numbers while the rate is open.

    Returns:
        Signal -> group; empty where the position is open.

    Raises:
        UnfitDataError: No torque or current.
        UserError: No positions of this arm's joints, or an answer that names no group.
    """
    chosen: dict[str, Group] = {}
    for signal in ("position", "velocity", "effort", "command"):
        group = _told(log, signal) or _named(log, signal)
        if group is not None:
            chosen[signal] = group
    if log.found.questions and not chosen:
        return chosen
    _by_derivative(log, chosen, seconds)
    if "position" not in chosen:
        return _without_position(log, chosen)
    if "effort" not in chosen and not any(q.startswith("effort") for q in log.found.questions):
        _by_weight(log, chosen)
    return chosen


def _told(log: Search, signal: str) -> Group | None:
    if signal not in log.answers:
        return None
    wanted = log.answers[signal]
    group = next((group for group in log.groups if group.name == wanted), None)
    if group is None:
        raise UserError(f"{log.where}: no group of columns {wanted!r}: it has {_names(log.groups)}")
    return group


def _named(log: Search, signal: str) -> Group | None:
    """The group whose names say that it is this signal; several that are alike are a question."""
    quantities = {"position": (POSITION,), "velocity": (VELOCITY,), "effort": (TORQUE, CURRENT)}
    commanded = signal == "command"
    wanted = quantities.get(signal, (POSITION,))
    fitting = [one for one in log.groups if one.quantity in wanted and one.commanded == commanded]
    if not fitting:
        return None

    def rank(group: Group) -> tuple[bool, bool, bool]:
        return group.quantity == CURRENT, group.motor_side and group.quantity != CURRENT, not group.measured

    best = [group for group in fitting if rank(group) == min(map(rank, fitting))]
    if len(best) > 1:
        if not commanded:
            log.ask(f"{signal} may be {_names(best)}", f"{signal}=NAME")
        return None
    others = [group.name for group in fitting if group is not best[0]]
    if others:
        log.found.left_out.append(f"{', '.join(others)}: not the {signal}, {best[0].name} is preferred")
    return best[0]


def _names(groups: Sequence[Group]) -> str:
    return ", ".join(repr(group.name) for group in groups) or "none"


def _by_derivative(log: Search, chosen: dict[str, Group], seconds: FloatArray) -> None:
    """Position and velocity among the groups whose names say nothing, from each other."""
    open_groups = [group for group in log.groups if group.quantity is None and not group.commanded]
    first = [chosen["position"]] if "position" in chosen else open_groups
    second = [chosen["velocity"]] if "velocity" in chosen else open_groups
    if "position" in chosen and "velocity" in chosen:
        return
    pairs = [(a, b) for a in first for b in second if a is not b and _follows(log, a, b, seconds)]
    if len(pairs) == 1:
        for signal, group in zip(("position", "velocity"), pairs[0], strict=True):
            if signal not in chosen:
                chosen[signal] = group
                other = pairs[0][1 if signal == "position" else 0].name
                why = f"{other} follows its differences" if signal == "position" else f"follows those of {other}"
                log.tell(signal, group.name, "", why)
    elif len(pairs) > 1 and "position" not in chosen:
        log.ask(f"position may be {_names(list(dict.fromkeys(pair[0] for pair in pairs)))}", "position=NAME")


def _follows(log: Search, position: Group, velocity: Group, seconds: FloatArray) -> bool:
    """Whether a group is the derivative of another, at every joint that moves."""
    q, v = position.values(log.table), velocity.values(log.table)
    slopes = [derivative_of(q[:, k], v[:, k], seconds, log.window(seconds)) for k in range(q.shape[1])]
    told = [slope for slope in slopes if slope is not None]
    return bool(told) and all(slope.correlation > DERIVATIVE for slope in told)


def _without_position(log: Search, chosen: dict[str, Group]) -> dict[str, Group]:
    if not any(question.startswith("position") for question in log.found.questions):
        there = _names([group for group in log.groups if group not in chosen.values()])
        if there == "none":
            raise UserError(
                f"{log.where}: no columns of the positions of {len(log.arm.joints)} joints found; is --arm its "
                f"arm? It has {', '.join(list(log.table.columns)[:12])}"
            )
        log.ask(f"position of the joints is not found by any name ({there})", "position=NAME")
    return {}


def _by_weight(log: Search, chosen: dict[str, Group]) -> None:
    """Effort among the groups whose names say nothing: what follows the weight of the arm."""
    used = list(chosen.values())
    open_groups = [one for one in log.groups if one.quantity is None and not one.commanded and one not in used]
    if not open_groups:
        raise UnfitDataError(
            f"{log.where}: no torque or current of the joints: without it no dynamics can be identified; the log "
            "can still show the motion itself, its limits and its spectrum"
        )
    position = chosen["position"].values(log.table)
    like = []
    for group in open_groups:
        for factor in (1.0, np.pi / 180.0):
            fit = weight_of(log.arm, position * log.scale(factor), group.values(log.table))
            if np.abs(fit.correlation).max() > LOADED and group not in like:
                like.append(group)
    if len(like) == 1:
        chosen["effort"] = like[0]
        log.tell("effort", like[0].name, "", "follows the weight of the CAD's arm")
    else:
        log.ask(f"effort may be {_names(like or open_groups)}", "effort=NAME")
