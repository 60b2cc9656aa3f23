"""Where, along a curve of the thumb's, q₀ and q₃ are inside their limits: ranges of τ.

The elbow is straight at τ = 0 and at π; from there on it is bent to the positive side between them and to the negative
side before and behind, most half way.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import acos, pi
from typing import NamedTuple, TypeAlias

from allegro_twin.kinematics.closed_form.search.curve import Course

Interval: TypeAlias = tuple[float, float]
"""A range of τ, or of q₀, rad."""
BESIDE = 1e-7
"""An interval this narrow is a point, rad of τ."""
_TURNS = (0.0, 2 * pi, -2 * pi)


class Side(NamedTuple):
    """One sign of the elbow, and d², m², where it is bent most and least."""

    elbow: float
    least: float
    most: float


def bent_inside(course: Course, sides: Sequence[Side], outer: float, whole: float, twice: float) -> list[Interval]:
    """τ where q₃ is inside its limits, if d² = whole - twice · cos(q₀ - middle), and `outer` where it is straight."""
    middle, half, elbow = course
    if half == 0.0:
        ends = [
            (clamped_acos(whole - least, twice), clamped_acos(whole - most, twice))
            for bent, least, most in sides
            if bent == elbow
        ]
        return [w for near, far in ends for w in ((middle + near, middle + far), (middle - far, middle - near))]
    ends = []  # From the straight elbow to where it is bent least, and most.
    for _, least, most in sides:
        near = acos(min(1.0, clamped_acos(whole - most, twice) / half)) if most < outer else 0.0
        ends.append((near, acos(min(1.0, clamped_acos(whole - least, twice) / half))))
    near, far = ends[0]
    if len(ends) == 2:
        first, last = (-ends[1][1], far), (pi - far, pi + ends[1][1])
    elif sides[0].elbow > 0.0:
        first, last = (near, far), (pi - far, pi - near)
    else:
        first, last = (-far, -near), (pi + near, pi + far)
    return [(first[0], last[1])] if first[1] >= last[0] else [first, last]


def turned_inside(course: Course, only: Interval) -> list[Interval]:
    """τ where q₀ is inside a range."""
    (low, high), (middle, half, _) = only, course
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


def common(first: Sequence[Interval], second: Sequence[Interval]) -> list[Interval]:
    """What is in both, points and next to nothing beside them included."""
    found = []
    for a, b in first:
        for c, d in second:
            low, high = (c if c > a else a), (d if d < b else b)
            if high - low > -BESIDE:
                found.append((low, high) if high > low else (high, low))
    return found


def clamped_acos(along: float, twice: float) -> float:
    """acos(along / twice), rad: zero or π beyond the ends."""
    return 0.0 if along >= twice else pi if along <= -twice else acos(along / twice)
