"""Which of the postures that reach a point: the one nearest to a posture, or the one that is turned nearest to another."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from math import cos, inf, sin
from typing import TypeAlias

from allegro_twin.kinematics.curve import Curve, Moving, Posture, Way
from allegro_twin.kinematics.orientation import Entries

Value: TypeAlias = Callable[[Moving], tuple[float, float]]
"""What a posture costs, and how fast that grows with τ."""
_DOUBT = 0.3  # Of the lesser slope at two places: where a cubic's falls below that, it is looked at.
STEPS, CLOSE = 60, 1e-6
"""So many steps at most, until one is this small, rad; by then the next would be far smaller."""


Place: TypeAlias = tuple[float, float, float, Moving]
"""τ, what the posture there costs, the slope of that, and the posture."""


def nearest_to(near: Sequence[float]) -> Value:
    """The square of the distance from a posture, rad²."""
    n0, n1, n2, n3 = near

    def value(at: Moving) -> tuple[float, float]:
        q0, q1, q2, q3, t0, t1, t2, t3 = at
        q0, q1, q2, q3 = q0 - n0, q1 - n1, q2 - n2, q3 - n3
        return q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3, 2.0 * (q0 * t0 + q1 * t1 + q2 * t2 + q3 * t3)

    return value


def turned_to(wanted: Entries[float]) -> Value:
    """Minus the trace of the thumb's rotation from R* to R = Rx(-q₀) Rz(q₁) Ry(ψ): the less, the nearer.

    With B = Rx(q₀) R* and Q = Rz(q₁) Ry(ψ), tr(R*ᵀ R) = tr(Bᵀ Q).
    """
    a0, a1, a2, b0, b1, b2, d0, d1, d2 = wanted

    def value(at: Moving) -> tuple[float, float]:
        q0, q1, q2, q3, t0, t1, t2, t3 = at
        c, s, c1, s1, cb, sb = cos(q0), sin(q0), cos(q1), sin(q1), cos(q2 + q3), sin(q2 + q3)
        e0, e1, e2 = c * b0 - s * d0, c * b1 - s * d1, c * b2 - s * d2
        f0, f1, f2 = s * b0 + c * d0, s * b1 + c * d1, s * b2 + c * d2
        along, across = a0 * cb + a2 * sb + e1, e0 * cb + e2 * sb - a1
        trace = c1 * along + s1 * across + f2 * cb - f0 * sb
        swing = c1 * across - s1 * along
        bend = c1 * (a2 * cb - a0 * sb) + s1 * (e2 * cb - e0 * sb) - f2 * sb - f0 * cb
        turn = e2 * cb - e0 * sb - c1 * f1 - s1 * (f0 * cb + f2 * sb)
        return -trace, -(t0 * turn + t1 * swing + (t2 + t3) * bend)

    return value


def cheapest(curve: Curve, value: Value) -> tuple[float, Posture | None]:
    """The least cost, and the posture that has it."""
    least, best = inf, None
    for posture in curve.ends:
        cost, _ = value((*posture, 0.0, 0.0, 0.0, 0.0))
        if cost < least:
            least, best = cost, posture
    for piece in curve.pieces:
        places = [(tau, *value(at), at) for tau, at in piece.knots()]
        for low, high in pairwise(places):
            for _, cost, _, at in (low, high, *bottoms(piece.at, value, low, high)):
                if cost < least:
                    least, best = cost, at[:4]
    return least, best


def bottoms(way: Way, value: Value, low: Place, high: Place, depth: int = 2) -> list[Place]:
    """The bottoms of the valleys between two places."""
    if low[2] < 0.0 < high[2]:
        return [_bottom(way, value, low, high)]
    tau = _hidden(low, high) if depth else None
    if tau is None:
        return []
    at = way(tau)
    between = (tau, *value(at), at)
    return [found for ends in ((low, between), (between, high)) for found in bottoms(way, value, *ends, depth - 1)]


def _hidden(low: Place, high: Place) -> float | None:
    """Where a cubic with the same costs and slopes, both of one sign, has the slope change its sign, or nearly so."""
    (a, cost, ga, _), (b, then, gb, _) = low, high
    if not ga * gb > 0.0:
        return None
    mean = (then - cost) / (b - a)
    square, linear = 3.0 * (ga + gb - 2.0 * mean), 6.0 * mean - 4.0 * ga - 2.0 * gb
    if not 0.0 < -linear * ga < 2.0 * square * ga:
        return None
    least = ga - linear * linear / (4.0 * square)
    return a - (b - a) * linear / (2.0 * square) if least / ga < _DOUBT * min(1.0, gb / ga) else None


def _bottom(way: Way, value: Value, falling: Place, rising: Place) -> Place:
    """Where the slope is zero between two places: through three of them, τ as a parabola of slope."""
    low, high = falling[0], rising[0]
    second, third = (falling, rising) if -falling[2] > rising[2] else (rising, falling)
    first = second
    for _ in range(STEPS):
        to = crossing((first[0], first[2]), (second[0], second[2]), (third[0], third[2]))
        if not low < to < high:
            to = (low + high) / 2
        at = way(to)
        step = to - third[0]
        first, second, third = second, third, (to, *value(at), at)
        if abs(step) < CLOSE:
            break
        if third[2] < 0.0:
            low = to
        else:
            high = to
    return third


def crossing(first: tuple[float, float], second: tuple[float, float], third: tuple[float, float]) -> float:
    """Where something is zero, from three places and its values there, or from the last two."""
    (a, ga), (b, gb), (c, gc) = first, second, third
    if ga != gb != gc != ga:
        ab, ac, bc = ga - gb, ga - gc, gb - gc
        return a * gb * gc / (ab * ac) - b * ga * gc / (ab * bc) + c * ga * gb / (ac * bc)
    return c - gc * (c - b) / (gc - gb) if gc != gb else inf
