"""Where a function of one number is least, when its slope is known too: every local minimum between two places."""

from __future__ import annotations

from collections.abc import Callable
from math import inf, sqrt
from typing import TypeVar

A = TypeVar("A")
"""What there is at a place, such as a posture."""
Place = tuple[float, float, float, A]
"""The number τ, what the function costs there, its slope, and what there is."""
Way = Callable[[float], A]
"""From τ to what there is."""
Value = Callable[[A], tuple[float, float]]
"""From that to its cost and its slope."""
_DOUBT = 0.3  # Of the lesser slope at two places: where a cubic's falls below that, it is looked at.
_APART = 1e-3  # of τ: no two minima are nearer.
_FLAT = 1e-6  # Of the greater: a slope that is less is that of a minimum.
_CLOSE, _GAIN = 1e-6, 1e-14  # A step of τ, and what it gains, after which the next would be far smaller.
STEPS = 60
"""So many at most."""


def minima(way: Way[A], value: Value[A], low: Place[A], high: Place[A], depth: int = 3) -> list[Place[A]]:
    """The local minima between two places."""
    found = [minimum(way, value, low, high)] if low[2] < 0.0 < high[2] else []
    if depth:
        for first, last in ((low, found[0]), (found[0], high)) if found else ((low, high),):
            tau = _hidden(first, last)
            if tau is not None:
                at = way(tau)
                between = (tau, *value(at), at)
                found += minima(way, value, first, between, depth - 1)
                found += minima(way, value, between, last, depth - 1)
    return found


def _hidden(low: Place[A], high: Place[A]) -> float | None:
    """Where a cubic with the same costs and slopes, of one sign, turns back, or nearly so: there a minimum may hide."""
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


def minimum(way: Way[A], value: Value[A], falling: Place[A], rising: Place[A]) -> Place[A]:
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
        if abs(moved) < _CLOSE and abs(moved * third[2]) < _GAIN:
            break
        if third[2] < 0.0:
            low = to
        else:
            high = to
        to = crossing((first[0], first[2]), (second[0], second[2]), (to, third[2]))
    return third


def _least(falling: Place[A], rising: Place[A]) -> float:
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
