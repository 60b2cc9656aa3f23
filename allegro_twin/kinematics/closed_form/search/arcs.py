"""The edge of what links in a plane can reach inside their limits: arcs, on which the nearest place is closed-form.

On the edge one joint turns, and the others are at a limit or in line with what lies between them and the tip (or folded
back onto it). Directions are counted from h towards r, rad.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import product
from math import atan2, cos, hypot, inf, pi, sin, sqrt
from typing import TypeAlias

from allegro_twin.kinematics.closed_form.forms.maths import FLOATS

Arc: TypeAlias = tuple[float, float, float, float, float, float, int, tuple[float, ...]]
"""The tip when one joint turns about a centre: r and h of that and the radius, m; from the joint's angle to the
direction in which the tip lies from the centre, and the joint's lowest and highest angle, rad; its place among the
links' joints; and the angles of the others, rad."""


def nearest_of(arcs: Iterable[Arc], r: float, h: float) -> tuple[float, tuple[float, ...]]:
    """The square of the least distance from a point, m², and the joints there; inf and none where there are no arcs."""
    least, bound = inf, inf
    best: tuple[float, ...] = ()
    for centre, height, radius, turn, low, high, joint, others in arcs:
        a, b = r - centre, h - height
        square = a * a + b * b
        distance = sqrt(square)
        gap = distance - radius
        if gap >= bound or gap <= -bound:
            continue
        q = atan2(a, b) - turn
        away = q - (low + high) / 2
        if away > pi or away < -pi:
            q -= 2 * pi * round(away / (2 * pi))
        if q < low:
            square += radius * (radius - 2 * distance * cos(q - low))
            q = low
        elif q > high:
            square += radius * (radius - 2 * distance * cos(q - high))
            q = high
        else:
            square = gap * gap
        if square < least:
            least, bound, best = square, sqrt(square) if square > 0.0 else 0.0, (*others[:joint], q, *others[joint:])
    return max(least, 0.0), best


def edge(links: Sequence[float], low: Sequence[float], high: Sequence[float]) -> list[Arc]:
    """The arcs of two or three links: of each joint, with those before it at a limit."""
    arcs: list[Arc] = []
    for joint in range(len(links)):
        for before in product(*zip(low[:joint], high[:joint], strict=True)):
            r, h, towards = 0.0, 0.0, 0.0
            for link, angle in zip(links, before, strict=False):
                towards += angle
                r, h = r + link * sin(towards), h + link * cos(towards)
            for behind in _stiff(links[joint:], low[joint + 1 :], high[joint + 1 :]):
                radius, lean = _frozen(links[joint:], behind)
                arcs.append((r, h, radius, towards + lean, low[joint], high[joint], joint, (*before, *behind)))
    return sorted(arcs, key=lambda arc: -arc[2] - hypot(arc[0], arc[1]))  # The outermost is most often the nearest.


def _stiff(links: Sequence[float], low: Sequence[float], high: Sequence[float]) -> list[tuple[float, ...]]:
    """The angles behind a joint at which the edge can be reached by turning it: at limits, in line or folded back."""
    if not low:
        return [()]
    if len(low) == 1:
        return [(angle,) for angle in bends(low[0], high[0])]
    first, second, tip = links
    found = set(product((low[0], high[0]), (low[1], high[1])))
    found |= set(product(_within((0.0, pi), low[0], high[0]), _within((0.0, pi), low[1], high[1])))
    for angle in (low[0], high[0]):  # The last link in line with the first two.
        lean = atan2(second * sin(angle), first + second * cos(angle)) - angle
        found |= {(angle, q) for q in _within((lean, lean + pi), low[1], high[1])}
    for angle in (low[1], high[1]):  # The first in line with the last two.
        lean = -atan2(tip * sin(angle), second + tip * cos(angle))
        found |= {(q, angle) for q in _within((lean, lean + pi), low[0], high[0])}
    return sorted(found)


def bends(low: float, high: float) -> list[float]:
    """The angles of a joint between two links at which the edge can be reached: at a limit, in line, or folded."""
    return sorted({low, high, *_within((0.0, pi), low, high)})


def _within(angles: Iterable[float], low: float, high: float) -> list[float]:
    near = [FLOATS.turned(angle, (low + high) / 2) for angle in angles]
    return [angle for angle in near if low <= angle <= high]


def _frozen(links: Sequence[float], angles: Sequence[float]) -> tuple[float, float]:
    """Links with their joints held: the length from end to end, m, and its direction from the first, rad."""
    r, h, towards = 0.0, links[0], 0.0
    for link, angle in zip(links[1:], angles, strict=True):
        towards += angle
        r, h = r + link * sin(towards), h + link * cos(towards)
    return hypot(r, h), atan2(r, h)
