"""The postures of an index, middle or ring finger that reach one point, inside one set of limits, and the best of them.

Every segment of the curve ends where a joint is at its limit. Fixing one joint leaves two links, which is closed-form:
so a point is reachable exactly if one of these ends is inside the limits, or a whole curve without an end.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import acos, atan, atan2, cos, hypot, inf, pi, sin, sqrt
from typing import NamedTuple

from allegro_twin.kinematics.closed_form.forms.two_links import TOLERANCE, TOUCH, TwoLinks, two_links_of
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
    Limits,
    distance_to,
    furthest_from_limits,
    least_cost,
)
from allegro_twin.kinematics.maths import FLOATS

_SMALL = 1e-6  # sin q₂ below which the elbow is straight.


class FingerRedundancy:
    """Targets are x, y, z, m, in the base frame at joint 1."""

    def __init__(self, links: tuple[float, ...], low: Sequence[float], high: Sequence[float]) -> None:
        self._links, self._pair = links, two_links_of(links[0], links[1])
        self._fixed = _joints_at_limits(links, low, high)
        self._limits = [(a - TOLERANCE, b + TOLERANCE) for a, b in zip(low, high, strict=True)]
        self._middles = [(a + b) / 2 for a, b in zip(low, high, strict=True)]
        self._low, self._high = low[0], high[0]
        # q₀ follows from the point alone: no choice can bring it away from its limits.
        self._clearances: Limits = (-inf, inf, low[1], high[1], low[2], high[2], low[3], high[3])

    def preferred(self, x: float, y: float, z: float, near: Sequence[float] | None) -> Posture | None:
        """The posture that reaches a point nearest to another posture, or furthest from every limit; None where none
        reaches it."""
        curve = self._curve_to(x, y, z, near[0] if near else 0.0)
        if curve is None:
            return None
        return furthest_from_limits(curve, self._clearances) if near is None else least_cost(curve, distance_to(near))

    def nearest_orientation(
        self, x: float, y: float, z: float, view: tuple[float, ...], angle: float
    ) -> Posture | None:
        """The posture that reaches a point turned nearest to an orientation. The angle grows with the distance from the
        best pitch, so the least is where the pitch ends: at limits, or at a straight elbow."""
        curve = self._curve_to(x, y, z, atan2(-view[1], view[4]))
        if curve is None:
            return None
        ends = curve.ends
        for segment in curve.segments:
            ends = [*ends, *(segment.at(k * pi)[:4] for k in (-1, 0, 1, 2) if segment.low < k * pi < segment.high)]
        if not ends:
            return None
        c, s = cos(ends[0][0]), sin(ends[0][0])
        across, along = c * view[2] + s * view[5] - view[6], c * view[0] + s * view[3] + view[8]

        def agreement(q: Posture) -> float:
            pitch = q[1] + q[2] + q[3]
            return across * sin(pitch) + along * cos(pitch)

        return max(ends, key=agreement)

    def _curve_to(self, x: float, y: float, z: float, free: float) -> PostureCurve | None:
        """On the abduction axis q₀ is free, and taken as near to `free` as its limits allow. None where its limits are
        in the way."""
        free = min(self._high, max(self._low, FLOATS.wrap(free, (self._low + self._high) / 2)))
        low, high = self._limits[0]
        r = sqrt(x * x + y * y)
        q0 = atan2(y, x) if r > TOUCH else free
        if low <= q0 <= high:
            return self.curve(q0, r, z)
        q0 = q0 - pi if q0 > 0.0 else q0 + pi
        return self.curve(q0, -r, z) if low <= q0 <= high else None

    def curve(self, q0: float, r: float, h: float) -> PostureCurve:
        """The curve to a point of the plane to which q₀ turns, m, counted from joint 1."""
        curve, tip = PostureCurve([], []), self._links[2]
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
            parameter = CurveParameter(middle, acos(bound / twice), 1.0)
            at = self._posture_at(parameter, q0, r, h)
            self._add(curve, parameter, at, ends) if ends else self._add_loop(curve, at)
        elif ends:
            for elbow in (1.0, -1.0):
                if some := [q for q in ends if q[2] * elbow >= 0.0]:
                    parameter = CurveParameter(middle, 0.0, elbow)
                    self._add(curve, parameter, self._posture_at(parameter, q0, r, h), some)
        return curve

    def _posture_at(self, parameter: CurveParameter, q0: float, r: float, h: float) -> PostureAt:
        (first, second, tip), (even, inner, outer, _, _), third = self._links, self._pair, self._middles[3]
        middle, half, sense = parameter
        least = sqrt(half * first * second / (tip * hypot(r, h) * sin(half))) if half else 0.0  # At a straight elbow.

        def at(tau: float) -> PostureRates:
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

    def _add(self, curve: PostureCurve, parameter: CurveParameter, at: PostureAt, ends: list[Posture]) -> None:
        """Between two ends that follow each other the curve is inside the limits as a whole, or outside."""
        places = sorted(parameter.tau(q[1] + q[2] + q[3], q[2]) for q in ends)
        for low, high in pairwise([*places, places[0] + 2 * pi]):
            middle = at((low + high) / 2)
            if high - low > TOLERANCE and self._inside(middle):
                curve.segments.append(Segment(at, low, high, middle))
        curve.ends.extend(ends)

    def _add_loop(self, curve: PostureCurve, at: PostureAt) -> None:
        """A curve without an end is inside the limits as a whole, or outside."""
        middle = at(0.0)
        if self._inside(middle):
            curve.segments.append(Segment(at, -pi, pi, middle))

    def _ends(self, q0: float, r: float, h: float) -> list[Posture]:
        """The postures with a joint at its limit."""
        found, middles = [], self._middles
        (_, _), (l1, h1), (l2, h2), (l3, h3) = self._limits
        for joint, value, r0, h0, before, behind, pair, sign, least, most in self._fixed:
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


class JointAtLimit(NamedTuple):
    """One joint fixed at a limit, and the two links that are left, with one sign of the elbow between them."""

    joint: int
    """The one that is fixed: 1, 2 or 3."""
    value: float
    """Its position, rad."""
    r: float
    h: float
    """Where the two links begin, m."""
    before: float
    """From the direction of the free joint before it to that of the first link, rad."""
    behind: float
    """From the position of the free joint behind it to the elbow's angle, rad."""
    pair: TwoLinks
    sign: float = 1.0
    least: float = 0.0
    most: float = 0.0
    """Least and most d², m², at which the elbow is inside its limits."""


