"""Position alone leaves a finger one freedom: the postures that reach a point form curves, and this picks one.

Inside the limits every such curve ends at a joint's limit or closes around a straight elbow. Fixing each joint in turn
at its limits, and the elbow at zero, is solved in closed form and so touches every curve: a point is reachable exactly
if one of these candidates is inside the limits. From the best of the candidates and of samples between them, along φ
on a finger and q₀ on the thumb, the preferred posture is found by a search that narrows.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from allegro_twin.kinematics.finger import Branches, ImaFinger, wrapped
from allegro_twin.kinematics.planar import TOUCH, Flags, two_link
from allegro_twin.kinematics.thumb import Thumb
from allegro_twin.types import Array, Vector

Chain = ImaFinger | Thumb
Cost = Callable[[Array], Array]
"""What a posture costs: joints (4, k, N) → (k, N); the least is preferred."""
TOLERANCE = 1e-9
"""A joint this far beyond its limit counts as on it, rad: the same as `HandSpec.posture`."""
_SAMPLES, _POINTS, _ROUNDS, _NARROWER = 33, 7, 26, 0.4


def inside(q: Array, lower: Vector, upper: Vector) -> tuple[Array, Flags]:
    """Joints (4, ...) turned into the limits where a full turn does it, and which are inside, (...)."""
    shape = (4,) + (1,) * (q.ndim - 1)
    low, high = lower.reshape(shape), upper.reshape(shape)
    turned = wrapped(q, (low + high) / 2)
    return turned, np.asarray(((turned >= low - TOLERANCE) & (turned <= high + TOLERANCE)).all(axis=0))


def resolve(
    chain: Chain, x: Array, y: Array, z: Array, lower: Vector, upper: Vector, cost: Cost
) -> tuple[Array, Array]:
    """The cheapest posture inside the limits at each point: joints (4, N), NaN where none reaches it, and cost (N,).

    `cost` sees only postures inside the limits. Accurate to about 1e-9 rad where it is smooth.
    """
    q, ok = candidates(chain, x, y, z, lower, upper)
    best, value = _cheapest((q, ok), lower, upper, cost)
    q, within = inside(q, lower, upper)
    along = np.where(within & ok, _parameter(chain, q), np.nan)
    low, high = np.fmin.reduce(along, axis=0), np.fmax.reduce(along, axis=0)
    half = np.where(high >= low, (high - low) / 2, 0.0)
    middle = np.where(high >= low, (high + low) / 2, 0.0)
    points = _SAMPLES
    for _ in range(_ROUNDS):
        steps = np.linspace(-1.0, 1.0, points)[:, None]
        sampled, cheaper = _at(chain, x, y, z, middle + half * steps, lower, upper, cost)
        better = cheaper < value
        best, value = np.where(better, sampled, best), np.where(better, cheaper, value)
        middle = np.where(np.isfinite(value), _parameter(chain, best), 0.0)
        half = half * (2.0 / (points - 1) if points == _SAMPLES else _NARROWER)
        points = _POINTS
    return best, value


def candidates(chain: Chain, x: Array, y: Array, z: Array, lower: Vector, upper: Vector) -> Branches:
    """Postures with one joint at a limit or the elbow straight: joints (4, k, N), reached (k, N)."""
    if isinstance(chain, ImaFinger):
        found = [
            _finger_with_fixed(chain, x, y, z, joint, float(value))
            for joint, values in ((1, (lower[1], upper[1])), (2, (lower[2], 0.0, upper[2])), (3, (lower[3], upper[3])))
            for value in values
        ]
    else:
        found = [
            way(x, y, z, np.full_like(x, value))
            for way, values in (
                (chain.at_q0, (lower[0], upper[0])),
                (chain.at_q1, (lower[1], upper[1])),
                (chain.at_q2, (lower[2], upper[2])),
                (chain.at_q3, (lower[3], 0.0, upper[3])),
            )
            for value in values
        ]
    return np.concatenate([q for q, _ in found], axis=1), np.concatenate([ok for _, ok in found], axis=0)


def _finger_with_fixed(chain: ImaFinger, x: Array, y: Array, z: Array, joint: int, value: float) -> Branches:
    """A finger with one bending joint fixed is two links: both sides of the abduction axis times both elbows."""
    first, second, tip = chain.geometry.links
    reach = np.hypot(x, y)
    turn = np.where(reach <= TOUCH, 0.0, np.arctan2(y, x))
    height = z - float(chain.geometry.offset[2])
    rows, oks = [], []
    for r, q0 in ((reach, turn), (-reach, turn + np.pi)):
        for sign in (1.0, -1.0):
            if joint == 1:
                bend = two_link(r - first * np.sin(value), height - first * np.cos(value), second, tip)
                q1, q3 = np.full_like(x, value), sign * bend.elbow
                q2 = bend.towards - sign * bend.lead - value
            elif joint == 2:
                along, aside = first + second * np.cos(value), second * np.sin(value)
                bend = two_link(r, height, float(np.hypot(along, aside)), tip)
                lean = float(np.arctan2(aside, along))
                q1, q2 = bend.towards - sign * bend.lead - lean, np.full_like(x, value)
                q3 = sign * bend.elbow - value + lean
            else:
                along, aside = second + tip * np.cos(value), tip * np.sin(value)
                bend = two_link(r, height, first, float(np.hypot(along, aside)))
                q1, q3 = bend.towards - sign * bend.lead, np.full_like(x, value)
                q2 = sign * bend.elbow - float(np.arctan2(aside, along))
            rows.append(np.stack([q0, q1, q2, q3]))
            oks.append(bend.reached)
    return np.stack(rows, axis=1), np.stack(oks)


def _parameter(chain: Chain, q: Array) -> Array:
    parameter: Array = q[1] + q[2] + q[3] if isinstance(chain, ImaFinger) else q[0]
    return parameter


def _at(
    chain: Chain, x: Array, y: Array, z: Array, along: Array, lower: Vector, upper: Vector, cost: Cost
) -> tuple[Array, Array]:
    """The cheapest posture at any of the parameters (s, N): joints (4, N) and cost (N,)."""
    samples, n = along.shape
    tx, ty, tz = (np.tile(c, samples) for c in (x, y, z))
    solve = chain.at_pitch if isinstance(chain, ImaFinger) else chain.at_q0
    q, ok = solve(tx, ty, tz, along.ravel())
    return _cheapest((q.reshape(4, -1, n), ok.reshape(-1, n)), lower, upper, cost)


def _cheapest(branches: Branches, lower: Vector, upper: Vector, cost: Cost) -> tuple[Array, Array]:
    q, within = inside(branches[0], lower, upper)
    price = np.where(within & branches[1], cost(q), np.inf)
    chosen = np.argmin(price, axis=0)
    value = np.take_along_axis(price, chosen[None], axis=0)[0]
    posture = np.take_along_axis(q, chosen[None, None], axis=1)[:, 0]
    return np.where(np.isfinite(value), posture, np.nan), value
