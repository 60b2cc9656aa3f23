"""The nearest point that an index, middle or ring finger can reach: the edge of its plane is made of arcs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import acos, atan2, cos, hypot, inf, sin, sqrt

from allegro_twin.kinematics.closed_form.forms.maths import FLOATS
from allegro_twin.kinematics.closed_form.forms.planar import TOLERANCE, bend, pair_of
from allegro_twin.kinematics.closed_form.search.arcs import Arc, bends, edge, nearest_of
from allegro_twin.kinematics.closed_form.search.curve import Posture
from allegro_twin.kinematics.closed_form.search.finger_curve import FingerFamily
from allegro_twin.kinematics.closed_form.search.nearest import InPlane, full_turns, swung


class FingerNearest:
    """Inside one set of limits. Targets are x, y, z in the base frame at joint 1, m."""

    def __init__(
        self, links: tuple[float, ...], low: Sequence[float], high: Sequence[float], family: FingerFamily | None
    ) -> None:
        """Without a family of curves, which needs narrower ones, limits are a full turn."""
        self._links, self._low, self._high = links, low, high
        self._pair = pair_of(links[0], links[1])
        self._edge = edge(links, low[1:], high[1:])
        self._middles = [(a + b) / 2 for a, b in zip(low, high, strict=True)]
        self._family = family
        first, second, _ = links
        self._first = [(q1, first * sin(q1), first * cos(q1)) for q1 in (low[1], high[1])]
        ends = [(q2, first + second * cos(q2), second * sin(q2)) for q2 in bends(low[2], high[2])]
        self._second = [(q2, hypot(along, aside), atan2(aside, along)) for q2, along, aside in ends]

    def at(self, x: float, y: float, z: float, pitch: float | None) -> tuple[float, Posture | None]:
        """The least distance, m, and the posture that has it; inf and none where none has the pitch."""

        def reach(r: float, h: float) -> InPlane:
            return self._anyhow(r, h) if pitch is None else self._with(pitch, r, h)

        square, q0, joints = swung(x, y, self._low[0], self._high[0], reach, z)
        return (sqrt(square), (q0, *joints)) if joints else (inf, None)  # type: ignore[return-value]  # Three joints.

    def _anyhow(self, r: float, h: float) -> InPlane:
        if self._family is None:
            posture = self._freely(r, h)
        else:
            curve = self._family.through(0.0, r, h)
            postures = [piece.middle[:4] for piece in curve.pieces] or curve.ends
            posture = postures[0][1:] if postures else ()
        return (0.0, posture) if posture else nearest_of(self._edge, r, h)

    def _freely(self, r: float, h: float) -> tuple[float, ...]:
        """Without limits: the last link as nearly in line with the target as the other two let it."""
        tip, square = self._links[2], r * r + h * h
        twice = 2.0 * tip * sqrt(square)
        least, most = (square + tip * tip - bound for bound in (self._pair.outer, self._pair.inner))
        if least > twice or most < -twice or twice == 0.0:
            return ()
        pitch = atan2(r, h) + acos(min(1.0, most / twice))
        return next(self._bent(r - tip * sin(pitch), h - tip * cos(pitch), pitch), ())

    def _bent(self, r: float, h: float, pitch: float) -> Iterator[tuple[float, float, float]]:
        """The first two links to a point, with either elbow, inside the limits."""
        half, lead, hole = bend(FLOATS, r * r + h * h, self._pair)
        if hole == 0.0:
            towards = atan2(r, h)
            for first, second in ((towards - lead, half + half), (towards + lead, -half - half)):
                free = first, second, pitch - first - second
                q1, q2, q3 = (FLOATS.turned(a, b) for a, b in zip(free, self._middles[1:], strict=True))
                if all(a <= b <= c for a, b, c in zip(self._low[1:], (q1, q2, q3), self._high[1:], strict=True)):
                    yield q1, q2, q3

    def _with(self, pitch: float, r: float, h: float) -> InPlane:
        """With q₁ + q₂ + q₃ held the first two links reach for what is the last link less."""
        tip, least = self._links[2], inf
        best: tuple[float, ...] = ()
        low, high = sum(self._low[1:]) - TOLERANCE, sum(self._high[1:]) + TOLERANCE
        for phi in full_turns(pitch, low, high):
            a, b = r - tip * sin(phi), h - tip * cos(phi)
            direct = next(self._bent(a, b, phi), None)
            if direct is not None:
                return 0.0, direct
            square, found = nearest_of(self._held(phi), a, b)
            if square < least:
                # Of the first link's angle and what arcs end with: the second's, or the direction of both.
                q1, other, direction = found
                q2 = other - q1 if direction else other
                least, best = square, (q1, q2, phi - q1 - q2)
        return least, best

    def _held(self, phi: float) -> list[Arc]:
        """The edge of what the first two links reach while q₃ = φ - q₁ - q₂ is inside its limits.

        Of the joints of an arc the first is q₁. The second is q₂; or, where a one follows, q₁ + q₂.
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
