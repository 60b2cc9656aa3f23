"""The posture of the thumb that is turned nearest to an orientation, near the one that has that orientation's q₀.

With q₀ = q₀* - β and k = tan(β/2), the angle left is a function of k of sums, products and roots alone: no angle is
needed before the best k is known. q₀*, q₁* and ψ* are the orientation's own.
"""

from __future__ import annotations

from math import nan
from typing import Generic, NamedTuple

from allegro_twin.kinematics.closed_form.forms.two_links import TOUCH
from allegro_twin.kinematics.maths import Maths, T

_WIDE = 0.3
"""Sine of the widest β at which a posture in the middle and two at the ends show that there is one minimum."""
_ALIKE = 4.0
"""How many times as steep as the other one half of the slope may be."""
_TOUCHED = TOUCH * TOUCH
_STEPS = 4
_CLOSE = 1e-8


class OrientationSlope(NamedTuple, Generic[T]):
    """The thumb at one k, and how the angle left changes."""

    slope: T
    """Derivative by β of minus the trace of the rotation left."""
    square: T
    """From joint 2 to the tip, m²."""
    growth: T
    """Half the derivative of `square` by β."""


class NearestOrientation(Generic[T]):
    """The postures that reach one point with a positive elbow and cos q₁ > 0."""

    def __init__(
        self,
        m: Maths[T],
        point: tuple[T, T, T],
        view: tuple[T, ...],
        rise: tuple[float, float],
        links: tuple[float, ...],
    ) -> None:
        """A point, m, an orientation (`ThumbForms.view`), the offset and the rise, and both links, m."""
        x, y, z = point
        _, swing, psi, c, s = view
        self._m: Maths[T] = m
        self._rise, self._links = rise, links
        self._point: tuple[T, T, T] = x, c * y - s * z, s * y + c * z
        self._swing: tuple[T, T] = m.circle(swing)
        self._psi: tuple[T, T] = m.circle(psi)

    def nearest(self, angle: T, most: float) -> tuple[T, object]:
        """The k of the posture turned nearest, and whether it is sure to be.

        One posture is known to be off by an angle θ, rad. The tip's y axis lies at longitude -q₀ about x, so sin β is
        at most sin θ / cos q₁*. With d² below `most`, m², no other side or elbow is inside the limits.
        """
        m, cosine = self._m, self._swing[0]
        sine = m.sin(angle) / m.where(cosine > _WIDE, cosine, _WIDE)
        sine = m.where((sine < _WIDE) & (angle < 1.0), sine, nan)
        edge = sine / (1.0 + m.root(1.0 - sine * sine))
        low, middle, high = self._at(-edge), self._at(edge * 0.0), self._at(edge)
        fall, rise = middle.slope - low.slope, high.slope - middle.slope
        sure = (low.slope < 0.0) & (high.slope > 0.0) & (fall < _ALIKE * rise) & (rise < _ALIKE * fall)
        sure = sure & (low.square < most) & (middle.square < most) & (high.square < most)
        sure = sure & ((low.growth <= 0.0) | (high.growth >= 0.0))
        if not m.any(sure):
            return edge, sure
        k, moved = self._flat([(-edge, low.slope), (edge, high.slope), (edge * 0.0, middle.slope)])
        return k, sure & (abs(moved) < _CLOSE) & (abs(k) < edge)

    def _flat(self, places: list[tuple[T, T]]) -> tuple[T, T]:
        """The k at which the slope is zero, by parabolas through its last three values, and the last step."""
        m = self._m
        (a, sa), (b, sb), (c, sc) = places
        first = (sb - sa) / (b - a)
        for step in range(_STEPS):
            apart, wide = c - b, c - a
            done = abs(apart) < _CLOSE  # Others of the batch are not; two slopes as near differ by rounding alone.
            second = m.where(done, first, (sc - sb) / m.where(done, 1.0, apart))
            steep = second + (second - first) * apart / m.where(wide == 0.0, 1.0, wide)
            moved = -sc / m.where(steep > 0.0, steep, nan)
            a, b, c, first, sb = b, c, c + moved, second, sc
            if step == _STEPS - 1 or not m.any(abs(moved) > _CLOSE):
                break
            sc = self._at(c).slope
        return c, moved

    def _at(self, k: T) -> OrientationSlope[T]:
        m, (x, y, z), (aside, up), (link, tip) = self._m, self._point, self._rise, self._links
        cosine, sine = (1.0 - k * k) / (1.0 + k * k), (k + k) / (1.0 + k * k)
        across, above = cosine * y + sine * z, cosine * z - sine * y
        b, h = across - aside, above - up
        flat = x * x + b * b
        r, square = m.copysign(m.root(m.where(flat > _TOUCHED, flat, nan)), x), flat + h * h
        # (sin ψ, cos ψ) is the direction from joint 2 to the tip, turned by the angle from there to the last link.
        along = (square + tip * tip - link * link) / (2.0 * tip * square)
        aslant = m.root(1.0 / square - along * along)
        aslant = m.where(aslant > 0.0, aslant, nan)
        sp, cp = along * r + aslant * h, along * h - aslant * r
        swings = above * x / (r * r)
        bends = (across * (h - tip * cp) - b * above / r * (r - tip * sp)) / (tip * aslant * square)
        slope = self._slope((cosine, sine), (x / r, b / r), (cp, sp), swings, bends)
        return OrientationSlope(slope, square, up * across - aside * above)

    def _slope(self, turn: tuple[T, T], swing: tuple[T, T], psi: tuple[T, T], swings: T, bends: T) -> T:
        """With the cosines and sines of β, q₁ and ψ, and how fast q₁ and ψ go with β: of Rx(β) Rz(q₁) Ry(ψ) and R*."""
        (cb, sb), (c, s), (cp, sp), (cn, sn), (ct, st) = turn, swing, psi, self._swing, self._psi
        cg, sg = cp * ct + sp * st, sp * ct - cp * st
        by_turn = sg * cb * (sn + s) - sb * (cg * (1.0 + sn * s) + cn * c)
        by_swing = c * (cg * sn * cb + sg * sb + sn) - cn * s * (cg + cb)
        by_psi = cg * sb * (sn + s) - sg * (cn * c + sn * cb * s + cb)
        slope: T = -(by_turn + swings * by_swing + bends * by_psi)
        return slope
