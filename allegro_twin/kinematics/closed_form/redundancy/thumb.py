"""The postures of the thumb that reach one point, inside one set of limits, and the best of them.

With P the distance of the point from joint 0's axis, v_y = P cos u and v_z = P sin u at u = q₀ + β; and from joint 2 to
the tip d² = K - 2 P ρ cos(u - δ). So the q₀ at which q₁ or q₃ is at a limit, or q₃ straight, is an arc cosine. The q₀
at which q₂ is at a limit is the root of a quartic, and is sought only where the best posture without that limit does
not keep it: a posture that is best without some of the limits and keeps them is best with them too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from math import acos, asin, atan, atan2, cos, hypot, inf, pi, sin, sqrt, tan
from typing import NamedTuple, TypeAlias

from allegro_twin.kinematics.closed_form.forms.quartic import FixedBend
from allegro_twin.kinematics.closed_form.forms.two_links import TOLERANCE, TOUCH, bend, two_links_of
from allegro_twin.kinematics.closed_form.redundancy.curve import (
    CurveParameter,
    Posture,
    PostureAt,
    PostureCurve,
    PostureRates,
    Segment,
    near_turn,
)
from allegro_twin.kinematics.closed_form.redundancy.preferences import (
    STEP,
    Limits,
    distance_to,
    furthest_from_limits,
    least_cost,
    orientation_error,
)
from allegro_twin.kinematics.maths import FLOATS

Interval: TypeAlias = tuple[float, float]
"""A range of τ, or of q₀, rad."""
_POINT = 1e-7  # rad of τ: an interval this narrow is a point.
_TURNS = (0.0, 2 * pi, -2 * pi)
_TOUCHED = TOUCH * TOUCH
_AXIS = 1e-6  # m from joint 1's axis.
_FINE = 0.25  # rad of τ between two samples, where an orientation is so far off that any posture may be the nearest.


class ThumbRedundancy:
    """Targets are x, y, z, m, in the base frame moved along x to joint 1."""

    def __init__(
        self, links: tuple[float, ...], aside: float, up: float, low: Sequence[float], high: Sequence[float]
    ) -> None:
        (first, second), self._aside, self._up = links, aside, up
        self._links, self._pair = (first, second), two_links_of(first, second)
        self._reach, self._towards = hypot(aside, up), atan2(up, aside)
        self._low, self._high = low, high
        self._clearances: Limits = (low[0], high[0], low[1], high[1], low[2], high[2], low[3], high[3])
        self._limits = [(a - TOLERANCE, b + TOLERANCE) for a, b in zip(low, high, strict=True)]
        self._middles = [(a + b) / 2 for a, b in zip(low, high, strict=True)]
        self._swings = [tan(angle) for angle in (low[1], high[1])]
        self._sides = []
        for elbow, least, most in ((1.0, low[3], high[3]), (-1.0, -high[3], -low[3])):
            least, most = max(least, 0.0), min(most, pi)
            if least <= most:
                squares = [first * first + second * second + 2 * first * second * cos(e) for e in (most, least)]
                self._sides.append(ElbowSide(elbow, squares[0], squares[1] if least > 0.0 else self._pair.outer))

    def preferred(self, x: float, y: float, z: float, near: Sequence[float] | None) -> Posture | None:
        """The posture that reaches a point nearest to another posture, or furthest from every limit; None where none
        reaches it."""

        def choose(curve: PostureCurve) -> Posture | None:
            if near is None:
                return furthest_from_limits(curve, self._clearances)
            return least_cost(curve, distance_to(near))

        free = (self._low[1] + self._high[1]) / 2 if near is None else near[1]
        return self._best(choose, (x, y, z), free)

    def nearest_orientation(
        self, x: float, y: float, z: float, view: tuple[float, ...], angle: float
    ) -> Posture | None:
        """The posture that reaches a point turned nearest to an orientation (`ThumbForms.view`); one is known to be off
        by an angle, rad. The tip's y axis lies at longitude -q₀ about x: so q₀ is no further from the wanted one than
        the angle allows."""
        value = orientation_error(view)
        only = self._range_of_q0(view, angle)
        step = _FINE if only is None else STEP
        return self._best(lambda curve: least_cost(curve, value, step), (x, y, z), view[1], only)

    def _range_of_q0(self, view: tuple[float, ...], angle: float) -> Interval | None:
        if angle >= pi / 2:
            return None
        part = sin(angle) / cos(view[1])
        if part >= 1.0:
            return None
        turn, off = FLOATS.wrap(view[0], (self._low[0] + self._high[0]) / 2), asin(part)
        return max(self._low[0], turn - off), min(self._high[0], turn + off)

    def _best(
        self,
        choose: Callable[[PostureCurve], Posture | None],
        target: tuple[float, float, float],
        free: float,
        only: Interval | None = None,
    ) -> Posture | None:
        """The posture that is chosen of the curve to a point. On joint 1's axis q₁ is `free`, as far as its limits let
        it; `only`: with q₀ in a range."""
        free = min(self._high[1], max(self._low[1], free))
        posture = choose(self._curve(target, free, only, bounded=False))
        if posture is None or not self._inside(posture):
            posture = choose(self._curve(target, free, only, bounded=True))
        return posture if posture is not None and self._inside(posture) else None

    def _inside(self, q: Posture) -> bool:
        (l0, h0), (l1, h1), (l2, h2), (l3, h3) = self._limits
        return l0 <= q[0] <= h0 and l1 <= q[1] <= h1 and l2 <= q[2] <= h2 and l3 <= q[3] <= h3

    def _curve(
        self, target: tuple[float, float, float], free: float, only: Interval | None, *, bounded: bool
    ) -> PostureCurve:
        """The curve to a point; `bounded`: with the limits of q₂, too."""
        x, y, z = target
        curve, square, lean = PostureCurve([], []), y * y + z * z, atan2(z, y)
        radius = sqrt(square)
        whole, twice = x * x + square + self._reach * self._reach, 2.0 * radius * self._reach
        straight = _clamped_acos(whole - self._pair.outer, twice)
        if straight == 0.0:
            return curve
        if abs(x) < _AXIS:
            curve.ends.extend(self._beside_axis(target, free))
        middle = near_turn(self._towards - lean, self._middles[0])
        ends = self._q0_at_limits_of_q1(x, radius, lean)
        if bounded:
            ends += self._q0_at_limits_of_q2(x, y, z)
        for sense in (1.0,) if straight < pi else (1.0, -1.0):
            parameter = CurveParameter(middle, straight if straight < pi else 0.0, sense)
            bent = _inside_limits_of_q3(parameter, self._sides, self._pair.outer, whole, twice)
            intervals = _common(bent, _inside_range_of_q0(parameter, only or (self._low[0], self._high[0])))
            if intervals:
                self._add(curve, parameter, self._posture_at(parameter, target, free), intervals, ends, bounded)
        return curve

    def _beside_axis(self, target: tuple[float, float, float], q1: float) -> list[Posture]:
        """The postures with one q₁, for a point beside joint 1's axis: there the other joints hardly move while q₁ goes
        through all its range."""
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

    def _posture_at(self, parameter: CurveParameter, target: tuple[float, float, float], free: float) -> PostureAt:
        x, y, z = target
        (even, inner, outer, _, _), (link, tip), aside, up = self._pair, self._links, self._aside, self._up
        middle, half, sense = parameter
        ahead, upright = self._middles[:2]
        xx = x * x
        small = 1e-6 * link * tip
        least = (
            sqrt(half / (link * tip * hypot(y, z) * self._reach * sin(half))) if half else 0.0
        )  # At a straight elbow.

        def at(tau: float) -> PostureRates:
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

    def _q0_at_limits_of_q1(self, x: float, radius: float, lean: float) -> list[float]:
        found: list[float] = []
        if radius > TOUCH:
            for swing in self._swings:
                across = (self._aside + x * swing) / radius
                if -1.0 <= across <= 1.0:
                    turn = acos(across)
                    found += (turn - lean, -turn - lean)
        return found

    def _q0_at_limits_of_q2(self, x: float, y: float, z: float) -> list[float]:
        link, tip = self._links
        found: list[float] = []
        for q2 in (self._low[2], self._high[2]):
            bend = FixedBend(FLOATS, (x, y, z), self._aside, tip, link * sin(q2), self._up + link * cos(q2))
            found += [q0 for _, q0, _ in bend.roots() if q0 == q0]
        return found

    def _add(
        self,
        curve: PostureCurve,
        parameter: CurveParameter,
        at: PostureAt,
        intervals: list[Interval],
        ends: list[float],
        bounded: bool,
    ) -> None:
        """Between two ends that follow each other the curve is inside the limits of q₁ and q₂ as a whole, or not."""
        (l1, h1), (l2, h2) = self._limits[1:3]
        taus: list[float] = []
        for q0 in ends:
            q0 = near_turn(q0, parameter.middle)
            if parameter.half == 0.0:
                taus.append(q0)
            elif abs(q0 - parameter.middle) < parameter.half:
                tau = acos((parameter.middle - q0) / parameter.half)
                taus += (tau, -tau, 2 * pi - tau)
        for first, last in intervals:
            places = [first, *sorted([tau for tau in taus if first < tau < last]), last]
            outside = True
            for low, high in pairwise(places):
                middle = at((low + high) / 2)
                if high - low > _POINT and l1 <= middle[1] <= h1 and (not bounded or l2 <= middle[2] <= h2):
                    curve.segments.append(Segment(at, low, high, middle))
                    outside = False
                else:
                    if outside:
                        self._add_single(curve, at(low))
                    outside = True
            if outside:
                self._add_single(curve, at(last))

    def _add_single(self, curve: PostureCurve, at: PostureRates) -> None:
        if self._inside(at[:4]):
            curve.ends.append(at[:4])


class ElbowSide(NamedTuple):
    """One sign of the elbow, and d², m², where it is bent most and least."""

    elbow: float
    least: float
    most: float


def _inside_limits_of_q3(
    parameter: CurveParameter, sides: Sequence[ElbowSide], outer: float, whole: float, twice: float
) -> list[Interval]:
    """Ranges of τ in which q₃ is inside its limits, if d² = whole - twice · cos(q₀ - middle), and d² = `outer` where it
    is straight: at τ = 0 and τ = π. The elbow is positive between them and negative beside them, most bent half way.
    """
    middle, half, elbow = parameter
    if half == 0.0:
        ends = [
            (_clamped_acos(whole - least, twice), _clamped_acos(whole - most, twice))
            for bent, least, most in sides
            if bent == elbow
        ]
        return [w for near, far in ends for w in ((middle + near, middle + far), (middle - far, middle - near))]
    ends = []  # From the straight elbow to where it is bent least, and most.
    for _, least, most in sides:
        near = acos(min(1.0, _clamped_acos(whole - most, twice) / half)) if most < outer else 0.0
        ends.append((near, acos(min(1.0, _clamped_acos(whole - least, twice) / half))))
    near, far = ends[0]
    if len(ends) == 2:
        first, last = (-ends[1][1], far), (pi - far, pi + ends[1][1])
    elif sides[0].elbow > 0.0:
        first, last = (near, far), (pi - far, pi - near)
    else:
        first, last = (-far, -near), (pi + near, pi + far)
    return [(first[0], last[1])] if first[1] >= last[0] else [first, last]


def _inside_range_of_q0(parameter: CurveParameter, only: Interval) -> list[Interval]:
    """Ranges of τ in which q₀ is inside a range."""
    (low, high), (middle, half, _) = only, parameter
    found: list[Interval] = []
    for turn in _TURNS:
        if half == 0.0:
            found.append((low + turn, high + turn))
        elif low + turn <= middle + half and high + turn >= middle - half:
            first, last = (middle - low - turn) / half, (middle - high - turn) / half
            first, last = acos(first) if first < 1.0 else 0.0, acos(last) if last > -1.0 else pi
            if first == 0.0:
                found += [(-last, last), (2 * pi - last, 2 * pi)] if last < pi else [(-pi, 2 * pi)]
            elif last == pi:
                found += [(first, 2 * pi - first), (-pi, -first)]
            else:
                found += [(first, last), (-last, -first), (2 * pi - last, 2 * pi - first)]
    return found


def _common(first: Sequence[Interval], second: Sequence[Interval]) -> list[Interval]:
    """Intersections of both, with those that are points, or a rounding less than that."""
    found = []
    for a, b in first:
        for c, d in second:
            low, high = (c if c > a else a), (d if d < b else b)
            if high - low > -_POINT:
                found.append((low, high) if high > low else (high, low))
    return found


def _clamped_acos(along: float, twice: float) -> float:
    """acos(along / twice), rad: zero or π beyond the ends."""
    return 0.0 if along >= twice else pi if along <= -twice else acos(along / twice)
