"""Of the postures that reach a point the one furthest from every limit: where most room is left to each joint."""

from __future__ import annotations

from itertools import pairwise
from math import inf
from typing import TypeAlias

from allegro_twin.kinematics.closed_form.search.curve import Curve, Moving, Posture, Way
from allegro_twin.kinematics.closed_form.search.minima import STEPS, crossing, minimum

Limits: TypeAlias = tuple[float, float, float, float, float, float, float, float]
"""Lowest and highest of each joint in turn, rad."""
Tight: TypeAlias = tuple[float, float, int]
"""The least room of any joint, its rate, and whose it is: 0 to 3 below that joint, 4 to 7 above."""
Spot: TypeAlias = tuple[float, Moving, Tight]
"""τ, the posture there and what is tight in it."""
_NEARLY = 0.01
_NARROW = 1e-9  # rad of τ.
_ALIKE = 1e-10  # rad between two rooms.
_FLAT = 1e-9  # The rate at the top or the bottom of a room.
_STEP = 0.7  # rad of τ between two knots, at most.


def roomiest(curve: Curve, limits: Limits) -> tuple[float, Posture | None]:
    """The most room that a posture leaves each joint to its limits, rad, and the posture that leaves it."""
    most, best = -inf, None
    for end in curve.ends:
        at = (*end, 0.0, 0.0, 0.0, 0.0)
        room = _tightest(at, limits)[0]
        if room > most:
            most, best = room, at
    dips: list[tuple[Way, Spot, Spot]] = []
    for piece in curve.pieces:
        places = [(tau, at, _tightest(at, limits)) for tau, at in piece.knots(_STEP)]
        for low, high in pairwise(places):
            room, at = _hill(piece.at, limits, low, high)
            if room > most:
                most, best = room, at
        dips += [(piece.at, low, high) for low, high in pairwise(places) if _turns(low[1], high[1])]
    for way, low, high in dips:
        for tau, at, tight in _dips(way, limits, low, high, most):
            for ends in ((low, (tau, at, tight)), ((tau, at, tight), high)):
                room, at = _hill(way, limits, *ends)
                if room > most:
                    most, best = room, at
    return most, None if best is None else best[:4]


def _hill(way: Way, limits: Limits, low: Spot, high: Spot) -> tuple[float, Moving]:
    """The most room between two places with one hill between them."""
    if low[2][1] > -_FLAT and high[2][1] < _FLAT:
        return _top(way, limits, low, high)
    return (low[2][0], low[1]) if low[2][0] > high[2][0] else (high[2][0], high[1])


def _turns(first: Moving, last: Moving) -> bool:
    """Whether some joint turns back between two places."""
    _, _, _, _, a0, a1, a2, a3 = first
    _, _, _, _, b0, b1, b2, b3 = last
    return a0 * b0 < 0.0 or a1 * b1 < 0.0 or a2 * b2 < 0.0 or a3 * b3 < 0.0


def _dips(way: Way, limits: Limits, low: Spot, high: Spot, most: float) -> list[Spot]:
    """Where the room of a joint is least between two places, and tight: that alone can part two hills.

    Neither is higher than the room that this joint has at its foot.
    """
    found = []
    for joint in (0, 1, 2, 3):
        before, after = low[1][joint + 4], high[1][joint + 4]
        if before * after < 0.0:
            which = joint if before < 0.0 else joint + 4
            if max(_room(low[1], which, limits), _room(high[1], which, limits)) > most:
                found += _dip(way, limits, low, high, which)
    return found


def _dip(way: Way, limits: Limits, low: Spot, high: Spot, which: int) -> list[Spot]:
    """Where a room is least, if it is tight there: the end of one hill and the beginning of another."""
    (a, first, _), (b, last, _) = low, high
    before, after = _rate(first, which), _rate(last, which)
    at = way(a + (b - a) * before / (before - after))
    if _room(at, which, limits) > _tightest(at, limits)[0] + _NEARLY:
        return []

    def value(at: Moving) -> tuple[float, float]:
        return _room(at, which, limits), _rate(at, which)

    tau, room, _, at = minimum(way, value, (a, *value(first), first), (b, *value(last), last))
    return [(tau, at, (room, 0.0, which))] if _tightest(at, limits)[2] == which else []


