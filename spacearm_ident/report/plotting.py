"""Matplotlib figures as inline SVG that follows the page: its fonts, its colours, light and dark.

Figures are drawn in stand-in colours, one a role; in the SVG each becomes the CSS variable of that role, so one
drawing serves both colour schemes and print. Point clouds are rasterised, in colours that stand out on either.
"""

from __future__ import annotations

import gc
import io
import re
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from typing import Any

import matplotlib as mpl
import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ..arrays import FloatArray

ROLES = (
    *("ink", "muted", "line", "band", "measured", "predicted", "residual"),
    *("data", "combined", "bound", "prior", "fixed", "before", "after"),
)
COLOUR = {role: f"#0{k:x}0{k:x}0{k:x}" for k, role in enumerate(ROLES, start=1)}
"""Role -> stand-in colour; the page's style sheet defines a variable of each name."""
CLOUD_MOVING, CLOUD_STANDING = "#3f8fd2", "#9a9a9a"
WIDTH_IN = 10.0
"""Width of every figure: 720 units of the SVG, which the page scales to its column."""
RASTER_DPI = 170
MOST_POINTS = 1500

_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "spacearm_ident",
    "text.parse_math": False,
    "font.size": 8,
    "axes.titlesize": 8.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titlepad": 4,
    "axes.titley": 1.0,  # where it would be put anyway, without measuring every label of the axes
    "axes.labelsize": 8,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.facecolor": "none",
    "axes.edgecolor": COLOUR["muted"],
    "axes.labelcolor": COLOUR["muted"],
    "axes.titlecolor": COLOUR["ink"],
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.unicode_minus": True,
    "text.color": COLOUR["ink"],
    "grid.color": COLOUR["line"],
    "grid.linewidth": 0.5,
    "xtick.color": COLOUR["muted"],
    "ytick.color": COLOUR["muted"],
    "xtick.labelsize": 7.5,
    "ytick.labelsize": 7.5,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "figure.facecolor": "none",
    "path.simplify": True,
}
_METADATA = dict.fromkeys(("Creator", "Date", "Format", "Type"))
_FONT = re.compile(r"font-family: [^;\"]*;? ?|(?<=px) '[^;\"]*(?=[;\"])")
_GROUP_ID = re.compile(r"<g id=\"[^\"]*\"")
_NAMESPACE = re.compile(r" xmlns(:\w+)?=\"[^\"]*\"")
_PREAMBLE = re.compile(r"^.*?(?=<svg)|<metadata>.*?</metadata>|<style type=\"text/css\">.*?</style>", re.DOTALL)
_SIZE = re.compile(r" (?:width|height)=\"[\d.]+pt\"")


@contextmanager
def _drawing() -> Iterator[None]:
    """The report's style, and no search for garbage: thousands of objects, all of them in use until the figure is done.

    Going through them again and again takes a fifth of the time of a page.
    """
    collects = gc.isenabled()
    gc.disable()
    try:
        with mpl.rc_context(_STYLE):
            yield
    finally:
        if collects:
            gc.enable()


