"""Local minima of a function of one number whose derivative is known: bracketed by slopes, found by interpolation."""

from __future__ import annotations

from collections.abc import Callable
from math import inf, sqrt
from typing import TypeVar

A = TypeVar("A")
"""What a function is computed of, such as a posture."""
Sample = tuple[float, float, float, A]
"""The number τ, the function's value there, its slope, and what it is computed of."""
At = Callable[[float], A]
"""From τ to what the function is computed of."""
Value = Callable[[A], tuple[float, float]]
"""From that to the function's value and slope."""
_DOUBT = 0.3  # Of the lesser slope of two samples: where a cubic's falls below that, the place is sampled.
_APART = 1e-3  # of τ: no two minima are nearer.
_FLAT = 1e-6  # Of the greater slope: one that is less is that of a minimum.
_CLOSE, _GAIN = 1e-6, 1e-14  # A step of τ, and what it gains, after which the next would be far smaller.
STEPS = 60
"""Steps to a minimum, at most."""


def minima(at: At[A], value: Value[A], low: Sample[A], high: Sample[A], depth: int = 3) -> list[Sample[A]]:
    """The local minima between two samples."""
    found = [minimum(at, value, low, high)] if low[2] < 0.0 < high[2] else []
    if depth:
        for first, last in ((low, found[0]), (found[0], high)) if found else ((low, high),):
            tau = _hidden(first, last)
            if tau is not None:
                there = at(tau)
                between = (tau, *value(there), there)
                found += minima(at, value, first, between, depth - 1)
                found += minima(at, value, between, last, depth - 1)
    return found


def _hidden(low: Sample[A], high: Sample[A]) -> float | None:
    """Where a minimum may hide between slopes of one sign: where the cubic with these values and slopes turns back, or
    nearly so. None where it does not."""
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


def minimum(at: At[A], value: Value[A], falling: Sample[A], rising: Sample[A]) -> Sample[A]:
    """The minimum between a falling and a rising sample: first that of a cubic, then the zero of the slope's inverse
    interpolation by a parabola."""
    low, high, to = falling[0], rising[0], _least_of_cubic(falling, rising)
    first, second, third = falling, rising, falling
    for step in range(STEPS):
        if not low < to < high:
            to = (low + high) / 2
        there = at(to)
        if step:
            first, second = second, third
        moved, third = to - third[0], (to, *value(there), there)
        if abs(moved) < _CLOSE and abs(moved * third[2]) < _GAIN:
            break
        if third[2] < 0.0:
            low = to
        else:
            high = to
        to = crossing((first[0], first[2]), (second[0], second[2]), (to, third[2]))
    return third


def _least_of_cubic(falling: Sample[A], rising: Sample[A]) -> float:
    """Where the cubic with these values and slopes is least (Nocedal & Wright, Numerical Optimization, eq. 3.59)."""
    (a, cost, ga, _), (b, then, gb, _) = falling, rising
    mean = ga + gb - 3.0 * (then - cost) / (b - a)
    root = sqrt(mean * mean - ga * gb)
    return b - (b - a) * (gb + root - mean) / (gb - ga + 2.0 * root)


def crossing(first: tuple[float, float], second: tuple[float, float], third: tuple[float, float]) -> float:
    """Where a function is zero, from three places and its values there, or from the last two."""
    (a, ga), (b, gb), (c, gc) = first, second, third
    if ga != gb != gc != ga:
        ab, ac, bc = ga - gb, ga - gc, gb - gc
        return a * gb * gc / (ab * ac) - b * ga * gc / (ab * bc) + c * ga * gb / (ac * bc)
    return c - gc * (c - b) / (gc - gb) if gc != gb else inf
