"""Figures of an adaptation: how well each model predicts, and friction over temperature."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from ..bayes.adaptation import Adaptation
from ..dynamics.friction import WARM_FROM
from ..estimate.identified import Validation
from .figures import name_axes
from .plotting import COLOUR, grid, to_svg

ROLES = ("muted", "before", "residual", "after")
"""Colour of the four models: ground on the ground, in orbit as it is, with gravity only, adapted."""


def fits(validations: Sequence[Validation], names: Sequence[str], wanted_r: float) -> Markup:
    """Correlation R and relative residual of every model, joint by joint.

    Args:
        validations: One for each model, in the order of `orbit_html.MODELS`.
        names: Names of the models, for the description of the figure.
        wanted_r: Required correlation R, drawn as a dashed line.
    """
    joints = list(validations[0].joints)
    with grid(2, 2, 2.3, left_in=0.6) as (figure, (left, right)):
        width = 0.8 / len(validations)
        for k, (validation, role) in enumerate(zip(validations, ROLES)):
            places = np.arange(len(joints)) + (k - (len(validations) - 1) / 2) * width
            r = [np.nan_to_num(validation.joints[joint].everything.correlation) for joint in joints]
            left.plot(places, r, "o", markersize=4.5, color=COLOUR[role], markeredgewidth=0)
            shares = [100 * validation.joints[joint].moving.relative_rms for joint in joints]
            right.bar(places, shares, 0.9 * width, color=COLOUR[role], linewidth=0)
        left.axhline(wanted_r, color=COLOUR["ink"], linewidth=0.7, linestyle="--")
        right.set_yscale("log")
        for axes, title, label in (
            (left, f"R of torque and prediction; dashed {wanted_r:g}", "R"),
            (right, "Residual RMS over torque RMS, moving", "%"),
        ):
            name_axes(axes, title, "joint", label)
            axes.set_title(title)
            axes.set_xticks(range(len(joints)))
            axes.set_xticklabels([str(k + 1) for k in range(len(joints))])
        right.yaxis.set_major_locator(LogLocator())
        right.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        right.yaxis.set_minor_formatter(NullFormatter())
        return to_svg(figure, f"R and residual by joint: {', '.join(names)}")


def over_temperature(adaptation: Adaptation) -> Markup:
    """Coulomb friction of single runs over their temperature, the adapted model's line, and the ground's level."""
    model, ground, levels = adaptation.adapted, adaptation.ground, adaptation.levels
    names = model.model.arm.joint_names
    slopes = {change.joint: change for change in adaptation.changes if change.symbol == "alpha_c"}
    with grid(len(names), 3, 1.95) as (figure, panels):
        for axes, (joint, name) in zip(panels, enumerate(names)):
            warm, level = levels.temperature[:, joint], levels.level[:, joint]
            axes.errorbar(
                warm, level, 2 * levels.error[:, joint], fmt="o", markersize=3.5, color=COLOUR["after"], linewidth=1.0
            )
            if name in slopes and np.isfinite(warm).any():
                line = np.array([min(np.nanmin(warm), WARM_FROM), max(np.nanmax(warm), WARM_FROM)])
                law = model.value("f_c", name) + slopes[name].after * (line - WARM_FROM)
                axes.plot(line, law, color=COLOUR["ink"], linewidth=1.0)
            axes.plot(WARM_FROM, ground.value("f_c", name), "s", markersize=4, color=COLOUR["before"])
            name_axes(axes, name, "joint temperature, °C", "f_c, N·m")
        return to_svg(figure, "Coulomb friction over temperature, one panel a joint")
