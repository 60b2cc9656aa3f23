"""The postures of the thumb that reach one point, inside the limits of q₀, q₁ and q₃, and of q₂ where it is `bounded`.

With P the distance from joint 0's axis, v_y = P cos u and v_z = P sin u at u = q₀ + β, and from joint 2 to the tip
d² = K - 2 P ρ cos(u - δ): so the q₀ at which q₁ or q₃ is at a limit, or q₃ straight, is an arc cosine. That of q₂ is
the root of a quartic, and is sought only where what was chosen without that limit does not keep it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from math import acos, atan, atan2, cos, hypot, inf, pi, sin, sqrt, tan

from allegro_twin.kinematics.closed_form.forms.maths import FLOATS
from allegro_twin.kinematics.closed_form.forms.planar import TOLERANCE, TOUCH, bend, pair_of
from allegro_twin.kinematics.closed_form.forms.quartic import FixedBend
from allegro_twin.kinematics.closed_form.search.curve import Course, Curve, Moving, Piece, Posture, Way, near_turn
from allegro_twin.kinematics.closed_form.search.intervals import (
    BESIDE,
    Interval,
    Side,
    bent_inside,
    clamped_acos,
    common,
    turned_inside,
)

_TOUCHED = TOUCH * TOUCH
_AXIS = 1e-6  # m from joint 1's axis.


class ThumbFamily:
    """All curves of the thumb inside one set of limits."""

    def __init__(
        self, links: tuple[float, ...], aside: float, up: float, low: Sequence[float], high: Sequence[float]
    ) -> None:
        (first, second), self._aside, self._up = links, aside, up
        self._links, self._pair = (first, second), pair_of(first, second)
        self._reach, self._towards = hypot(aside, up), atan2(up, aside)
        self._low, self._high = low, high
        self._limits = [(a - TOLERANCE, b + TOLERANCE) for a, b in zip(low, high, strict=True)]
        self._middles = [(a + b) / 2 for a, b in zip(low, high, strict=True)]
        self._swings = [tan(angle) for angle in (low[1], high[1])]
        self._sides = []
        for elbow, least, most in ((1.0, low[3], high[3]), (-1.0, -high[3], -low[3])):
            least, most = max(least, 0.0), min(most, pi)
            if least <= most:
                squares = [first * first + second * second + 2 * first * second * cos(e) for e in (most, least)]
                self._sides.append(Side(elbow, squares[0], squares[1] if least > 0.0 else self._pair.outer))

    def best(
        self,
        chosen: Callable[[Curve], Posture | None],
        target: tuple[float, float, float],
        free: float,
        only: Interval | None = None,
    ) -> Posture | None:
        """What is chosen of a curve. What is best without some of the limits and keeps them is best with them too.

        On joint 1's axis q₁ is `free`, as far as its limits let it.
        """
        free = min(self._high[1], max(self._low[1], free))
        posture = chosen(self._through(target, free, only, bounded=False))
        if posture is None or not self._inside(posture):
            posture = chosen(self._through(target, free, only, bounded=True))
        return posture if posture is not None and self._inside(posture) else None

    def _beside_axis(self, target: tuple[float, float, float], q1: float) -> list[Posture]:
        """With one q₁: beside joint 1's axis, where the others hardly move while it goes through all its range."""
        (x, y, z), found = target, []
        r = x / cos(q1)
        across = self._aside + r * sin(q1)
        up = sqrt(max(0.0, y * y + z * z - across * across))
        for above in (up, -up):
            q0, h = near_turn(atan2(above, across) - atan2(z, y), self._middles[0]), above - self._up
            half, lead, hole = bend(FLOATS, r * r + h * h, self._pair)
            for side in (1.0, -1.0) if hole == 0.0 else ():
                posture = (q0, q1, atan2(r, h) - side * lead, side * (half + half))
                if self._inside(posture):
                    found.append(posture)
        return found

    def _inside(self, q: Posture) -> bool:
        (l0, h0), (l1, h1), (l2, h2), (l3, h3) = self._limits
        return l0 <= q[0] <= h0 and l1 <= q[1] <= h1 and l2 <= q[2] <= h2 and l3 <= q[3] <= h3

    def _through(
        self, target: tuple[float, float, float], free: float, only: Interval | None, *, bounded: bool
    ) -> Curve:
        """The curve through a point in the base frame moved along x to joint 1, or `only` q₀ in a range."""
        x, y, z = target
        curve, square, lean = Curve([], []), y * y + z * z, atan2(z, y)
        radius = sqrt(square)
        whole, twice = x * x + square + self._reach * self._reach, 2.0 * radius * self._reach
        straight = clamped_acos(whole - self._pair.outer, twice)
        if straight == 0.0:
            return curve
        if abs(x) < _AXIS:
            curve.ends.extend(self._beside_axis(target, free))
        middle = near_turn(self._towards - lean, self._middles[0])
        ends = self._swinging(x, radius, lean)
        if bounded:
            ends += self._bending(x, y, z)
        for sense in (1.0,) if straight < pi else (1.0, -1.0):
            course = Course(middle, straight if straight < pi else 0.0, sense)
            bent = bent_inside(course, self._sides, self._pair.outer, whole, twice)
            intervals = common(bent, turned_inside(course, only or (self._low[0], self._high[0])))
            if intervals:
                self._add(curve, course, self._way(course, target, free), intervals, ends, bounded)
        return curve

    def _way(self, course: Course, target: tuple[float, float, float], free: float) -> Way:
        x, y, z = target
        (even, inner, outer, _, _), (link, tip), aside, up = self._pair, self._links, self._aside, self._up
        middle, half, sense = course
        ahead, upright = self._middles[:2]
        xx = x * x
        small = 1e-6 * link * tip
        least = (
            sqrt(half / (link * tip * hypot(y, z) * self._reach * sin(half))) if half else 0.0
        )  # At a straight elbow.

        def at(tau: float) -> Moving:
            if half:
                pace = half * sin(tau)
                q0, elbow = middle - half * cos(tau), 1.0 if pace >= 0.0 else -1.0
            else:
                q0, elbow, pace = tau, sense, 1.0
            if not -pi < q0 - ahead < pi:
                q0 = near_turn(q0, ahead)
            c, s = cos(q0), sin(q0)
            across, above = c * y - s * z, s * y + c * z
            b, h = across - aside, above - up
            flat = xx + b * b
            r, q1 = sqrt(flat), atan2(b, x)
            square = flat + h * h
            if flat < _TOUCHED:  # On joint 1's axis, where q₁ is free.
                q1, flat = free, inf
            elif abs(q1 - upright) > pi / 2:
                q1, r = (q1 - pi if q1 > 0.0 else q1 + pi), -r
            u = (outer - square) / (square - inner) if square > inner else inf
            u = sqrt(u) if u > 0.0 else 0.0
            turn = elbow * atan(u)
            q2 = atan2(r, h) - turn + elbow * atan(even * u)
            s2, c2 = link * sin(q2), link * cos(q2)
            # The tip's motion in the plane of the bend is that of the last link about joint 3, and of both about 2.
            swing = -above / flat
            dr, sr, ch = b * swing * r, r - s2, h - c2
            weight = sr * c2 - ch * s2  # l t sin q₃
            rate = pace / weight if abs(weight) > small else least
            t2 = rate * (dr * sr + across * ch)
            return q0, q1, q2, turn + turn, pace, pace * x * swing, t2, -rate * (dr * s2 + across * c2) - t2

        return at

    def _swinging(self, x: float, radius: float, lean: float) -> list[float]:
        """q₀ where q₁ is at a limit."""
        found: list[float] = []
        if radius > TOUCH:
            for swing in self._swings:
                across = (self._aside + x * swing) / radius
                if -1.0 <= across <= 1.0:
                    turn = acos(across)
                    found += (turn - lean, -turn - lean)
        return found

    def _bending(self, x: float, y: float, z: float) -> list[float]:
        """q₀ where q₂ is at a limit."""
        link, tip = self._links
        found: list[float] = []
        for q2 in (self._low[2], self._high[2]):
            bend = FixedBend(FLOATS, (x, y, z), self._aside, tip, link * sin(q2), self._up + link * cos(q2))
            found += [q0 for _, q0, _ in bend.roots() if q0 == q0]
        return found

    def _add(
        self, curve: Curve, course: Course, way: Way, intervals: list[Interval], ends: list[float], bounded: bool
    ) -> None:
        """Between two ends that follow each other the curve is inside the limits of q₁ and q₂, or it is not."""
        (l1, h1), (l2, h2) = self._limits[1:3]
        taus: list[float] = []
        for q0 in ends:
            q0 = near_turn(q0, course.middle)
            if course.half == 0.0:
                taus.append(q0)
            elif abs(q0 - course.middle) < course.half:
                tau = acos((course.middle - q0) / course.half)
                taus += (tau, -tau, 2 * pi - tau)
        for first, last in intervals:
            places = [first, *sorted([tau for tau in taus if first < tau < last]), last]
            outside = True
            for low, high in pairwise(places):
                middle = way((low + high) / 2)
                if high - low > BESIDE and l1 <= middle[1] <= h1 and (not bounded or l2 <= middle[2] <= h2):
                    curve.pieces.append(Piece(way, low, high, middle))
                    outside = False
                else:
                    if outside:
                        self._alone(curve, way(low))
                    outside = True
            if outside:
                self._alone(curve, way(last))

    def _alone(self, curve: Curve, at: Moving) -> None:
        if self._inside(at[:4]):
            curve.ends.append(at[:4])
