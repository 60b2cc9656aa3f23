"""Charts as inline SVG; colours are classes of the page, so that they follow the reader's light or dark."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from allegro_twin.types import Array

_LABEL, _PLOT, _ROW, _TOP = 210, 380, 26, 22
_DOTS, _POINTS = 400, 300
"""In a strip or a scatter, and of a line; of more, as many are drawn, evenly."""


class IntervalRow(NamedTuple):
    """A row of an interval chart: a value, its interval, and a note on the right."""

    label: str
    value: float
    low: float
    high: float
    note: str


class ChartLine(NamedTuple):
    """One line of a line chart, (k,) each."""

    x: Array
    y: Array
    kind: Literal["ink", "good", "bad", "soft"]
    label: str


def rate_chart(rows: Sequence[tuple[str, int, int, float, float]], title: str) -> str:
    """A dot for each rate on the line of its interval, 0 to 100 %. `rows`: label, successes, trials, and the interval's
    ends, from 0 to 1."""
    body = [_grid(len(rows), [(part / 4, f"{25 * part} %") for part in range(5)])]
    for number, (label, successes, trials, low, high) in enumerate(rows):
        rate = successes / trials if trials else None
        body.append(_interval(number, label, rate, low, high, f"{successes} of {trials}"))
    described = "; ".join(f"{label}: {successes} of {trials}" for label, successes, trials, *_ in rows)
    return _rows(len(rows), 130, body, f"{title}. {described}")


def interval_chart(rows: Sequence[IntervalRow], title: str, unit: str, limit: float | None = None) -> str:
    """A dot for each value on the line of its interval; a line at 0, and a dashed one at a limit."""
    ends = [end for row in rows for end in row[1:4]] + [0.0] + ([] if limit is None else [limit])
    low, high = min(ends), max(ends)
    span = (high - low) or 1.0
    ticks = [((tick - low) / span, f"{tick:+g} {unit}" if tick else "0") for tick in round_ticks(low, high)]
    body = [_grid(len(rows), ticks), _rule((0.0 - low) / span, len(rows))]
    if limit is not None:
        body.append(_rule((limit - low) / span, len(rows), ' stroke-dasharray="4 4"'))
    for number, row in enumerate(rows):
        value, start, end = ((each - low) / span for each in row[1:4])
        body.append(_interval(number, row.label, value, start, end, row.note))
    described = "; ".join(f"{row.label}: {row.value:+.2f} {unit}, {row.note}" for row in rows)
    return _rows(len(rows), 190, body, f"{title}. {described}")


def strip_chart(columns: Sequence[tuple[str, Array]], good: Array, title: str) -> str:
    """For each column its values on a line, a mark at the median; failures are crosses. A line at 0."""
    finite = np.concatenate([values[np.isfinite(values)] for _, values in columns] or [np.zeros(1)])
    low, high = min(0.0, float(finite.min(initial=0.0))), max(0.0, float(finite.max(initial=0.0)))
    span = (high - low) or 1.0
    ticks = [((tick - low) / span, f"{tick:g}") for tick in round_ticks(low, high)]
    body = [_grid(len(columns), ticks), _rule((0.0 - low) / span, len(columns))]
    for number, (label, values) in enumerate(columns):
        y, chosen = _middle(number), _thinned(np.flatnonzero(np.isfinite(values)))
        body.append(svg_text(_LABEL - 10, y + 4, label, "end"))
        body += [_mark(_x((values[k] - low) / span), y, bool(good[k])) for k in chosen]
        if len(chosen):
            median = float(np.median(values[np.isfinite(values)]))
            x = _x((median - low) / span)
            body.append(f'<line class="median" x1="{x}" x2="{x}" y1="{y - 9}" y2="{y + 9}"/>')
            body.append(svg_text(_LABEL + _PLOT + 12, y + 4, f"median {median:.3g}", "start"))
    return _rows(len(columns), 130, body, title)


def scatter_chart(values: Array, outcome: Array, good: Array, name: str, axis: str) -> str:
    """Values to the right, an outcome from 0 to 1 upwards, (k,) each."""
    width, height, left, foot, top = 340, 200, 40, 40, 12
    known = np.flatnonzero(np.isfinite(values) & np.isfinite(outcome))
    low, high = (float(values[known].min()), float(values[known].max())) if len(known) else (0.0, 1.0)
    span, across, tall = (high - low) or 1.0, width - left - 20, height - foot - top
    body = []
    for part in (0.0, 0.5, 1.0):
        y = top + tall * (1.0 - part)
        body.append(f'<line class="grid" x1="{left}" x2="{width - 20}" y1="{y:.1f}" y2="{y:.1f}"/>')
        body.append(svg_text(left - 6, y + 4, f"{part:g}", "end"))
    for tick in round_ticks(low, high):
        body.append(svg_text(left + across * (tick - low) / span, height - foot + 18, f"{tick:g}", "middle"))
    body.append(svg_text(left + across / 2, height - 3, axis, "middle"))
    for k in _thinned(known):
        lift = 0.06 * (k * 0.618034 % 1.0 - 0.5)  # So that equal ones do not cover each other: the same each time.
        y = top + tall * (1.0 - np.clip(outcome[k] + lift, 0.0, 1.0))
        body.append(_mark(left + across * (values[k] - low) / span, float(y), bool(good[k])))
    return svg(width, height, "".join(body), f"{axis} against {name}, {len(known)} results")


def line_chart(lines: Sequence[ChartLine], across: str, upwards: str) -> str:
    """All lines in one frame that holds them; `across` and `upwards` name the axes."""
    width, height, left, foot, top, right = 340, 210, 52, 40, 12, 14
    (x0, x1), (y0, y1) = (_range(np.concatenate([line[k] for line in lines])) for k in (0, 1))
    wide, tall = width - left - right, height - foot - top
    body = []
    for tick in round_ticks(y0, y1):
        at = top + tall * (1.0 - (tick - y0) / (y1 - y0))
        body.append(f'<line class="grid" x1="{left}" x2="{width - right}" y1="{at:.1f}" y2="{at:.1f}"/>')
        body.append(svg_text(left - 6, at + 4, f"{tick:g}", "end"))
    for tick in round_ticks(x0, x1):
        body.append(svg_text(left + wide * (tick - x0) / (x1 - x0), height - foot + 18, f"{tick:g}", "middle"))
    for line in lines:
        chosen = np.unique(np.linspace(0, len(line.x) - 1, min(len(line.x), _POINTS)).astype(int))
        px = left + wide * (line.x[chosen] - x0) / (x1 - x0)
        py = top + tall * (1.0 - (line.y[chosen] - y0) / (y1 - y0))
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(px, py, strict=True))
        body.append(
            f'<polyline class="line {line.kind}" points="{points}"><title>{escape(line.label)}</title></polyline>'
        )
    body.append(svg_text(left + wide / 2, height - 4, across, "middle"))
    body.append(svg_text(left, top - 2, upwards, "start"))
    described = f"{upwards} against {across}: {'; '.join(line.label for line in lines)}"
    return svg(width, height, "".join(body), described)


def round_ticks(low: float, high: float) -> list[float]:
    """Some three to seven between two numbers: multiples of 1, 2 or 5 times a power of ten."""
    if not high > low:
        return [low]
    rough = (high - low) / 4.0
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(power * size for size in (1.0, 2.0, 5.0, 10.0) if power * size >= 0.999 * rough)
    first = math.ceil(low / step - 1e-9)
    return [round(k * step, 12) + 0.0 for k in range(first, math.floor(high / step + 1e-9) + 1)]


def svg(width: float, height: float, body: str, label: str) -> str:
    """A drawing of SVG elements; `label`: what it says, for those who cannot see it."""
    return (
        f'<svg viewBox="0 0 {width:g} {height:g}" width="{width:g}" role="img" aria-label="{escape(label)}">{body}'
        "</svg>"
    )


def svg_text(x: float, y: float, text: str, anchor: str) -> str:
    """Text in a drawing; `anchor`: `start`, `middle` or `end`."""
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape(text)}</text>'


def _rows(count: int, note: float, body: Sequence[str], label: str) -> str:
    """A chart of rows with notes so wide."""
    return svg(_LABEL + _PLOT + note, _TOP + _ROW * count + 8, "".join(body), label)


def _interval(number: int, label: str, part: float | None, low: float, high: float, note: str) -> str:
    """A row; its value and ends as parts of the plot's width."""
    y = _middle(number)
    whisker = f'<line class="whisker" x1="{_x(low)}" x2="{_x(high)}" y1="{y}" y2="{y}"/>'
    dot = "" if part is None else f'<circle class="good" cx="{_x(part)}" cy="{y}" r="5"/>'
    texts = svg_text(_LABEL - 10, y + 4, label, "end"), svg_text(_LABEL + _PLOT + 12, y + 4, note, "start")
    return f"{texts[0]}{whisker}{dot}{texts[1]}"


