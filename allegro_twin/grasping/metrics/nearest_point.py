"""The point of a polytope that is nearest to 0, of which only the farthest point in each direction is asked.

Wolfe, "Finding the nearest point in a polytope", Mathematical Programming 11, 1976: ends after finitely many steps.
Least squares with weights for the constraints (NNLS) was tried: what SciPy answers depends on the weight, and on its
version.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from allegro_twin.types import Array, Vector

_EXACT = 1e-8
"""What equations may leave over, of 1, before they are solved by least squares."""
_GAP, _STEPS = 1e-14, 500
"""Share of the largest square by which the nearest point may still come nearer when the search ends; most steps."""


def nearest_point(farthest: Callable[[Vector], Vector], dimension: int) -> Vector:
    """The nearest point, (d,). `farthest(direction)` is a point of the polytope with the least product with it."""
    corners = farthest(np.zeros(dimension))[None]
    shares, largest = np.ones(1), float(corners[0] @ corners[0])
    for _ in range(_STEPS):
        point: Vector = shares @ corners
        corner = farthest(point)
        largest = max(largest, float(corner @ corner))
        if float(point @ point - point @ corner) <= _GAP * largest:
            break
        corners, shares = _within(np.vstack([corners, corner]), np.append(shares, 0.0))
    found: Vector = shares @ corners
    return found


def _within(corners: Array, shares: Vector) -> tuple[Array, Vector]:
    """The corners whose hull holds the point of their plane that is nearest to 0, and its shares of them."""
    while True:
        wanted = _in_plane(corners)
        out = wanted <= 1e-12
        if not out.any():
            return corners, wanted
        step = (shares[out] / np.maximum(shares[out] - wanted[out], 1e-300)).min()
        shares = shares + min(step, 1.0) * (wanted - shares)
        kept = shares > 1e-12
        if kept.all():
            kept = ~out
        corners, shares = corners[kept], shares[kept] / shares[kept].sum()


def _in_plane(corners: Array) -> Vector:
    """Shares, which sum to 1, of the point nearest to 0 in the plane through some corners, (m,)."""
    count = len(corners)
    system = np.ones((count + 1, count + 1))
    system[0, 0], system[1:, 1:] = 0.0, corners @ corners.T
    right = np.append(1.0, np.zeros(count))
    try:
        solved = np.linalg.solve(system, right)
        exact = bool(np.abs(system @ solved - right).max() < _EXACT)
    except np.linalg.LinAlgError:
        exact = False
    if not exact:  # Corners that lie in less than a plane; a hundred times slower.
        solved, *_ = np.linalg.lstsq(system, right, rcond=None)
    shares: Vector = solved[1:]
    return shares
