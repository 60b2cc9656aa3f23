"""The baseline of perception: voxels, centroid and principal axes of the visible points, as in the lab's report."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from allegro_twin.types import Array, Vector


class PrincipalFrame(NamedTuple):
    """Of points, in the camera's frame."""

    centroid: Vector
    """(3,), m."""
    axes: Array
    """Columns of (3, 3), the one of the largest spread first."""
    spread: Vector
    """Variance along each, (3,), m²."""


def principal_frame(points: Array, before: PrincipalFrame | None = None) -> PrincipalFrame:
    """Of points (n, 3), m, in the camera's frame, whose y goes down in the picture.

    The sign of the second axis is the report's, `if secondary.y > 0: secondary = -secondary`, which still flips where
    its y is about 0; with the frame `before` each axis keeps to the side on which it was.
    """
    centroid = points.mean(axis=0)
    spread, axes = np.linalg.eigh((points - centroid).T @ (points - centroid) / len(points))
    first, second = axes[:, 2], axes[:, 1]
    if before is not None:
        first, second = (axis if axis @ was >= 0.0 else -axis
                         for axis, was in zip((first, second), before.axes.T, strict=False))  # fmt: skip
    elif second[1] > 0.0:
        second = -second
    return PrincipalFrame(centroid, np.stack([first, second, np.cross(first, second)], axis=1), spread[::-1])


def voxel(points: Array, edge: float) -> Array:
    """The mean of the points (n, 3) of each cube of `edge`, m, (k, 3). All must be known."""
    if len(points) == 0:
        return np.empty((0, 3))
    cells = np.floor((points - points.min(axis=0)) / edge).astype(np.int64)
    spans = cells.max(axis=0) + 1
    keys = (cells[:, 0] * spans[1] + cells[:, 1]) * spans[2] + cells[:, 2]
    order = np.argsort(keys, kind="stable")
    starts = np.flatnonzero(np.diff(keys[order], prepend=-1))
    sums = np.add.reduceat(points[order].astype(np.float64), starts, axis=0)
    return np.asarray(sums / np.diff(starts, append=len(points))[:, None])
