"""A picture of a scan before and after its repair, side by side: faces seen from behind are red, holes are holes."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from allegro_twin.files.atomic_write import atomic_file
from allegro_twin.types import Array

_PANE = 420
"""Pixels."""
_BAND = 40
"""Pixels below a pane, for its words."""
_VIEWS = tuple((0.62 * side, -0.62 * side, 0.48 * height) for height in (1, -1) for side in (1, -1))
"""From where both may be seen: from that one where most shows of what is amiss, from the first if nothing does."""
_MORE = 400
"""Red pixels, that another view has to show than the first: the noise of a scan is some of them."""
_FRONT, _BACK, _PAPER = (0.55, 0.66, 0.78), (0.86, 0.25, 0.2), (1.0, 1.0, 1.0)


class Pane(NamedTuple):
    """One side of the picture."""

    title: str
    points: Array
    """On the surface, closer than a pixel where they are of triangles, (k, 3), m."""
    normals: Array | None
    """(k, 3); None for points of a cloud."""


def draw_scan(before: Pane, after: Pane, path: Path) -> None:
    """Write the picture. Both sides have one scale and one view, in which the red of the first is seen best."""
    from PIL import Image, ImageDraw, ImageFont

    low = np.minimum(*(np.quantile(pane.points, 0.002, axis=0) for pane in (before, after)))
    high = np.maximum(*(np.quantile(pane.points, 0.998, axis=0) for pane in (before, after)))
    middle, size = (low + high) / 2, 1.12 * float(np.linalg.norm(high - low))
    sheet = Image.new("RGB", (2 * _PANE, _PANE + _BAND), "white")
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(15)
    shown = [_drawn(before, middle, size, view) for view in _VIEWS]
    red = np.array([count for _, count in shown])
    best = int(np.argmax(red)) if red.max() > red[0] + _MORE else 0
    pictures = shown[best][0], _drawn(after, middle, size, _VIEWS[best])[0]
    for number, (pane, picture) in enumerate(zip((before, after), pictures, strict=True)):
        pixels = np.round(255 * picture).astype(np.uint8)
        sheet.paste(Image.fromarray(pixels), (number * _PANE, 0))
        draw.text((number * _PANE + 12, _PANE + 10), pane.title, "black", font)
    with atomic_file(path) as temporary:
        sheet.quantize(64).save(temporary, format="png", optimize=True)


def _drawn(pane: Pane, middle: Array, size: float, view: tuple[float, float, float]) -> tuple[Array, int]:
    """Rows, columns and colours in 0 … 1, of each pixel's points the nearest one; and how many pixels are red."""
    ahead = np.array(view) / np.linalg.norm(view)
    right = np.cross([0.0, 0.0, 1.0], ahead)
    right /= np.linalg.norm(right)
    up = np.cross(ahead, right)
    place = (pane.points - middle) @ np.stack([right, up, ahead], axis=1)
    at = np.floor(place[:, :2] / size * _PANE + _PANE / 2).astype(int)
    seen = ((at >= 0) & (at < _PANE)).all(axis=1)
    at, depth = at[seen], place[seen, 2]
    order = np.argsort(depth, kind="stable")  # The nearest is drawn last.
    picture = np.broadcast_to(np.array(_PAPER), (_PANE, _PANE, 3)).copy()
    back = np.zeros((_PANE, _PANE), dtype=bool)
    if pane.normals is None:
        colors = np.array(_FRONT) * (0.45 + 0.55 * (depth - depth.min()) / max(float(np.ptp(depth)), 1e-9))[:, None]
    else:
        facing = pane.normals[seen] @ ahead
        light = pane.normals[seen] @ (ahead + 0.5 * up - 0.4 * right) / 1.2
        shade = 0.35 + 0.65 * np.clip(np.where(facing < 0, -light, light), 0, 1)
        behind = facing < -0.02
        colors = np.where(behind[:, None], np.array(_BACK), np.array(_FRONT)) * shade[:, None]
        back[at[order, 1], at[order, 0]] = behind[order]
    picture[_PANE - 1 - at[order, 1], at[order, 0]] = colors[order]
    return picture, int(back.sum())
