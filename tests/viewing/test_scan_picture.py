"""The picture of a repair looks at what was amiss."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from allegro_twin.types import Array
from allegro_twin.viewing.scan_picture import Pane, draw_scan


def cup(open_below: bool, closed: bool = False) -> Pane:
    """Points and normals of a can of 60 mm without one of its ends, or with both."""
    angle, part = (each.ravel() for each in np.meshgrid(np.linspace(0.0, 2 * np.pi, 800), np.linspace(0, 1, 260)))
    side = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    height, radius = 0.06 * part - 0.03, 0.03 * part[:, None]
    points, normals = [0.03 * side + np.outer(height, [0, 0, 1.0])], [side]
    for end in (-1.0, 1.0):
        if closed or (end > 0.0) == open_below:
            points.append(radius * side + [0.0, 0.0, 0.03 * end])
            normals.append(np.tile([0.0, 0.0, end], (len(side), 1)))
    return Pane("", np.vstack(points), np.vstack(normals))


def picture(path: Path) -> Array:
    return np.asarray(pytest.importorskip("PIL.Image").open(path).convert("RGB"), dtype=np.float64) / 255.0


@pytest.mark.parametrize("open_below", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_missing_bottom_is_seen_from_below_and_a_missing_lid_from_above(open_below: bool, tmp_path: Path) -> None:
    draw_scan(cup(open_below), cup(open_below, closed=True), tmp_path / "cup.png")
    left, right = np.split(picture(tmp_path / "cup.png")[:420], 2, axis=1)
    red = [(pane[..., 0] > 1.8 * pane[..., 2]).sum() for pane in (left, right)]
    assert red[0] > 2000
    assert red[1] < 200  # Of the rim.
