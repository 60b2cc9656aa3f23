"""Kinds of solids, the points that they are fitted to, and the least squares that fit them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

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
class PointSample:
    """Points of an object for a fit, in axes whose z is the table's normal and whose x points away from the camera;
    heights are above the table."""

    points: Array
    """(n, 3), m."""
    outline: Vector
    """Support function of all points near the top: their extent in each of DIRECTIONS, (36,), m."""
    trust: Vector
    """In each of them: less than 1 where pixels lie further apart than what is to be told, (36,)."""
    top: float
    """Height of the highest level part, m."""
    sigma: float
    """The standard deviation of a point along its ray, m."""

    @property
    def middle(self) -> Vector:
        """Middle of the outline, (2,), m."""
        return np.asarray(2.0 / N_DIRECTIONS * self.outline @ DIRECTIONS)


def sample_points(points: Array, pixel: float, sigma: float, elevation: float) -> PointSample:
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
    return PointSample(points, outline, np.minimum(1.0, _TOLD / np.maximum(apart, 1e-9)), top, sigma)


def thinned(sample: PointSample, most: int, draws: np.random.Generator) -> PointSample:
    """With at most so many of its points, and the same outline."""
    if len(sample.points) <= most:
        return sample
    return replace(sample, points=sample.points[draws.integers(len(sample.points), size=most)])


Residuals = Callable[[Array], Array]
"""Residuals of parameters (k, m), a row each, (k, n), m."""
_STEP = 1e-6  # Of a difference, m and rad.


class SolidFit(NamedTuple):
    """Result of a fit: where the steps ended."""

    parameters: Vector
    error: float
    """The root of the mean square of what is left, m, in which nothing counts for more than twice the scale."""


def solve(residuals: Residuals, start: Vector, counts: Vector, scale: float, steps: int) -> SolidFit:
    """The least of Σ c log(1 + r²/s²), Cauchy's loss, under which what is many `scale`, m, away hardly counts.

    `counts` (n,) are the c: for how many points each residual stands.
    """
    now, damping, n = np.asarray(start, dtype=np.float64), 1e-3, len(start)
    every = np.concatenate([np.zeros((1, n)), _STEP * np.eye(n)])
    values = residuals(now + every)
    loss = _loss(values[0], counts, scale)
    for _ in range(steps):
        r, slopes = values[0], (values[1:] - values[0]) / _STEP
        weighted = slopes * (counts / (1.0 + np.square(r / scale)))
        curve = weighted @ slopes.T
        curve.flat[:: n + 1] += damping * curve.flat[:: n + 1] + 1e-9
        step = np.linalg.solve(curve, -(weighted @ r))
        trial = residuals(now + step + every)
        tried = _loss(trial[0], counts, scale)
        if tried < loss:
            now, values, loss, damping = now + step, trial, tried, damping * 0.3
            if np.abs(step).max() < 5e-5:  # 0.05 mm
                break
        else:
            damping *= 10.0
    most = np.minimum(np.square(values[0]), (2.0 * scale) ** 2)
    return SolidFit(now, float(np.sqrt(most @ counts / counts.sum())))


def _loss(residuals: Array, counts: Vector, scale: float) -> float:
    return float(np.log1p(np.square(residuals / scale)) @ counts)


Shape = Literal["sphere", "cylinder", "box", "ellipsoid", "compound"]
SHAPES: tuple[Shape, ...] = ("sphere", "cylinder", "box", "ellipsoid")
"""Those that are fitted to points; a compound is made of them."""
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, slots=True, eq=False)
class Solid:
    """A thing. Its own x is its main axis: of revolution, or of the longest edge, then come the shorter ones."""

    shape: Shape
    position: Array
    """Position of its middle, (3,), m."""
    axes: Array
    """Columns of (3, 3). What symmetry leaves open is anyhow."""
    size: tuple[float, float, float]
    """Along its axes, m."""
    error: float
    """The root mean square distance of the points from its surface, m."""
    parts: tuple[Solid, ...] = ()
    """Solids of a compound, whose place, axes and size are those of the box around them."""


def half_width(solid: Solid, direction: Vector) -> float:
    """How far it, or the box around a compound, reaches from its middle along a unit direction (3,), m."""
    parts, half = direction @ solid.axes, np.array(solid.size) / 2.0
    match solid.shape:
        case "box" | "compound":
            return float(np.abs(parts) @ half)
        case "cylinder":
            return float(abs(parts[0]) * half[0] + np.hypot(parts[1], parts[2]) * half[1])
    return float(np.linalg.norm(parts * half))


class SolidModel(NamedTuple):
    """A kind of solid as few numbers."""

    starts: Callable[[PointSample], list[Vector]]
    """Where they may be looked for, at least one."""
    residuals: Callable[[PointSample], Residuals]
    """How far the points and the outline are off, m."""
    counts: Callable[[PointSample], Vector]
    """For how many points each residual stands."""
    solid: Callable[[Vector, float], Solid]
    """What they are, with an error, m."""


def level(turn: float) -> Array:
    """The direction along the table at an angle, (3,)."""
    return np.array([np.cos(turn), np.sin(turn), 0.0])


def along(axis: Array) -> Array:
    """Axes whose first is given, level or upright, (3, 3). Plain numbers: `np.cross` costs as much as a fit's step."""
    x, y, z = (float(value) for value in axis)
    second = (-y, x, 0.0) if abs(z) < 0.5 else (1.0, 0.0, 0.0)
    third = (-z * second[1], z * second[0], x * second[1] - y * second[0])
    return np.array([axis, second, third]).T


def main_direction(places: Array) -> float:
    """The angle of the direction in which places (n, 2) spread most, rad."""
    x, y = (places - places.mean(axis=0)).T
    return 0.5 * float(np.arctan2(2.0 * (x @ y), x @ x - y @ y))


def behind(sample: PointSample, radius: float) -> Array:
    """The middle of what is seen from the front is nearer than the solid's: a start, (2,), m."""
    return np.asarray(sample.points[:, :2].mean(axis=0) + np.array([0.25 * radius, 0.0]))
