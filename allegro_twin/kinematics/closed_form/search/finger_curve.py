"""The postures of an index, middle or ring finger that reach one point, inside the limits.

Every piece of the curve ends where a joint is at its limit. Fixing each joint in turn leaves two links and is
closed-form: so a point is reachable exactly if one of these ends is inside the limits, or a whole curve without one.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import acos, atan, atan2, cos, hypot, inf, pi, sin, sqrt
from typing import NamedTuple

from allegro_twin.kinematics.closed_form.forms.planar import TOLERANCE, TOUCH, Pair, pair_of
from allegro_twin.kinematics.closed_form.search.curve import Course, Curve, Moving, Piece, Posture, Way, near_turn

_SMALL = 1e-6  # sin q₂ below which the elbow is straight.


class Arm(NamedTuple):
    """Two links that are left when one joint is fixed, with one sign of the elbow between them."""

    joint: int
    """The one that is fixed: 1, 2 or 3."""
    value: float
    """At which angle, rad."""
    r: float
    h: float
    """Where the two links begin, m."""
    before: float
    """From the direction of the joint that is free before it to that of the first link, rad."""
    behind: float
    """From the angle of the joint that is free behind it to that of the elbow, rad."""
    pair: Pair
    sign: float = 1.0
    least: float = 0.0
    most: float = 0.0
    """Bounds of d², m², outside of which the elbow's limits lie."""


def arms_of(links: tuple[float, ...], low: Sequence[float], high: Sequence[float]) -> list[Arm]:
    """All of them, for limits of q₀ to q₃, rad."""
    first, second, tip = links
    arms: list[Arm] = []
    for value in (low[1], high[1]):
        arm = Arm(1, value, first * sin(value), first * cos(value), value, 0.0, pair_of(second, tip))
        arms += _signs(arm, second, tip, low[3], high[3])
    for value in (low[2], high[2]):
        along, aside = first + second * cos(value), second * sin(value)
        lean, link = atan2(aside, along), hypot(along, aside)
        arms += _signs(Arm(2, value, 0.0, 0.0, lean, value - lean, pair_of(link, tip)), link, tip, low[3], high[3])
    for value in (low[3], high[3]):
        along, aside = second + tip * cos(value), tip * sin(value)
        lean, link = atan2(aside, along), hypot(along, aside)
        arms += _signs(Arm(3, value, 0.0, 0.0, 0.0, lean, pair_of(first, link)), first, link, low[2], high[2])
    return arms


def _signs(arm: Arm, first: float, second: float, low: float, high: float) -> list[Arm]:
    """With both signs of the elbow, as far as the joint behind it allows."""

    def square(angle: float) -> float:
        return first * first + second * second + 2 * first * second * cos(angle)

    low, high = low + arm.behind, high + arm.behind
    arms = []
    for sign, least, most in ((1.0, low, high), (-1.0, -high, -low)):
        least, most = max(least - TOLERANCE, 0.0), min(most + TOLERANCE, pi)
        if least <= most:
            nearest = square(most) if most < pi else arm.pair.below
            furthest = square(least) if least > 0.0 else arm.pair.above
            arms.append(arm._replace(sign=sign, least=nearest, most=furthest))
    return arms