def _grid(count: int, ticks: Sequence[tuple[float, str]]) -> str:
    foot = _TOP + _ROW * count
    lines = [f'<line class="grid" x1="{_x(p)}" x2="{_x(p)}" y1="{_TOP - 4}" y2="{foot}"/>' for p, _ in ticks]
    return "".join(lines) + "".join(svg_text(_x(part), _TOP - 9, text, "middle") for part, text in ticks)


def _rule(part: float, count: int, dashes: str = "") -> str:
    return f'<line class="zero"{dashes} x1="{_x(part)}" x2="{_x(part)}" y1="{_TOP - 4}" y2="{_TOP + _ROW * count}"/>'


def _mark(x: float, y: float, good: bool) -> str:
    if good:
        return f'<circle class="good faint" cx="{x:.1f}" cy="{y:.1f}" r="3.5"/>'
    return f'<path class="bad" d="M{x - 3.5:.1f} {y - 3.5:.1f}l7 7m0 -7l-7 7"/>'


def _x(part: float) -> float:
    return round(_LABEL + _PLOT * float(part), 1)


def _middle(number: int) -> float:
    return _TOP + _ROW * (number + 0.5)


def _range(values: Array) -> tuple[float, float]:
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    return (low, high) if high > low else (low - 1.0, high + 1.0)


def _thinned(indices: NDArray[np.int_]) -> list[int]:
    """At most _DOTS of them, evenly."""
    if len(indices) <= _DOTS:
        return [int(k) for k in indices]
    return [int(indices[k]) for k in np.linspace(0, len(indices) - 1, _DOTS).astype(int)]
