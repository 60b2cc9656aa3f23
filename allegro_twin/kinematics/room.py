"""Of the postures that reach a point the one furthest from every limit: where most room is left to each joint."""

from __future__ import annotations

from itertools import pairwise
from math import inf
from typing import TypeAlias

from allegro_twin.kinematics.choose import STEPS, bottom, crossing
from allegro_twin.kinematics.curve import Curve, Moving, Posture, Way

Limits: TypeAlias = tuple[float, float, float, float, float, float, float, float]
"""Lowest and highest of each joint in turn, rad."""
Tight: TypeAlias = tuple[float, float, int]
"""The least room of any joint, its rate, and whose it is: 0 to 3 below that joint, 4 to 7 above."""
Spot: TypeAlias = tuple[float, Moving, Tight]
"""τ, the posture there and what is tight in it."""
_DIP = 0.1  # rad that a joint's room may be less in between than at two knots.
_NEARLY = 0.01
_NARROW = 1e-9  # rad of τ.
_ALIKE = 1e-10  # rad between two rooms.
_FLAT = 1e-9  # The rate at the top or the bottom of a room.
_STEP = 0.7  # rad of τ between two knots, at most.


def roomiest(curve: Curve, limits: Limits) -> tuple[float, Posture | None]:
    """The most room that a posture leaves each joint to its limits, rad, and the posture that leaves it."""
    most, best = -inf, None
    for posture in () if curve.pieces else curve.ends:  # On pieces there is more.
        room = _tightest((*posture, 0.0, 0.0, 0.0, 0.0), limits)[0]
        if room > most:
            most, best = room, posture
    for piece in curve.pieces:
        places = [(tau, at, _tightest(at, limits)) for tau, at in piece.knots(_STEP)]
        for low, high in pairwise(places):
            for rising, falling in pairwise((low, *_dips(piece.at, limits, low, high), high)):
                if falling[2][0] > most:
                    most, best = falling[2][0], falling[1][:4]
                if rising[2][1] > -_FLAT and falling[2][1] < _FLAT:
                    room, found = _top(piece.at, limits, rising, falling)
                    if room > most:
                        most, best = room, found[:4]
    return most, best


def _dips(way: Way, limits: Limits, low: Spot, high: Spot) -> list[Spot]:
    """Both sides of where the room of a joint is least, which can part two hills: nothing else can."""
    (_, first, (room, _, _)), (_, last, (then, _, _)) = low, high
    _, _, _, _, a0, a1, a2, a3 = first
    _, _, _, _, b0, b1, b2, b3 = last
    found: list[Spot] = []
    if a0 * b0 < 0.0 or a1 * b1 < 0.0 or a2 * b2 < 0.0 or a3 * b3 < 0.0:
        for joint, before, after in ((0, a0, b0), (1, a1, b1), (2, a2, b2), (3, a3, b3)):
            if before * after < 0.0:
                which = joint if before < 0.0 else joint + 4
                if min(_room(first, which, limits), _room(last, which, limits)) < max(room, then) + _DIP:
                    found += _dip(way, limits, low, high, which)
        found.sort(key=lambda spot: spot[0])
    return found


def _dip(way: Way, limits: Limits, low: Spot, high: Spot, which: int) -> list[Spot]:
    """Where a room is least, found to rounding if it is tight there: the end of one hill and the beginning of another."""
    (a, first, _), (b, last, _) = low, high
    before, after = _rate(first, which), _rate(last, which)
    tau = a + (b - a) * before / (before - after)
    at = way(tau)
    tight = _tightest(at, limits)
    if _room(at, which, limits) > tight[0] + _NEARLY:
        return [(tau, at, tight)]

    def value(at: Moving) -> tuple[float, float]:
        return _room(at, which, limits), _rate(at, which)

    tau, room, _, at = bottom(way, value, (a, *value(first), first), (b, *value(last), last))
    tight = _tightest(at, limits)
    return [(tau, at, (room, 0.0, which) if tight[2] == which else tight)]


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
