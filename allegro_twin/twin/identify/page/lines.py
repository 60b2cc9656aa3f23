"""Lines in a frame, as inline SVG; colours are classes of the page's style."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Literal, NamedTuple

import numpy as np

from allegro_twin.grasping.evaluation.page.charts import round_numbers
from allegro_twin.types import Array

WIDTH, HEIGHT, LEFT, FOOT, TOP, RIGHT = 340, 210, 52, 40, 12, 14
_MOST = 300
"""Points of a line."""


class Line(NamedTuple):
    """One line, (k,) each."""

    x: Array
    y: Array
    kind: Literal["ink", "good", "bad", "soft"]
    said: str


def chart(lines: Sequence[Line], across: str, upwards: str) -> str:
    """All lines in one frame that holds them; `across` and `upwards` name the axes."""
    x, y = (np.concatenate([line[k] for line in lines]) for k in (0, 1))
    (x0, x1), (y0, y1) = _range(x), _range(y)
    wide, tall = WIDTH - LEFT - RIGHT, HEIGHT - FOOT - TOP
    body = []
    for tick in round_numbers(y0, y1):
        at = TOP + tall * (1.0 - (tick - y0) / (y1 - y0))
        body.append(f'<line class="grid" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{at:.1f}" y2="{at:.1f}"/>')
        body.append(_text(LEFT - 6, at + 4, f"{tick:g}", "end"))
    for tick in round_numbers(x0, x1):
        body.append(_text(LEFT + wide * (tick - x0) / (x1 - x0), HEIGHT - FOOT + 18, f"{tick:g}", "middle"))
    for line in lines:
        chosen = np.unique(np.linspace(0, len(line.x) - 1, min(len(line.x), _MOST)).astype(int))
        px = LEFT + wide * (line.x[chosen] - x0) / (x1 - x0)
        py = TOP + tall * (1.0 - (line.y[chosen] - y0) / (y1 - y0))
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(px, py, strict=True))
        body.append(
            f'<polyline class="line {line.kind}" points="{points}"><title>{escape(line.said)}</title></polyline>'
        )
    body.append(_text(LEFT + wide / 2, HEIGHT - 4, across, "middle"))
    body.append(_text(LEFT, TOP - 2, upwards, "start"))
    said = escape(f"{upwards} against {across}: {'; '.join(line.said for line in lines)}")
    return f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" role="img" aria-label="{said}">{"".join(body)}</svg>'


def card(title: str, said: str, drawing: str) -> str:
    return f"<figure><h3>{escape(title)}</h3><figcaption class='soft'>{escape(said)}</figcaption>{drawing}</figure>"


def _range(values: Array) -> tuple[float, float]:
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    return (low, high) if high > low else (low - 1.0, high + 1.0)


def _text(x: float, y: float, said: str, anchor: str) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape(said)}</text>'
