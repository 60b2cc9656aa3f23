"""Force closure: whether the contacts can resist any wrench, and how far they are from it."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np

from allegro_twin.grasping.metrics.contacts import EDGES, Contacts, Indices, forces, wrenches
from allegro_twin.grasping.metrics.nearest import nearest
from allegro_twin.grasping.metrics.needs import scipy_part
from allegro_twin.grasping.metrics.quality import rank
from allegro_twin.types import Array, Vector

PUSH = 0.1
"""N, of each of the six forces of the residual; DexGraspBench's."""
GRIP = 1.0
"""N: in the residual all contacts together press at least so hard, and each at most; DexGraspBench's."""


def margin(touch: Contacts, edges: int = EDGES) -> float:
    """How evenly the primitive wrenches wᵢ can balance themselves:

    m = max g t, subject to Σ xᵢ wᵢ = 0, Σ xᵢ = 1, xᵢ ≥ t for all g of them.

    Force closure ⇔ m > 0 (all of them are needed to push against each other, and they span the six dimensions); at most
    1, when all do so alike. Not above 0 means none; -inf: there is no balance at all, with pulling either. A linear
    program (HiGHS), exact for the pyramids. Raises ConfigError without SciPy.
    """
    points = wrenches(touch, edges)
    count = len(points)
    if not count:
        return -math.inf
    balance = np.zeros((7, count + 1))
    balance[:6, :count], balance[6, :count] = points.T, 1.0
    above = np.hstack([-np.eye(count), np.ones((count, 1))])
    solved = scipy_part("optimize").linprog(
        np.append(np.zeros(count), -1.0), A_ub=above, b_ub=np.zeros(count), A_eq=balance,
        b_eq=np.append(np.zeros(6), 1.0), bounds=(None, None), method="highs",
    )  # fmt: skip
    if not solved.success:
        return -math.inf
    found = count * float(-solved.fun)
    return found if rank(points) == 6 else min(found, 0.0)


def residual(
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
    points, owner = wrenches(careful, edges), forces(careful, edges)[2]
    left = []
    for way in np.vstack([np.eye(6)[:3], -np.eye(6)[:3]]):
        strongest = partial(_strongest, points, owner, len(touch), grip, most, push * way)
        left.append(np.linalg.norm(nearest(strongest, 6)))
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
