"""The space of wrenches that a grasp can exert: its largest ball and its volume.

Ferrari and Canny, "Planning optimal grasps", ICRA 1992. The L1 variant: the normal forces of all contacts together are
at most 1 N, so the space is the convex hull of 0 and the primitive wrenches. (In the other, L∞, each contact has 1 N
of its own, and the space is the sum of their hulls: it grows with the number of contacts and is not computed here.)
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from allegro_twin.grasping.metrics.contacts import EDGES, Contacts, wrenches
from allegro_twin.grasping.metrics.needs import scipy_part
from allegro_twin.types import Array

_FLAT = 1e-7
"""Of the largest extent: a hull that is thinner in some direction has no inside."""


class Quality(NamedTuple):
    """Of the convex hull of 0 and the primitive wrenches."""

    epsilon: float
    """N: the largest wrench that can be resisted in every direction with normal forces of 1 N in all; 0 without force
    closure."""
    volume: float
    """N⁶; also of a grasp without force closure."""


def quality(touch: Contacts, edges: int = EDGES) -> Quality:
    """ε and the volume. Exact for the pyramids, whose hull lies inside that of the cones: both are lower bounds, which
    more edges raise. Raises ConfigError without SciPy."""
    return of_wrenches(wrenches(touch, edges))


def of_wrenches(points: Array) -> Quality:
    """The same of primitive wrenches, (g, 6), N."""
    if rank(points) < 6:
        return Quality(0.0, 0.0)
    hull = scipy_part("spatial").ConvexHull(np.vstack([np.zeros(6), points]))
    # Each facet is normal · w + offset ≤ 0, its normal of length 1: what is left at w = 0 is the distance to it.
    return Quality(max(0.0, float(-hull.equations[:, -1].max())), float(hull.volume))


def rank(points: Array) -> int:
    """The dimension of the hull of 0 and some wrenches (g, 6)."""
    if not len(points):
        return 0
    sizes = np.linalg.svd(points, compute_uv=False)
    return int((sizes > _FLAT * sizes[0]).sum())
