"""Points on solids as a camera from one side sees them, with its scatter; in the axes of `fits`."""

from __future__ import annotations

import numpy as np

from allegro_twin.cell.perception.fits.model import PointSample, sample_points
from allegro_twin.types import Array

ELEVATION = np.radians(45.0)
SIGMA, PIXEL = 0.0007, 0.0012
TOWARDS = np.array([np.cos(ELEVATION), 0.0, -np.sin(ELEVATION)])
"""The ray: away from the camera and down."""


def seen(points: Array, normals: Array, draws: np.random.Generator) -> PointSample:
    """Of points (n, 3) of a surface with normals those that face the camera, above 6 mm, and their scatter."""
    facing = (normals @ TOWARDS < -0.2) & (points[:, 2] > 0.006)
    on = points[facing]
    on = on + SIGMA * draws.standard_normal(len(on))[:, None] * TOWARDS
    return sample_points(on, PIXEL, SIGMA, ELEVATION)


def ball(radius: float, n: int, draws: np.random.Generator) -> tuple[Array, Array]:
    normals = draws.standard_normal((n, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    return radius * normals + [0.0, 0.0, radius], normals


def egg(a: float, b: float, turn: float, n: int, draws: np.random.Generator) -> tuple[Array, Array]:
    """Lying, its length along `turn`."""
    unit = draws.standard_normal((n, 3))
    unit /= np.linalg.norm(unit, axis=1)[:, None]
    normals = unit / [a, b, b]
    turned = _about_z(turn)
    points = (unit * [a, b, b]) @ turned.T + [0.0, 0.0, b]
    return points, (normals / np.linalg.norm(normals, axis=1)[:, None]) @ turned.T


def box(edges: tuple[float, float, float], turn: float, n: int, draws: np.random.Generator) -> tuple[Array, Array]:
    """Standing, its first edge along `turn`."""
    half = np.array(edges) / 2
    areas = np.array([half[1] * half[2], half[0] * half[2], half[0] * half[1]])
    axis, sign = draws.choice(3, n, p=areas / areas.sum()), draws.choice([-1.0, 1.0], n)
    points, normals = draws.uniform(-1.0, 1.0, (n, 3)) * half, np.zeros((n, 3))
    points[np.arange(n), axis] = sign * half[axis]
    normals[np.arange(n), axis] = sign
    return points @ _about_z(turn).T + [0.0, 0.0, half[2]], normals @ _about_z(turn).T


def cylinder(radius: float, length: float, n: int, draws: np.random.Generator) -> tuple[Array, Array]:
    """About z, its middle at 0."""
    angle, caps = draws.uniform(-np.pi, np.pi, n), draws.random(n) < radius / (radius + length)
    side = np.stack([np.cos(angle), np.sin(angle), np.zeros(n)], axis=1)
    sign = draws.choice([-1.0, 1.0], n)
    out = np.where(caps, radius * np.sqrt(draws.random(n)), radius)
    along = np.where(caps, sign * length / 2, draws.uniform(-length / 2, length / 2, n))
    points = side * out[:, None] + np.stack([np.zeros(n), np.zeros(n), along], axis=1)
    return points, np.where(caps[:, None], np.stack([np.zeros(n), np.zeros(n), sign], axis=1), side)


def lying(points: Array, normals: Array, radius: float, turn: float) -> tuple[Array, Array]:
    """What is about z, laid on the table along `turn`."""
    down = _about_z(turn) @ np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    return points @ down.T + [0.0, 0.0, radius], normals @ down.T


def _about_z(turn: float) -> Array:
    c, s = np.cos(turn), np.sin(turn)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
