"""The report's figures, each a function from results to inline SVG."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.ticker import FuncFormatter, MaxNLocator

from ..arrays import FloatArray
from ..dynamics.friction_curve import friction_curve
from ..dynamics.model import IdentifiedModel
from ..estimate.identified import Determination, Estimate, Identified, Trace
from ..results.tables import by_joint, shown_value
from .plotting import CLOUD_MOVING, CLOUD_STANDING, COLOUR, decimated, grid, stacked, thinned, to_svg
from .text import MINUS, unit_text

BINS, FEWEST_IN_BIN = 30, 5
JOIN_SHARE = 0.015
"""White space between two recordings joined on one time axis, as a share of it."""
HEADROOM = 0.15
"""Added above the torque for the names of recordings, as a share of its range."""
LONGEST_NAME = 26
WIDEST_BAR = 3.0
"""An interval wider than so many times the largest value of its panel runs out of the picture."""
MARKER = {
    Determination.DATA: ("data", "o", True),
    Determination.COMBINED: ("combined", "o", False),
    Determination.BOUND: ("bound", "^", True),
    Determination.PRIOR: ("prior", "s", False),
    Determination.FIXED: ("fixed", "x", False),
}
"""What a value rests on -> role of the colour, matplotlib's marker, and whether it is filled."""


@dataclass(frozen=True)
class JointSignals:
    """One joint's rows of all traces, one after the other on one time axis.

    Attributes:
        time: (M,) s; recordings and stretches follow each other with a little space.
        velocity, measured, predicted: (M,).
        moving: (M,).
        revolute: Whether the joint turns.
        starts: First row of every trace.
        sources: Recording of every trace.
    """

    time: FloatArray
    velocity: FloatArray
    measured: FloatArray
    predicted: FloatArray
    moving: np.ndarray
    revolute: bool
    starts: tuple[int, ...]
    sources: tuple[str, ...]

    @property
    def residual(self) -> FloatArray:
        """(M,) measured minus predicted, N·m."""
        return self.measured - self.predicted

    @property
    def torque_unit(self) -> str:
        """Of measured, predicted and residual."""
        return "N·m" if self.revolute else "N"

    @property
    def velocity_label(self) -> str:
        """Of an axis."""
        return f"velocity, {'rad' if self.revolute else 'm'}/s"


def joint_signals(traces: Sequence[Trace], joint: int, revolute: bool) -> JointSignals | None:
    """The signals of one joint in all traces, joined; None where no trace has a row.

    Args:
        traces: Signals of the validation, one trace for each uninterrupted stretch.
        joint: Index of the joint.
        revolute: Whether the joint turns, for the units.
    """
    traces = [trace for trace in traces if len(trace.time)]
    if not traces:
        return None
    velocity, measured, predicted, moving = (
        np.concatenate([getattr(trace, name)[:, joint] for trace in traces])
        for name in ("velocity", "measured", "predicted", "moving")
    )
    starts = np.cumsum([0, *(len(trace.time) for trace in traces[:-1])])
    return JointSignals(
        joined([trace.time for trace in traces]),
        *(velocity, measured, predicted),
        moving.astype(bool),
        revolute,
        tuple(int(start) for start in starts),
        tuple(trace.source for trace in traces),
    )


def joined(times: Sequence[FloatArray]) -> FloatArray:
    """Times of recordings, none of them empty, one after the other with a little white space between, s."""
    space = JOIN_SHARE * sum(float(np.ptp(time)) for time in times)
    moved, end = [], None
    for time in times:
        moved.append(time if end is None else time - time[0] + end + space)
        end = float(moved[-1][-1])
    return np.concatenate(moved)


