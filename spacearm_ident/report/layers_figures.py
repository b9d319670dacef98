"""The figures of a comparison with a simulation: what each layer removes, and the torque before and after."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from ..arrays import FloatArray
from ..layers.comparison import Comparison, Trace
from .figures import short
from .plotting import COLOUR, gapped_line, grid, stacked, to_svg

LINE_POINTS = 1200
HATCHES = {"conventions": "", "parameters": "//", "physics": "..", "rest": ""}
ROLES = {"conventions": "prior", "parameters": "predicted", "physics": "before", "rest": "residual"}
"""Layer -> colour; hatching says the same in print without colour."""


def waterfall(comparison: Comparison) -> Markup:
    """A bar a joint: the simulation's residual variance, as one, divided into what each layer removes and what is left.

    A layer that makes a joint worse has no share there; the ceiling of a flexible function is a line.
    """
    whole = comparison.before_Nm**2
    rows = len(comparison.joints)
    with grid(1, 1, 0.5 + 0.34 * rows, left_in=1.7) as (figure, (axes,)):
        places = np.arange(rows)[::-1]
        start = np.zeros(rows)
        for layer in comparison.layers:
            with np.errstate(invalid="ignore", divide="ignore"):
                share = np.nan_to_num(np.clip((layer.before_Nm**2 - layer.after_Nm**2) / whole, 0.0, 1.0 - start))
            axes.barh(
                places,
                share,
                0.62,
                left=start,
                color=COLOUR[ROLES[layer.name]],
                hatch=HATCHES[layer.name],
                edgecolor=COLOUR["band"],
                linewidth=0.4,
            )
            start = start + share
        axes.barh(places, 1.0 - start, 0.62, left=start, color=COLOUR["band"], linewidth=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            ceiling = 1.0 - np.clip(comparison.ceiling_Nm**2 / whole, 0.0, 1.0)
        for place, value in zip(places, ceiling):
            if np.isfinite(value):
                axes.plot([value] * 2, [place - 0.42, place + 0.42], color=COLOUR["ink"], linewidth=1.6)
        axes.set_yticks(places, [short(name, 24) for name in comparison.joints])
        axes.set_xlim(0.0, 1.02)
        axes.set_xticks(np.arange(0.0, 1.01, 0.2), [f"{share:.0%}" for share in np.arange(0.0, 1.01, 0.2)])
        axes.set_xlabel("share of the simulation's residual variance, held-out recordings")
        axes.grid(visible=False, axis="y")
        axes.tick_params(axis="y", length=0, labelcolor=COLOUR["ink"])
        return to_svg(figure, "Share of the simulation's residual variance that each layer removes, by joint")


def torques(comparison: Comparison) -> Markup | None:
    """Measured torque over time, as simulated and as mended, a joint a row; the first held-out recording."""
    traces = [trace for trace in comparison.traces if len(trace.time) > 1]
    if not traces:
        return None
    trace = traces[0]
    with stacked([0.85] * len(comparison.joints), titled=True) as (figure, panels):
        for row, (axes, name) in enumerate(zip(panels, comparison.joints)):
            for values, role, style, width in _lines(trace):
                look = {"color": COLOUR[role], "linestyle": style, "linewidth": width}
                gapped_line(axes, trace.time, values[:, row], LINE_POINTS, **look)
            axes.set_title(name)
            axes.margins(x=0.005)
        panels[-1].set_xlabel("time, s")
        return to_svg(figure, "Measured torque, torque of the simulation and of the corrected simulation over time")


def _lines(trace: Trace) -> Sequence[tuple[FloatArray, str, object, float]]:
    """Signals in drawing order: measured below as a broad line, the others over it."""
    return (
        (trace.measured, "measured", "-", 2.2),
        (trace.simulated, "before", (0, (4, 2)), 0.9),
        (trace.mended, "after", "-", 0.9),
    )
