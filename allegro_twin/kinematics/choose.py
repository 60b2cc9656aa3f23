"""Which of the postures that reach a point: the one nearest to a posture, or the one that is turned nearest to another."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from math import cos, inf, sin, sqrt
from typing import TypeAlias

from allegro_twin.kinematics.curve import Curve, Moving, Posture, Way

Value: TypeAlias = Callable[[Moving], tuple[float, float]]
"""What a posture costs, and how fast that grows with τ."""
_DOUBT = 0.3  # Of the lesser slope at two places: where a cubic's falls below that, it is looked at.
_STEP = 1.0  # rad of τ between two knots, at most.
_FLAT = 1e-6  # Of the greater: a slope that is less is that of a bottom.
_APART = 1e-3  # rad of τ: no valley is narrower.
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


def turned_to(view: tuple[float, ...]) -> Value:
    """Minus the square of cos(θ/2), of the angle θ to the thumb's orientation with these q₀, q₁ and ψ (`Thumb.angle_to`)."""
    n0, n1, n, _, _ = view

    def value(at: Moving) -> tuple[float, float]:
        q0, q1, q2, q3, t0, t1, t2, t3 = at
        d, b, less, more = (q2 + q3 - n) / 2.0, (q0 - n0) / 2.0, (q1 - n1) / 2.0, (q1 + n1) / 2.0
        cd, sd, cb, sb, cm, sp = cos(d), sin(d), cos(b), sin(b), cos(less), sin(more)
        w = cd * cb * cm - sd * sb * sp
        turn, swing = cd * sb * cm + sd * cb * sp, cd * cb * sin(less) + sd * sb * cos(more)
        return -w * w, w * (t0 * turn + t1 * swing + (t2 + t3) * (sd * cb * cm + cd * sb * sp))

    return value


def cheapest(curve: Curve, value: Value) -> tuple[float, Posture | None]:
    """The least cost, and the posture that has it."""
    least, best = inf, None
    for posture in curve.ends:
        cost, _ = value((*posture, 0.0, 0.0, 0.0, 0.0))
        if cost < least:
            least, best = cost, posture
    for piece in curve.pieces:
        places = [(tau, *value(at), at) for tau, at in piece.knots(_STEP)]
        for low, high in pairwise(places):
            for _, cost, _, at in (low, high, *bottoms(piece.at, value, low, high)):
                if cost < least:
                    least, best = cost, at[:4]
    return least, best


def bottoms(way: Way, value: Value, low: Place, high: Place, depth: int = 3) -> list[Place]:
    """The bottoms of the valleys between two places."""
    found = [bottom(way, value, low, high)] if low[2] < 0.0 < high[2] else []
    if depth:
        for first, last in ((low, found[0]), (found[0], high)) if found else ((low, high),):
            tau = _hidden(first, last)
            if tau is not None:
                at = way(tau)
                between = (tau, *value(at), at)
                found += bottoms(way, value, first, between, depth - 1)
                found += bottoms(way, value, between, last, depth - 1)
    return found


def _hidden(low: Place, high: Place) -> float | None:
    """Where a cubic with the same costs and slopes, of one sign, turns back, or nearly so: there a valley may hide."""
    (a, cost, ga, _), (b, then, gb, _) = low, high
    if b - a < _APART:
        return None
    sign = 1.0 if ga + gb > 0.0 else -1.0
    ga, gb, mean = sign * ga, sign * gb, sign * (then - cost) / (b - a)
    least = min(ga, gb)
    square, linear = 3.0 * (ga + gb - 2.0 * mean), 6.0 * mean - 4.0 * ga - 2.0 * gb
    if least < -_FLAT * max(ga, gb) or not 0.0 < -linear < 2.0 * square:
        return None
    return a - (b - a) * linear / (2.0 * square) if ga - linear * linear / (4.0 * square) < _DOUBT * least else None


def bottom(way: Way, value: Value, falling: Place, rising: Place) -> Place:
    """Where the slope is zero between two places: first as of a cubic, then τ as a parabola of slope."""
    low, high, to = falling[0], rising[0], _least(falling, rising)
    first, second, third = falling, rising, falling
    for step in range(STEPS):
        if not low < to < high:
            to = (low + high) / 2
        at = way(to)
        if step:
            first, second = second, third
        moved, third = to - third[0], (to, *value(at), at)
        if abs(moved) < CLOSE:
            break
        if third[2] < 0.0:
            low = to
        else:
            high = to
        to = crossing((first[0], first[2]), (second[0], second[2]), (to, third[2]))
    return third


def _least(falling: Place, rising: Place) -> float:
    """Where a cubic with the same costs and slopes is least (Nocedal & Wright, Numerical Optimization, eq. 3.59)."""
    (a, cost, ga, _), (b, then, gb, _) = falling, rising
    mean = ga + gb - 3.0 * (then - cost) / (b - a)
    root = sqrt(mean * mean - ga * gb)
    return b - (b - a) * (gb + root - mean) / (gb - ga + 2.0 * root)


def crossing(first: tuple[float, float], second: tuple[float, float], third: tuple[float, float]) -> float:
    """Where something is zero, from three places and its values there, or from the last two."""
    (a, ga), (b, gb), (c, gc) = first, second, third
    if ga != gb != gc != ga:
        ab, ac, bc = ga - gb, ga - gc, gb - gc
        return a * gb * gc / (ab * ac) - b * ga * gc / (ab * bc) + c * ga * gb / (ac * bc)
    return c - gc * (c - b) / (gc - gb) if gc != gb else inf
