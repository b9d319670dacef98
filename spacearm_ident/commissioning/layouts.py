"""Layouts of the live graph for Foxglove or Lichtblick, and for PlotJuggler, made for an arm's joints.

Both show a joint's measured and predicted torque and the residual, friction parameters as they are published, and
what the nodes say of themselves. `config/` holds those of the paper's arm, `spacearm new-arm` writes one's own.

Names: Foxglove addresses a `JointState` by place in the array, a diagnostic value by filters on its names.
PlotJuggler's ROS parser calls a joint's torque `/TOPIC/JOINT/effort` and a diagnostic value
`/TOPIC/HARDWARE_ID/STATUS/KEY`; values that are not numbers are no series.
"""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from typing import Any, Final

FOXGLOVE: Final = "foxglove_layout.json"
PLOTJUGGLER: Final = "plotjuggler_layout.xml"
STATES, PREDICTED, RESIDUALS = "/joint_states", "/identifier/predicted", "/identifier/residuals"
PARAMETERS, DIAGNOSTICS = "/identifier/parameters", "/diagnostics"
TORQUES: Final = (
    ("measured", STATES, "#98a3b2"),
    ("predicted", PREDICTED, "#1668b8"),
    ("residual", RESIDUALS, "#c2410c"),
)
COLOURS: Final = ("#1668b8", "#c2410c", "#15803d", "#7c3aed", "#a16207", "#0e7490", "#be185d", "#5c6775")
SYMBOLS: Final = {"f_c": "Coulomb friction, N·m", "k_v1": "viscous friction, N·m·s/rad"}
DRIVER: Final = "canopen_driver"
RESIDUAL_PART: Final = "identifier: residual"
CYCLE: Final = {
    "lateness, µs": ("lateness_p50_us", "lateness_p99_us", "lateness_p999_us"),
    "cycles that went wrong": ("missed_cycles", "incomplete_cycles", "late_frames"),
}
WINDOW_S: Final = 20.0


Curve = tuple[str, str, str, str]
"""Label, Foxglove's path, PlotJuggler's name, colour."""


def _tabs(arm: str, joints: Sequence[str]) -> dict[str, dict[str, list[Curve]]]:
    """Tab -> title of a plot -> its curves; `arm` is the hardware id of the diagnostics, for PlotJuggler alone."""

    def value(label: str, topic: str, status: str, key: str, number: int) -> Curve:
        path = f"{topic}.status[:]{{name=={json.dumps(status)}}}.values[:]{{key=={json.dumps(key)}}}.value"
        return label, path, f"{topic}/{arm}/{status}/{key}", COLOURS[number % len(COLOURS)]

    parameters = {
        words: [value(joint, PARAMETERS, f"{symbol}[{joint}]", "value", k) for k, joint in enumerate(joints)]
        for symbol, words in SYMBOLS.items()
    }
    parameters["residual, RMS of ten seconds, N·m"] = [
        value(joint, DIAGNOSTICS, RESIDUAL_PART, f"rms_Nm[{joint}]", k) for k, joint in enumerate(joints)
    ]
    return {
        "torque": {
            f"{joint}: torque, N·m": [
                (label, f"{topic}.effort[{k}]", f"{topic}/{joint}/effort", colour) for label, topic, colour in TORQUES
            ]
            for k, joint in enumerate(joints)
        },
        "parameters": parameters,
        "cycle": {
            words: [value(key, DIAGNOSTICS, DRIVER, key, k) for k, key in enumerate(keys)]
            for words, keys in CYCLE.items()
        },
    }


