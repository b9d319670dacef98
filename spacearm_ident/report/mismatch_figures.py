"""The figures of a mismatch: where the residual is, and what it depends on before and after.

A finding is drawn over whatever shows it best: of the dependences its physics can have, the one along which the mean
of the residual varied most and no longer does. Where none stands out, over time.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, NullLocator

from ..arrays import FloatArray
from ..dynamics.arm import Arm
from ..dynamics.effects import EFFECTS
from ..mismatch.finding import Explanation, Finding, Trace
from .figures import cloud, joined, name_axes, short
from .plotting import CLOUD_MOVING, COLOUR, gapped_line, grid, stacked, thinned, to_svg
from .text import number

MOST_JOINTS = 3
"""So many joints of a finding are drawn, those where it takes most away."""
CLEAR = 0.15
"""Share of a residual's variance that a dependence must explain to be the one shown."""
PREFERRED = 0.1
"""Another joint's motion is shown instead of the joint's own only where it explains so much more."""
FEWEST_IN_BIN, MOST_BINS = 8, 60
NOISE_BAND = 2.0
"""Half width of the band of noise, in its standard deviations."""
OVERVIEW_TOP = 3.0
"""The overview reaches at least so many times the noise floor, so that what is nothing looks like nothing."""
MOST_LABELS, LONGEST_LABEL = 3, 24
LINE_POINTS = 900

POSITION, VELOCITY, ACCELERATION, TIME = "position", "velocity", "acceleration", "time"
OVER = {
    **{signal: (signal, False) for signal in (POSITION, VELOCITY, ACCELERATION)},
    **{f"friction_{signal}": (signal, True) for signal in (POSITION, VELOCITY, TIME)},
}
"""Dependence, as in `Effect.shown_over` -> (signal, whether the residual is taken in the direction of motion)."""


@dataclass(frozen=True)
class Signals:
    """Every trace, one after the other on one time axis.

    Attributes:
        time: (M,) s; the residuals of the first row of a further trace are NaN.
        position, velocity, acceleration: (M, n).
        before, after: (M, n) residual, N·m; NaN where no row counts.
        starts: Row at which each trace begins.
    """

    time: FloatArray
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    before: FloatArray
    after: FloatArray
    starts: tuple[int, ...]


@dataclass(frozen=True)
class View:
    """What one joint's residual is drawn over.

    Attributes:
        signal: `position`, `velocity`, `acceleration` or `time`.
        driver: Joint whose signal it is.
        along: Whether the residual counts in the direction of motion, as friction does.
        cycles: Where given, positions are folded into one of so many cycles a revolution.
    """

    signal: str
    driver: int
    along: bool = False
    cycles: float | None = None


def signals(traces: Sequence[Trace]) -> Signals | None:
    """All traces joined, or None where there is nothing to draw."""
    traces = [trace for trace in traces if len(trace.time) > 1]
    if not any(np.isfinite(trace.before).any() for trace in traces):
        return None

    def stack(name: str) -> FloatArray:
        return np.concatenate([getattr(trace, name) for trace in traces])

    before, after = stack("before"), stack("after")
    lengths = [len(trace.time) for trace in traces]
    starts = np.cumsum([0, *lengths[:-1]])
    # A line must not run on from one recording to the next.
    before[starts[1:]] = after[starts[1:]] = np.nan
    acceleration = [np.gradient(trace.velocity, trace.time, axis=0) for trace in traces]
    return Signals(
        joined([trace.time for trace in traces]),
        *(stack("position"), stack("velocity"), np.concatenate(acceleration), before, after),
        tuple(int(start) for start in starts),
    )


