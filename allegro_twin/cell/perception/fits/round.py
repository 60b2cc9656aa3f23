"""Balls and eggs on a table: solids that their visible side alone says."""

from __future__ import annotations

import numpy as np

from allegro_twin.cell.perception.fits.model import (
    UP,
    PointSample,
    Residuals,
    Shape,
    Solid,
    SolidModel,
    along,
    behind,
    level,
    main_direction,
)
from allegro_twin.types import Array, Vector

_ROUND = 1.08
"""An egg that is longer than wide by less than this is a ball."""


def _ones(seen: PointSample) -> Vector:
    return np.ones(len(seen.points))


def _height(seen: PointSample) -> float:
    return max(seen.top / 2.0, 0.005)


def _ball(seen: PointSample) -> Residuals:
    """x, y, r: it touches the table, so that its middle is at the height r."""
    a, b, c = seen.points.T

    def residuals(p: Array) -> Array:
        x, y, r = p.T[..., None]
        return np.asarray(np.sqrt((a - x) ** 2 + (b - y) ** 2 + (c - r) ** 2) - r)

    return residuals


def _lying(seen: PointSample) -> Residuals:
    """x, y, θ, a, b: half its length a along (cos θ, sin θ); half its width b, also its middle's height."""
    i, j, k = seen.points.T

    def residuals(p: Array) -> Array:
        x, y, turn, a, b = p.T[..., None]
        c, s = np.cos(turn), np.sin(turn)
        return _off((c * (i - x) + s * (j - y)) ** 2, (c * (j - y) - s * (i - x)) ** 2 + (k - b) ** 2, a, b)

    return residuals


def _standing(seen: PointSample) -> Residuals:
    """x, y, a, b: half its height a, also its middle's, and half its width b."""
    i, j, k = seen.points.T

    def residuals(p: Array) -> Array:
        x, y, a, b = p.T[..., None]
        return _off((k - a) ** 2, (i - x) ** 2 + (j - y) ** 2, a, b)

    return residuals


def _off(along2: Array, out2: Array, a: Array, b: Array) -> Array:
    """How far off f = 1, with f² = (along/a)² + (out/b)², of squares: to first order (f - 1)/|∇f|."""
    f = np.sqrt(along2 / a**2 + out2 / b**2) + 1e-9
    return np.asarray((f - 1.0) * f / np.sqrt(along2 / a**4 + out2 / b**4 + 1e-12))


def _ball_starts(seen: PointSample) -> list[Vector]:
    r = _height(seen)
    return [np.array([*behind(seen, r), r])]


def _lying_starts(seen: PointSample) -> list[Vector]:
    b, turn = _height(seen), main_direction(seen.points[:, :2])
    angles = turn + np.pi / 4 * np.arange(4)
    return [np.array([*behind(seen, b), angle, 1.25 * b, b]) for angle in angles]


def _standing_starts(seen: PointSample) -> list[Vector]:
    a = _height(seen)
    return [np.array([*behind(seen, 0.75 * a), a, 0.75 * a])]


def _egg(position: list[float], axis: Array, a: float, b: float, error: float) -> Solid:
    """Wider than long is none."""
    shape: Shape = "ellipsoid" if a > _ROUND * b else "sphere"
    axes = along(axis) if shape == "ellipsoid" else np.eye(3)
    return Solid(shape, np.array(position), axes, (2 * a, 2 * b, 2 * b), error if a > b / _ROUND else np.inf)


def _sphere_of(p: Vector, error: float) -> Solid:
    x, y, r = (float(value) for value in p)
    return Solid("sphere", np.array([x, y, r]), np.eye(3), (2 * r, 2 * r, 2 * r), error)


def _lying_of(p: Vector, error: float) -> Solid:
    x, y, turn, a, b = (float(value) for value in p)
    return _egg([x, y, b], level(turn), a, b, error)


def _standing_of(p: Vector, error: float) -> Solid:
    x, y, a, b = (float(value) for value in p)
    return _egg([x, y, a], UP, a, b, error)


SPHERE = SolidModel(_ball_starts, _ball, _ones, _sphere_of)
LYING_EGG = SolidModel(_lying_starts, _lying, _ones, _lying_of)
STANDING_EGG = SolidModel(_standing_starts, _standing, _ones, _standing_of)
