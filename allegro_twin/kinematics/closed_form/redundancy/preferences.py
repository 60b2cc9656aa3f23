"""Preferred posture of a redundancy curve: nearest to a posture, nearest to an orientation, or furthest from
the joint limits.

The clearance of a joint is its distance to one of its limits; the clearance of a posture is the least of all eight. Two
clearances are plain functions of τ with known rates. So between two samples that show one joint's clearance rising and
another's falling, the greatest clearance of the posture lies where the two are equal, or where one has its maximum.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import cos, inf, sin
from typing import TypeAlias

from allegro_twin.kinematics.closed_form.redundancy.curve import Posture, PostureAt, PostureCurve, PostureRates
from allegro_twin.kinematics.closed_form.redundancy.minima import STEPS, Value, crossing, minima, minimum

STEP = 1.0
"""rad of τ between two samples at most, where there are few minima."""
Cost: TypeAlias = Value[PostureRates]
Limits: TypeAlias = tuple[float, float, float, float, float, float, float, float]
"""Lowest and highest of each joint in turn, rad."""
Clearance: TypeAlias = tuple[float, float, int]
"""The least clearance of a posture, rad, its rate, and which it is: 0 to 3 to that joint's lower limit, 4 to 7 to its
upper one."""
Knot: TypeAlias = tuple[float, PostureRates, Clearance]
"""τ, the posture there and its clearance."""
_NEARLY = 0.01  # rad above the least clearance: one that is more is not the least near by.
_NARROW = 1e-9  # rad of τ.
_ALIKE = 1e-10  # rad between two clearances that are equal.
_FLAT = 1e-9  # The rate of a clearance at its maximum or minimum.
_KNOTS = 0.7  # rad of τ between two knots, at most.


def distance_to(near: Sequence[float]) -> Cost:
    """The square of the distance from a posture, rad²."""
    n0, n1, n2, n3 = near

    def value(at: PostureRates) -> tuple[float, float]:
        q0, q1, q2, q3, t0, t1, t2, t3 = at
        q0, q1, q2, q3 = q0 - n0, q1 - n1, q2 - n2, q3 - n3
        return q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3, 2.0 * (q0 * t0 + q1 * t1 + q2 * t2 + q3 * t3)

    return value


def orientation_error(view: tuple[float, ...]) -> Cost:
    """Minus cos²(θ/2), θ the angle to the thumb's orientation with these q₀, q₁ and ψ (`ThumbForms.angle_to`)."""
    n0, n1, n, _, _ = view

    def value(at: PostureRates) -> tuple[float, float]:
        q0, q1, q2, q3, t0, t1, t2, t3 = at
        d, b, less, more = (q2 + q3 - n) / 2.0, (q0 - n0) / 2.0, (q1 - n1) / 2.0, (q1 + n1) / 2.0
        cd, sd, cb, sb, cm, sp = cos(d), sin(d), cos(b), sin(b), cos(less), sin(more)
        w = cd * cb * cm - sd * sb * sp
        turn, swing = cd * sb * cm + sd * cb * sp, cd * cb * sin(less) + sd * sb * cos(more)
        return -w * w, w * (t0 * turn + t1 * swing + (t2 + t3) * (sd * cb * cm + cd * sb * sp))

    return value


def least_cost(curve: PostureCurve, value: Cost, step: float = STEP) -> Posture | None:
    """The posture of the curve with the least cost."""
    least, best = inf, None
    for posture in curve.ends:
        cost, _ = value((*posture, 0.0, 0.0, 0.0, 0.0))
        if cost < least:
            least, best = cost, posture
    for segment in curve.segments:
        samples = [(tau, *value(at), at) for tau, at in segment.knots(step)]
        for low, high in pairwise(samples):
            for _, cost, _, at in (low, high, *minima(segment.at, value, low, high)):
                if cost < least:
                    least, best = cost, at[:4]
    return best


def furthest_from_limits(curve: PostureCurve, limits: Limits) -> Posture | None:
    """The posture of the curve with the greatest clearance."""
    most, best = -inf, None
    for end in curve.ends:
        at = (*end, 0.0, 0.0, 0.0, 0.0)
        clearance = _least_clearance(at, limits)[0]
        if clearance > most:
            most, best = clearance, at
    turns: list[tuple[PostureAt, Knot, Knot]] = []
    for segment in curve.segments:
        knots = [(tau, at, _least_clearance(at, limits)) for tau, at in segment.knots(_KNOTS)]
        for low, high in pairwise(knots):
            clearance, at = _greatest(segment.at, limits, low, high)
            if clearance > most:
                most, best = clearance, at
        turns += [(segment.at, low, high) for low, high in pairwise(knots) if _turns_back(low[1], high[1])]
    for at_tau, low, high in turns:
        for knot in _least_between(at_tau, limits, low, high, most):
            for ends in ((low, knot), (knot, high)):
                clearance, at = _greatest(at_tau, limits, *ends)
                if clearance > most:
                    most, best = clearance, at
    return None if best is None else best[:4]


def _greatest(at: PostureAt, limits: Limits, low: Knot, high: Knot) -> tuple[float, PostureRates]:
    """The greatest clearance between two knots with one maximum between them."""
    if low[2][1] > -_FLAT and high[2][1] < _FLAT:
        return _maximum(at, limits, low, high)
    return (low[2][0], low[1]) if low[2][0] > high[2][0] else (high[2][0], high[1])