def overview(explanation: Explanation) -> Markup:
    """Bars that grow out of each joint's noise floor: the residual before and after, in multiples of the floor."""
    names, floor = explanation.joints, explanation.noise_floor_Nm
    labels = [_labels(explanation.findings, joint) for joint in names]
    lines = max(map(len, labels), default=0) + max(len(_broken(name)) - 1 for name in names)
    with grid(1, 1, 2.75 + 0.16 * lines, left_in=0.62, below_in=0.3 + 0.16 * lines) as (figure, (axes,)):
        axes.set_yscale("log")
        highest, lowest = OVERVIEW_TOP, 1 / 1.4
        for shift, role, values in ((-0.2, "before", explanation.before_Nm), (0.2, "after", explanation.after_Nm)):
            for place, (value, noise) in enumerate(zip(values, floor)):
                if not (np.isfinite(value) and value > 0 and np.isfinite(noise) and noise > 0):
                    continue
                ratio = float(value / noise)
                highest, lowest = max(highest, 1.5 * ratio), min(lowest, ratio / 1.4)
                axes.bar(place + shift, ratio - 1.0, 0.36, bottom=1.0, color=COLOUR[role], linewidth=0)
                axes.annotate(
                    number(float(value), 2), (place + shift, max(ratio, 1.0)), (0, 2), textcoords="offset points",
                    ha="center", va="bottom", fontsize=7.5,
                )  # fmt: skip
        axes.axhline(1.0, color=COLOUR["ink"], linewidth=1.0)
        axes.set_ylim(lowest, highest)
        axes.set_xlim(-0.6, len(names) - 0.4)
        axes.set_xticks(range(len(names)), ["\n".join((*_broken(n), *own)) for n, own in zip(names, labels)])
        axes.tick_params(axis="x", length=0, labelcolor=COLOUR["ink"])
        axes.grid(visible=False, axis="x")
        axes.yaxis.set_minor_locator(NullLocator())
        axes.set_yticks([v for e in range(-2, 7) for v in (10.0**e, 2 * 10.0**e, 5 * 10.0**e) if lowest < v < highest])
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}×"))
        axes.set_ylabel("residual over noise floor")
        return to_svg(figure, "Residual before and after in multiples of each joint's noise floor")


def _broken(name: str) -> list[str]:
    """A name in lines of at most `LONGEST_LABEL` characters, broken after underscores where it can be."""
    lines = [""]
    for part in re.findall(r"[^_]*_+|[^_]+", name):
        if lines[-1] and len(lines[-1]) + len(part) > LONGEST_LABEL:
            lines.append("")
        lines[-1] += part
    return [short(line, LONGEST_LABEL) for line in lines]


def _labels(findings: Sequence[Finding], joint: str) -> list[str]:
    """What was found at a joint, for below its name."""
    kinds = list(dict.fromkeys(finding.effect.replace("_", " ") for finding in findings if joint in finding.joints))
    if len(kinds) > MOST_LABELS:
        kinds = [*kinds[: MOST_LABELS - 1], f"and {len(kinds) - MOST_LABELS + 1} more"]
    return [short(kind, LONGEST_LABEL) for kind in kinds]


def dependence(finding: Finding, arm: Arm, of: Signals, floor: FloatArray) -> tuple[Markup, str] | None:
    """Residual before and after over the quantity a finding depends on, and a caption; None: nothing to draw.

    Args:
        finding: The finding.
        arm: The arm, for names and units.
        of: Signals of all traces.
        floor: (n,) noise floor, RMS, N·m or N.
    """
    rows = [k for k in _strongest(finding, arm.joint_names, of) if np.isfinite(of.before[:, k]).any()]
    if not rows:
        return None
    views = [view_of(finding, row, of) for row in rows]
    with grid(2 * len(rows), 2, 2.15, left_in=0.58) as (figure, panels):
        for pair, row, view in zip(zip(panels[::2], panels[1::2]), rows, views):
            limit = _limit(of, row, floor[row])
            for axes, when in zip(pair, ("before", "after")):
                _panel(axes, of, row, view, when)
                _noise(axes, floor[row])
                axes.axhline(0.0, color=COLOUR["muted"], linewidth=0.6)
                unit = "N·m" if arm.joints[row].revolute else "N"
                beside = f"residual along the motion, {unit}" if view.along else f"residual, {unit}"
                name_axes(axes, f"{when}: {arm.joint_names[row]}", _below(view, arm), beside)
                axes.set_ylim(-limit, limit)
        described = f"Residual before and after, {finding.effect} at {', '.join(arm.joint_names[row] for row in rows)}"
        return to_svg(figure, described), _caption(views)


