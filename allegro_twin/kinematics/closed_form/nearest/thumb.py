"""The nearest point that the thumb can reach inside one set of limits: closed-form for every q₀, and a search over q₀.

The square of the distance, S(q₀), is the least over all postures behind joint 0. For one posture it depends on q₀ as

    |T|² + |p|² − 2 (T_x p_x + R ρ cos(q₀ − φ)),    R, ρ: distances of target and tip from joint 0's axis.

So S has as many valleys as there are ways to bend, with ridges between them, but its second derivative is at most
K = 2 R ρ. For a minimum m of S that bounds every other place of its valley:

    S(q₀) ≤ S(m) + K/2 (q₀ − m)²,    |S'(q₀)| ≤ K |q₀ − m| where S falls towards m.

An interval is divided until these bounds leave no place in it that is nearer to the target by _GAIN.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from math import ceil, cos, hypot, inf, sin, sqrt
from typing import TypeAlias

from allegro_twin.kinematics.closed_form.forms.two_links import TOLERANCE
from allegro_twin.kinematics.closed_form.nearest.plane import (
    Arc,
    PlaneResult,
    PlaneSearch,
    full_turns,
    nearest_by_turning,
    nearest_on_arcs,
    two_link_search,
)
from allegro_twin.kinematics.closed_form.redundancy.curve import Posture
from allegro_twin.kinematics.closed_form.redundancy.minima import Sample, minimum
from allegro_twin.kinematics.closed_form.targets import Mode

_STEP = 0.6  # rad of q₀ between two first samples, at most.
_GAIN = 1e-10  # m
_NARROW = 1e-9  # rad: an interval is this narrow only where the distance is next to nothing; 1e-19 m² can be gained.
_THERE = 1e-24  # m²: nothing is nearer than the target itself.
NearestAtQ0: TypeAlias = tuple[float, float, Posture]
"""With one q₀ the square of the least distance, m², its slope by q₀, and the posture."""


class ThumbNearest:
    """Targets are x, y, z, m, in the base frame moved along x to joint 1."""

    def __init__(
        self, links: tuple[float, ...], aside: float, up: float, low: Sequence[float], high: Sequence[float]
    ) -> None:
        self._links, self._aside, self._up, self._low, self._high = links, aside, up, low, high
        self._two_links = two_link_search(links, low[2:], high[2:])
        self._reach = hypot(aside, up) + sum(links)

    def nearest(self, x: float, y: float, z: float, mode: Mode, angle: float) -> tuple[float, Posture | None]:
        """The least distance, m, and its posture; inf and None where none has the angle that the mode holds."""
        (low, high), swing, search = (self._low[0], self._high[0]), None, self._two_links
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
            search = self._with_psi(angle)
            if not search(0.0, 0.0)[1]:
                return inf, None

        def at_q0(q0: float) -> NearestAtQ0:
            return self._with_q0(x, y, z, q0, swing, search)

        if low == high:
            square, _, posture = at_q0(low)
            return sqrt(square), posture
        count = 2 * ceil((high - low) / (2 * _STEP))
        first = [low + (high - low) * k / count for k in range(count + 1)]
        square, _, posture = _lowest(at_q0, first, 2.0 * hypot(y, z) * self._reach)
        return sqrt(square), posture

    def _with_q0(
        self, x: float, y: float, z: float, q0: float, swing: float | None, search: PlaneSearch
    ) -> NearestAtQ0:
        """`swing`: q₁, where it is held. The slope is that of the target's own motion as it turns about joint 0."""
        c, s = cos(q0), sin(q0)
        across, above = c * y - s * z, s * y + c * z
        b, h = across - self._aside, above - self._up
        if swing is None:
            square, q1, (q2, q3) = nearest_by_turning(x, b, self._low[1], self._high[1], search, h)
            c1, s1 = cos(q1), sin(q1)
        else:
            q1, c1, s1 = swing, cos(swing), sin(swing)
            square, (q2, q3) = search(x * c1 + b * s1, h)
            square += (b * c1 - x * s1) ** 2
        link, tip = self._links
        off = b - s1 * (link * sin(q2) + tip * sin(q2 + q3)), h - link * cos(q2) - tip * cos(q2 + q3)
        return square, 2.0 * (off[1] * across - off[0] * above), (q0, q1, q2, q3)

    def _with_psi(self, psi: float) -> PlaneSearch:
        """With q₂ + q₃ held the first link alone bends, on a circle that the last link shifts."""
        (link, tip), (l2, l3), (h2, h3) = self._links, self._low[2:], self._high[2:]
        arcs: list[Arc] = []
        for angle in full_turns(psi, l2 + l3 - TOLERANCE, h2 + h3 + TOLERANCE):
            low, high = max(l2, angle - h3), min(h2, angle - l3)
            arcs.append((tip * sin(angle), tip * cos(angle), link, 0.0, low, max(low, high), 0, (angle,)))

        def search(r: float, h: float) -> PlaneResult:
            square, found = nearest_on_arcs(arcs, r, h)
            return square, (found[0], found[1] - found[0]) if found else ()

        return search


def _lowest(at_q0: Callable[[float], NearestAtQ0], first: Sequence[float], bend: float) -> NearestAtQ0:
    """The lowest place of a function whose second derivative is at most `bend`, m²/rad², from first samples on."""
    samples = [(q0, at[0], at[1], at) for q0 in first for at in (at_q0(q0),)]
    best = min(samples, key=lambda sample: sample[1])[3]
    open_ = list(pairwise(samples))
    while open_ and best[0] > _THERE:
        low, high = open_.pop()
        worth = max(0.0, sqrt(best[0]) - _GAIN)
        if high[0] - low[0] < _NARROW or not _may_hide(low, high, bend, worth * worth):
            continue
        if low[2] < 0.0 < high[2]:
            q0, cost, _, at = minimum(at_q0, _value, low, high)
            between = (q0, cost, 0.0, at)
        else:
            middle = (low[0] + high[0]) / 2.0
            at = at_q0(middle)
            between = (middle, at[0], at[1], at)
        best = min(best, between[3], key=lambda found: found[0])
        open_ += ((low, between), (between, high))
    return best


def _may_hide(low: Sample[NearestAtQ0], high: Sample[NearestAtQ0], bend: float, best: float) -> bool:
    """Whether a valley that is lower than `best` may lie between two samples."""
    (a, cost, ga, _), (b, then, gb, _) = low, high
    first = a - ga / bend if ga < 0.0 else a
    last = b - gb / bend if gb > 0.0 else b
    if first > last:
        return False
    m = (a + b) / 2.0 + (cost - then) / (bend * (b - a))
    m = first if m < first else last if m > last else m
    half = bend / 2.0
    return max(cost - half * (m - a) * (m - a), then - half * (b - m) * (b - m)) < best


def _value(at: NearestAtQ0) -> tuple[float, float]:
    return at[0], at[1]
