"""Points on an object, and which way is out."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.orientation import matrix_from_quaternion
from allegro_twin.sim.objects.catalogue import Placement, Thing
from allegro_twin.types import Array

Random = np.random.Generator


class Surface(NamedTuple):
    """Drawn uniformly by area."""

    points: Array
    """(k, 3), m."""
    normals: Array
    """Outward, (k, 3)."""


def placed_surface(placed: Placement, count: int, random: Random) -> Surface:
    """Points on an object where it stands, world."""
    own = surface(placed.thing, count, random)
    turn = matrix_from_quaternion(np.array(placed.quaternion))
    return Surface(own.points @ turn.T + placed.position, own.normals @ turn.T)


def surface(thing: Thing, count: int, random: Random) -> Surface:
    """Points on an object, in its own frame. Raises ConfigError for an MJCF."""
    match thing.shape, thing.size:
        case "sphere", (diameter,):
            normals = _unit(random.normal(size=(count, 3)))
            return Surface(diameter / 2 * normals, normals)
        case "cylinder", (diameter, height):
            return _cylinder(diameter / 2, height, count, random)
        case "box", _:
            return _box(thing.half_extents(), count, random)
        case "ellipsoid", _:
            return _ellipsoid(thing.half_extents(), count, random)
        case "mesh", _:
            return _mesh(thing, count, random)
    raise ConfigError(f"object {thing.name}: the surface of an {thing.shape} is not known; give it as a mesh")


def _cylinder(radius: float, height: float, count: int, random: Random) -> Surface:
    side = random.random(count) < height / (height + radius)  # 2πrh of 2πrh + 2πr²
    angle = random.uniform(0.0, 2.0 * np.pi, count)
    round_ = np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=1)
    end = random.choice([-1.0, 1.0], count)
    flat = np.stack([np.zeros(count), np.zeros(count), end], axis=1)
    along = random.uniform(-0.5, 0.5, count) * height
    within = radius * np.sqrt(random.random(count))
    points = np.where(side[:, None], radius * round_, within[:, None] * round_)
    points[:, 2] = np.where(side, along, end * height / 2)
    return Surface(points, np.where(side[:, None], round_, flat))


def _box(half: Array, count: int, random: Random) -> Surface:
    areas = np.array([half[1] * half[2], half[0] * half[2], half[0] * half[1]])
    axis = random.choice(3, count, p=areas / areas.sum())
    end = random.choice([-1.0, 1.0], count)
    points = random.uniform(-1.0, 1.0, (count, 3)) * half
    points[np.arange(count), axis] = end * half[axis]
    normals = np.zeros((count, 3))
    normals[np.arange(count), axis] = end
    return Surface(points, normals)


def _ellipsoid(half: Array, count: int, random: Random) -> Surface:
    """By rejection: an area element of the sphere is stretched by |diag(1/half) n| det(half)."""
    found = np.empty((0, 3))
    while len(found) < count:
        unit = _unit(random.normal(size=(2 * count, 3)))
        stretch = np.linalg.norm(unit / half, axis=1) * half.min()
        found = np.concatenate([found, unit[random.random(2 * count) < stretch]])
    found = found[:count]
    return Surface(found * half, _unit(found / half))


def _mesh(thing: Thing, count: int, random: Random) -> Surface:
    mesh = thing.mesh()
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    area = np.linalg.norm(cross, axis=1)
    face = random.choice(len(area), count, p=area / area.sum())
    u, v = random.random((2, count, 1))
    folded = u + v > 1.0
    u, v = np.where(folded, 1.0 - u, u), np.where(folded, 1.0 - v, v)
    points = a[face] + u * (b[face] - a[face]) + v * (c[face] - a[face])
    return Surface(points, cross[face] / area[face, None])


def _unit(vectors: Array) -> Array:
    unit: Array = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    return unit
