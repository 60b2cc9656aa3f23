"""Rounded boxes as Wavefront OBJ, for drawing links."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from allegro_twin.types import Array

_SEGMENTS = 9  # Odd, so that no vertex lies on a mid-plane and every corner gets its own part of the sphere.


def rounded_box(half: tuple[float, ...], radius: float, segments: int = _SEGMENTS) -> tuple[Array, NDArray[np.int64]]:
    """Vertices (k, 3) in m and triangles (f, 3) of a box with round edges, outward normals.

    A cube's grid is blown up to the unit sphere; the sphere's eight octants, scaled by `radius`, move into the corners.
    """
    angles = np.tan(np.linspace(-np.pi / 4, np.pi / 4, segments + 1))
    a, b = np.meshgrid(angles, angles, indexing="ij")
    corner = np.arange((segments + 1) ** 2, dtype=np.int64).reshape(segments + 1, segments + 1)
    quads = np.stack([corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]], axis=-1).reshape(-1, 4)
    vertices: list[Array] = []
    triangles: list[NDArray[np.int64]] = []
    for axis in range(3):
        for sign in (1.0, -1.0):
            face = np.empty((*a.shape, 3))
            face[..., axis], face[..., (axis + 1) % 3], face[..., (axis + 2) % 3] = sign, a, b
            order = quads if sign > 0 else quads[:, ::-1]
            order = order + len(vertices) * a.size
            vertices.append(face.reshape(-1, 3))
            triangles += [order[:, [0, 1, 2]], order[:, [0, 2, 3]]]
    directions = np.concatenate(vertices)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    core = np.asarray(half) - radius
    unique, index = np.unique(
        np.round(np.sign(directions) * core + radius * directions, 9), axis=0, return_inverse=True
    )
    return unique, index.astype(np.int64).reshape(-1)[np.concatenate(triangles)]


def obj(vertices: Array, triangles: NDArray[np.int64]) -> str:
    """The text of an OBJ file, lengths in m rounded to 10 µm."""
    lines = [f"v {x:.5f} {y:.5f} {z:.5f}" for x, y, z in vertices + 0.0]
    lines += [f"f {a} {b} {c}" for a, b, c in triangles + 1]
    return "\n".join(lines).replace("-0.00000", "0.00000") + "\n"
