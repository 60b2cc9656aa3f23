"""The curve of all postures that reach one point: position alone leaves a finger one freedom.

The curve has an angle as its parameter: φ = q₁ + q₂ + q₃ of a finger, q₀ of the thumb. Where the elbow can be straight,
that angle goes to and fro between the two places at which it is: angle = middle - half · cos τ, with the elbow bent to
one side on the way there and to the other on the way back, and the joints depend smoothly on τ. Where the elbow cannot
be straight, there are two curves, and τ is the angle itself. Joint limits cut the curve into segments.
"""

from __future__ import annotations

from collections.abc import Callable
from math import acos, ceil, pi
from typing import NamedTuple, TypeAlias

Posture: TypeAlias = tuple[float, float, float, float]
"""Joints from the palm outward, rad."""
PostureRates: TypeAlias = tuple[float, float, float, float, float, float, float, float]
"""A posture, and the derivative of each joint by τ."""
PostureAt: TypeAlias = Callable[[float], PostureRates]
"""From τ to the posture there."""


class CurveParameter(NamedTuple):
    """Dependence of the angle on τ, rad."""

    middle: float
    half: float
    """Zero where τ is the angle itself."""
    elbow: float
    """Where τ is the angle itself, the sign of the elbow, +1 or -1; +1 otherwise."""

    def tau(self, angle: float, elbow: float) -> float:
        """τ at an angle, within π of zero, or of the middle where τ is the angle."""
        angle = near_turn(angle, self.middle)
        if self.half == 0.0:
            return angle
        turn = acos(min(1.0, max(-1.0, (self.middle - angle) / self.half)))
        return turn if elbow >= 0.0 else -turn


class Segment(NamedTuple):
    """A part of the curve, from one τ to another."""

    at: PostureAt
    low: float
    high: float
    middle: PostureRates
    """Half way."""

    def knots(self, step: float) -> list[tuple[float, PostureRates]]:
        """Ascending τ, at most a step apart (two intervals at least), and the postures there."""
        at, low, high, middle = self
        wide = high - low
        if wide <= 2.0 * step:
            return [(low, at(low)), (low + wide / 2.0, middle), (high, at(high))]
        count = 2 * ceil(wide / (2.0 * step))
        taus = [low + wide * k / count for k in range(count + 1)]
        return [(tau, middle if 2 * k == count else at(tau)) for k, tau in enumerate(taus)]


class PostureCurve(NamedTuple):
    """The postures that reach one point, inside the limits."""

    segments: list[Segment]
    ends: list[Posture]
    """At the ends of segments, and single postures beside which there are no others."""


def near_turn(angle: float, middle: float) -> float:
    """Equivalent angle within π of `middle`, rad, for angles within three half turns of it."""
    if angle > middle + pi:
        return angle - 2 * pi
    return angle + 2 * pi if angle < middle - pi else angle
