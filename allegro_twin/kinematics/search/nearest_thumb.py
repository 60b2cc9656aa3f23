"""The nearest point that the thumb can reach. For every q₀ it is closed-form, as a finger's is; and q₀ is sought."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import ceil, cos, inf, sin, sqrt
from typing import TypeAlias

from allegro_twin.kinematics.forms.planar import TOLERANCE
from allegro_twin.kinematics.search.arcs import Arc, nearest_of
from allegro_twin.kinematics.search.curve import Posture
from allegro_twin.kinematics.search.minima import Place, minima
from allegro_twin.kinematics.search.nearest import InPlane, Mode, Reach, full_turns, swung, two_links

_STEP = 0.6  # rad of q₀ between two places from which the valleys are searched, at most.
Seen: TypeAlias = tuple[float, float, Posture]
"""With one q₀ the square of the least distance, m², its slope by q₀ and the posture."""


class ThumbNearest:
    """Inside one set of limits. Targets are x, y, z in the base frame moved along x to joint 1, m."""

    def __init__(
        self, links: tuple[float, ...], aside: float, up: float, low: Sequence[float], high: Sequence[float]
    ) -> None:
        self._links, self._aside, self._up, self._low, self._high = links, aside, up, low, high
        self._both = two_links(links, low[2:], high[2:])

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
        found = [seen(low + (high - low) * k / count) for k in range(count + 1)]
        places: list[Place[Seen]] = [(at[2][0], at[0], at[1], at) for at in found]
        for ends in pairwise(places):
            found += [place[3] for place in minima(seen, _cost, *ends)]
        square, _, posture = min(found, key=_square)
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


def _cost(at: Seen) -> tuple[float, float]:
    return at[0], at[1]


def _square(at: Seen) -> float:
    return at[0]
