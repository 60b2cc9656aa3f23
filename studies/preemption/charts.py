"""Charts of the study as inline SVG, in the colours of the other reports."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from typing import NamedTuple

from allegro_twin.grasping.evaluation.page.charts import round_numbers
from allegro_twin.grasping.statistics import Interval
from studies.preemption.dose_response import Dose

_LABEL, _PLOT, _NOTE, _ROW, _TOP = 210, 380, 190, 26, 22


class Difference(NamedTuple):
    """A row of a chart of differences."""

    label: str
    value: float
    interval: Interval
    note: str


def differences(rows: Sequence[Difference], title: str, unit: str, limit: float | None = None) -> str:
    """A dot for each difference on the line of its interval; a line at 0, and a dashed one at a limit."""
    ends = [end for row in rows for end in (*row.interval, row.value)] + [0.0] + ([] if limit is None else [limit])
    low, high = min(ends), max(ends)
    span = (high - low) or 1.0

    def x(value: float) -> float:
        return round(_LABEL + _PLOT * (value - low) / span, 1)

    foot = _TOP + _ROW * len(rows)
    body = []
    for tick in round_numbers(low, high):
        body.append(f'<line class="grid" x1="{x(tick)}" x2="{x(tick)}" y1="{_TOP - 4}" y2="{foot}"/>')
        body.append(_text(x(tick), _TOP - 9, f"{tick:+g} {unit}" if tick else "0", "middle"))
    body.append(f'<line class="zero" x1="{x(0)}" x2="{x(0)}" y1="{_TOP - 4}" y2="{foot}"/>')
    if limit is not None:
        dashed = 'stroke-dasharray="4 4"'
        body.append(f'<line class="zero" {dashed} x1="{x(limit)}" x2="{x(limit)}" y1="{_TOP - 4}" y2="{foot}"/>')
    for number, row in enumerate(rows):
        y = _TOP + _ROW * (number + 0.5)
        body.append(_text(_LABEL - 10, y + 4, row.label, "end"))
        body.append(f'<line class="whisker" x1="{x(row.interval.low)}" x2="{x(row.interval.high)}" y1="{y}" y2="{y}"/>')
        body.append(f'<circle class="good" cx="{x(row.value)}" cy="{y}" r="5"/>')
        body.append(_text(_LABEL + _PLOT + 12, y + 4, row.note, "start"))
    said = "; ".join(f"{row.label}: {row.value:+.2f} {unit}, {row.note}" for row in rows)
    return _svg(_LABEL + _PLOT + _NOTE, foot + 8, "".join(body), f"{title}. {said}")


def doses(curves: Mapping[str, tuple[Dose, Sequence[tuple[float, int, int]]]], title: str) -> str:
    """Rates against the overlap from 0 to 1: dots as they were, lines as they were fitted, each with its name."""
    width, height, left, foot, top, right = 460, 240, 46, 40, 12, 90
    across, tall, body = width - left - right, height - foot - top, []

    def place(overlap: float, rate: float) -> tuple[float, float]:
        return round(left + across * overlap, 1), round(top + tall * (1.0 - rate), 1)

    for part in (0.0, 0.25, 0.5, 0.75, 1.0):
        (x0, y), (x1, _) = place(0.0, part), place(1.0, part)
        body.append(f'<line class="grid" x1="{x0}" x2="{x1}" y1="{y}" y2="{y}"/>')
        body.append(_text(left - 6, y + 4, f"{100 * part:.0f} %", "end"))
        body.append(_text(place(part, 0.0)[0], height - foot + 18, f"{part:g}", "middle"))
    body.append(_text(left + across / 2, height - 3, "overlap φ", "middle"))
    for number, (dose, dots) in enumerate(curves.values()):
        strength = f'style="opacity:{1.0 - 0.75 * number / max(len(curves), 1):.2f}"'
        way = " ".join(f"{x},{y}" for x, y in (place(k / 40, dose.rate(k / 40)) for k in range(41)))
        marks = "".join(
            '<circle class="good" cx="{}" cy="{}" r="4"/>'.format(*place(overlap, held / tried))
            for overlap, held, tried in dots
            if tried
        )
        body.append(f'<g {strength}><polyline class="whisker" style="fill:none" points="{way}"/>{marks}</g>')
    ends = {name: place(1.0, dose.rate(1.0))[1] for name, (dose, _) in curves.items()}
    body += [_text(left + across + 6, y + 4, name, "start") for name, y in _apart(ends, 14.0).items()]
    return _svg(width, height, "".join(body), f"{title}: {', '.join(curves)}")


def _apart(heights: Mapping[str, float], least: float) -> dict[str, float]:
    """Labels at some heights, from the top down, moved so that none is written over another."""
    found, last = dict[str, float](), -math.inf
    for name in sorted(heights, key=lambda each: heights[each]):
        found[name] = last = max(heights[name], last + least)
    return found


def _svg(width: float, height: float, body: str, said: str) -> str:
    return (
        f'<svg viewBox="0 0 {width:g} {height:g}" width="{width:g}" role="img" aria-label="{escape(said)}">{body}</svg>'
    )


def _text(x: float, y: float, said: str, anchor: str) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape(said)}</text>'
