"""The nearest point that a finger can reach, where it cannot reach the one asked for."""

from __future__ import annotations

from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from allegro_twin.kinematics.family import Chain
from allegro_twin.kinematics.finger import wrapped
from allegro_twin.types import Array, Vector

Mode: TypeAlias = Literal["position", "pitch", "rotation", "q0", "q1", "psi"]
"""What a target fixes besides the position."""
_CHUNK, _ROUNDS, _NARROWER = 256, 60, 0.62


class Nearest(NamedTuple):
    """The posture that brings the tip nearest to a target, in straight-line distance of the tip's centre."""

    posture: Array
    """Joints, shape (..., 4), rad; NaN where no posture has the angle asked for."""
    point: Array
    """Where the tip then is, in the palm frame, shape (..., 3), m."""
    distance: Array
    """From there to the target, shape (...), m; inf where no posture has the angle asked for."""


def search(
    chain: Chain, mode: Mode, target: tuple[Array, Array, Array], angle: Array, lower: Vector, upper: Vector
) -> tuple[Array, Array]:
    """Joints (4, N) that minimise |tip(q) - p| over lower ≤ q ≤ upper with the mode's angle held, and that distance.

    One joint is optimal in closed form given the others: q₀, or q₁ where q₀ is held. Over the two or three others a
    grid is narrowed around its best point until it is 1e-9 rad wide. It is a global search as far as its first grid
    (5 to 10 degrees) tells two minima apart; tests/kinematics/test_unreachable.py compares it with dense sampling.
    """
    n = len(angle)
    parts = [
        _search(chain, mode, tuple(c[k : k + _CHUNK] for c in target), angle[k : k + _CHUNK], lower, upper)  # type: ignore[arg-type]  # Three stay three.
        for k in range(0, n, _CHUNK)
    ]
    return np.concatenate([q for q, _ in parts], axis=1), np.concatenate([d for _, d in parts])


def _search(
    chain: Chain, mode: Mode, target: tuple[Array, Array, Array], angle: Array, lower: Vector, upper: Vector
) -> tuple[Array, Array]:
    free = {"pitch": (1, 2), "psi": (1, 2), "q0": (2, 3), "q1": (2, 3)}.get(mode, (1, 2, 3))
    low, high = lower[list(free)][:, None], upper[list(free)][:, None]  # (f, 1)
    middle, half = np.repeat((low + high) / 2, len(angle), axis=1), (high - low) / 2
    best, least = np.full((4, len(angle)), np.nan), np.full(len(angle), np.inf)
    points = 25 if len(free) == 2 else 13
    for _ in range(_ROUNDS):
        steps = np.stack(np.meshgrid(*[np.linspace(-1, 1, points)] * len(free), indexing="ij")).reshape(len(free), -1)
        grid = np.clip(middle[:, None] + (half * steps)[:, :, None], low[:, :, None], high[:, :, None])  # (f, s, N)
        q, distance = _completed(chain, mode, grid, free, target, angle, lower, upper)
        chosen = np.argmin(distance, axis=0)
        found = np.take_along_axis(distance, chosen[None], axis=0)[0]
        posture = np.take_along_axis(q, chosen[None, None], axis=1)[:, 0]
        better = found < least
        best, least = np.where(better, posture, best), np.where(better, found, least)
        middle = np.where(np.isfinite(least), best[list(free)], middle)
        half = half * (3.0 / (points - 1) if points > 7 else _NARROWER)
        points = 7 if len(free) == 2 else 5
    return best, least


def _completed(
    chain: Chain,
    mode: Mode,
    grid: Array,
    free: tuple[int, ...],
    target: tuple[Array, Array, Array],
    angle: Array,
    lower: Vector,
    upper: Vector,
) -> tuple[Array, Array]:
    """Whole postures (4, s, N) from joints (f, s, N), and how far their tips are (s, N); inf outside the limits."""
    q = np.zeros((4, *grid.shape[1:]))
    q[list(free)] = grid
    feasible = np.ones(q.shape[1:], dtype=bool)
    if mode in ("pitch", "psi"):
        rest = angle - q[2] - (q[1] if mode == "pitch" else 0.0)
        q[3] = wrapped(rest, (lower[3] + upper[3]) / 2)
        feasible = (q[3] >= lower[3] - 1e-12) & (q[3] <= upper[3] + 1e-12)
    if mode in ("q0", "q1"):
        held = 0 if mode == "q0" else 1
        q[held] = wrapped(angle, (lower[held] + upper[held]) / 2)
        feasible = (q[held] >= lower[held] - 1e-9) & (q[held] <= upper[held] + 1e-9)
    if mode == "q0":
        q = chain.swung_towards(q, *target, lower, upper)  # type: ignore[union-attr]  # Only the thumb has this mode.
    else:
        q = chain.turned_towards(q, *target, lower, upper)
    x, y, z = chain.tip(q)
    distance = np.sqrt((x - target[0]) ** 2 + (y - target[1]) ** 2 + (z - target[2]) ** 2)
    return q, np.where(feasible, distance, np.inf)
