"""Position alone leaves a finger one freedom: the postures that reach a point form a curve, cut by the joints' limits.

The curve is run through by an angle, φ of a finger and q₀ of the thumb. Where the elbow can be straight that angle goes
to and fro between the two places at which it is: as middle - half · cos τ, once with the elbow bent to either side, and
the joints go evenly with τ. Where it cannot, there are two curves, and τ is the angle itself.
"""

from __future__ import annotations

from collections.abc import Callable
from math import acos, ceil, pi
from typing import NamedTuple, TypeAlias

Posture: TypeAlias = tuple[float, float, float, float]
"""Joints from the palm outward, rad."""
Moving: TypeAlias = tuple[float, float, float, float, float, float, float, float]
"""A posture, and the rate of each joint by τ."""
Way: TypeAlias = Callable[[float], Moving]
"""From τ to the posture there."""


class Course(NamedTuple):
    """How the angle depends on τ, rad."""

    middle: float
    half: float
    """Zero where τ is the angle itself."""
    elbow: float
    """Then its sign, +1 or -1; +1 otherwise."""

    def tau(self, angle: float, elbow: float) -> float:
        """τ, within π of zero, or of the middle where it is the angle."""
        angle = near_turn(angle, self.middle)
        if self.half == 0.0:
            return angle
        turn = acos(min(1.0, max(-1.0, (self.middle - angle) / self.half)))
        return turn if elbow >= 0.0 else -turn


class Piece(NamedTuple):
    """A part of the curve, from one τ to another."""

    at: Way
    low: float
    high: float
    middle: Moving
    """Half way."""

    def knots(self, step: float) -> list[tuple[float, Moving]]:
        """τ in ascending order, no further apart than a step if not half as far as it is long, and the postures."""
        at, low, high, middle = self
        wide = high - low
        if wide <= 2.0 * step:
            return [(low, at(low)), (low + wide / 2.0, middle), (high, at(high))]
        count = 2 * ceil(wide / (2.0 * step))
        taus = [low + wide * k / count for k in range(count + 1)]
        return [(tau, middle if 2 * k == count else at(tau)) for k, tau in enumerate(taus)]


class Curve(NamedTuple):
    """The postures that reach one point, inside the limits."""

    pieces: list[Piece]
    ends: list[Posture]
    """At the ends of pieces, and those that have none beside them."""


def near_turn(angle: float, middle: float) -> float:
    """The same angle within π of `middle`, rad, for angles within three half turns of it."""
    if angle > middle + pi:
        return angle - 2 * pi
    return angle + 2 * pi if angle < middle - pi else angle