def over_time(signals: JointSignals, joint: str) -> Markup:
    """Measured and predicted torque, and below them the residual; standstill shaded.

    Args:
        signals: Rows of one joint in the validation, several recordings joined on one time axis.
        joint: Name, for the figure's description.

    Returns:
        Inline SVG; long recordings are thinned for it.
    """
    with stacked((1.45, 0.75)) as (figure, (torque, residual)):
        ends = [*signals.starts[1:], len(signals.time)]
        for start, end in zip(signals.starts, ends):
            part = slice(start, end)
            kept = start + decimated(
                signals.measured[part], signals.residual[part], most=max(50, 1500 * (end - start) // len(signals.time))
            )
            time = signals.time[kept]
            torque.plot(time, signals.measured[kept], color=COLOUR["measured"], linewidth=3.2)
            torque.plot(time, signals.predicted[kept], color=COLOUR["predicted"], linewidth=0.9)
            residual.plot(time, signals.residual[kept], color=COLOUR["residual"], linewidth=0.7)
            for axes in (torque, residual):
                _shade(axes, signals.time[part], ~signals.moving[part])
                if start:
                    axes.axvline(float(signals.time[start]), color=COLOUR["muted"], linewidth=0.6, linestyle=":")
        torque.margins(x=0.005)
        torque.set_ylabel(f"{'torque' if signals.revolute else 'force'}, {signals.torque_unit}")
        residual.set_ylabel("residual")
        _name_sources(torque, signals)
        residual.set_xlabel("time, s" if len(signals.starts) == 1 else "time, s (stretches joined)")
        return to_svg(figure, f"{joint}: measured and predicted torque, and residual, over time")


def _shade(axes: Axes, time: FloatArray, where: np.ndarray) -> None:
    """A band over every run of rows; all of them one collection, which is drawn faster than as many patches."""
    change = np.flatnonzero(np.diff(np.concatenate([[False], where, [False]]).astype(int)))
    spans = zip(time[change[::2]], time[change[1::2] - 1])
    boxes = [[(first, 0.0), (first, 1.0), (last, 1.0), (last, 0.0)] for first, last in spans]
    bands = PolyCollection(
        boxes, facecolor=COLOUR["band"], edgecolor="none", linewidth=0, zorder=0, transform=axes.get_xaxis_transform()
    )
    axes.add_collection(bands, autolim=False)


def _name_sources(axes: Axes, signals: JointSignals) -> None:
    """Name each recording where it begins, when there is more than one."""
    if len(set(signals.sources)) < 2:
        return
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + HEADROOM * (high - low))
    before = None
    for start, source in zip(signals.starts, signals.sources):
        if source != before:
            place = (float(signals.time[start]), 1.0)
            axes.annotate(
                short(source, 40),
                place,
                (3, -2),
                xycoords=("data", "axes fraction"),
                textcoords="offset points",
                va="top",
                fontsize=7,
                color=COLOUR["muted"],
            )
        before = source


def over_velocity(signals: dict[str, JointSignals]) -> Markup:
    """Residual over velocity, a panel a joint, with the mean of every speed range."""
    with grid(len(signals), 3, 1.95) as (figure, panels):
        for axes, (joint, mine) in zip(panels, signals.items()):
            keep = thinned(len(mine.time))
            for where, colour in ((~mine.moving, CLOUD_STANDING), (mine.moving, CLOUD_MOVING)):
                chosen = keep[where[keep]]
                cloud(axes, mine.velocity[chosen], mine.residual[chosen], colour)
            axes.axhline(0.0, color=COLOUR["muted"], linewidth=0.6)
            axes.plot(
                *_trend(mine.velocity[mine.moving], mine.residual[mine.moving]), color=COLOUR["ink"], linewidth=1.1
            )
            name_axes(axes, joint, mine.velocity_label, f"residual, {mine.torque_unit}")
        return to_svg(figure, "Residual over velocity, one panel a joint")


def cloud(axes: Axes, x: FloatArray, y: FloatArray, colour: str) -> None:
    """Draw points, as a raster image within the vector figure.

    Args:
        axes: Panel to draw in.
        x: (N,) coordinates along the x axis, in its unit.
        y: (N,) coordinates along the y axis, in its unit.
        colour: Colour of the points.
    """
    axes.plot(x, y, ".", markersize=3.2, markeredgewidth=0, color=colour, alpha=0.55, rasterized=True)


