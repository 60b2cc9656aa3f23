"""Shapes as triangles: few of them, with smooth normals and one colour each."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from allegro_twin.hands.description.appearance import VisualShape, object_appearance
from allegro_twin.kinematics.orientation import matrix_from_quaternion
from allegro_twin.types import Array

_ROUND, _HIGH = 24, 12  # Parts around and along; enough where a millimetre is a pixel.
_FINE = 2  # So many times finer where a pattern is painted.


class TriangleSurface(NamedTuple):
    """Triangles that share nothing: every three rows are one."""

    vertices: Array
    """(3 f, 3), m."""
    normals: Array
    """(3 f, 3)."""
    colors: NDArray[np.uint8]
    """(3 f, 4), RGBA."""


def surface_of(shape: VisualShape) -> TriangleSurface:
    """One shape in the frame of its body."""
    corners, normals = _local(shape)
    colors = np.tile(np.array(shape.color), (len(corners), 1))
    if shape.paint:
        middles = corners.reshape(-1, 3, 3).mean(axis=1)
        extent = np.maximum(np.abs(corners).max(axis=0), 1e-9)
        colors[:, :3] = np.repeat(object_appearance(shape.paint).paint(middles / extent), 3, axis=0)
    turn = matrix_from_quaternion(np.array(shape.quaternion))
    rgba = np.round(255 * colors).astype(np.uint8)
    return TriangleSurface(corners @ turn.T + np.array(shape.position), normals @ turn.T, rgba)


def join_surfaces(surfaces: list[TriangleSurface]) -> TriangleSurface:
    """Many as one: one thing to send and to draw."""
    vertices, normals, colors = (np.concatenate(parts) for parts in zip(*surfaces, strict=True))
    return TriangleSurface(vertices, normals, colors)


def _local(shape: VisualShape) -> tuple[Array, Array]:
    fine = _FINE if shape.paint else 1
    match shape.kind:
        case "sphere":
            return _ellipsoid(np.full(3, shape.size[0]), fine)
        case "ellipsoid":
            return _ellipsoid(np.array(shape.size), fine)
        case "box":
            edges = object_appearance(shape.paint).box_edges() if shape.paint else np.array([-1.0, 1.0])
            return _box(np.array(shape.size), edges)
        case "capsule":
            return _turned(*_capsule(*shape.size))
        case "cylinder":
            return _turned(*_cylinder(shape.size[0], shape.size[1], fine))
        case _:
            assert shape.vertices is not None
            assert shape.triangles is not None
            corners = shape.vertices[shape.triangles].reshape(-1, 3)
            return corners, _flat(corners)


def _ellipsoid(half: Array, fine: int) -> tuple[Array, Array]:
    turns = np.linspace(-np.pi / 2, np.pi / 2, _HIGH * fine * fine + 1)
    unit, _ = _turned(np.cos(turns), np.sin(turns), np.cos(turns), np.sin(turns), fine * fine)
    normals = unit / half
    return unit * half, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def _capsule(radius: float, half: float) -> tuple[Array, Array, Array, Array]:
    """Its outline: distance from the axis and height, and the same of the normal."""
    turns = np.linspace(-np.pi / 2, np.pi / 2, 9)
    up = np.where(np.arange(9) < 5, -half, half)
    up, turns = np.insert(up, 5, half), np.insert(turns, 5, 0.0)
    return radius * np.cos(turns), up + radius * np.sin(turns), np.cos(turns), np.sin(turns)


def _cylinder(radius: float, half: float, fine: int) -> tuple[Array, Array, Array, Array, int]:
    wall = np.linspace(-half, half, 20 * fine if fine > 1 else 2)
    high = np.concatenate([[-half, -half], wall, [half, half]])
    wide = np.concatenate([[0.0, radius], np.full(len(wall), radius), [radius, 0.0]])
    out = np.concatenate([[0.0, 0.0], np.ones(len(wall)), [0.0, 0.0]])
    up = np.concatenate([[-1.0, -1.0], np.zeros(len(wall)), [1.0, 1.0]])
    return wide, high, out, up, fine


def _turned(wide: Array, high: Array, out: Array, up: Array, fine: int = 1) -> tuple[Array, Array]:
    """An outline turned about z: vertices and normals, three rows a triangle."""
    turns = np.linspace(0.0, 2 * np.pi, _ROUND * fine + 1)
    circle = np.stack([np.cos(turns), np.sin(turns)], axis=1)

    def swept(radius: Array, height: Array) -> Array:
        flat = radius[:, None, None] * circle[None]
        return np.concatenate([flat, np.broadcast_to(height[:, None, None], (*flat.shape[:2], 1))], axis=2)

    return _split(swept(wide, high).swapaxes(0, 1)), _split(swept(out, up).swapaxes(0, 1))


def _box(half: Array, steps: Array) -> tuple[Array, Array]:
    a, b = np.meshgrid(steps, steps, indexing="ij")
    corners, normals = [], []
    for axis in range(3):
        for sign in (1.0, -1.0):
            face = np.empty((*a.shape, 3))
            face[..., axis] = sign
            face[..., (axis + 1) % 3], face[..., (axis + 2) % 3] = (a, b) if sign > 0 else (b, a)
            corners.append(_split(face) * half)
            normals.append(np.tile(sign * np.eye(3)[axis], (len(corners[-1]), 1)))
    return np.concatenate(corners), np.concatenate(normals)


def _split(grid: Array) -> Array:
    """The quadrilaterals of a grid (r, c, 3) as triangles, outward if rows then columns turn to the right hand."""
    quads = np.stack([grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]], axis=2).reshape(-1, 4, 3)
    found: Array = quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    return found


def _flat(corners: Array) -> Array:
    first, second, third = np.moveaxis(corners.reshape(-1, 3, 3), 1, 0)
    normal = np.cross(second - first, third - first)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    return np.repeat(normal, 3, axis=0)
