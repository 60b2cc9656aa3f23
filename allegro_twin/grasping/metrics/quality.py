"""The space of wrenches that a grasp can exert: its largest ball and its volume.

Ferrari and Canny, "Planning optimal grasps", ICRA 1992. The L1 variant: the normal forces of all contacts together are
at most 1 N, so the space is the convex hull of 0 and the primitive wrenches. (In the other, L∞, each contact has 1 N
of its own, and the space is the sum of their hulls: it grows with the number of contacts and is not computed here.)
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from types import ModuleType
from typing import NamedTuple

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.grasping.metrics.contacts import EDGES, Contacts, Indices, cone_forces, cone_wrenches
from allegro_twin.grasping.metrics.nearest_point import nearest_point
from allegro_twin.types import Array, Vector


def import_scipy(name: str) -> ModuleType:
    """One part of SciPy: `optimize`, `spatial`. Raises ConfigError where the extra is not installed."""
    try:
        import scipy.optimize  # type: ignore[import-untyped]  # Its types are a package of their own.
        import scipy.spatial  # type: ignore[import-untyped]
    except ImportError as error:
        raise ConfigError("metrics of contacts need SciPy: pip install 'allegro-twin[objects]'") from error
    found: ModuleType = getattr(scipy, name)
    return found


_FLAT = 1e-7
"""Share of the largest extent: a hull that is thinner in some direction has no inside."""


class GraspQuality(NamedTuple):
    """Quality of a grasp: measures of the convex hull of 0 and the primitive wrenches."""

    epsilon: float
    """N: the largest wrench that can be resisted in every direction with normal forces of 1 N in all; 0 without force
    closure."""
    volume: float
    """N⁶; also of a grasp without force closure."""


def grasp_quality(touch: Contacts, edges: int = EDGES) -> GraspQuality:
    """ε and the volume. Exact for the pyramids, whose hull lies inside that of the cones: both are lower bounds, which
    more edges raise. Raises ConfigError without SciPy."""
    return wrench_quality(cone_wrenches(touch, edges))


def wrench_quality(points: Array) -> GraspQuality:
    """Quality of primitive wrenches, (g, 6), N."""
    if rank(points) < 6:
        return GraspQuality(0.0, 0.0)
    hull = import_scipy("spatial").ConvexHull(np.vstack([np.zeros(6), points]))
    # Each facet is normal · w + offset ≤ 0, its normal of length 1: what is left at w = 0 is the distance to it.
    return GraspQuality(max(0.0, float(-hull.equations[:, -1].max())), float(hull.volume))


def rank(points: Array) -> int:
    """The dimension of the hull of 0 and some wrenches (g, 6)."""
    if not len(points):
        return 0
    sizes = np.linalg.svd(points, compute_uv=False)
    return int((sizes > _FLAT * sizes[0]).sum())


PUSH = 0.1
"""N, of each of the six forces of the residual; DexGraspBench's."""
GRIP = 1.0
"""N: in the residual all contacts together press at least so hard, and each at most; DexGraspBench's."""


def closure_margin(touch: Contacts, edges: int = EDGES) -> float:
    """How evenly the primitive wrenches wᵢ can balance themselves:

    m = max g t, subject to Σ xᵢ wᵢ = 0, Σ xᵢ = 1, xᵢ ≥ t for all g of them.

    Force closure ⇔ m > 0 (all of them are needed to push against each other, and they span the six dimensions); at most
    1, when all do so alike. Not above 0 means none; -inf: there is no balance at all, with pulling either. A linear
    program (HiGHS), exact for the pyramids. Raises ConfigError without SciPy.
    """
    points = cone_wrenches(touch, edges)
    count = len(points)
    if not count:
        return -math.inf
    balance = np.zeros((7, count + 1))
    balance[:6, :count], balance[6, :count] = points.T, 1.0
    above = np.hstack([-np.eye(count), np.ones((count, 1))])
    solved = import_scipy("optimize").linprog(
        np.append(np.zeros(count), -1.0), A_ub=above, b_ub=np.zeros(count), A_eq=balance,
        b_eq=np.append(np.zeros(6), 1.0), bounds=(None, None), method="highs",
    )  # fmt: skip
    if not solved.success:
        return -math.inf
    found = count * float(-solved.fun)
    return found if rank(points) == 6 else min(found, 0.0)


def qp_residual(
    touch: Contacts,
    edges: int = EDGES,
    *,
    share: float = 0.5,
    push: float = PUSH,
    grip: float = GRIP,
    most: float = GRIP,
) -> float:
    """What is left of six pushes, N: the mean over ±x, ±y, ±z of

    min ‖Σ xᵢ wᵢ + w‖, subject to xᵢ ≥ 0, Σ xᵢ ≥ grip, and at each contact Σ xᵢ ≤ most (both N),

    where w is a force of `push` (N), and friction is only `share` of what it is. 0: all six can be resisted.

    DexGraspBench's QP metric; torques count divided by `Contacts.length`. To have its very figures: `edges` 4, a length
    of 1 m, and as the centre the mean of the points. Without contacts, or where `grip` asks for more than `most`
    allows, it is 1, as there. Exact for the pyramids (Wolfe's algorithm).
    """
    if len(touch) * most < grip:
        return 1.0
    careful = replace(touch, friction=share * touch.friction, torsion=share * touch.torsion)
    points, owner = cone_wrenches(careful, edges), cone_forces(careful, edges)[2]
    left = []
    for way in np.vstack([np.eye(6)[:3], -np.eye(6)[:3]]):
        strongest = partial(_strongest, points, owner, len(touch), grip, most, push * way)
        left.append(np.linalg.norm(nearest_point(strongest, 6)))
    return float(np.mean(left))


def _strongest(
    points: Array, owner: Indices, count: int, grip: float, most: float, load: Vector, direction: Vector
) -> Vector:
    """With the load, the wrench that goes least along a direction, (6,): each contact presses fully where that helps,
    and then, until all press with `grip`, those where it harms least."""
    along = points @ direction
    best = np.array([np.flatnonzero(owner == k)[along[owner == k].argmin()] for k in range(count)])
    cheapest = best[along[best].argsort(kind="stable")]
    helping = float((along[best] < 0.0).sum())
    total = max(grip, most * helping)
    pressed = np.clip(total - most * np.arange(count), 0.0, most)
    wrench: Vector = load + pressed @ points[cheapest]
    return wrench


def imbalance(held: Contacts) -> float:
    """How far contacts that press with 1 in all are from balancing each other: min |Σ xᵢ wᵢ| over x ≥ 0, Σ xᵢ = 1, the
    distance of the origin from the hull of the wrenches."""
    corners = cone_wrenches(held)
    return float(np.linalg.norm(nearest_point(lambda way: corners[int(np.argmin(corners @ way))], 6)))