def foxglove_layout(joints: Sequence[str]) -> str:
    """Text of a layout file for Foxglove and Lichtblick."""
    panels: dict[str, Any] = {}
    shown: dict[str, list[str]] = {}
    for tab, plots in _tabs("", joints).items():
        shown[tab] = [f"Plot!{len(panels) + k}" for k in range(len(plots))]
        panels |= {name: _plot(title, curves) for name, (title, curves) in zip(shown[tab], plots.items())}
    panels["DiagnosticSummary!0"] = {
        "minLevel": 0,
        "pinnedIds": [],
        "hardwareIdFilter": "",
        "topicToRender": DIAGNOSTICS,
        "sortByLevel": True,
    }
    panels["RawMessages!0"] = {
        "topicPath": f"{DIAGNOSTICS}.status[:]{{name=={json.dumps(DRIVER)}}}",
        "diffEnabled": False,
    }
    tabs = {
        "torque": _grid(shown["torque"]),
        "parameters": _stack(shown["parameters"]),
        "cycle": _stack([*shown["cycle"], "RawMessages!0"]),
    }
    panels["Tab!0"] = {
        "activeTabIdx": 0,
        "tabs": [{"title": title, "layout": layout} for title, layout in tabs.items()],
    }
    layout = {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": {"direction": "row", "first": "DiagnosticSummary!0", "second": "Tab!0", "splitPercentage": 25},
    }
    return json.dumps(layout, indent=1, ensure_ascii=False) + "\n"


def _plot(title: str, curves: Sequence[Curve]) -> dict[str, Any]:
    return {
        "title": title,
        "paths": [
            {"value": path, "label": label, "color": colour, "enabled": True, "timestampMethod": "headerStamp"}
            for label, path, _, colour in curves
        ],
        "showLegend": True,
        "legendDisplay": "floating",
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "isSynced": True,
        "xAxisVal": "timestamp",
        "followingViewWidth": WINDOW_S,
    }


def plotjuggler_layout(arm: str, joints: Sequence[str]) -> str:
    """Text of a layout file for PlotJuggler; `arm` is the hardware id of the diagnostics, the arm's name.

    Args:
        arm: Part of the names of diagnostic values, as PlotJuggler's ROS parser makes them.
        joints: Names as in the joint states, in the order of the plots.
    """
    root = ET.Element("root")
    window = ET.SubElement(root, "tabbed_widget", {"name": "Main Window", "parent": "main_window"})
    for name, plots in _tabs(arm, joints).items():
        _tab(window, name, plots)
    ET.SubElement(window, "currentTabIndex", index="0")
    ET.SubElement(root, "use_relative_time_offset", enabled="1")
    ET.SubElement(root, "previouslyLoaded_Datafiles")
    ET.SubElement(root, "customMathEquations")
    ET.SubElement(root, "snippets")
    ET.indent(root, " ")
    return f"<?xml version='1.0' encoding='UTF-8'?>\n{ET.tostring(root, encoding='unicode')}\n"


def _tab(window: ET.Element, name: str, plots: dict[str, list[Curve]]) -> None:
    tab = ET.SubElement(window, "Tab", containers="1", tab_name=name)
    sizes = ";".join([f"{1 / len(plots):.6f}"] * len(plots))
    box = ET.SubElement(tab, "Container")
    splitter = ET.SubElement(box, "DockSplitter", orientation="-", count=str(len(plots)), sizes=sizes)
    for title, curves in plots.items():
        area = ET.SubElement(splitter, "DockArea", name=title)
        plot = ET.SubElement(area, "plot", mode="TimeSeries", style="Lines", flip_x="false", flip_y="false")
        ET.SubElement(plot, "range", left="0.0", right=str(WINDOW_S), bottom="-1.0", top="1.0")
        ET.SubElement(plot, "limitY")
        for _, _, curve, colour in curves:
            ET.SubElement(plot, "curve", name=curve, color=colour)


def _stack(panels: Sequence[str], direction: str = "column") -> Any:
    """Panels of equal size, one after the other: a mosaic is a binary tree."""
    if len(panels) == 1:
        return panels[0]
    return {
        "direction": direction,
        "first": panels[0],
        "second": _stack(panels[1:], direction),
        "splitPercentage": 100 / len(panels),
    }


def _grid(panels: Sequence[str]) -> Any:
    """Panels in two columns where there are more than three."""
    if len(panels) <= 3:
        return _stack(panels)
    half = -(-len(panels) // 2)
    return {
        "direction": "row",
        "first": _stack(panels[:half]),
        "second": _stack(panels[half:]),
        "splitPercentage": 50,
    }
