"""The nearest point that links in a plane can reach inside their joint limits, and the plane that turns about an axis.

The boundary of what the links reach is made of arcs: one joint turns, and the others are at a limit or in line with
what lies between them and the tip (or folded back onto it). The nearest point of an arc is closed-form.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import product
from math import atan2, ceil, cos, floor, hypot, inf, pi, sin, sqrt
from typing import TypeAlias

from allegro_twin.kinematics.closed_form.forms.two_links import bend, two_links_of
from allegro_twin.kinematics.maths import FLOATS

Arc: TypeAlias = tuple[float, float, float, float, float, float, int, tuple[float, ...]]
"""Where the tip is while one joint turns: r and h of the centre and the radius, m; from the joint's angle to the
direction in which the tip lies from the centre, and the joint's lowest and highest angle, rad; its index among the
links' joints; and the angles of the others, rad."""
PlaneResult: TypeAlias = tuple[float, tuple[float, ...]]
"""The square of the least distance in a plane, m², and the joints that bend; inf and none where there are none."""
PlaneSearch: TypeAlias = Callable[[float, float], PlaneResult]
"""From a target r and h in the plane, m, to the nearest posture of the joints that bend."""


def nearest_on_arcs(arcs: Iterable[Arc], r: float, h: float) -> PlaneResult:
    """The nearest point of some arcs."""
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


def boundary_arcs(links: Sequence[float], low: Sequence[float], high: Sequence[float]) -> list[Arc]:
    """The arcs of two or three links: each joint turns in turn, with those before it at a limit."""
    arcs: list[Arc] = []
    for joint in range(len(links)):
        for before in product(*zip(low[:joint], high[:joint], strict=True)):
            r, h, towards = 0.0, 0.0, 0.0
            for link, angle in zip(links, before, strict=False):
                towards += angle
                r, h = r + link * sin(towards), h + link * cos(towards)
            for behind in _angles_behind(links[joint:], low[joint + 1 :], high[joint + 1 :]):
                radius, lean = _rigid(links[joint:], behind)
                arcs.append((r, h, radius, towards + lean, low[joint], high[joint], joint, (*before, *behind)))
    return sorted(arcs, key=lambda arc: -arc[2] - hypot(arc[0], arc[1]))  # The outermost is most often the nearest.


def _angles_behind(links: Sequence[float], low: Sequence[float], high: Sequence[float]) -> list[tuple[float, ...]]:
    """The angles of the joints behind one, at which turning it leads along the boundary: at limits, in line, or folded
    back."""
    if not low:
        return [()]
    if len(low) == 1:
        return [(angle,) for angle in boundary_angles(low[0], high[0])]
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


def boundary_angles(low: float, high: float) -> list[float]:
    """The angles of a joint between two links on the boundary of what they reach: at a limit, in line, or folded."""
    return sorted({low, high, *_within((0.0, pi), low, high)})


def _within(angles: Iterable[float], low: float, high: float) -> list[float]:
    near = [FLOATS.wrap(angle, (low + high) / 2) for angle in angles]
    return [angle for angle in near if low <= angle <= high]


def _rigid(links: Sequence[float], angles: Sequence[float]) -> tuple[float, float]:
    """Links with their joints fixed: the length from end to end, m, and its direction from the first, rad."""
    r, h, towards = 0.0, links[0], 0.0
    for link, angle in zip(links[1:], angles, strict=True):
        towards += angle
        r, h = r + link * sin(towards), h + link * cos(towards)
    return hypot(r, h), atan2(r, h)


def nearest_by_turning(
    x: float, y: float, low: float, high: float, search: PlaneSearch, h: float
) -> tuple[float, float, tuple[float, ...]]:
    """The joint that turns a plane about an axis towards a target, and the nearest posture in that plane: the square of
    the distance, m², that joint, and those that bend, rad.

    Before the axis the best angle is the one that points at the target, as far as the limits let it, and behind the
    axis the opposite one.
    """
    towards, middle = atan2(y, x), (low + high) / 2
    least, best = inf, low
    joints: tuple[float, ...] = ()
    for angle in (towards, towards + pi):
        q = min(high, max(low, FLOATS.wrap(angle, middle)))
        c, s = cos(q), sin(q)
        r, aside = x * c + y * s, y * c - x * s
        # Behind the axis, where only the second angle is better, nothing is nearer than the axis itself.
        if (x * x + y * y if angle != towards and r > 0.0 else aside * aside) < least:
            square, found = search(r, h)
            if square + aside * aside < least:
                least, best, joints = square + aside * aside, q, found
    return least, best, joints


def two_link_search(links: Sequence[float], low: Sequence[float], high: Sequence[float]) -> PlaneSearch:
    """The search for two links inside the limits of both joints."""
    pair, arcs = two_links_of(links[0], links[1]), boundary_arcs(links, low, high)
    (l0, l1), (h0, h1) = low, high

    def search(r: float, h: float) -> PlaneResult:
        square = r * r + h * h
        if pair.inner < square < pair.outer:
            half, lead, _ = bend(FLOATS, square, pair)
            towards = atan2(r, h)
            for first, second in ((towards - lead, half + half), (towards + lead, -half - half)):
                first, second = FLOATS.wrap(first, (l0 + h0) / 2), FLOATS.wrap(second, (l1 + h1) / 2)
                if l0 <= first <= h0 and l1 <= second <= h1:
                    return 0.0, (first, second)
        return nearest_on_arcs(arcs, r, h)

    return search


def full_turns(angle: float, low: float, high: float) -> list[float]:
    """The angles between two bounds that differ from one by full turns, rad."""
    first, last = ceil((low - angle) / (2 * pi)), floor((high - angle) / (2 * pi))
    return [angle + 2 * pi * k for k in range(first, last + 1)]
