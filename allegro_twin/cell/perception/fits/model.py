"""What a kind of solid is to the solver, and what a fitted one is to everybody else."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from allegro_twin.cell.perception.fits.sample import Sample
from allegro_twin.cell.perception.fits.solver import Residuals
from allegro_twin.types import Array, Vector

Shape = Literal["sphere", "cylinder", "box", "ellipsoid"]
SHAPES: tuple[Shape, ...] = ("sphere", "cylinder", "box", "ellipsoid")
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, slots=True, eq=False)
class Solid:
    """A thing. Its own x is its main axis: of revolution, or of the longest edge, then come the shorter ones."""

    shape: Shape
    position: Array
    """Of its middle, (3,), m."""
    axes: Array
    """Columns of (3, 3). What symmetry leaves open is anyhow."""
    size: tuple[float, float, float]
    """Along its axes, m."""
    error: float
    """The root mean square distance of the points from its surface, m."""


class Model(NamedTuple):
    """A kind of solid as few numbers."""

    starts: Callable[[Sample], list[Vector]]
    """Where they may be looked for, at least one."""
    residuals: Callable[[Sample], Residuals]
    """How far the points and the outline are off, m."""
    counts: Callable[[Sample], Vector]
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


def behind(seen: Sample, radius: float) -> Array:
    """The middle of what is seen from the front is nearer than the solid's: a start, (2,), m."""
    return np.asarray(seen.points[:, :2].mean(axis=0) + np.array([0.25 * radius, 0.0]))
