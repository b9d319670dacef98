"""Further figures of an identification's page: motion, residual spectrum, correlations, masses on the arm."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import pinocchio as pin
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from ..arrays import FloatArray
from ..dynamics.arm import Arm
from ..dynamics.urdf_chain import bounded
from ..estimate.identified import Determination, Estimate, Identified, Spectrum
from ..results.recorded_runs import RecordedRun
from .figures import name_axes, short
from .plotting import COLOUR, grid, to_svg
from .text import SUPERSCRIPT

LARGEST_DISC_PT = 26.0
"""Diameter of the heaviest link's disc on the drawing of the arm, points."""
POSITIVE, NEGATIVE = "#3f8fd2", "#d9762b"
"""Colours of correlations, readable on light and dark pages: the squares are a picture within the figure."""
SHOWN_CORRELATION = 0.02
"""Absolute correlation under which a cell stays empty; ratio."""


def motion(run: RecordedRun, arm: Arm) -> Markup:
    """Position of every joint over time, with its limits where they are near.

    Args:
        run: Recording with its positions, thinned; joints in the order of the arm.
        arm: Names, units and position limits of its joints. A limit is drawn within half the range of the axis beyond
            it.
    """
    with grid(len(arm.joints), 3, 1.5) as (figure, panels):
        for k, (axes, joint) in enumerate(zip(panels, arm.joints)):
            position = run.position[:, k]
            axes.plot(run.time, position, color=COLOUR["predicted"], linewidth=0.9)
            low, high = axes.get_ylim()
            for limit in (joint.lower, joint.upper):
                if np.isfinite(limit) and low - 0.5 * (high - low) < limit < high + 0.5 * (high - low):
                    axes.axhline(limit, color=COLOUR["residual"], linewidth=0.9, linestyle="--")
            name_axes(axes, joint.name, "time, s", joint.units.position)
        return to_svg(figure, f"Joint positions over time in {run.name}, one panel a joint")


def spectrum(spectrum: Spectrum, cutoff_hz: float, arm: Arm) -> Markup:
    """Power spectral density of unfiltered torque and residual, a panel a joint, with the bandwidth of the fit.

    Args:
        spectrum: (F, n) densities of torque and residual, (N·m)²/Hz or N²/Hz.
        cutoff_hz: Bandwidth of the fit, Hz.
        arm: The arm, for names and units.
    """
    with grid(len(arm.joints), 3, 1.8, left_in=0.6) as (figure, panels):
        for k, (axes, joint) in enumerate(zip(panels, arm.joints)):
            for density, role in ((spectrum.torque, "measured"), (spectrum.residual, "residual")):
                positive = density[:, k] > 0.0
                axes.loglog(spectrum.frequency[positive], density[positive, k], color=COLOUR[role], linewidth=1.2)
            for axis in (axes.xaxis, axes.yaxis):
                axis.set_major_locator(LogLocator(numticks=5))
                axis.set_major_formatter(FuncFormatter(lambda value, _: power_of_ten(value)))
                axis.set_minor_locator(NullLocator())
            axes.axvline(cutoff_hz, color=COLOUR["muted"], linewidth=0.8, linestyle="--")
            unit = "(N·m)²/Hz" if joint.revolute else "N²/Hz"
            axes.set_title(short(joint.name, 26))
            axes.set_xlabel("frequency, Hz", labelpad=1)
            axes.set_ylabel(unit, labelpad=2)
        return to_svg(figure, "Power spectral density of torque and residual, one panel a joint")


def power_of_ten(value: float) -> str:
    """A tick of a logarithmic axis: `0.1`, `1`, `10`, `100`, then `10⁻⁴`."""
    if not value > 0.0:
        return ""
    exponent = round(math.log10(value))
    return f"{value:g}" if -1 <= exponent <= 3 else f"10{str(exponent).translate(SUPERSCRIPT)}"


def correlation(covariance: FloatArray) -> FloatArray:
    """(k, k) correlations of a covariance (k, k); 0 beside what has no variance."""
    deviation = np.sqrt(np.diag(covariance))
    scale = np.divide(1.0, deviation, out=np.zeros_like(deviation), where=deviation > 0.0)
    return np.asarray(np.clip(covariance * np.outer(scale, scale), -1.0, 1.0))


def correlations(names: Sequence[str], matrix: FloatArray) -> Markup:
    """The correlations of parameters as a matrix of squares: area is size, colour is sign.

    Args:
        names: Names of the parameters; long ones are shortened.
        matrix: (k, k) correlation coefficients in the order of `names`; those up to `SHOWN_CORRELATION` are not drawn.
    """
    count = len(names)
    side = min(8.4, 1.6 + 0.17 * count)
    with grid(1, 1, side, left_in=1.5, below_in=1.25) as (figure, (axes,)):
        rows, columns = np.nonzero(np.abs(matrix) > SHOWN_CORRELATION)
        size = 72.0 * (side - 1.6) / max(count, 1)
        values = matrix[rows, columns]
        for chosen, colour in ((values > 0.0, POSITIVE), (values < 0.0, NEGATIVE)):
            area = np.abs(values[chosen]) * size**2
            where = columns[chosen], rows[chosen]
            axes.scatter(*where, s=area, marker="s", color=colour, linewidths=0, rasterized=True)
        axes.set_xticks(range(count), [short(name, 22) for name in names], rotation=90, fontsize=6.5)
        axes.set_yticks(range(count), [short(name, 22) for name in names], fontsize=6.5)
        axes.set_xlim(-0.6, count - 0.4)
        axes.set_ylim(count - 0.4, -0.6)
        axes.set_aspect("equal", anchor="NW")
        return to_svg(figure, "Correlations of the parameters that the data determine")