def _tightest(at: Moving, limits: Limits) -> Tight:
    q0, q1, q2, q3, t0, t1, t2, t3 = at
    l0, h0, l1, h1, l2, h2, l3, h3 = limits
    room, rate, which = (q1 - l1, t1, 1) if q1 - l1 < h1 - q1 else (h1 - q1, -t1, 5)
    if q2 - l2 < room:
        room, rate, which = q2 - l2, t2, 2
    if h2 - q2 < room:
        room, rate, which = h2 - q2, -t2, 6
    if q3 - l3 < room:
        room, rate, which = q3 - l3, t3, 3
    if h3 - q3 < room:
        room, rate, which = h3 - q3, -t3, 7
    if q0 - l0 < room:
        room, rate, which = q0 - l0, t0, 0
    if h0 - q0 < room:
        room, rate, which = h0 - q0, -t0, 4
    return room, rate, which


def _rate(at: Moving, which: int) -> float:
    return at[which + 4] if which < 4 else -at[which]


def _room(at: Moving, which: int, limits: Limits) -> float:
    return at[which] - limits[2 * which] if which < 4 else limits[2 * which - 7] - at[which - 4]


def _top(way: Way, limits: Limits, rising: Spot, falling: Spot) -> tuple[float, Moving]:
    """Where the room of what is tight on one side meets the room of what is tight on the other."""
    (a, first, (_, _, i)), (b, last, (_, _, j)) = rising, falling
    before, third = a, first
    for step in range(STEPS):
        if i == j:
            to = crossing((before, _rate(third, i)), (a, _rate(first, i)), (b, _rate(last, i)))
        else:
            to = _meeting(a, first, b, last, i, j, limits)
        if not a < to < b or step % 4 == 3:  # Now and then half of what is left, so that it ends.
            to = (a + b) / 2
        at = way(to)
        room, rate, which = _tightest(at, limits)
        if b - a < _NARROW or (which in (i, j) and _is_top(at, i, j, limits)):
            break
        if rate > 0.0:
            before, third = a, first
            a, first, i = to, at, which
            if _rate(at, j) > 0.0:  # Where the two meet is not yet the top.
                i = j
        else:
            before, third = b, last
            b, last, j = to, at, which
            if _rate(at, i) < 0.0:
                j = i
    return room, at


def _meeting(a: float, first: Moving, b: float, last: Moving, i: int, j: int, limits: Limits) -> float:
    """Where two rooms are alike: τ as a cubic of their difference, through two places and with the slopes there."""
    before, after = _room(first, i, limits) - _room(first, j, limits), _room(last, i, limits) - _room(last, j, limits)
    rise, slope, then = after - before, _rate(first, i) - _rate(first, j), _rate(last, i) - _rate(last, j)
    least = rise * rise / (3.0 * (b - a))  # With a lesser slope the cubic need not go one way.
    if not (slope * rise > least and then * rise > least):
        return (a * after - b * before) / rise if rise else inf
    s = -before / rise
    t = 1.0 - s
    return t * t * ((1.0 + 2.0 * s) * a + s * rise / slope) + s * s * ((3.0 - 2.0 * s) * b - t * rise / then)


def _is_top(at: Moving, i: int, j: int, limits: Limits) -> bool:
    """Whether a room is at its top; or two are alike, and one of them rises and the other falls."""
    if i == j:
        return abs(_rate(at, i)) < _FLAT
    return abs(_room(at, i, limits) - _room(at, j, limits)) < _ALIKE and _rate(at, i) >= 0.0 >= _rate(at, j)