@contextmanager
def grid(
    count: int, columns: int, height_in: float, left_in: float = 0.6, below_in: float = 0.42
) -> Iterator[tuple[Figure, list[Axes]]]:
    """A figure with a grid of axes in the report's style; draw and convert it to SVG inside the block.

    Args:
        count: Number of axes.
        columns: Axes in a row; together they are `WIDTH_IN` wide.
        height_in: Height of a row, inches.
        left_in: Space left of each panel for its labels, inches.
        below_in: Space below each panel for its labels, inches.
    """
    with _drawing():
        rows = -(-count // columns)
        total, cell = height_in * rows, WIDTH_IN / columns
        figure = _figure(total)
        width, height = cell - left_in - 0.12, height_in - below_in - 0.28
        axes = []
        for k in range(count):
            row, column = divmod(k, columns)
            box = (column * cell + left_in, total - (row + 1) * height_in + below_in, width, height)
            axes.append(figure.add_axes(_share(box, total)))
        yield figure, axes


@contextmanager
def stacked(heights_in: Sequence[float], titled: bool = False) -> Iterator[tuple[Figure, list[Axes]]]:
    """Axes above each other that share the horizontal axis, with room for a title each; used as `grid` is.

    Args:
        heights_in: Height of each, inches, from the top.
        titled: Whether there is a title above each.
    """
    gap_in, below_in, above_in, left_in = (0.3, 0.42, 0.24, 0.62) if titled else (0.1, 0.42, 0.08, 0.62)
    with _drawing():
        total = sum(heights_in) + gap_in * (len(heights_in) - 1) + below_in + above_in
        figure = _figure(total)
        axes: list[Axes] = []
        top = total - above_in
        for height in heights_in:
            box = (left_in, top - height, WIDTH_IN - left_in - 0.12, height)
            axes.append(figure.add_axes(_share(box, total), sharex=axes[0] if axes else None))
            axes[-1].yaxis.set_major_locator(MaxNLocator(max(2, int(height / 0.3))))
            top -= height + gap_in
        for upper in axes[:-1]:
            upper.tick_params(labelbottom=False)
        figure.align_ylabels(axes)
        yield figure, axes


def _figure(height_in: float) -> Figure:
    figure = Figure(figsize=(WIDTH_IN, height_in))
    FigureCanvasSVG(figure)
    return figure


def _share(box_in: tuple[float, float, float, float], height_in: float) -> tuple[float, float, float, float]:
    left, bottom, width, height = box_in
    return left / WIDTH_IN, bottom / height_in, width / WIDTH_IN, height / height_in


def gapped_line(axes: Axes, x: FloatArray, y: FloatArray, most: int, **style: Any) -> None:
    """A line that keeps its extremes and its gaps.

    Args:
        axes: Where.
        x: (M,).
        y: (M,); NaN is a gap.
        most: About so many points are drawn.
        style: Of `Axes.plot`.
    """
    there = np.isfinite(y)
    kept = decimated(np.where(there, y, 0.0), most=most)
    edges = np.flatnonzero(np.diff(there.astype(int)))
    kept = np.unique(np.concatenate([kept, edges, edges + 1]))
    axes.plot(x[kept], y[kept], **style)


def to_svg(figure: Figure, described: str) -> Markup:
    """A figure as an inline `<svg>` with no size, fonts, namespaces or colours of its own.

    Args:
        figure: Drawn in the report's style.
        described: What a screen reader says of it.
    """
    buffer = io.StringIO()
    with warnings.catch_warnings():
        # The reader's browser draws the text, with fonts of its own.
        warnings.filterwarnings("ignore", "Glyph .* missing")
        figure.savefig(buffer, format="svg", dpi=RASTER_DPI, metadata=_METADATA, facecolor="none")
    text = _PREAMBLE.sub("", buffer.getvalue())
    head, rest = text.split(">", 1)
    head = _SIZE.sub("", _NAMESPACE.sub("", head))
    label = described.replace("&", "&amp;").replace('"', "&quot;").replace("<", "&lt;")
    rest = _GROUP_ID.sub("<g", _FONT.sub(_page_font, rest))
    for role, colour in COLOUR.items():
        rest = rest.replace(colour, f"var(--{role})")
    return Markup(f'{head} role="img" aria-label="{label}">{rest.strip()}')


def _page_font(found: re.Match[str]) -> str:
    """Leave the family to the page; matplotlib before 3.11 writes size and family as one property."""
    return "" if found[0].startswith("font-family") else " system-ui, sans-serif"


def decimated(*signals: FloatArray, most: int = MOST_POINTS) -> np.ndarray:
    """Samples to draw of signals of equal length, at most `most`: the extremes of each in every stretch, and ends.

    Every peak that could be seen stays, at its own sample.
    """
    count = len(signals[0])
    if count <= most:
        return np.arange(count)
    stretches = max(1, (most - 2) // (2 * len(signals)))
    edges = np.linspace(0, count, stretches + 1).astype(int)
    kept = {0, count - 1}
    for start, stop in pairwise(edges):
        for signal in signals:
            kept.update((start + int(np.argmin(signal[start:stop])), start + int(np.argmax(signal[start:stop]))))
    return np.array(sorted(kept))


def thinned(count: int, most: int = MOST_POINTS) -> np.ndarray:
    """At most `most` of `count` samples for a point cloud, evenly over all, always the same ones.

    Args:
        count: Number of samples.
        most: So many are kept.
    """
    if count <= most:
        return np.arange(count)
    return np.unique(np.random.default_rng(0).choice(count, most, replace=False))
