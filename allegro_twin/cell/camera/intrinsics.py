"""Camera intrinsics: projection of points to pixels and back, with the values of the D435i."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from allegro_twin.errors import ConfigError
from allegro_twin.types import Array

Image = NDArray[np.float32]
"""One number a pixel, (rows, columns)."""
Cloud = NDArray[np.float32]
"""One point a pixel, (rows, columns, 3), m, x right, y down, z ahead; NaN where nothing is known."""


class Intrinsics(NamedTuple):
    """A pinhole without distortion: u = fx·x/z + cx, v = fy·y/z + cy; the middle of the first pixel is (0, 0)."""

    width: int
    height: int
    fx: float
    """Pixels, as are the others."""
    fy: float
    cx: float
    cy: float

    def edges(self) -> tuple[float, float, float, float]:
        """Where the picture ends at 1 m ahead: left, right, up, down, m."""
        left, right = ((u - self.cx) / self.fx for u in (-0.5, self.width - 0.5))
        up, down = ((v - self.cy) / self.fy for v in (-0.5, self.height - 0.5))
        return left, right, up, down

    def rays(self) -> Cloud:
        """The direction of every pixel, (rows, columns, 3), with z = 1."""
        return _rays(self)

    def cloud(self, depth: Image) -> Cloud:
        """The points of a depth picture (rows, columns), m along z."""
        if depth.shape != (self.height, self.width):
            raise ConfigError(f"a depth picture of {depth.shape} for a camera of {(self.height, self.width)} pixels")
        return np.asarray(self.rays() * depth[..., None], np.float32)

    def pixel(self, points: Array) -> Array:
        """Column and row of points (..., 3) in the camera's frame, (..., 2)."""
        x, y, z = np.moveaxis(points, -1, 0)
        return np.stack([self.fx * x / z + self.cx, self.fy * y / z + self.cy], axis=-1)


@cache
def _rays(lens: Intrinsics) -> Cloud:
    rays = np.ones((lens.height, lens.width, 3), np.float32)
    rays[..., 0] = (np.arange(lens.width) - lens.cx) / lens.fx
    rays[..., 1] = ((np.arange(lens.height) - lens.cy) / lens.fy)[:, None]
    rays.setflags(write=False)
    return rays


def _depth(width: int, height: int, f: float) -> Intrinsics:
    """A mode's principal point is as far from the picture's middle as that of 640x480, (319.5, 236.4), in scale."""
    return Intrinsics(width, height, f, f, (width - 1) / 2, (height - 1) / 2 + f / 384.2 * (236.4 - 239.5))


D435I_DEPTH = {
    f"{width}x{height}": _depth(width, height, f)
    for width, height, f in (
        (640, 480, 384.2),
        (848, 480, 424.2),
        (640, 360, 320.2),
        (480, 270, 240.1),
        (424, 240, 212.1),
    )
}
"""One unit's, by resolution (realsense-ros #2788, librealsense #4050); its distortion is zero."""
D435I_COLOUR = Intrinsics(640, 480, 612.4, 610.6, 314.3, 237.8)
"""Intrinsics of the same D435i's colour pictures, 640 × 480."""
D435I_BASELINE = 0.050
"""Between the two imagers, m (datasheet)."""
D435I_COLOUR_AT = (0.015, 0.0, 0.0)
"""The colour camera in the depth camera's frame, m (realsense-ros #2788, without its turn of half a degree)."""
