"""What has no closed form, for one target of one finger of the right hand inside one set of limits."""

from __future__ import annotations

from collections.abc import Sequence
from math import asin, atan2, cos, inf, pi, sin
from typing import Protocol

from allegro_twin.kinematics.closed_form.forms.maths import FLOATS
from allegro_twin.kinematics.closed_form.search.choose import STEP, cheapest, nearest_to, turned_to
from allegro_twin.kinematics.closed_form.search.curve import Curve, Posture
from allegro_twin.kinematics.closed_form.search.finger_curve import FingerFamily
from allegro_twin.kinematics.closed_form.search.nearest import Mode
from allegro_twin.kinematics.closed_form.search.nearest_finger import FingerNearest
from allegro_twin.kinematics.closed_form.search.nearest_thumb import ThumbNearest
from allegro_twin.kinematics.closed_form.search.room import Limits, roomiest
from allegro_twin.kinematics.closed_form.search.thumb_curve import ThumbFamily

_FINE = 0.25  # rad of τ between two knots, where an orientation is so far off that any posture may be the nearest.


class Search(Protocol):
    """Targets are x, y, z, m, in the frame of the chain."""

    def preferred(self, x: float, y: float, z: float, near: Sequence[float] | None) -> Posture | None:
        """The posture that reaches it nearest to another, or furthest from every limit; None where none reaches it."""
        ...

    def turned(self, x: float, y: float, z: float, view: tuple[float, ...], angle: float) -> Posture | None:
        """Of those that reach it the one turned nearest to an orientation; one is known to be off by an angle, rad."""
        ...

    def nearest(self, x: float, y: float, z: float, mode: Mode, angle: float) -> tuple[float, Posture | None]:
        """The posture that comes nearest to it, and how near, m; inf and None where none has the angle of the mode."""
        ...


class FingerSearch:
    """An index, middle or ring finger."""

    def __init__(self, links: tuple[float, ...], low: Sequence[float], high: Sequence[float]) -> None:
        self._low, self._high = low, high
        self._family = FingerFamily(links, low, high)
        free = high[1] - low[1] >= pi  # Without limits there are no ends of curves.
        # What q₀ leaves follows from the place alone, and is none of the choice.
        self._limits: Limits = (-inf, inf, low[1], high[1], low[2], high[2], low[3], high[3])
        self._nearest = FingerNearest(links, low, high, None if free else self._family)

    def preferred(self, x: float, y: float, z: float, near: Sequence[float] | None) -> Posture | None:
        curve = self._curve(x, y, z, near[0] if near else 0.0)
        if curve is None:
            return None
        return roomiest(curve, self._limits)[1] if near is None else cheapest(curve, nearest_to(near))[1]

    def turned(self, x: float, y: float, z: float, view: tuple[float, ...], angle: float) -> Posture | None:
        """The angle grows with the way from the best pitch, so the least is where that ends: at limits, or straight."""
        curve = self._curve(x, y, z, atan2(-view[1], view[4]))
        if curve is None:
            return None
        ends = curve.ends
        for piece in curve.pieces:
            ends = [*ends, *(piece.at(k * pi)[:4] for k in (-1, 0, 1, 2) if piece.low < k * pi < piece.high)]
        if not ends:
            return None
        c, s = cos(ends[0][0]), sin(ends[0][0])
        across, along = c * view[2] + s * view[5] - view[6], c * view[0] + s * view[3] + view[8]

        def agreement(q: Posture) -> float:
            pitch = q[1] + q[2] + q[3]
            return across * sin(pitch) + along * cos(pitch)

        return max(ends, key=agreement)

    def nearest(self, x: float, y: float, z: float, mode: Mode, angle: float) -> tuple[float, Posture | None]:
        return self._nearest.at(x, y, z, angle if mode == "pitch" else None)

    def _curve(self, x: float, y: float, z: float, free: float) -> Curve | None:
        """With q₀ where it is free: on the abduction axis."""
        low, high = self._low[0], self._high[0]
        plane = self._family.plane(x, y, min(high, max(low, FLOATS.turned(free, (low + high) / 2))))
        return None if plane is None else self._family.through(*plane, z)


class ThumbSearch:
    """The thumb."""

    def __init__(
        self, links: tuple[float, ...], aside: float, up: float, low: Sequence[float], high: Sequence[float]
    ) -> None:
        self._low, self._high = low, high
        self._family = ThumbFamily(links, aside, up, low, high)
        self._limits: Limits = (low[0], high[0], low[1], high[1], low[2], high[2], low[3], high[3])
        self._nearest = ThumbNearest(links, aside, up, low, high)

    def preferred(self, x: float, y: float, z: float, near: Sequence[float] | None) -> Posture | None:
        def chosen(curve: Curve) -> Posture | None:
            return (roomiest(curve, self._limits) if near is None else cheapest(curve, nearest_to(near)))[1]

        free = (self._low[1] + self._high[1]) / 2 if near is None else near[1]
        return self._family.best(chosen, (x, y, z), free)

    def turned(self, x: float, y: float, z: float, view: tuple[float, ...], angle: float) -> Posture | None:
        """The tip's y axis lies at longitude -q₀ about x: so q₀ is no further from the wanted than the angle allows."""
        value = turned_to(view)
        only = self._interval(view, angle)
        step = _FINE if only is None else STEP
        return self._family.best(lambda curve: cheapest(curve, value, step)[1], (x, y, z), view[1], only)

    def _interval(self, view: tuple[float, ...], angle: float) -> tuple[float, float] | None:
        if angle >= pi / 2:
            return None
        part = sin(angle) / cos(view[1])
        if part >= 1.0:
            return None
        turn, off = FLOATS.turned(view[0], (self._low[0] + self._high[0]) / 2), asin(part)
        return max(self._low[0], turn - off), min(self._high[0], turn + off)

    def nearest(self, x: float, y: float, z: float, mode: Mode, angle: float) -> tuple[float, Posture | None]:
        return self._nearest.at(x, y, z, mode, angle)
