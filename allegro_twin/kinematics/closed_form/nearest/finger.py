"""The nearest point that an index, middle or ring finger can reach inside one set of limits."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import acos, atan2, cos, hypot, inf, sin, sqrt

from allegro_twin.kinematics.closed_form.forms.two_links import TOLERANCE, bend, two_links_of
from allegro_twin.kinematics.closed_form.nearest.plane import (
    Arc,
    PlaneResult,
    boundary_angles,
    boundary_arcs,
    full_turns,
    nearest_by_turning,
    nearest_on_arcs,
)
from allegro_twin.kinematics.closed_form.redundancy.curve import Posture
from allegro_twin.kinematics.closed_form.redundancy.finger import FingerRedundancy
from allegro_twin.kinematics.closed_form.targets import Mode
from allegro_twin.kinematics.maths import FLOATS


class FingerNearest:
    """Targets are x, y, z, m, in the base frame at joint 1."""

    def __init__(
        self, links: tuple[float, ...], low: Sequence[float], high: Sequence[float], reached: FingerRedundancy | None
    ) -> None:
        """`reached` finds the postures that reach a point; None where every joint may turn once: then the curve of them
        has no ends to find them by."""
        self._links, self._low, self._high = links, low, high
        self._pair = two_links_of(links[0], links[1])
        self._boundary = boundary_arcs(links, low[1:], high[1:])
        self._middles = [(a + b) / 2 for a, b in zip(low, high, strict=True)]
        self._reached = reached
        first, second, _ = links
        self._first = [(q1, first * sin(q1), first * cos(q1)) for q1 in (low[1], high[1])]
        ends = [(q2, first + second * cos(q2), second * sin(q2)) for q2 in boundary_angles(low[2], high[2])]
        self._second = [(q2, hypot(along, aside), atan2(aside, along)) for q2, along, aside in ends]

    def nearest(self, x: float, y: float, z: float, mode: Mode, angle: float) -> tuple[float, Posture | None]:
        """The least distance, m, and its posture, with the pitch held or free; inf and None if none has the pitch."""

        def search(r: float, h: float) -> PlaneResult:
            return self._with_pitch(angle, r, h) if mode == "pitch" else self._with_any_pitch(r, h)

        square, q0, joints = nearest_by_turning(x, y, self._low[0], self._high[0], search, z)
        return (sqrt(square), (q0, *joints)) if joints else (inf, None)  # type: ignore[return-value]  # Three joints.

    def _with_any_pitch(self, r: float, h: float) -> PlaneResult:
        if self._reached is None:
            posture = self._without_limits(r, h)
        else:
            curve = self._reached.curve(0.0, r, h)
            postures = [segment.middle[:4] for segment in curve.segments] or curve.ends
            posture = postures[0][1:] if postures else ()
        return (0.0, posture) if posture else nearest_on_arcs(self._boundary, r, h)

    def _without_limits(self, r: float, h: float) -> tuple[float, ...]:
        """q₁, q₂, q₃ that reach a point, the last link as nearly in line with it as the other two allow."""
        tip, square = self._links[2], r * r + h * h
        twice = 2.0 * tip * sqrt(square)
        least, most = (square + tip * tip - bound for bound in (self._pair.outer, self._pair.inner))
        if least > twice or most < -twice or twice == 0.0:
            return ()
        pitch = atan2(r, h) + acos(min(1.0, most / twice))
        return next(self._two_links_to(r - tip * sin(pitch), h - tip * cos(pitch), pitch), ())

    def _two_links_to(self, r: float, h: float, pitch: float) -> Iterator[tuple[float, float, float]]:
        """q₁, q₂, q₃ that bring the end of the first two links to a point with a pitch, inside the limits."""
        half, lead, hole = bend(FLOATS, r * r + h * h, self._pair)
        if hole == 0.0:
            towards = atan2(r, h)
            for first, second in ((towards - lead, half + half), (towards + lead, -half - half)):
                free = first, second, pitch - first - second
                q1, q2, q3 = (FLOATS.wrap(a, b) for a, b in zip(free, self._middles[1:], strict=True))
                if all(a <= b <= c for a, b, c in zip(self._low[1:], (q1, q2, q3), self._high[1:], strict=True)):
                    yield q1, q2, q3

    def _with_pitch(self, pitch: float, r: float, h: float) -> PlaneResult:
        """With q₁ + q₂ + q₃ held the first two links reach for the target less the last link."""
        tip, least = self._links[2], inf
        best: tuple[float, ...] = ()
        low, high = sum(self._low[1:]) - TOLERANCE, sum(self._high[1:]) + TOLERANCE
        for phi in full_turns(pitch, low, high):
            a, b = r - tip * sin(phi), h - tip * cos(phi)
            direct = next(self._two_links_to(a, b, phi), None)
            if direct is not None:
                return 0.0, direct
            square, found = nearest_on_arcs(self._boundary_with_pitch(phi), a, b)
            if square < least:
                q1, other, is_direction = found
                q2 = other - q1 if is_direction else other
                least, best = square, (q1, q2, phi - q1 - q2)
        return least, best

    def _boundary_with_pitch(self, phi: float) -> list[Arc]:
        """The boundary of what the first two links reach while q₃ = φ - q₁ - q₂ is inside its limits.

        The joints of an arc are q₁, q₂ and a zero; or q₁, the second link's direction q₁ + q₂, and a one.
        """
        (_, l1, l2, l3), (_, h1, h2, h3), (first, second, _) = self._low, self._high, self._links
        least, most = phi - h3, phi - l3  # Of the direction of the second link.
        arcs: list[Arc] = []
        for q1, r, h in self._first:
            low, high = max(q1 + l2, least), min(q1 + h2, most)
            if low <= high + TOLERANCE:
                arcs.append((r, h, second, 0.0, low, max(low, high), 1, (q1, 1.0)))
        for q2, length, lean in self._second:
            low, high = max(l1, least - q2), min(h1, most - q2)
            if low <= high + TOLERANCE:
                arcs.append((0.0, 0.0, length, lean, low, max(low, high), 0, (q2, 0.0)))
        for towards in (least, most):
            low, high = max(l1, towards - h2), min(h1, towards - l2)
            if low <= high + TOLERANCE:
                r, h = second * sin(towards), second * cos(towards)
                arcs.append((r, h, first, 0.0, low, max(low, high), 0, (towards, 1.0)))
        return arcs
