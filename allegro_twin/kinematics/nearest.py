"""The nearest point that a finger can reach, where it cannot reach the one asked for."""

from __future__ import annotations

from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from allegro_twin.kinematics.family import Chain
from allegro_twin.kinematics.finger import wrapped
from allegro_twin.types import Array, Vector

Mode: TypeAlias = Literal["position", "pitch", "rotation", "q0", "q1", "psi"]
"""What a target fixes besides the position."""
_CHUNK, _ROUNDS, _SMALLEST = 256, 90, 1e-10
_STEPS = {2: np.array([0.01, 0.03, 0.1, 0.3, 1.0]), 3: np.array([0.03, 0.2, 1.0])}


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
    grid finds the best start, and a pattern of steps along the axes of the tip's motion, which shrinks where it finds
    no better, follows it down, to 1e-7 m. It is global as far as the first grid (5 to 10 degrees) tells two minima
    apart; tests/kinematics/test_unreachable.py compares it with dense sampling.
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
    points = 25 if len(free) == 2 else 13
    grid = middle[:, None] + half[:, None] * _product(np.linspace(-1, 1, points), len(free))[:, :, None]
    best, least = _least(*_completed(chain, mode, grid, free, target, angle, lower, upper))
    size = np.full(len(angle), 3.0 / points) * half.max()
    steps = _product(np.concatenate([-_STEPS[len(free)], [0.0], _STEPS[len(free)]]), len(free))
    for _ in range(_ROUNDS):
        centre = np.where(np.isfinite(least), best[list(free)], middle)
        axes = _axes(chain, mode, centre, free, target, angle, lower, upper)  # (N, f, f)
        grid = np.clip(centre[:, None] + np.einsum("nij,js->isn", axes, steps) * size, low[:, None], high[:, None])
        q, distance = _least(*_completed(chain, mode, grid, free, target, angle, lower, upper))
        better = distance < least
        best, least = np.where(better, q, best), np.where(better, distance, least)
        size = np.where(better, size, size * 0.4)
        if size.max() < _SMALLEST:
            break
    return np.where(np.isfinite(least), best, np.nan), least


def _product(steps: Array, n: int) -> Array:
    """Every combination of n steps, shape (n, s)."""
    return np.stack(np.meshgrid(*[steps] * n, indexing="ij")).reshape(n, -1)


def _least(q: Array, distance: Array) -> tuple[Array, Array]:
    """The best of the samples: joints (4, N) and distance (N,)."""
    chosen = np.argmin(distance, axis=0)
    posture = np.take_along_axis(q, chosen[None, None], axis=1)[:, 0]
    return posture, np.take_along_axis(distance, chosen[None], axis=0)[0]


def _axes(
    chain: Chain,
    mode: Mode,
    centre: Array,
    free: tuple[int, ...],
    target: tuple[Array, Array, Array],
    angle: Array,
    lower: Vector,
    upper: Vector,
) -> Array:
    """The directions in which the free joints move the tip least to most, the eigenvectors of JᵀJ, (N, f, f)."""
    step = 1e-6 * np.hstack([np.zeros((len(free), 1)), np.eye(len(free))])
    q, _ = _completed(chain, mode, centre[:, None] + step[:, :, None], free, target, angle, lower, upper)
    tip = np.stack(chain.tip(q))  # (3, 1 + f, N)
    jacobian = (tip[:, 1:] - tip[:, :1]) / 1e-6
    return np.asarray(np.linalg.eigh(np.einsum("xin,xjn->nij", jacobian, jacobian))[1])


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
        bent = q[2] + (q[1] if mode == "pitch" else 0.0)
        wanted = bent + wrapped(angle - bent, (lower[3] + upper[3]) / 2)
        q[3] = np.clip(wanted - bent, lower[3], upper[3])
        # What joint 3 cannot give the others do, so that samples beyond its limit fall onto it.
        for joint in (2, 1) if mode == "pitch" else (2,):
            excess = wanted - (q[1] if mode == "pitch" else 0.0) - q[2] - q[3]
            q[joint] = np.clip(q[joint] + excess, lower[joint], upper[joint])
        feasible = np.abs(wanted - (q[1] if mode == "pitch" else 0.0) - q[2] - q[3]) <= 1e-12
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
