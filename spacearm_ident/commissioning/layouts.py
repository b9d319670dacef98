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


def foxglove_layout(joints: Sequence[str]) -> str:
    """Text of a layout file for Foxglove and Lichtblick."""
    panels: dict[str, Any] = {}

    def plot(title: str, paths: Sequence[tuple[str, str, str]]) -> str:
        name = f"Plot!{len(panels)}"
        panels[name] = _plot(title, paths)
        return name

    torques = [
        plot(f"{joint}: torque, N·m", [(label, f"{topic}.effort[{k}]", colour) for label, topic, colour in TORQUES])
        for k, joint in enumerate(joints)
    ]
    parameters = [
        plot(words, [(j, _value(PARAMETERS, f"{symbol}[{j}]", "value"), _colour(k)) for k, j in enumerate(joints)])
        for symbol, words in SYMBOLS.items()
    ]
    rms = [
        (joint, _value(DIAGNOSTICS, RESIDUAL_PART, f"rms_Nm[{joint}]"), _colour(k)) for k, joint in enumerate(joints)
    ]
    parameters.append(plot("residual, RMS of ten seconds, N·m", rms))
    cycle = [
        plot(words, [(key, _value(DIAGNOSTICS, DRIVER, key), _colour(k)) for k, key in enumerate(keys)])
        for words, keys in CYCLE.items()
    ]
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
    tabs = {"torque": _grid(torques), "parameters": _stack(parameters), "cycle": _stack([*cycle, "RawMessages!0"])}
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


def _plot(title: str, paths: Sequence[tuple[str, str, str]]) -> dict[str, Any]:
    """A panel of curves, each a label, a message path and a colour."""
    return {
        "title": title,
        "paths": [
            {"value": path, "label": label, "color": colour, "enabled": True, "timestampMethod": "headerStamp"}
            for label, path, colour in paths
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
    """Text of a layout file for PlotJuggler; `arm` is the hardware id of the diagnostics, the arm's name."""
    root = ET.Element("root")
    window = ET.SubElement(root, "tabbed_widget", {"name": "Main Window", "parent": "main_window"})
    _tab(
        window,
        "torque",
        {
            f"{joint}: torque, N·m": [(f"{topic}/{joint}/effort", colour) for _, topic, colour in TORQUES]
            for joint in joints
        },
    )
    parameters = {
        words: [(f"{PARAMETERS}/{arm}/{symbol}[{joint}]/value", _colour(k)) for k, joint in enumerate(joints)]
        for symbol, words in SYMBOLS.items()
    }
    parameters["residual, RMS of ten seconds, N·m"] = [
        (f"{DIAGNOSTICS}/{arm}/{RESIDUAL_PART}/rms_Nm[{joint}]", _colour(k)) for k, joint in enumerate(joints)
    ]
    _tab(window, "parameters", parameters)
    _tab(
        window,
        "cycle",
        {
            words: [(f"{DIAGNOSTICS}/{arm}/{DRIVER}/{key}", _colour(k)) for k, key in enumerate(keys)]
            for words, keys in CYCLE.items()
        },
    )
    ET.SubElement(window, "currentTabIndex", index="0")
    ET.SubElement(root, "use_relative_time_offset", enabled="1")
    ET.SubElement(root, "previouslyLoaded_Datafiles")
    ET.SubElement(root, "customMathEquations")
    ET.SubElement(root, "snippets")
    ET.indent(root, " ")
    return f"<?xml version='1.0' encoding='UTF-8'?>\n{ET.tostring(root, encoding='unicode')}\n"


def _tab(window: ET.Element, name: str, plots: dict[str, list[tuple[str, str]]]) -> None:
    tab = ET.SubElement(window, "Tab", containers="1", tab_name=name)
    sizes = ";".join([f"{1 / len(plots):.6f}"] * len(plots))
    box = ET.SubElement(tab, "Container")
    splitter = ET.SubElement(box, "DockSplitter", orientation="-", count=str(len(plots)), sizes=sizes)
    for title, curves in plots.items():
        area = ET.SubElement(splitter, "DockArea", name=title)
        plot = ET.SubElement(area, "plot", mode="TimeSeries", style="Lines", flip_x="false", flip_y="false")
        ET.SubElement(plot, "range", left="0.0", right=str(WINDOW_S), bottom="-1.0", top="1.0")
        ET.SubElement(plot, "limitY")
        for curve, colour in curves:
            ET.SubElement(plot, "curve", name=curve, color=colour)


def _value(topic: str, status: str, key: str) -> str:
    """Foxglove's path of one value of one status."""
    return f"{topic}.status[:]{{name=={json.dumps(status)}}}.values[:]{{key=={json.dumps(key)}}}.value"


def _colour(number: int) -> str:
    return COLOURS[number % len(COLOURS)]


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
