"""Clouds: regions, thinning, and an organised cloud with where its camera stood."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from allegro_twin.errors import ConfigError
from allegro_twin.types import Array, Vector

Points = NDArray[np.floating[Any]]
"""Points, (..., 3), m; NaN where nothing is known."""
Mask = NDArray[np.bool_]


def pass_through(points: Points, lower: Array, upper: Array) -> Mask:
    """Which points (..., 3) are known and lie in the region from `lower` (3,) to `upper` (3,), (...)."""
    inside = np.ones(points.shape[:-1], np.bool_)
    for axis in range(3):  # A NaN is not in any region.
        value = points[..., axis]
        inside &= (value >= lower[axis]) & (value <= upper[axis])
    return inside


def finite(points: Points) -> Mask:
    """Which points (..., 3) are known, (...); by columns: a reduction over three costs several times more."""
    return np.asarray(np.isfinite(points[..., 0]) & np.isfinite(points[..., 1]) & np.isfinite(points[..., 2]))


_ROWS = 24  # One of so many is looked at for the focal length.


@dataclass(frozen=True, eq=False)
class OrganizedCloud:
    """Depth picture as points, with the camera's pose. Raises ConfigError unless the shapes fit and the pose is
    finite."""

    cloud: Points
    """(rows, columns, 3), m, x right, y down, z ahead; NaN is unknown."""
    position: Vector
    """Position of the camera in the world, (3,), m."""
    rotation: Array
    """Its axes in the world, columns of (3, 3)."""
    robot: Array | None = None
    """Balls around what is the robot's own: middle in the world and radius, (k, 4), m."""

    def __post_init__(self) -> None:
        if self.cloud.ndim != 3 or self.cloud.shape[2] != 3 or not np.issubdtype(self.cloud.dtype, np.floating):
            raise ConfigError(f"cloud: (rows, columns, 3) floats, not {self.cloud.shape} of {self.cloud.dtype}")
        if self.position.shape != (3,) or self.rotation.shape != (3, 3):
            raise ConfigError(f"camera pose: (3,) and (3, 3), not {self.position.shape} and {self.rotation.shape}")
        if self.robot is not None and (self.robot.ndim != 2 or self.robot.shape[1] != 4):
            raise ConfigError(f"robot: balls (k, 4), middle and radius, not {self.robot.shape}")
        if not (np.isfinite(self.position).all() and np.isfinite(self.rotation).all()):
            raise ConfigError("camera pose: not finite; give the pose in which the picture was taken")

    def world(self, points: Points) -> Points:
        """Transform points, (n, 3), m, from the camera's frame to the world."""
        kind = points.dtype
        with np.errstate(invalid="ignore"):  # What is infinite becomes unknown.
            return np.asarray(points @ self.rotation.T.astype(kind) + self.position.astype(kind))

    def not_robot(self, points: Points) -> Mask:
        """Which points of the world, (n, 3), are not the robot's own, (n,)."""
        if self.robot is None:
            return np.ones(len(points), np.bool_)
        away = np.linalg.norm(points[:, None] - self.robot[None, :, :3], axis=-1)
        return np.asarray((away > self.robot[:, 3]).all(axis=1))

    @cached_property
    def focal(self) -> float:
        """Focal length of the camera, pixels, by two known points of one row. Raises ConfigError for a cloud without
        order."""
        rows = self.cloud[::_ROWS]
        known = finite(rows) & (rows[..., 2] > 0.0)
        if np.count_nonzero(known, axis=1).max() < 2:  # Hardly anything is known: look at all.
            rows = self.cloud
            known = finite(rows) & (rows[..., 2] > 0.0)
        row = int(np.argmax(np.count_nonzero(known, axis=1)))
        columns = np.flatnonzero(known[row])
        if len(columns) < 2:
            return float("inf")
        first, last = rows[row, columns[0]], rows[row, columns[-1]]
        slope = last[0] / last[2] - first[0] / first[2]
        if not slope > 0.0:
            raise ConfigError("cloud: x/z does not grow along its rows; give it as the camera's picture is ordered")
        return float((columns[-1] - columns[0]) / slope)