class FingerFamily:
    """All curves of one finger inside one set of limits."""

    def __init__(self, links: tuple[float, ...], low: Sequence[float], high: Sequence[float]) -> None:
        self._links, self._pair = links, pair_of(links[0], links[1])
        self._arms = arms_of(links, low, high)
        self._limits = [(a - TOLERANCE, b + TOLERANCE) for a, b in zip(low, high, strict=True)]
        self._middles = [(a + b) / 2 for a, b in zip(low, high, strict=True)]

    def plane(self, x: float, y: float, free: float = 0.0) -> tuple[float, float] | None:
        """q₀ and r of a point in the base frame; on its axis q₀ is `free`. None where its limits are in the way."""
        low, high = self._limits[0]
        r = sqrt(x * x + y * y)
        q0 = atan2(y, x) if r > TOUCH else free
        if low <= q0 <= high:
            return q0, r
        q0 = q0 - pi if q0 > 0.0 else q0 + pi
        return (q0, -r) if low <= q0 <= high else None

    def through(self, q0: float, r: float, h: float) -> Curve:
        """The curve through a point in the plane to which q₀ turns, from joint 1."""
        curve, tip = Curve([], []), self._links[2]
        square = r * r + h * h
        twice, middle = 2.0 * tip * sqrt(square), atan2(r, h)
        bound = square + tip * tip - self._pair.outer
        if bound >= twice:  # Fully stretched, or too far.
            posture = (q0, middle, 0.0, 0.0)
            if sqrt(square) <= sum(self._links) + TOUCH and self._inside(posture):
                curve.ends.append(posture)
            return curve
        ends = self._ends(q0, r, h)
        if bound > -twice:
            course = Course(middle, acos(bound / twice), 1.0)
            way = self._way(course, q0, r, h)
            self._add(curve, course, way, ends) if ends else self._loop(curve, way)
        elif ends:
            for elbow in (1.0, -1.0):
                if some := [q for q in ends if q[2] * elbow >= 0.0]:
                    course = Course(middle, 0.0, elbow)
                    self._add(curve, course, self._way(course, q0, r, h), some)
        return curve

    def _way(self, course: Course, q0: float, r: float, h: float) -> Way:
        (first, second, tip), (even, inner, outer, _, _), third = self._links, self._pair, self._middles[3]
        middle, half, sense = course
        least = sqrt(half * first * second / (tip * hypot(r, h) * sin(half))) if half else 0.0  # At a straight elbow.

        def at(tau: float) -> Moving:
            if half:
                pace = half * sin(tau)
                phi, elbow = middle - half * cos(tau), 1.0 if pace >= 0.0 else -1.0
            else:
                phi, elbow, pace = tau, sense, 1.0
            a, b = r - tip * sin(phi), h - tip * cos(phi)
            square = a * a + b * b
            u = (outer - square) / (square - inner) if square > inner else inf
            u = sqrt(u) if u > 0.0 else 0.0
            turn = elbow * atan(u)
            q2 = turn + turn
            q1 = atan2(a, b) - turn + elbow * atan(even * u)
            q3 = phi - q1 - q2
            if not -pi < q3 - third < pi:
                q3 = near_turn(q3, third)
            # The rates are those of a four-bar linkage.
            weight = sin(q2)
            rate = pace / weight if abs(weight) > _SMALL else least
            t1 = rate * tip / first * sin(q3)
            t2 = -rate * tip / second * sin(q2 + q3) - t1
            return q0, q1, q2, q3, 0.0, t1, t2, pace - t1 - t2

        return at

    def _inside(self, q: Sequence[float]) -> bool:
        _, (l1, h1), (l2, h2), (l3, h3) = self._limits
        return l1 <= q[1] <= h1 and l2 <= q[2] <= h2 and l3 <= q[3] <= h3

    def _add(self, curve: Curve, course: Course, way: Way, ends: list[Posture]) -> None:
        """Between two ends that follow each other the curve is inside the limits, or it is not."""
        places = sorted(course.tau(q[1] + q[2] + q[3], q[2]) for q in ends)
        for low, high in pairwise([*places, places[0] + 2 * pi]):
            middle = way((low + high) / 2)
            if high - low > TOLERANCE and self._inside(middle):
                curve.pieces.append(Piece(way, low, high, middle))
        curve.ends.extend(ends)

    def _loop(self, curve: Curve, way: Way) -> None:
        """A curve without an end is inside the limits altogether, or nowhere."""
        middle = way(0.0)
        if self._inside(middle):
            curve.pieces.append(Piece(way, -pi, pi, middle))

    def _ends(self, q0: float, r: float, h: float) -> list[Posture]:
        """Where a joint is at its limit."""
        found, middles = [], self._middles
        (_, _), (l1, h1), (l2, h2), (l3, h3) = self._limits
        for joint, value, r0, h0, before, behind, pair, sign, least, most in self._arms:
            a, b = r - r0, h - h0
            square = a * a + b * b
            if not least <= square <= most:
                continue
            u = (pair.outer - square) / (square - pair.inner)
            u = sqrt(u) if u > 0.0 else 0.0
            turn = atan(u)
            led, bent = atan2(a, b) - sign * (turn - atan(pair.even * u)) - before, sign * (turn + turn) - behind
            if joint == 1:
                q1, q2, q3 = value, near_turn(led, middles[2]), bent
            elif joint == 2:
                q1, q2, q3 = near_turn(led, middles[1]), value, bent
            else:
                q1, q2, q3 = near_turn(led, middles[1]), bent, value
            if l1 <= q1 <= h1 and l2 <= q2 <= h2 and l3 <= q3 <= h3:
                found.append((q0, q1, q2, q3))
        return found
