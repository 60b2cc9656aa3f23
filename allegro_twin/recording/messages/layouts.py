"""Layouts of Foxglove and PlotJuggler for a hand's bags and topics: the hand in 3-D, and plots by finger."""

from __future__ import annotations

import json
from functools import reduce
from typing import Any
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from allegro_twin.recording.messages.bag_topics import NAMESPACE, STATES
from allegro_twin.recording.messages.frames import LinkFrames
from allegro_twin.spec import HandSpec

_FIELDS = ("position", "velocity", "effort")
_COLORS = ("#1f77b4", "#ff7f0e", "#2ca02c", "#d62728", "#9467bd", "#8c564b")


def foxglove(spec: HandSpec) -> str:
    """JSON of a layout to import."""
    plots: dict[str, Any] = {}
    for finger in spec.fingers:
        for field in _FIELDS:
            plots[f"Plot!{finger.name}_{field}"] = {
                "foxglovePanelTitle": f"{finger.name}: {field}",
                "paths": [
                    {"value": f"{STATES}.{field}[{joint}]", "label": spec.joint_labels[joint], "enabled": True,
                     "timestampMethod": "receiveTime"}
                    for joint in finger.joints
                ],
                "showLegend": True,
                "isSynced": True,
                "xAxisVal": "timestamp",
            }  # fmt: skip
    scene = {
        "followTf": LinkFrames(spec).root,
        "layers": {
            "hand": {"layerId": "foxglove.Urdf", "instanceId": "hand", "label": spec.name, "sourceType": "topic",
                     "topic": f"{NAMESPACE}/robot_description", "visible": True},
            "grid": {"layerId": "foxglove.Grid", "instanceId": "grid", "size": 0.5, "divisions": 10, "visible": True},
        },
        "topics": {"/tf": {"visible": True}, "/tf_static": {"visible": True}},
    }  # fmt: skip
    rows = [_split([f"Plot!{finger.name}_{field}" for field in _FIELDS], "row") for finger in spec.fingers]
    layout = {"first": "3D!hand", "second": _split(rows, "column"), "direction": "row", "splitPercentage": 35}
    whole = {
        "configById": {"3D!hand": scene, **plots},
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": layout,
    }
    return json.dumps(whole, indent=2)


def plotjuggler(spec: HandSpec) -> str:
    """XML of a layout to load, one tab per finger."""
    root = Element("root")
    tabs = SubElement(root, "tabbed_widget", {"name": "Main Window", "parent": "main_window"})
    for finger in spec.fingers:
        tab = SubElement(tabs, "Tab", tab_name=finger.name, containers="1")
        split = SubElement(SubElement(tab, "Container"), "DockSplitter", orientation="-", count=str(len(_FIELDS)),
                           sizes=";".join(["1"] * len(_FIELDS)))  # fmt: skip
        for field in _FIELDS:
            plot = SubElement(SubElement(split, "DockArea", name=field), "plot", mode="TimeSeries", style="Lines")
            for place, joint in enumerate(finger.joints):
                name, color = f"{STATES}/{spec.joints[joint]}/{field}", _COLORS[place % len(_COLORS)]
                SubElement(plot, "curve", name=name, color=color)
    SubElement(tabs, "currentTabIndex", index="0")
    indent(root)
    return tostring(root, encoding="unicode") + "\n"


def _split(parts: list[Any], direction: str) -> Any:
    """Panels of equal size in a row or a column: Foxglove splits in two, repeatedly."""

    def joined(rest: Any, first: Any) -> Any:
        count[0] += 1
        return {"first": first, "second": rest, "direction": direction, "splitPercentage": 100 / count[0]}

    count = [1]
    return reduce(joined, reversed(parts[:-1]), parts[-1])
