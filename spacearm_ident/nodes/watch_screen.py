"""The screen of `spacearm watch`: a `View` as rich tables."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rich.console import Group, RenderableType
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from ..canbus.cia402 import State
from .watch_state import Cycle, JointRow, NodeRow, ParameterRow, Run, View

STYLES = {"ok": "green", "warn": "yellow", "error": "bold red", "silent": "magenta"}
LATE_US = 300.0
"""Lateness at 99.9 % from which a cycle of a millisecond is worth a look."""
MOVED, FAR = 1.0, 3.0
"""Standard errors a parameter may move between two sets before it is marked, and marked as far."""
BLOCKS = "▁▂▃▄▅▆▇█"
BAR = 30


def screen(view: View) -> RenderableType:
    """All of it, from what stops the arm to what is being learnt."""
    parts: list[RenderableType] = [_title(view), _nodes(view.nodes)]
    if view.joints:
        parts.append(_joints(view.joints))
    if view.cycle is not None:
        parts.append(_cycle(view.cycle))
    if view.run is not None:
        parts.append(_run(view.run))
    if view.identifying is not None:
        parts.append(_bar("identifying", view.identifying, f"{view.identifying:.0%}"))
    if view.identification:
        parts.append(Text.assemble(("identification  ", "bold"), view.identification))
    if view.parameters_total:
        parts.append(_parameters(view))
    return Group(*parts)


def _title(view: View) -> Text:
    rate = "no joint states" if view.rate_hz is None else f"joint states {view.rate_hz:.0f} Hz"
    style = "yellow" if view.rate_hz is None else "green"
    return Text.assemble((view.arm or "arm not known yet", "bold"), "   ", (rate, style))


def _table(*columns: str, right: Sequence[str] = ()) -> Table:
    table = Table(box=None, pad_edge=False, header_style="dim", padding=(0, 2, 0, 0))
    for column in columns:
        table.add_column(column, justify="right" if column in right else "left", overflow="fold")
    return table


def _nodes(nodes: Sequence[NodeRow]) -> Table:
    table = _table("node", "is", "says")
    for node in nodes:
        table.add_row(Text(node.name), Text(node.level, STYLES[node.level]), Text(node.message))
    return table


def _joints(joints: Sequence[JointRow]) -> Table:
    numbers = ("position rad", "torque N m", "residual N m RMS", "°C")
    table = _table("joint", "drive", *numbers, right=numbers)
    for joint in joints:
        enabled = joint.drive == State.OPERATION_ENABLED.label
        style = "green" if enabled else "bold red" if "fault" in joint.drive.lower() else "yellow"
        table.add_row(
            Text(joint.name),
            Text(joint.drive or "–", style if joint.drive else "dim"),
            _figure(joint.position, 4),
            _figure(joint.torque, 2),
            _figure(joint.residual_rms, 3),
            _figure(joint.temperature, 1),
        )
    return table


def _figure(value: float | None, decimals: int) -> Text:
    return Text("–", "dim") if value is None or not math.isfinite(value) else Text(f"{value:.{decimals}f}")


def _cycle(cycle: Cycle) -> Text:
    wrong = cycle.missed or cycle.incomplete
    late = " / ".join(f"{value:.0f}" for value in cycle.lateness_us)
    worst = cycle.lateness_us[-1] if cycle.lateness_us else math.nan
    line = Text.assemble(
        ("cycle  ", "bold"),
        f"{cycle.cycles} cycles, ",
        (f"{cycle.missed} missed, {cycle.incomplete} incomplete", "yellow" if wrong else "green"),
        f", {cycle.late_frames} late frames; begins late by ",
        (f"{late} µs", "yellow" if worst > LATE_US else "green"),
        " (50 / 99 / 99.9 %)",
    )
    for number, load in enumerate(cycle.loads):
        line.append(f"\nbus {number}  ", "bold")
        line.append(load)
    return line


def _run(run: Run) -> RenderableType:
    words = f"{run.state}, period {run.period} of {run.periods}" if run.period else run.state
    if run.reason:
        words += f": {run.reason}"
    return _bar("run", run.done, words, "yellow" if run.reason else "green")


def _bar(name: str, done: float, words: str, style: str = "cyan") -> Table:
    grid = Table.grid(padding=(0, 2, 0, 0))
    bar = ProgressBar(total=1.0, completed=min(max(done, 0.0), 1.0), width=BAR, complete_style=style)
    grid.add_row(Text(name, "bold"), bar, Text(words))
    return grid


def _parameters(view: View) -> RenderableType:
    title = Text.assemble(
        ("parameters  ", "bold"),
        f"{view.known} of {view.parameters_total} with a standard error; those that moved most",
    )
    if not view.parameters:
        return title
    numbers = ("value", "± standard error", "moved, errors")
    table = _table("parameter", *numbers, "errors so far", right=numbers)
    for row in view.parameters:
        table.add_row(Text(row.name), *_parameter(row), Text(spark(row.errors), "cyan"))
    return Group(title, table)


def _parameter(row: ParameterRow) -> tuple[Text, Text, Text]:
    unit = "" if row.unit == "1" else f" {row.unit}"
    if row.change is None:
        moved = Text("–", "dim")
    else:
        size = abs(row.change)
        moved = Text(f"{row.change:+.1f}", "bold red" if size > FAR else "yellow" if size > MOVED else "green")
    return Text(f"{row.value:.5g}"), Text(f"{row.error:.2g}{unit}"), moved


def spark(values: Sequence[float]) -> str:
    """Positive values as blocks, the largest full; falling blocks are converging errors. Empty for a single one."""
    largest = max(values, default=0.0)
    if len(values) < 2 or not largest > 0:
        return ""
    return "".join(BLOCKS[round((len(BLOCKS) - 1) * max(value, 0.0) / largest)] for value in values)
