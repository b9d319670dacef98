"""Why a model moved, in sentences: each cause with the evidence that only it leaves (`adaptation`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from ..dynamics.friction import WARM_FROM
from ..environment.temperature import LEAST_SPAN_K
from .adaptation import CLEAR, Adaptation, Change

GRAVITY_m_s2 = 0.05
"""Gravity off by less than this is not worth a word: half a per cent of a weight."""


@dataclass(frozen=True)
class Cause:
    """One possible cause: whether it is at work (None: these runs cannot tell), and why that is thought."""

    name: str
    found: bool | None
    why: str


def causes(adaptation: Adaptation) -> tuple[Cause, ...]:
    """Gravity, vacuum, temperature, friction level, rigid bodies: all of them, found or not."""
    return (
        _gravity(adaptation),
        _vacuum(adaptation),
        _temperature(adaptation),
        _level(adaptation),
        _bodies(adaptation),
    )


def reason(adaptation: Adaptation, change: Change) -> str:
    """Why one parameter is thought to have moved, or not, in a few words.

    Args:
        adaptation: Its share of k_v2 and k_v3 that is gone shows vacuum, its friction levels run by run show
            temperature.
        change: One of `adaptation.changes`.
    """
    share = adaptation.vacuum
    if change.symbol in ("k_v2", "k_v3"):
        gone = change.after_error > 0 and abs(change.after) < CLEAR * change.after_error
        if share is not None and _gone(adaptation):
            return "vacuum: nothing left of it" if gone else "vacuum, but not gone"
        return "not distinguishable from the ground" if not change.moved else "moved by itself"
    if change.symbol.startswith("alpha"):
        if not change.moved:
            return "no slope over temperature"
        joint = adaptation.adapted.model.arm.joint_names.index(change.joint)
        r = adaptation.levels.correlation(joint)
        return "temperature" if change.symbol == "alpha_v" else f"temperature: single runs follow it, R {r:.3f}"
    if not change.moved:
        return "as on the ground"
    if change.symbol == "f_c":
        return f"level at {WARM_FROM:g} °C: not temperature; lubricant, preload or wear"
    return "not temperature; lubricant"


def _gone(adaptation: Adaptation) -> bool:
    share = adaptation.vacuum
    return share is not None and share.value > CLEAR * share.error and abs(share.value - 1.0) < CLEAR * share.error


def _gravity(adaptation: Adaptation) -> Cause:
    before, stated = adaptation.ground.model.arm.gravity, adaptation.weightless.model.arm.gravity
    found, error = adaptation.gravity, adaptation.gravity_error
    known = np.isfinite(found)
    if not known.any():
        return Cause("gravity", None, "no joint of this arm feels gravity in these runs")
    off = np.abs(found - stated)[known]
    seen = ", ".join(with_error(x, e) if np.isfinite(x) else "not felt" for x, e in zip(found, error))
    apart = float(np.max(np.abs(found - before)[known] / np.maximum(error[known], 1e-12)))
    text = f"set to {_vector(stated)} m/s²; the torque itself says ({seen})"
    if bool(((off > CLEAR * error[known]) & (off > GRAVITY_m_s2)).any()):
        return Cause("gravity", None, f"{text}, which is not that: check the gravity that was set")
    if np.allclose(before, stated):
        return Cause("gravity", False, f"{text}, as on the ground")
    far = f"{apart:.0f}" if apart < 1000.0 else "more than a thousand"
    return Cause("gravity", True, f"{text}; the ground's {_vector(before)} is {far} standard errors away")


def with_error(value: float, error: float, sign: str = "") -> str:
    """A value to two digits of its error: `2.185 ± 0.018`.

    Args:
        value: The value.
        error: Its standard error, in the same unit. Where it is not positive and finite, the value is given alone.
        sign: Sign option of a format specification: `+` also marks positive values.
    """
    if not (np.isfinite(error) and error > 0.0):
        return f"{value:{sign}.4g}"
    decimals = max(0, 1 - int(np.floor(np.log10(error))))
    return f"{round(value, decimals) + 0.0:{sign}.{decimals}f} ± {error:.{decimals}f}"


def _vector(values: Sequence[float] | np.ndarray) -> str:
    return f"({', '.join(f'{value:g}' for value in values)})"


def _vacuum(adaptation: Adaptation) -> Cause:
    share = adaptation.vacuum
    if share is None:
        return Cause("vacuum", None, "the ground model has no k_v2 and k_v3 that could vanish")
    text = f"{with_error(share.value, share.error)} of the ground's k_v2 and k_v3 is gone, all joints together"
    if share.error > 1.0 / CLEAR:
        return Cause("vacuum", None, f"{text}: faster motion would determine it")
    if _gone(adaptation):
        return Cause("vacuum", True, f"{text}; they are nothing now, within the error")
    if abs(share.value) < CLEAR * share.error:
        return Cause("vacuum", False, f"{text}: they are as they were")
    return Cause("vacuum", None, f"{text}: they changed, but did not vanish")


def _temperature(adaptation: Adaptation) -> Cause:
    names = adaptation.adapted.model.arm.joint_names
    warm = adaptation.levels.temperature
    slopes = [change for change in adaptation.changes if change.symbol == "alpha_c"]
    if not slopes:
        return Cause(
            "temperature", None, f"no joint's temperature was recorded over {LEAST_SPAN_K:g} K or more in these runs"
        )
    span = f"{len(warm)} runs from {np.nanmin(warm):.0f} to {np.nanmax(warm):.0f} °C"
    follow = [change for change in slopes if change.moved]
    if not follow:
        return Cause("temperature", False, f"friction does not follow temperature over {span}")
    parts = [
        f"{change.joint} {with_error(1e3 * change.after, 1e3 * change.after_error)} mN·m/K "
        f"(R {adaptation.levels.correlation(names.index(change.joint)):.3f})"
        for change in follow
    ]
    return Cause(
        "temperature",
        True,
        f"f_c of single runs follows the joint's temperature over {span}: alpha {', '.join(parts)}",
    )


def _level(adaptation: Adaptation) -> Cause:
    moved = [change for change in adaptation.changes if change.symbol == "f_c" and change.moved]
    at = f"at {WARM_FROM:g} °C, so not temperature" if any(c.symbol == "alpha_c" for c in adaptation.changes) else ""
    if not moved:
        return Cause("friction level", False, f"f_c {at or 'of every joint'} is as it was on the ground")
    parts = [f"{change.joint} {with_error(change.change, change.change_error, '+')} N·m" for change in moved]
    return Cause(
        "friction level",
        True,
        f"f_c moved {at}: {', '.join(parts)}. Lubricant lost in vacuum, preload and wear look alike in torque",
    )


def _bodies(adaptation: Adaptation) -> Cause:
    shift, count = adaptation.inertia_shift, 11 * len(adaptation.ground.model.arm.joint_names)
    usual = shift < norm.ppf(1.0 - 0.5e-4 / count)
    text = f"masses and inertias are the ground's: the runs move none by more than {shift:.1f} of its standard errors"
    if usual:
        return Cause("rigid bodies", False, text)
    return Cause(
        "rigid bodies",
        None,
        f"a mass or inertia is drawn {shift:.1f} standard errors away from the ground's: is something in the gripper?",
    )
