"""Charts as inline SVG; colours are classes of `style`, so that they follow the reader's light or dark."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape
from typing import NamedTuple

import numpy as np

from allegro_twin.types import Array

_LABEL, _PLOT, _NOTE, _ROW, _TOP = 210, 380, 130, 26, 22
_DOTS = 400
"""In a strip or a scatter; of more, as many are drawn, evenly."""


class Rate(NamedTuple):
    """A row of a chart of rates."""

    label: str
    successes: int
    draws: int
    low: float
    high: float


def rates(rows: Sequence[Rate], title: str) -> str:
    """A dot for each rate on the line of its interval, 0 to 100 %."""
    body = [_grid(len(rows), [(part / 4, f"{25 * part} %") for part in range(5)])]
    for number, row in enumerate(rows):
        y, rate = _middle(number), row.successes / row.draws if row.draws else 0.0
        body.append(_text(_LABEL - 10, y + 4, row.label, "end"))
        body.append(f'<line class="whisker" x1="{_x(row.low)}" x2="{_x(row.high)}" y1="{y}" y2="{y}"/>')
        if row.draws:
            body.append(f'<circle class="good" cx="{_x(rate)}" cy="{y}" r="5"/>')
        body.append(_text(_LABEL + _PLOT + 12, y + 4, f"{row.successes} of {row.draws}", "start"))
    said = "; ".join(f"{row.label}: {row.successes} of {row.draws}" for row in rows)
    return _svg(_LABEL + _PLOT + _NOTE, _TOP + _ROW * len(rows) + 8, "".join(body), f"{title}. {said}")


def strips(columns: Sequence[tuple[str, Array]], good: Array, title: str) -> str:
    """For each column its values on a line, a mark at the median; failures are crosses. A line at 0."""
    finite = np.concatenate([values[np.isfinite(values)] for _, values in columns] or [np.zeros(1)])
    low, high = min(0.0, float(finite.min(initial=0.0))), max(0.0, float(finite.max(initial=0.0)))
    span = (high - low) or 1.0
    ticks = [((tick - low) / span, f"{tick:g}") for tick in round_numbers(low, high)]
    body = [_grid(len(columns), ticks), _rule((0.0 - low) / span, len(columns))]
    for number, (label, values) in enumerate(columns):
        y, chosen = _middle(number), _some(np.flatnonzero(np.isfinite(values)))
        body.append(_text(_LABEL - 10, y + 4, label, "end"))
        body += [_mark(_x((values[k] - low) / span), y, bool(good[k])) for k in chosen]
        if len(chosen):
            median = float(np.median(values[np.isfinite(values)]))
            x = _x((median - low) / span)
            body.append(f'<line class="median" x1="{x}" x2="{x}" y1="{y - 9}" y2="{y + 9}"/>')
            body.append(_text(_LABEL + _PLOT + 12, y + 4, f"median {median:.3g}", "start"))
    return _svg(_LABEL + _PLOT + _NOTE, _TOP + _ROW * len(columns) + 8, "".join(body), title)


def scatter(values: Array, outcome: Array, good: Array, name: str, axis: str) -> str:
    """Values to the right, an outcome from 0 to 1 upwards, (k,) each."""
    width, height, left, foot, top = 340, 200, 40, 40, 12
    known = np.flatnonzero(np.isfinite(values) & np.isfinite(outcome))
    low, high = (float(values[known].min()), float(values[known].max())) if len(known) else (0.0, 1.0)
    span, across, tall = (high - low) or 1.0, width - left - 20, height - foot - top
    body = []
    for part in (0.0, 0.5, 1.0):
        y = top + tall * (1.0 - part)
        body.append(f'<line class="grid" x1="{left}" x2="{width - 20}" y1="{y:.1f}" y2="{y:.1f}"/>')
        body.append(_text(left - 6, y + 4, f"{part:g}", "end"))
    for tick in round_numbers(low, high):
        body.append(_text(left + across * (tick - low) / span, height - foot + 18, f"{tick:g}", "middle"))
    body.append(_text(left + across / 2, height - 3, axis, "middle"))
    for k in _some(known):
        lift = 0.06 * (k * 0.618034 % 1.0 - 0.5)  # So that equal ones do not cover each other: the same each time.
        y = top + tall * (1.0 - np.clip(outcome[k] + lift, 0.0, 1.0))
        body.append(_mark(left + across * (values[k] - low) / span, float(y), bool(good[k])))
    return _svg(width, height, "".join(body), f"{axis} against {name}, {len(known)} results")


def round_numbers(low: float, high: float) -> list[float]:
    """Some three to seven between two numbers: multiples of 1, 2 or 5 times a power of ten."""
    if not high > low:
        return [low]
    rough = (high - low) / 4.0
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(power * size for size in (1.0, 2.0, 5.0, 10.0) if power * size >= 0.999 * rough)
    first = math.ceil(low / step - 1e-9)
    return [round(k * step, 12) + 0.0 for k in range(first, math.floor(high / step + 1e-9) + 1)]


def _svg(width: float, height: float, body: str, said: str) -> str:
    return (
        f'<svg viewBox="0 0 {width:g} {height:g}" width="{width:g}" role="img" aria-label="{escape(said)}">{body}</svg>'
    )


def _grid(count: int, ticks: Sequence[tuple[float, str]]) -> str:
    foot = _TOP + _ROW * count
    lines = [f'<line class="grid" x1="{_x(p)}" x2="{_x(p)}" y1="{_TOP - 4}" y2="{foot}"/>' for p, _ in ticks]
    return "".join(lines) + "".join(_text(_x(part), _TOP - 9, said, "middle") for part, said in ticks)


def _rule(part: float, count: int) -> str:
    return f'<line class="zero" x1="{_x(part)}" x2="{_x(part)}" y1="{_TOP - 4}" y2="{_TOP + _ROW * count}"/>'


def _mark(x: float, y: float, good: bool) -> str:
    if good:
        return f'<circle class="good faint" cx="{x:.1f}" cy="{y:.1f}" r="3.5"/>'
    return f'<path class="bad" d="M{x - 3.5:.1f} {y - 3.5:.1f}l7 7m0 -7l-7 7"/>'


def _text(x: float, y: float, said: str, anchor: str) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape(said)}</text>'


def _x(part: float) -> float:
    return round(_LABEL + _PLOT * float(part), 1)


def _middle(number: int) -> float:
    return _TOP + _ROW * (number + 0.5)


def _some(indices: Array | np.ndarray[tuple[int], np.dtype[np.int_]]) -> list[int]:
    """At most _DOTS of them, evenly."""
    if len(indices) <= _DOTS:
        return [int(k) for k in indices]
    return [int(indices[k]) for k in np.linspace(0, len(indices) - 1, _DOTS).astype(int)]
