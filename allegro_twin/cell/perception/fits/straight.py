"""Boxes and cylinders on a table: solids whose far sides only their top and their ends say."""

from __future__ import annotations

import numpy as np

from allegro_twin.cell.perception.fits.model import (
    DIRECTIONS,
    N_DIRECTIONS,
    UP,
    PointSample,
    Residuals,
    Solid,
    SolidModel,
    along,
    level,
)
from allegro_twin.types import Array, Vector

_OUTLINE = 0.3
"""The outline counts for this part of the points."""
_END = 0.05
"""Each end of what lies counts for this part of the points."""
_BEYOND = 0.008
"""This part of the points may lie beyond an end: noise."""


def _upright(seen: PointSample) -> Residuals:
    """x, y, r, h: points lie on its side or its top, and its outline is a circle."""
    i, j, k = seen.points.T

    def residuals(p: Array) -> Array:
        x, y, r, h = p.T[..., None]
        side = np.sqrt((i - x) ** 2 + (j - y) ** 2) - r
        rim = seen.trust * (seen.outline - (x * DIRECTIONS[:, 0] + y * DIRECTIONS[:, 1] + r))
        return np.concatenate([np.maximum(side, k - h), rim], axis=1)

    return residuals


def _box(seen: PointSample) -> Residuals:
    """x, y, θ, l, w, h: its edge l goes along (cos θ, sin θ); points lie on its sides or its top."""
    i, j, k = seen.points.T
    m, n = DIRECTIONS.T

    def residuals(p: Array) -> Array:
        x, y, turn, length, width, h = p.T[..., None]
        c, s = np.cos(turn), np.sin(turn)
        u, v = c * (i - x) + s * (j - y), c * (j - y) - s * (i - x)
        side = np.maximum(np.abs(u) - length / 2, np.abs(v) - width / 2)
        corner = np.abs(c * m + s * n) * length / 2 + np.abs(c * n - s * m) * width / 2
        rim = seen.trust * (seen.outline - (x * m + y * n + corner))
        return np.concatenate([np.maximum(side, k - h), rim], axis=1)

    return residuals


def _lying(seen: PointSample) -> Residuals:
    """x, y, θ, r, l: its axis goes along (cos θ, sin θ) at the height r; its ends are where the points end."""
    i, j, k = seen.points.T
    last = len(i) - 1 - int(_BEYOND * len(i))

    def residuals(p: Array) -> Array:
        x, y, turn, r, length = p.T[..., None]
        c, s = np.cos(turn), np.sin(turn)
        u, v = c * (i - x) + s * (j - y), c * (j - y) - s * (i - x)
        side = np.sqrt(v**2 + (k - r) ** 2) - r
        order = np.partition(u, (len(i) - 1 - last, last), axis=1)
        ends = np.stack([order[:, last], -order[:, len(i) - 1 - last]], axis=1) - length / 2
        return np.concatenate([np.maximum(side, np.abs(u) - length / 2), ends], axis=1)

    return residuals


def _upright_starts(seen: PointSample) -> list[Vector]:
    return [np.array([*seen.middle, seen.outline.mean(), seen.top])]


def _box_starts(seen: PointSample) -> list[Vector]:
    """Starts of a box fit: the rectangle of least area around the outline."""
    quarter = N_DIRECTIONS // 4
    widths = seen.outline + np.roll(seen.outline, -2 * quarter)
    k = int(np.argmin(widths[:quarter] * widths[quarter : 2 * quarter]))
    middle = sum(((seen.outline[n] - widths[n] / 2) * DIRECTIONS[n] for n in (k, k + quarter)), np.zeros(2))
    return [np.array([*middle, k * 2.0 * np.pi / N_DIRECTIONS, widths[k], widths[k + quarter], seen.top])]


def _lying_starts(seen: PointSample) -> list[Vector]:
    """At every 30 degrees; as wide as the top is high, and narrower, for something may stand out above it."""
    found = []
    for angle in np.pi / 6 * np.arange(6):
        forth, across = level(angle)[:2], level(angle + np.pi / 2)[:2]
        u, v = seen.points[:, :2] @ forth, seen.points[:, :2] @ across
        for radius in (seen.top / 2.0, 0.75 * seen.top / 2.0):
            # Across, the near side is seen up to where it is steep, and of the far one less.
            side = v.mean() + 0.25 * radius * across[0]
            found.append(np.array([*((u.min() + u.max()) / 2 * forth + side * across), angle, radius, np.ptp(u)]))
    return found


def _with_outline(seen: PointSample) -> Vector:
    n = len(seen.points)
    return np.concatenate([np.ones(n), np.full(N_DIRECTIONS, _OUTLINE * n / N_DIRECTIONS)])


def _with_ends(seen: PointSample) -> Vector:
    return np.concatenate([np.ones(len(seen.points)), np.full(2, _END * len(seen.points))])


def _upright_of(p: Vector, error: float) -> Solid:
    x, y, r, h = (float(value) for value in p)
    return Solid("cylinder", np.array([x, y, h / 2]), along(UP), (h, 2 * r, 2 * r), error)


def _lying_of(p: Vector, error: float) -> Solid:
    x, y, turn, r, length = (float(value) for value in p)
    return Solid("cylinder", np.array([x, y, r]), along(level(turn)), (length, 2 * r, 2 * r), error)


def _box_of(p: Vector, error: float) -> Solid:
    x, y, turn, *edges = (float(value) for value in p)
    order = np.argsort(edges)[::-1]
    axes = np.stack([level(turn), level(turn + np.pi / 2), UP], axis=1)[:, order]
    axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
    return Solid(
        "box", np.array([x, y, edges[2] / 2]), axes, (edges[order[0]], edges[order[1]], edges[order[2]]), error
    )


STANDING_CYLINDER = SolidModel(_upright_starts, _upright, _with_outline, _upright_of)
LYING_CYLINDER = SolidModel(_lying_starts, _lying, _with_ends, _lying_of)
BOX = SolidModel(_box_starts, _box, _with_outline, _box_of)
