"""What solids are fitted to: points of one thing above the table, and its outline seen from above."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from allegro_twin.types import Array, Vector

N_DIRECTIONS = 36
_ANGLES = 2.0 * np.pi / N_DIRECTIONS * np.arange(N_DIRECTIONS)
DIRECTIONS = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)
"""(36, 2), around."""
_OUTERMOST = 3
"""The outline goes through the third point from outside: one may be a stray."""
_WITHIN = 1.0
"""So many pixels further out is the edge: half of the outermost, and half for those that were passed over or lost."""
_TOLD = 0.002
"""m."""
_TOP = 0.99
"""The part of the points below which the top is looked for."""


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """In axes whose z is the table's normal and whose x goes away from the camera; heights are above the table."""

    points: Array
    """(n, 3), m."""
    outline: Vector
    """Of all points near the top: how far out they reach in each of DIRECTIONS, (36,), m."""
    trust: Vector
    """In each of them: less than 1 where pixels lie further apart than what is to be told, (36,)."""
    top: float
    """Height of the highest level part, m."""
    sigma: float
    """The standard deviation of a point along its ray, m."""

    @property
    def middle(self) -> Vector:
        """Of the outline, (2,), m."""
        return np.asarray(2.0 / N_DIRECTIONS * self.outline @ DIRECTIONS)


def sample(points: Array, pixel: float, sigma: float, elevation: float) -> Sample:
    """From all points (n, 3) of a thing, one of which stands for a square of edge `pixel`, m, across the ray, and so on
    the table further along the ray than across it. `elevation`: by how much the camera looks down at the top, rad.

    At least one point. The top is the height of one of them, so that its outline is never of none: halfway between two
    heights, where the mean of a shiny object's spikes and its surface may be, there is nothing."""
    height = points[:, 2]
    band = max(0.003, 2.5 * sigma)
    place = int(_TOP * (len(height) - 1))
    upper = np.sort(height[height > np.partition(height, place)[place] - band])
    top = float(upper[(len(upper) - 1) // 2])
    reach = DIRECTIONS @ points[np.abs(height - top) < band, :2].T
    last = max(reach.shape[1] - _OUTERMOST, 0)
    outline = np.partition(reach, last, axis=1)[:, last]
    apart = pixel * np.hypot(DIRECTIONS[:, 0] / max(np.sin(elevation), 0.2), DIRECTIONS[:, 1])
    outline += _WITHIN * apart
    return Sample(points, outline, np.minimum(1.0, _TOLD / np.maximum(apart, 1e-9)), top, sigma)


def thinned(seen: Sample, most: int, draws: np.random.Generator) -> Sample:
    """With at most so many of its points, and the same outline."""
    if len(seen.points) <= most:
        return seen
    return replace(seen, points=seen.points[draws.integers(len(seen.points), size=most)])