def _joints_at_limits(links: tuple[float, ...], low: Sequence[float], high: Sequence[float]) -> list[JointAtLimit]:
    """Joints 1 to 3 at either limit, with both signs of the elbow; limits of q₀ to q₃, rad."""
    first, second, tip = links
    found: list[JointAtLimit] = []
    for value in (low[1], high[1]):
        pair = two_links_of(second, tip)
        fixed = JointAtLimit(1, value, first * sin(value), first * cos(value), value, 0.0, pair)
        found += _both_elbows(fixed, second, tip, low[3], high[3])
    for value in (low[2], high[2]):
        along, aside = first + second * cos(value), second * sin(value)
        lean, link = atan2(aside, along), hypot(along, aside)
        fixed = JointAtLimit(2, value, 0.0, 0.0, lean, value - lean, two_links_of(link, tip))
        found += _both_elbows(fixed, link, tip, low[3], high[3])
    for value in (low[3], high[3]):
        along, aside = second + tip * cos(value), tip * sin(value)
        lean, link = atan2(aside, along), hypot(along, aside)
        fixed = JointAtLimit(3, value, 0.0, 0.0, 0.0, lean, two_links_of(first, link))
        found += _both_elbows(fixed, first, link, low[2], high[2])
    return found


def _both_elbows(fixed: JointAtLimit, first: float, second: float, low: float, high: float) -> list[JointAtLimit]:
    """With both signs of the elbow, as far as the limits of the joint behind it allow."""

    def square(angle: float) -> float:
        return first * first + second * second + 2 * first * second * cos(angle)

    low, high = low + fixed.behind, high + fixed.behind
    found = []
    for sign, least, most in ((1.0, low, high), (-1.0, -high, -low)):
        least, most = max(least - TOLERANCE, 0.0), min(most + TOLERANCE, pi)
        if least <= most:
            nearest = square(most) if most < pi else fixed.pair.below
            furthest = square(least) if least > 0.0 else fixed.pair.above
            found.append(fixed._replace(sign=sign, least=nearest, most=furthest))
    return found