def _turns_back(first: PostureRates, last: PostureRates) -> bool:
    """Whether some joint turns back between two postures."""
    _, _, _, _, a0, a1, a2, a3 = first
    _, _, _, _, b0, b1, b2, b3 = last
    return a0 * b0 < 0.0 or a1 * b1 < 0.0 or a2 * b2 < 0.0 or a3 * b3 < 0.0


def _least_between(at: PostureAt, limits: Limits, low: Knot, high: Knot, most: float) -> list[Knot]:
    """Where a joint's clearance has a minimum between two knots and is the posture's: only there can the clearance have
    two maxima. Neither is greater than this joint's clearance at the knot on its side."""
    found = []
    for joint in (0, 1, 2, 3):
        before, after = low[1][joint + 4], high[1][joint + 4]
        if before * after < 0.0:
            which = joint if before < 0.0 else joint + 4
            if max(_clearance(low[1], which, limits), _clearance(high[1], which, limits)) > most:
                found += _least_of(at, limits, low, high, which)
    return found


def _least_of(at: PostureAt, limits: Limits, low: Knot, high: Knot, which: int) -> list[Knot]:
    """The minimum of one clearance, if it is the posture's there: between it and either knot there is one maximum."""
    (a, first, _), (b, last, _) = low, high
    before, after = _rate(first, which), _rate(last, which)
    there = at(a + (b - a) * before / (before - after))
    if _clearance(there, which, limits) > _least_clearance(there, limits)[0] + _NEARLY:
        return []

    def value(posture: PostureRates) -> tuple[float, float]:
        return _clearance(posture, which, limits), _rate(posture, which)

    tau, clearance, _, there = minimum(at, value, (a, *value(first), first), (b, *value(last), last))
    return [(tau, there, (clearance, 0.0, which))] if _least_clearance(there, limits)[2] == which else []


def _least_clearance(at: PostureRates, limits: Limits) -> Clearance:
    q0, q1, q2, q3, t0, t1, t2, t3 = at
    l0, h0, l1, h1, l2, h2, l3, h3 = limits
    clearance, rate, which = (q1 - l1, t1, 1) if q1 - l1 < h1 - q1 else (h1 - q1, -t1, 5)
    if q2 - l2 < clearance:
        clearance, rate, which = q2 - l2, t2, 2
    if h2 - q2 < clearance:
        clearance, rate, which = h2 - q2, -t2, 6
    if q3 - l3 < clearance:
        clearance, rate, which = q3 - l3, t3, 3
    if h3 - q3 < clearance:
        clearance, rate, which = h3 - q3, -t3, 7
    if q0 - l0 < clearance:
        clearance, rate, which = q0 - l0, t0, 0
    if h0 - q0 < clearance:
        clearance, rate, which = h0 - q0, -t0, 4
    return clearance, rate, which


def _rate(at: PostureRates, which: int) -> float:
    return at[which + 4] if which < 4 else -at[which]


def _clearance(at: PostureRates, which: int, limits: Limits) -> float:
    return at[which] - limits[2 * which] if which < 4 else limits[2 * which - 7] - at[which - 4]


def _maximum(at: PostureAt, limits: Limits, rising: Knot, falling: Knot) -> tuple[float, PostureRates]:
    """Where the clearance that rises on one side meets the one that falls on the other, or has its own maximum."""
    (a, first, (_, _, i)), (b, last, (_, _, j)) = rising, falling
    before, third = a, first
    for step in range(STEPS):
        if i == j:
            to = crossing((before, _rate(third, i)), (a, _rate(first, i)), (b, _rate(last, i)))
        else:
            to = _meeting(a, first, b, last, i, j, limits)
        if not a < to < b or step % 4 == 3:  # Now and then half of what is left, so that it ends.
            to = (a + b) / 2
        there = at(to)
        clearance, rate, which = _least_clearance(there, limits)
        if b - a < _NARROW or (which in (i, j) and _is_maximum(there, i, j, limits)):
            break
        if rate > 0.0:
            before, third = a, first
            a, first, i = to, there, which
            if _rate(there, j) > 0.0:  # Where the two meet is not yet the maximum.
                i = j
        else:
            before, third = b, last
            b, last, j = to, there, which
            if _rate(there, i) < 0.0:
                j = i
    return clearance, there


def _meeting(a: float, first: PostureRates, b: float, last: PostureRates, i: int, j: int, limits: Limits) -> float:
    """Where two clearances are equal: τ as a cubic of their difference, by the values and slopes at two places."""
    before, after = (_clearance(at, i, limits) - _clearance(at, j, limits) for at in (first, last))
    rise, slope, then = after - before, _rate(first, i) - _rate(first, j), _rate(last, i) - _rate(last, j)
    least = rise * rise / (3.0 * (b - a))  # With a lesser slope the cubic need not be monotonic.
    if not (slope * rise > least and then * rise > least):
        return (a * after - b * before) / rise if rise else inf
    s = -before / rise
    t = 1.0 - s
    return t * t * ((1.0 + 2.0 * s) * a + s * rise / slope) + s * s * ((3.0 - 2.0 * s) * b - t * rise / then)


def _is_maximum(at: PostureRates, i: int, j: int, limits: Limits) -> bool:
    """Whether one clearance is at its maximum; or two are equal, and one of them rises and the other falls."""
    if i == j:
        return abs(_rate(at, i)) < _FLAT
    return abs(_clearance(at, i, limits) - _clearance(at, j, limits)) < _ALIKE and _rate(at, i) >= 0.0 >= _rate(at, j)
