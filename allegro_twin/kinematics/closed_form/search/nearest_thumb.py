"""The nearest point that the thumb can reach. For every q₀ it is closed-form, as a finger's is; and q₀ is sought.

The square of the distance, S(q₀), is the least of those of all postures behind joint 0, each of which goes with q₀ as

    |T|² + |p|² − 2 (T_x p_x + R ρ cos(q₀ − φ)),    R, ρ: how far target and tip are from joint 0's axis.

So S has as many valleys as there are ways to bend, with ridges between them, but bends upwards by at most K = 2 R ρ.
Of a valley's lowest place m, where the slope is zero, that says for any other place

    S(q₀) ≤ S(m) + K/2 (q₀ − m)²,    |S'(q₀)| ≤ K |q₀ − m| where it falls towards m.

What two places leave possible between them is searched until nothing can be there that is nearer by GAIN.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import ceil, cos, hypot, inf, sin, sqrt
from typing import TypeAlias

from allegro_twin.kinematics.closed_form.forms.planar import TOLERANCE
from allegro_twin.kinematics.closed_form.search.arcs import Arc, nearest_of
from allegro_twin.kinematics.closed_form.search.curve import Posture
from allegro_twin.kinematics.closed_form.search.minima import Place, Way, minimum
from allegro_twin.kinematics.closed_form.search.nearest import InPlane, Mode, Reach, full_turns, swung, two_links

_STEP = 0.6  # rad of q₀ between two places from which the valleys are searched, at most.
_GAIN = 1e-10  # m
_NARROW = (
    1e-9  # rad. Less is left between two places only where the distance is next to nothing: 1e-19 m² can be there.
)
_THERE = 1e-24  # m²: nothing is nearer than the target itself.
Seen: TypeAlias = tuple[float, float, Posture]
"""With one q₀ the square of the least distance, m², its slope by q₀ and the posture."""


class ThumbNearest:
    """Inside one set of limits. Targets are x, y, z in the base frame moved along x to joint 1, m."""

    def __init__(
        self, links: tuple[float, ...], aside: float, up: float, low: Sequence[float], high: Sequence[float]
    ) -> None:
        self._links, self._aside, self._up, self._low, self._high = links, aside, up, low, high
        self._both = two_links(links, low[2:], high[2:])
        self._reach = hypot(aside, up) + sum(links)

    def at(self, x: float, y: float, z: float, mode: Mode, angle: float) -> tuple[float, Posture | None]:
        """The least distance, m, and the posture that has it; inf and none where none has the angle of the mode."""
        (low, high), swing, reach = (self._low[0], self._high[0]), None, self._both
        if mode == "q0":
            held = full_turns(angle, low - TOLERANCE, high + TOLERANCE)
            if not held:
                return inf, None
            low = high = held[0]
        elif mode == "q1":
            held = full_turns(angle, self._low[1] - TOLERANCE, self._high[1] + TOLERANCE)
            if not held:
                return inf, None
            swing = held[0]
        elif mode == "psi":
            reach = self._with(angle)
            if not reach(0.0, 0.0)[1]:
                return inf, None

        def seen(q0: float) -> Seen:
            return self._seen(x, y, z, q0, swing, reach)

        if low == high:
            square, _, posture = seen(low)
            return sqrt(square), posture
        count = 2 * ceil((high - low) / (2 * _STEP))
        taus = [low + (high - low) * k / count for k in range(count + 1)]
        square, _, posture = _lowest(seen, taus, 2.0 * hypot(y, z) * self._reach)
        return sqrt(square), posture

    def _seen(self, x: float, y: float, z: float, q0: float, swing: float | None, reach: Reach) -> Seen:
        """The nearest with this q₀. As the target turns about joint 0, its distance changes as its own motion says."""
        c, s = cos(q0), sin(q0)
        across, above = c * y - s * z, s * y + c * z
        b, h = across - self._aside, above - self._up
        if swing is None:
            square, q1, (q2, q3) = swung(x, b, self._low[1], self._high[1], reach, h)
            c1, s1 = cos(q1), sin(q1)
        else:
            q1, c1, s1 = swing, cos(swing), sin(swing)
            square, (q2, q3) = reach(x * c1 + b * s1, h)
            square += (b * c1 - x * s1) ** 2
        link, tip = self._links
        off = b - s1 * (link * sin(q2) + tip * sin(q2 + q3)), h - link * cos(q2) - tip * cos(q2 + q3)
        return square, 2.0 * (off[1] * across - off[0] * above), (q0, q1, q2, q3)

    def _with(self, psi: float) -> Reach:
        """With q₂ + q₃ held the first link alone bends, and the last shifts its circle."""
        (link, tip), (l2, l3), (h2, h3) = self._links, self._low[2:], self._high[2:]
        arcs: list[Arc] = []
        for angle in full_turns(psi, l2 + l3 - TOLERANCE, h2 + h3 + TOLERANCE):
            low, high = max(l2, angle - h3), min(h2, angle - l3)
            arcs.append((tip * sin(angle), tip * cos(angle), link, 0.0, low, max(low, high), 0, (angle,)))

        def reach(r: float, h: float) -> InPlane:
            square, found = nearest_of(arcs, r, h)
            return square, (found[0], found[1] - found[0]) if found else ()

        return reach


def _lowest(seen: Way[Seen], taus: Sequence[float], bend: float) -> Seen:
    """The lowest place between some, of what bends upwards by at most `bend`, m²/rad²."""
    places: list[Place[Seen]] = []
    for tau in taus:
        at = seen(tau)
        places.append((tau, at[0], at[1], at))
    best = min(places, key=_cost)[3]
    open_ = list(pairwise(places))
    while open_ and best[0] > _THERE:
        low, high = open_.pop()
        worth = max(0.0, sqrt(best[0]) - _GAIN)
        if high[0] - low[0] < _NARROW or not _may_hide(low, high, bend, worth * worth):
            continue
        if low[2] < 0.0 < high[2]:
            tau, cost, _, at = minimum(seen, _value, low, high)
            between = (tau, cost, 0.0, at)
        else:
            middle = (low[0] + high[0]) / 2.0
            at = seen(middle)
            between = (middle, at[0], at[1], at)
        best = min(best, between[3], key=_square)
        open_ += ((low, between), (between, high))
    return best


def _may_hide(low: Place[Seen], high: Place[Seen], bend: float, best: float) -> bool:
    """Whether a valley that is lower than that may lie between two places."""
    (a, cost, ga, _), (b, then, gb, _) = low, high
    first = a - ga / bend if ga < 0.0 else a
    last = b - gb / bend if gb > 0.0 else b
    if first > last:
        return False
    m = (a + b) / 2.0 + (cost - then) / (bend * (b - a))
    m = first if m < first else last if m > last else m
    half = bend / 2.0
    return max(cost - half * (m - a) * (m - a), then - half * (b - m) * (b - m)) < best


def _value(at: Seen) -> tuple[float, float]:
    return at[0], at[1]


def _cost(place: Place[Seen]) -> float:
    return place[1]


def _square(at: Seen) -> float:
    return at[0]