def _strongest(finding: Finding, names: Sequence[str], of: Signals) -> list[int]:
    """Rows of the joints to draw: those where most went away, among all for what moves the torque of all."""
    if not finding.joints or (finding.effect in EFFECTS and EFFECTS[finding.effect].bodily):
        before, after = (np.where(np.isfinite(y), y, 0.0) for y in (of.before, of.after))
        taken = dict(zip(names, np.sum(before**2 - after**2, axis=0)))
    else:
        nothing = float("nan")
        taken = {
            joint: finding.before_Nm.get(joint, nothing) ** 2 - finding.after_Nm.get(joint, nothing) ** 2
            for joint in finding.joints
            if joint in names
        }
    ordered = sorted(taken, key=lambda joint: -np.nan_to_num(taken[joint], nan=-np.inf))
    return [list(names).index(joint) for joint in ordered[:MOST_JOINTS]]


def view_of(finding: Finding, row: int, of: Signals) -> View:
    """The quantity over which one joint's residual shows a finding best.

    Args:
        finding: The finding; its effect limits the choice.
        row: Index of the joint.
        of: Signals of all traces.

    Returns:
        The view that explains most of the residual's variance; over time where none is clear, and of an event.
    """
    cycles = finding.parameters.get("cycles")
    if cycles is not None and np.isfinite(cycles.value) and cycles.value > 0:
        return View(POSITION, row, cycles=cycles.value)
    best, most = View(TIME, row), CLEAR
    choices = () if finding.event else _dependences(finding.effect)
    for driver in (row, *(k for k in range(of.before.shape[1]) if k != row)):
        margin = 0.0 if driver == row or best.signal == TIME else PREFERRED
        for signal, along in (OVER[name] for name in choices):
            if signal == TIME and driver != row:
                continue
            view = View(signal, driver, along)
            share = _shown_by(view, row, of)
            if share > most + margin:
                best, most = view, share
    return best


def _dependences(effect: str) -> Iterable[str]:
    """Names in `OVER` of what an effect's residual may be drawn over; all for what is no effect of the catalogue."""
    known = EFFECTS.get(effect)
    if known is None or (known.shown_over is None and known.follows not in OVER):
        return OVER
    return (known.follows,) if known.shown_over is None else known.shown_over


def _shown_by(view: View, row: int, of: Signals) -> float:
    """Share of the residual's variance that its mean over a dependence has before and no longer after."""
    x, before, after = _x(view, of), _y(view, row, of, "before"), _y(view, row, of, "after")
    where = np.isfinite(before) & np.isfinite(after)
    if where.sum() < 4 * FEWEST_IN_BIN:
        return 0.0
    groups = _groups(x[where])
    weights = np.array([len(group) for group in groups]) / where.sum()
    means = [np.array([y[where][group].mean() for group in groups]) for y in (before, after)]
    return float((weights @ means[0] ** 2 - weights @ means[1] ** 2) / max(np.mean(before[where] ** 2), 1e-30))


def _x(view: View, of: Signals) -> FloatArray:
    if view.signal == TIME:
        return of.time
    x = np.asarray(getattr(of, view.signal)[:, view.driver])
    return x if view.cycles is None else np.mod(x * view.cycles / (2 * np.pi), 1.0)


def _y(view: View, row: int, of: Signals, when: str) -> FloatArray:
    y = np.asarray(getattr(of, when)[:, row])
    return y * np.sign(of.velocity[:, row]) if view.along else y


