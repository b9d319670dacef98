"""The page of an excitation: how near its runs come to every limit, their motion and torque, the arm's postures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pinocchio as pin
from markupsafe import Markup

from ..arrays import FloatArray
from ..documents import write_whole
from ..dynamics.arm import Arm
from ..dynamics.urdf_chain import bounded
from ..errors import UserError
from ..excitation.constraints import Margin, Requirements, model_torque
from ..excitation.trajectory import Trajectory
from .pages import render
from .plotting import COLOUR, decimated, grid, to_svg
from .text import unit_text

Run = tuple[str, Trajectory]
RATE_HZ = 100.0
POSTURES = 7
"""Postures drawn of a run, even in time; more cannot be told apart."""
VIEWS = (("from the side: x, z", 0, 2), ("from above: x, y", 0, 1))


def excitation_html(needs: Requirements, runs: Sequence[Run], margins: Sequence[Margin]) -> str:
    """The page.

    Args:
        needs: What the runs keep; its model predicts the torque shown.
        runs: File name and trajectory; the full run first.
        margins: Of the full run, one a kind of limit.
    """
    arm = needs.identified.model.arm
    return render(
        "excitation.html",
        arm=arm,
        nearest=max(margins, key=lambda margin: margin.used),
        margins=margins,
        runs=[
            {
                "name": name,
                "duration_s": run.duration_s,
                "signals": _signals(needs, run),
                "postures": _postures(arm, run),
            }
            for name, run in runs
        ],
    )


def write_page(path: Path, text: str) -> None:
    """Write the page.

    Args:
        path: File to write; an older one is replaced.
        text: The page as HTML, of `excitation_html`.

    Raises:
        UserError: It cannot be written.
    """
    try:
        write_whole(path, text)
    except OSError as error:
        raise UserError(f"cannot write {path} ({error.strerror or error}): choose another --out") from error


def _signals(needs: Requirements, run: Trajectory) -> Markup:
    """Position, velocity and torque of every joint over time."""
    times = np.arange(0.0, run.duration_s, 1.0 / RATE_HZ)
    arm, motion = needs.identified.model.arm, run.evaluate(times)
    torque = model_torque(needs.identified, motion, RATE_HZ)
    limits = needs.motion
    with grid(3 * len(arm.joints), 3, 1.25, left_in=0.55, below_in=0.3) as (figure, axes):
        for j, joint in enumerate(arm.joints):
            panels = (
                (motion.q, limits.lower[j], limits.upper[j], joint.units.position),
                (motion.qd, -limits.velocity[j], limits.velocity[j], joint.units.velocity),
                (torque, -needs.torque_Nm[j], needs.torque_Nm[j], joint.units.effort),
            )
            for k, (values, low, high, unit) in enumerate(panels):
                ax, kept = axes[3 * j + k], decimated(values[:, j], most=600)
                ax.plot(times[kept], values[kept, j], color=COLOUR["predicted"], linewidth=0.9)
                _limits(ax, values[:, j], low, high)
                ax.set_title(f"{joint.name}, {unit_text(unit)}" if k == 0 else unit_text(unit))
        return to_svg(figure, f"Motion and torque of {len(arm.joints)} joints over {run.duration_s:.0f} s")


def _limits(ax: object, values: FloatArray, low: float, high: float) -> None:
    """The limits as dashed lines where the panel, which shows the values with room, reaches them."""
    span = max(float(np.ptp(values)), 1e-6)
    bottom, top = float(values.min()) - 0.5 * span, float(values.max()) + 0.5 * span
    shown = [limit for limit in (low, high) if np.isfinite(limit) and bottom <= limit <= top]
    for limit in shown:
        ax.axhline(limit, color=COLOUR["residual"], linewidth=0.8, linestyle="--")  # type: ignore[attr-defined]


def _postures(arm: Arm, run: Trajectory) -> Markup:
    model = pin.buildModelFromXML(bounded(arm.urdf))
    data = model.createData()
    tips = [f for f, frame in enumerate(model.frames) if frame.type == pin.FrameType.BODY]

    def chain(posture: FloatArray) -> FloatArray:
        """(points, 3) m: the base, every joint, and the farthest link frame behind the last."""
        pin.forwardKinematics(model, data, posture)
        pin.updateFramePlacements(model, data)
        points = [np.zeros(3), *(data.oMi[k].translation.copy() for k in range(1, model.njoints))]
        behind = [data.oMf[f].translation.copy() for f in tips if model.frames[f].parentJoint == model.njoints - 1]
        far = max(behind, key=lambda point: float(np.linalg.norm(point - points[-1])), default=points[-1])
        return np.array([*points, far])

    postures = run.evaluate(np.linspace(0.0, run.duration_s, POSTURES + 2)[:-1]).q
    chains = [chain(posture) for posture in postures]
    with grid(2, 2, 4.2, left_in=0.6) as (figure, axes):
        for ax, (words, one, other) in zip(axes, VIEWS):
            for k, points in enumerate(chains):
                ax.plot(
                    points[:, one],
                    points[:, other],
                    color=COLOUR["ink"] if k == 0 else COLOUR["predicted"],
                    linewidth=2.2 if k == 0 else 0.9,
                    marker="o",
                    markersize=2.5,
                )
            ax.set_aspect("equal", adjustable="datalim")
            ax.set_title(words)
        return to_svg(figure, f"{arm.name} in {len(chains)} postures of the run, from the side and from above")
