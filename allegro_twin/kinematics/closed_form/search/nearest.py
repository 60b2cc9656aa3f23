"""The nearest point that a finger can reach, where it cannot reach the one asked for: what all fingers share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import atan2, ceil, cos, floor, inf, pi, sin
from typing import Literal, TypeAlias

from allegro_twin.kinematics.closed_form.forms.maths import FLOATS
from allegro_twin.kinematics.closed_form.forms.planar import bend, pair_of
from allegro_twin.kinematics.closed_form.search.arcs import edge, nearest_of

Mode: TypeAlias = Literal["position", "pitch", "rotation", "q0", "q1", "psi"]
"""What a target fixes besides the position."""
InPlane: TypeAlias = tuple[float, tuple[float, ...]]
"""The square of the least distance in a plane, m², and the joints that bend; inf and none where there are none."""
Reach: TypeAlias = Callable[[float, float], InPlane]
"""From a target r and h in the plane, m, to what is nearest to it."""


def swung(
    x: float, y: float, low: float, high: float, reach: Reach, h: float
) -> tuple[float, float, tuple[float, ...]]:
    """The joint that turns a plane about an axis towards a target, and what is then nearest in it.

    Before the axis the best angle is the one that points at the target, as far as the limits let it, and behind the
    axis the opposite one. The square of the distance, m², that joint, and those that bend.
    """
    towards, middle = atan2(y, x), (low + high) / 2
    least, best = inf, low
    joints: tuple[float, ...] = ()
    for angle in (towards, towards + pi):
        q = min(high, max(low, FLOATS.turned(angle, middle)))
        c, s = cos(q), sin(q)
        r, aside = x * c + y * s, y * c - x * s
        # Behind the axis, where only the second angle is better, nothing is nearer than the axis itself.
        if (x * x + y * y if angle != towards and r > 0.0 else aside * aside) < least:
            square, found = reach(r, h)
            if square + aside * aside < least:
                least, best, joints = square + aside * aside, q, found
    return least, best, joints


def two_links(links: Sequence[float], low: Sequence[float], high: Sequence[float]) -> Reach:
    """Two links inside the limits of both joints."""
    pair, arcs = pair_of(links[0], links[1]), edge(links, low, high)
    (l0, l1), (h0, h1) = low, high

    def reach(r: float, h: float) -> InPlane:
        square = r * r + h * h
        if pair.inner < square < pair.outer:
            half, lead, _ = bend(FLOATS, square, pair)
            towards = atan2(r, h)
            for first, second in ((towards - lead, half + half), (towards + lead, -half - half)):
                first, second = FLOATS.turned(first, (l0 + h0) / 2), FLOATS.turned(second, (l1 + h1) / 2)
                if l0 <= first <= h0 and l1 <= second <= h1:
                    return 0.0, (first, second)
        return nearest_of(arcs, r, h)

    return reach


def full_turns(angle: float, low: float, high: float) -> list[float]:
    """The angles between two others that are the same but for full turns, rad."""
    first, last = ceil((low - angle) / (2 * pi)), floor((high - angle) / (2 * pi))
    return [angle + 2 * pi * k for k in range(first, last + 1)]