def _groups(x: FloatArray) -> list[np.ndarray]:
    """Indices of equally filled ranges."""
    return np.array_split(np.argsort(x, kind="stable"), max(1, min(MOST_BINS, len(x) // FEWEST_IN_BIN)))


def _panel(axes: Axes, of: Signals, row: int, view: View, when: str) -> None:
    x, y = _x(view, of), _y(view, row, of, when)
    if view.signal == TIME and not view.along:
        gapped_line(axes, x, y, LINE_POINTS, color=COLOUR[when], linewidth=0.8)
        return
    where = np.flatnonzero(np.isfinite(y) & np.isfinite(x))
    chosen = where[thinned(len(where))]
    cloud(axes, x[chosen], y[chosen], CLOUD_MOVING)
    if len(where) >= FEWEST_IN_BIN:
        groups = _groups(x[where])
        means = np.array([(x[where][group].mean(), y[where][group].mean()) for group in groups])
        axes.plot(*means.T, color=COLOUR[when], linewidth=1.5)


def _limit(of: Signals, row: int, noise: float) -> float:
    """Half the height of the panels of one joint: all but the rarest points, before and after, and the noise."""
    sizes = np.abs(np.concatenate([of.before[:, row], of.after[:, row]]))
    sizes = sizes[np.isfinite(sizes)]
    if not len(sizes):
        return 1.0
    return 1.1 * max(float(np.quantile(sizes, 0.998)), NOISE_BAND * noise if np.isfinite(noise) else 0.0) or 1.0


def _below(view: View, arm: Arm) -> str:
    if view.signal == TIME:
        return "time, s"
    if view.cycles is not None:
        return f"position within one of {number(view.cycles, 4)} cycles a revolution"
    joint = arm.joints[view.driver]
    unit = {POSITION: "", VELOCITY: "/s", ACCELERATION: "/s²"}[view.signal]
    return f"{view.signal} of {short(joint.name, 22)}, {'rad' if joint.revolute else 'm'}{unit}"


def _caption(views: Sequence[View]) -> str:
    parts = ["Left without anything added to the base model, right with every finding, on one scale"]
    if any(view.signal != TIME or view.along for view in views):
        parts.append("line: mean over ranges of equally many samples, near zero for a complete model")
    if any(view.along for view in views):
        parts.append("along the motion: positive resists it, as friction does")
    return "; ".join([*parts, "band: noise, ± two standard deviations"]) + "."


def over_time(names: Sequence[str], of: Signals, floor: FloatArray) -> Markup:
    """Residual of every joint over time, before and after.

    Args:
        names: Names of the n joints.
        of: Signals of all traces.
        floor: (n,) noise floor, RMS, N·m or N.
    """
    with stacked([0.75] * len(names), titled=True) as (figure, panels):
        for row, (axes, name) in enumerate(zip(panels, names)):
            for when in ("before", "after"):
                gapped_line(axes, of.time, getattr(of, when)[:, row], LINE_POINTS, color=COLOUR[when], linewidth=0.8)
            _noise(axes, floor[row])
            for start in of.starts[1:]:
                axes.axvline(float(of.time[start]), color=COLOUR["muted"], linewidth=0.6, linestyle=":")
            axes.set_title(name)
            axes.margins(x=0.005)
            limit = _limit(of, row, floor[row])
            axes.set_ylim(-limit, limit)
        panels[-1].set_xlabel("time, s" if len(of.starts) == 1 else "time, s (recordings joined)")
        return to_svg(figure, "Residual of every joint over time, before and after")


def _noise(axes: Axes, floor: float) -> None:
    """A band as high as the noise."""
    if np.isfinite(floor):
        half = NOISE_BAND * float(floor)
        axes.axhspan(-half, half, facecolor=COLOUR["band"], linewidth=0, zorder=0)
