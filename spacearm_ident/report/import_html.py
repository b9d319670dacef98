"""What `spacearm import` understood of a log, as one page: columns and units with the reason, and the signals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from ..dynamics.arm import Arm, Joint
from ..errors import one_line
from ..logs.search import Proposal
from ..recording.log_mapping import CURRENT_UNITS, LogMapping
from ..recording.recording import Recording
from .html import captioned, page
from .markup import Markup, breakable, element, join
from .plotting import COLOUR, gapped_line, stacked, to_svg

HEIGHT_IN = 0.85
"""Height of the panel of one signal, inches."""
MOST = 800
"""Points that are drawn of a signal."""


def import_html(log: Path, proposal: Proposal, mapping: LogMapping, recording: Recording, arm: Arm) -> str:
    """The page.

    Args:
        log: The log.
        proposal: What was understood, and why.
        mapping: The mapping that came of it.
        recording: What the mapping makes of the log, SI; effort as `mapping.is_torque` says.
        arm: The arm, whose position limits are drawn.
    """
    head = element("tr", *(element("th", text, class_="text") for text in ("signal", "columns", "unit", "because")))
    understood = [(row.signal, row.columns, row.unit, row.because) for row in proposal.rows]
    rows = [element("tr", *(element("td", text, class_="text wrap") for text in row)) for row in understood]
    left = [element("li", one_line(line)) for line in proposal.left_out]
    joints = {joint.name: joint for joint in arm.joints}
    body = join(
        element("h1", f"What the columns of {log.name} are"),
        element("p", f"{len(recording.time)} rows, {recording.rate_hz:.5g} Hz, arm {arm.name}", class_="quiet"),
        element("div", element("table", element("thead", head), element("tbody", *rows)), class_="wide"),
        element("ul", *left) if left else None,
        element("h2", "Signals"),
        element(
            "p",
            "As read by the mapping. Dashed: the position limits of the arm's description. Is each joint the one it is "
            "said to be, in the right unit and direction? spacearm check tests it on the data.",
            class_="quiet",
        ),
        *(_joint(recording, k, joints[name], mapping) for k, name in enumerate(recording.joints) if name in joints),
    )
    return page(f"Import of {log.name}", body)


def _joint(recording: Recording, k: int, joint: Joint, mapping: LogMapping) -> Markup:
    """The signals of one joint over time."""
    columns = mapping.columns.get(joint.name, {})
    angle, speed = ("rad", "rad/s") if joint.revolute else ("m", "m/s")
    effort = joint.units.effort if mapping.is_torque else "A" if mapping.units["effort"] in CURRENT_UNITS else "%"
    shown = [("position", recording.position[:, k], angle)]
    if recording.velocity is not None and np.isfinite(recording.velocity[:, k]).any():
        shown.append(("velocity", recording.velocity[:, k], speed))
    shown.append(("effort", recording.effort[:, k], effort))
    with stacked([HEIGHT_IN] * len(shown)) as (figure, axes):
        for panel, (signal, values, unit) in zip(axes, shown, strict=True):
            for part in recording.segments:
                gapped_line(panel, recording.time[part], values[part], MOST, color=COLOUR["measured"], linewidth=0.8)
            panel.set_ylabel(f"{signal}\n{unit}")
            panel.margins(x=0.005)
        _limits(axes[0], joint)
        axes[-1].set_xlabel("time, s")
        drawing = to_svg(figure, f"{joint.name}: {', '.join(signal for signal, _, _ in shown)} over time")
    names = ", ".join(f"{signal}: {columns[signal]}" for signal, _, _ in shown if signal in columns)
    return element("section", element("h3", breakable(joint.name)), captioned(drawing, names), class_="joint")


def _limits(axes: Axes, joint: Joint) -> None:
    """The position limits, where they are known and near enough to be seen beside the motion."""
    bottom, top = axes.get_ylim()
    for limit in (joint.lower, joint.upper):
        if np.isfinite(limit) and bottom - 2.0 * (top - bottom) < limit < top + 2.0 * (top - bottom):
            axes.axhline(limit, color=COLOUR["muted"], linewidth=0.8, linestyle="--")