def _trend(velocity: FloatArray, residual: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean residual of equally filled ranges of velocity, at the mean velocity of each."""
    if len(velocity) < FEWEST_IN_BIN:
        return np.empty(0), np.empty(0)
    order = np.argsort(velocity, kind="stable")
    groups = np.array_split(order, min(BINS, len(order) // FEWEST_IN_BIN))
    return (
        np.array([velocity[group].mean() for group in groups]),
        np.array([residual[group].mean() for group in groups]),
    )


def friction(model: IdentifiedModel, signals: dict[str, JointSignals], pose: FloatArray) -> Markup:
    """Friction of the model over velocity, with the residual added to it while the joint moves.

    Args:
        model: The identified model.
        signals: Joint -> its signals, one panel each.
        pose: (n,) position in which friction is computed, rad or m.
    """
    names = model.model.arm.joint_names
    with grid(len(signals), 3, 1.95) as (figure, panels):
        for axes, (joint, mine) in zip(panels, signals.items()):
            top = 1.05 * float(np.max(np.abs(mine.velocity))) or 1.0
            velocity, torque = friction_curve(model, names.index(joint), top, pose)
            rows = np.flatnonzero(mine.moving)
            rows = rows[thinned(len(rows))]
            shown = mine.residual[rows] + np.interp(mine.velocity[rows], velocity, torque)
            cloud(axes, mine.velocity[rows], shown, CLOUD_MOVING)
            for half in (velocity < 0, velocity > 0):
                axes.plot(velocity[half], torque[half], color=COLOUR["ink"], linewidth=1.1)
            axes.axhline(0.0, color=COLOUR["muted"], linewidth=0.6)
            axes.axvline(0.0, color=COLOUR["muted"], linewidth=0.6)
            name_axes(axes, joint, mine.velocity_label, f"friction, {mine.torque_unit}")
        return to_svg(figure, "Friction torque over velocity, one panel a joint")


def name_axes(axes: Axes, title: str, below: str, beside: str) -> None:
    """Set title, axis labels and few ticks of a panel.

    Args:
        axes: The panel.
        title: Title; shortened to `LONGEST_NAME` characters.
        below: Label of the x axis, with unit.
        beside: Label of the y axis, with unit.
    """
    axes.set_title(short(title, LONGEST_NAME))
    axes.set_xlabel(below, labelpad=1)
    axes.set_ylabel(beside, labelpad=2)
    axes.yaxis.set_major_locator(MaxNLocator(4))
    axes.xaxis.set_major_locator(MaxNLocator(6))
    axes.margins(x=0.03)


def parameters(identified: Identified) -> Markup:
    """Every parameter with its 95 % interval: a panel a symbol, the joints side by side in one unit.

    A satellite beside them would leave nothing of the links to be seen: the base is in the tables only.
    """
    listing = by_joint(identified, with_base=False)
    places = {joint: place for place, joint in enumerate(listing, start=1)}
    symbols: dict[str, list[Estimate]] = {}
    for estimates in listing.values():
        for item in estimates:
            symbols.setdefault(item.symbol, []).append(replace(item, value=shown_value(item)))
    with grid(len(symbols), 6, 1.4, left_in=0.46, below_in=0.26) as (figure, panels):
        for axes, (symbol, items) in zip(panels, symbols.items()):
            axes.axhline(0.0, color=COLOUR["muted"], linewidth=0.5)
            for determination in Determination:
                _draw_estimates(axes, places, [item for item in items if item.determination is determination])
            unit = unit_text(next((item.unit for item in items if item.unit), ""))
            axes.set_title(f"{symbol}, {unit}" if unit else symbol, fontsize=7.5)
            axes.set_xlim(0.4, len(places) + 0.6)
            axes.set_xticks(range(1, len(places) + 1))
            axes.grid(visible=False, axis="x")
            axes.set_ylim(*_reach(items))
            axes.yaxis.set_major_locator(MaxNLocator(3))
            axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}".replace("-", MINUS)))
            axes.tick_params(labelsize=7)
        return to_svg(figure, "Parameters with 95 % intervals, one panel a symbol")


def _draw_estimates(axes: Axes, places: Mapping[str, int], items: Sequence[Estimate]) -> None:
    """Values that rest on the same, with their intervals: two lines, however many there are."""
    if not items:
        return
    role, marker, filled = MARKER[items[0].determination]
    colour = COLOUR[role]
    known = [item for item in items if np.isfinite(item.standard_error)]
    if known:
        bars = [(*item.interval, np.nan) for item in known]
        where = [(places[item.joint],) * 3 for item in known]
        axes.plot(np.ravel(where), np.ravel(bars), color=colour, linewidth=1.2, solid_capstyle="butt")
    axes.plot(
        [places[item.joint] for item in items], [item.value for item in items], marker, markersize=4, color=colour,
        markerfacecolor=colour if filled else "none", markeredgewidth=0.9,
    )  # fmt: skip


def _reach(items: Sequence[Estimate]) -> tuple[float, float]:
    """Vertical range of a panel: all values, and the intervals that are not hopelessly wide."""
    largest = max(abs(item.value) for item in items) or 1.0
    ends = [0.0]
    for item in items:
        half = item.interval[1] - item.value
        half = min(half, WIDEST_BAR * largest) if np.isfinite(half) else 0.0
        ends += [item.value - half, item.value + half]
    low, high = min(ends), max(ends)
    space = 0.08 * (high - low or largest)
    return low - space, high + space


def short(name: str, most: int) -> str:
    """At most so many characters of a name.

    Args:
        name: Of a parameter, a joint, an effect or a file.
        most: Characters; of a longer name the last that is shown is "…".
    """
    return name if len(name) <= most else name[: most - 1] + "…"
