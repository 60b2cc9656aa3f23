"""Which of the postures that reach a point: the one nearest to a posture, or the one turned nearest to another."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import cos, inf, sin
from typing import TypeAlias

from allegro_twin.kinematics.closed_form.search.curve import Curve, Moving, Posture
from allegro_twin.kinematics.closed_form.search.minima import Value, minima

STEP = 1.0
"""rad of τ between two knots at most, where few minima lie."""
Cost: TypeAlias = Value[Moving]


def nearest_to(near: Sequence[float]) -> Cost:
    """The square of the distance from a posture, rad²."""
    n0, n1, n2, n3 = near

    def value(at: Moving) -> tuple[float, float]:
        q0, q1, q2, q3, t0, t1, t2, t3 = at
        q0, q1, q2, q3 = q0 - n0, q1 - n1, q2 - n2, q3 - n3
        return q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3, 2.0 * (q0 * t0 + q1 * t1 + q2 * t2 + q3 * t3)

    return value


def turned_to(view: tuple[float, ...]) -> Cost:
    """Minus cos²(θ/2), of the angle θ to the thumb's orientation with these q₀, q₁ and ψ (`Thumb.angle_to`)."""
    n0, n1, n, _, _ = view

    def value(at: Moving) -> tuple[float, float]:
        q0, q1, q2, q3, t0, t1, t2, t3 = at
        d, b, less, more = (q2 + q3 - n) / 2.0, (q0 - n0) / 2.0, (q1 - n1) / 2.0, (q1 + n1) / 2.0
        cd, sd, cb, sb, cm, sp = cos(d), sin(d), cos(b), sin(b), cos(less), sin(more)
        w = cd * cb * cm - sd * sb * sp
        turn, swing = cd * sb * cm + sd * cb * sp, cd * cb * sin(less) + sd * sb * cos(more)
        return -w * w, w * (t0 * turn + t1 * swing + (t2 + t3) * (sd * cb * cm + cd * sb * sp))

    return value


def cheapest(curve: Curve, value: Cost, step: float = STEP) -> tuple[float, Posture | None]:
    """The least cost, and the posture that has it."""
    least, best = inf, None
    for posture in curve.ends:
        cost, _ = value((*posture, 0.0, 0.0, 0.0, 0.0))
        if cost < least:
            least, best = cost, posture
    for piece in curve.pieces:
        places = [(tau, *value(at), at) for tau, at in piece.knots(step)]
        for low, high in pairwise(places):
            for _, cost, _, at in (low, high, *minima(piece.at, value, low, high)):
                if cost < least:
                    least, best = cost, at[:4]
    return least, best
