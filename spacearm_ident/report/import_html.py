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
from .pages import render
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
    joints = {joint.name: joint for joint in arm.joints}
    return render(
        "import.html",
        log=log.name,
        recording=recording,
        arm=arm,
        understood=proposal.rows,
        left_out=[one_line(line) for line in proposal.left_out],
        joints=[
            _joint(recording, k, joints[name], mapping) for k, name in enumerate(recording.joints) if name in joints
        ],
    )


def _joint(recording: Recording, k: int, joint: Joint, mapping: LogMapping) -> dict[str, str]:
    """The signals of one joint over time: its name, the drawing and the columns they are from."""
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
    return {"name": joint.name, "drawing": drawing, "columns": names}


def _limits(axes: Axes, joint: Joint) -> None:
    """The position limits, where they are known and near enough to be seen beside the motion."""
    bottom, top = axes.get_ylim()
    for limit in (joint.lower, joint.upper):
        if np.isfinite(limit) and bottom - 2.0 * (top - bottom) < limit < top + 2.0 * (top - bottom):
            axes.axhline(limit, color=COLOUR["muted"], linewidth=0.8, linestyle="--")
