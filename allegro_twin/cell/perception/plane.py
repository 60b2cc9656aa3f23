"""The largest level plane in a cloud: drawn triples of points, then least squares over those near the best."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from allegro_twin.cell.perception.cloud import Points
from allegro_twin.types import Array

_SAMPLE = 600  # Points by which the drawn planes are judged.


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """All points p with normal · p = offset."""

    normal: Array
    """Unit, out of the table, (3,)."""
    offset: float
    """m."""
    part: float
    """Of the points that were looked at, those that lie on it."""

    def height(self, points: Points) -> Array:
        """Above it, (..., 3) → (...), m."""
        return np.asarray(points @ self.normal - self.offset)

    def axes(self, towards: Array) -> Array:
        """Rows of (3, 3): x along the plane as `towards` (3,) goes, y, and z the normal."""
        along = towards - (towards @ self.normal) * self.normal
        if np.linalg.norm(along) < 1e-6:  # Straight down: any direction will do.
            along = np.cross(self.normal, np.eye(3)[np.argmin(np.abs(self.normal))])
        x = along / np.linalg.norm(along)
        return np.stack([x, np.cross(self.normal, x), self.normal])


def find_plane(
    points: Points, up: Array, draws: np.random.Generator, *, near: float, tilt: float, tries: int = 64
) -> Plane | None:
    """The plane on which most points (n, 3) lie within `near`, m, its normal within `tilt`, rad, of `up` (3,).

    None where no three of the drawn points span one. Its `part` says whether it is a table.
    """
    if len(points) < 3:
        return None
    sample = points[draws.integers(len(points), size=_SAMPLE)].astype(np.float64)
    a, b, c = sample[draws.integers(_SAMPLE, size=(3, tries))]
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    normals *= np.copysign(1.0 / np.maximum(lengths, 1e-12), normals @ up)[:, None]
    level = (lengths > 1e-6) & (normals @ up > np.cos(tilt))
    if not level.any():
        return None
    normals, offsets = normals[level], np.add.reduce(normals * a, axis=1)[level]
    hits = np.count_nonzero(np.abs(sample @ normals.T - offsets) < near, axis=0)
    best = int(np.argmax(hits))
    return _refined(points, Plane(normals[best], float(offsets[best]), 0.0), near)


def _refined(points: Points, plane: Plane, near: float) -> Plane:
    """Least squares over the points near it, twice: the second time nearer."""
    for reach in (near, near / 2.0):
        on = points[np.abs(plane.height(points)) < reach].astype(np.float64)
        if len(on) < 3:
            return plane
        middle = on.mean(axis=0)
        normal = np.linalg.eigh((on - middle).T @ (on - middle))[1][:, 0]
        normal *= np.copysign(1.0, normal @ plane.normal)
        plane = Plane(normal, float(normal @ middle), 0.0)
    part = np.count_nonzero(np.abs(plane.height(points)) < near) / len(points)
    return Plane(plane.normal, plane.offset, part)
