"""How far the lowest point of an object is above the surface of the palm that looks up."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from allegro_twin.array_api import library
from allegro_twin.kinematics.orientation import product, quaternion_from_vector
from allegro_twin.learning.tasks.scenes import FACING, PALM
from allegro_twin.learning.tasks.vectors import length, turned
from allegro_twin.sim.objects.catalogue import GraspObject
from allegro_twin.types import Array

ON_PALM = 0.005
"""m. An object whose lowest point is less than this above the plane of the palm's surface counts as on the palm: it
begins 8 mm or more above (`search._GAP`), and one that lies there is within 1 mm of it."""
_CORNERS, _ROUND, _TUBE, _MESH = range(4)
_KINDS = {"box": _CORNERS, "sphere": _ROUND, "ellipsoid": _ROUND, "cylinder": _TUBE, "mesh": _MESH}


class Shapes:
    """Objects to choose from, on the device of the simulations: which kind each is, its half-sizes, (k, 3), m, and of
    meshes the vertices, (k, vertices, 3), m."""

    def __init__(self, things: Sequence[GraspObject], xp: Any) -> None:
        self.kind = xp.asarray(np.array([_KINDS[thing.shape] for thing in things]), np.int64)
        self.half = xp.asarray(np.stack([thing.half_extents() for thing in things]))
        vertices = [thing.mesh().vertices if thing.shape == "mesh" else np.zeros((1, 3)) for thing in things]
        most = max(map(len, vertices))
        padded = [np.concatenate([each, np.repeat(each[:1], most - len(each), axis=0)]) for each in vertices]
        self.vertices = xp.asarray(np.stack(padded)) if most > 1 else None


def palm_normal(tilt: Array) -> Array:
    """Where the surface of the upturned palm looks, world, whose wrist is turned by rotation vectors (..., 3), rad, in
    the palm's own axes; shape (..., 3)."""
    facing = library(tilt).asarray(FACING) + 0.0 * tilt[..., :1]
    upward = library(tilt).asarray(np.array([1.0, 0.0, 0.0])) + 0.0 * tilt
    return turned(product(facing, quaternion_from_vector(tilt)), upward)


def clearance(pose: Array, shapes: Shapes, kind: Array, factor: Array, normal: Array) -> Array:
    """Of the lowest points of objects over the palm's surface, shape (n,), m; below it negative. Poses (n, 7), world;
    which of the shapes each is (n,), and its size as a factor of that (n,); the palm's normal (n, 3)."""
    xp, back = library(pose), pose[:, 3:] * library(pose).asarray(np.array([1.0, -1.0, -1.0, -1.0]))
    down, half = -turned(back, normal), shapes.half[kind] * factor[:, None]
    parts = xp.abs(down * half)
    shape = shapes.kind[kind]
    tube = length(parts[:, :2]) + parts[:, 2]
    reach = xp.where(shape == _CORNERS, parts.sum(axis=-1), xp.where(shape == _ROUND, length(parts), tube))
    if shapes.vertices is not None:
        points = (shapes.vertices[kind] * down[:, None, :]).sum(axis=-1)
        reach = xp.where(shape == _MESH, xp.max(points, axis=-1) * factor, reach)
    found: Array = (pose[:, :3] * normal).sum(axis=-1) - reach - PALM
    return found
