"""Numbers that change thirty times a second, as HTML: bars of positions, torques and temperatures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape

from allegro_twin.hands.description.appearance import series_color
from allegro_twin.spec import HandSpec
from allegro_twin.surfaces.panel.page.groups import Group, groups
from allegro_twin.surfaces.panel.stream import Frame

_WARM = 60.0  # °C, from which on the guard fades torques: docs/safety.md.
_ROW = "display:grid;grid-template-columns:{wide:.1f}em 1fr 4em 1fr 4.2em;gap:6px;align-items:center"
_NAME, _LETTER = 5.2, 0.55
"""em: room for a name, and of a letter."""
_TRACK = "position:relative;height:8px;border-radius:4px;background:#e6eaef"
FONT = "font:12px/1.5 system-ui,sans-serif;color:#333;padding:2px 12px"


def group_bars(spec: HandSpec, group: Group, frame: Frame) -> str:
    """A row a joint: where it is between its limits, with a mark where it should be, and what torque it gives."""
    row = _ROW.format(wide=max(_NAME, *(_LETTER * len(name_of(spec, joint)) for joint in group.joints)))
    rows = [f'<div style="{row};color:#777"><span></span><span>position</span><span></span><span>torque</span>'
            "<span></span></div>"]  # fmt: skip
    for place, joint in enumerate(group.joints):
        color, lower, upper = hexed(place), spec.lower[joint], spec.upper[joint]
        part = (frame.position[joint] - lower) / (upper - lower)
        wanted = (frame.target[joint] - lower) / (upper - lower)
        mark = "" if math.isnan(wanted) else _mark(wanted)
        torque = frame.torque[joint] / spec.actuation.torque_limit[joint]
        rows.append(
            f'<div style="{row}"><span>{escape(name_of(spec, joint))}</span>'
            f'<div style="{_TRACK}">{_fill(0.0, part, color)}{mark}</div><span>{frame.position[joint]:+.3f}</span>'
            f'<div style="{_TRACK}">{_fill(0.5, 0.5 + torque / 2, color)}{_mark(0.5)}</div>'
            f"<span>{frame.torque[joint]:+.3f}</span></div>"
        )
    return f'<div style="{FONT}">{"".join(rows)}</div>'


def health(spec: HandSpec, frame: Frame, rate: float) -> str:
    """What the link went through and how warm the motors are."""
    lines = [f"{frame.t:.1f} s since the hand was opened", f"{rate:.0f} pictures a second of the hand's clock",
             f"{frame.lost} periods without a state", *frame.link]  # fmt: skip
    return f'<div style="{FONT}">{"<br>".join(map(escape, lines))}{_temperatures(spec, frame)}</div>'


def _temperatures(spec: HandSpec, frame: Frame) -> str:
    if not any(math.isfinite(value) for value in frame.temperature):
        return "<br>this hand reports no temperatures"
    cells = []
    for group in groups(spec):
        values = "".join(
            f'<td style="padding:0 8px;color:{"#c8102e" if frame.temperature[joint] >= _WARM else "#333"}">'
            f"{frame.temperature[joint]:.0f}</td>"
            for joint in group.joints
        )
        cells.append(f"<tr><td>{escape(group.name)}</td>{values}</tr>")
    return f'<table style="margin-top:8px"><tr><td>°C</td></tr>{"".join(cells)}</table>'


def banner(lines: Sequence[tuple[str, str]]) -> str:
    """Lines of a colour and a text each."""
    rows = "".join(f'<div style="color:{color}">{escape(text)}</div>' for color, text in lines)
    return f'<div style="{FONT};font-size:13px">{rows}</div>'


def name_of(spec: HandSpec, joint: int) -> str:
    """That a person reads."""
    return spec.joint_labels[joint]


def hexed(number: int) -> str:
    """The colour of a series."""
    return "#" + "".join(f"{round(255 * part):02x}" for part in series_color(number))


def _fill(begin: float, end: float, color: str) -> str:
    low, high = sorted((_inside(begin), _inside(end)))
    place = f"left:{100 * low:.1f}%;width:{100 * (high - low):.1f}%"
    return f'<i style="position:absolute;top:0;bottom:0;border-radius:4px;{place};background:{color}"></i>'


def _mark(part: float) -> str:
    place = f"left:calc({100 * _inside(part):.1f}% - 1px)"
    return f'<i style="position:absolute;top:-2px;bottom:-2px;width:2px;{place};background:#222"></i>'


def _inside(part: float) -> float:
    return min(max(part, 0.0), 1.0)