def masses(identified: Identified, pose: FloatArray) -> Markup:
    """The arm from the side that shows it largest, each link's mass as a disc at its centre: CAD ring, identified disc.

    Args:
        identified: Masses and centres.
        pose: (n,) rad or m that the arm is drawn in.
    """
    arm = identified.model.model.arm
    found = {(item.joint, item.symbol): item for item in identified.estimates}
    origins, rotations = _frames(arm, pose)
    seen = _side(origins)
    heaviest = max([1e-9, *(float(joint.inertial[0]) for joint in arm.joints), *_masses(arm, found)])
    with grid(1, 1, 4.2, left_in=0.5) as (figure, (axes,)):
        chain = np.vstack([np.zeros(3), origins]) @ seen.T
        for k, joint in enumerate(arm.joints):
            ends = chain[[joint.parent + 1, k + 1]]
            axes.plot(ends[:, 0], ends[:, 1], color=COLOUR["muted"], linewidth=2.5, solid_capstyle="round", zorder=1)
        axes.plot(*chain[1:].T, "o", markersize=3.5, color=COLOUR["ink"], zorder=2)
        for k, joint in enumerate(arm.joints):
            mass = found.get((joint.name, "m"))
            cad = joint.inertial
            if cad[0] > 0.0:
                _disc(axes, _centre(cad, origins[k], rotations[k]) @ seen.T, cad[0] / heaviest, "prior", filled=False)
            if mass is not None and mass.value > 0.0:
                moments = [found[joint.name, name].value if (joint.name, name) in found else 0.0 for name in _MOMENTS]
                place = _centre(np.array([mass.value, *moments]), origins[k], rotations[k]) @ seen.T
                role = "data" if mass.determination is Determination.DATA else "measured"
                _disc(axes, place, mass.value / heaviest, role, filled=True)
                axes.annotate(
                    str(k + 1),
                    (float(place[0]), float(place[1])), (8, 4 + 9 * (k % 2)),
                    textcoords="offset points", fontsize=8.5, color=COLOUR["ink"],
                )  # fmt: skip
        axes.set_aspect("equal", adjustable="datalim")
        axes.margins(0.22)
        axes.set_xlabel("m", labelpad=1)
        axes.set_ylabel("m", labelpad=2)
        return to_svg(figure, "Masses of the links on a drawing of the arm, identified and CAD")


_MOMENTS = ("mcx", "mcy", "mcz")


def _masses(arm: Arm, found: Mapping[tuple[str, str], Estimate]) -> list[float]:
    return [found[name, "m"].value for name in arm.joint_names if (name, "m") in found]


def _disc(axes: Axes, place: FloatArray, share: float, role: str, filled: bool) -> None:
    """A disc whose area is a mass."""
    axes.plot(
        [place[0]], [place[1]], "o", markersize=max(2.5, LARGEST_DISC_PT * float(np.sqrt(share))),
        color=COLOUR[role], markerfacecolor=COLOUR[role] if filled else "none", alpha=0.75 if filled else 1.0,
        markeredgewidth=0.0 if filled else 1.2, zorder=3 if filled else 4,
    )  # fmt: skip


def _centre(inertial: FloatArray, origin: FloatArray, rotation: FloatArray) -> FloatArray:
    """(3,) centre of mass in the base frame, m."""
    return np.asarray(origin + rotation @ (np.asarray(inertial[1:4]) / inertial[0]))


def _frames(arm: Arm, pose: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n, 3) origins and (n, 3, 3) rotations of the joint frames in the base frame."""
    model = pin.buildModelFromXML(bounded(arm.urdf))
    data = model.createData()
    pin.forwardKinematics(model, data, np.asarray(pose, dtype=float))
    places = [data.oMi[model.getJointId(name)] for name in arm.joint_names]
    return np.array([place.translation for place in places]), np.array([place.rotation for place in places])


def _side(origins: FloatArray) -> FloatArray:
    """(2, 3) horizontal axis along which the arm reaches farthest, and the vertical one."""
    flat = np.vstack([np.zeros(2), origins[:, :2]])
    _, sizes, axes = np.linalg.svd(flat - flat.mean(axis=0))
    across = axes[0] if sizes[0] > 1e-6 else np.array([1.0, 0.0])
    across = across if across @ (flat[-1] - flat[0]) >= 0.0 else -across
    return np.array([[*across, 0.0], [0.0, 0.0, 1.0]])
