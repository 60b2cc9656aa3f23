"""Lines over time in a PNG: panels below one another, each with the names of its lines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from allegro_twin.files.atomic_write import atomic_file
from allegro_twin.hands.description.appearance import Color
from allegro_twin.types import Vector

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw

_WIDE, _HIGH, _LEFT, _EDGE = 1100, 220, 64, 24  # Pixels: a panel, its scale, its margin.
_INK, _SOFT = (40, 40, 40), (190, 190, 190)
_COLUMNS = 2000  # Points of a line at most.


class Line(NamedTuple):
    """One of a panel."""

    name: str
    values: Vector
    """At the panel's moments from `first` on, as many as there are."""
    color: Color
    width: int = 2
    first: int = 0


def plot(path: Path, t: Vector, panels: Mapping[str, Sequence[Line]], *, mark: float, title: str) -> None:
    """Write the file; a vertical line stands at `mark`, s. `panels` by heading. Raises RecordingError."""
    from PIL import Image, ImageDraw

    image = Image.new("RGB", (_WIDE, _EDGE + _HIGH * len(panels)), "white")
    draw = ImageDraw.Draw(image)
    draw.text((_LEFT, 6), title, fill=_INK)
    for number, (heading, lines) in enumerate(panels.items()):
        _panel(draw, _EDGE + number * _HIGH, t, heading, lines, mark)
    with atomic_file(path) as temporary:
        image.save(temporary)


def _panel(draw: ImageDraw, top: int, t: Vector, heading: str, lines: Sequence[Line], mark: float) -> None:
    low, high = _range([line.values for line in lines])
    box = (_LEFT, top + _EDGE, _WIDE - 12, top + _HIGH - 8)
    across = (box[2] - box[0]) / max(float(t[-1] - t[0]), 1e-9)

    def place(at: Vector, values: Vector) -> list[tuple[float, float]]:
        x, y = box[0] + across * (at - t[0]), box[3] - (values - low) / (high - low) * (box[3] - box[1])
        return list(zip(x.tolist(), y.tolist(), strict=True))

    draw.rectangle(box, outline=_SOFT)
    draw.text((box[0], top + 6), heading, fill=_INK)
    for value, y in ((high, box[1]), (low, box[3] - 11)):
        draw.text((6, y), f"{value:+.3f}", fill=_INK)
    draw.line(place(np.array([mark, mark]), np.array([low, high])), fill=_INK, width=1)
    named = box[0] + 260
    for line in lines:
        thin = max(1, len(line.values) // _COLUMNS)
        color = tuple(round(255 * part) for part in line.color)
        draw.line(place(t[line.first :][: len(line.values)][::thin], line.values[::thin]), fill=color, width=line.width)
        draw.text((named, top + 6), line.name, fill=color)
        named += 9 * len(line.name) + 8


def _range(rows: Sequence[Vector]) -> tuple[float, float]:
    values = np.concatenate(rows)
    low, high = float(values.min()), float(values.max())
    edge = max(0.05 * (high - low), 1e-3)
    return low - edge, high + edge
