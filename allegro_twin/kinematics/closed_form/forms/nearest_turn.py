"""The thumb turned nearest to an orientation, close by where it has that orientation's q₀.

With q₀ = q₀* - β and k = tan(β/2), how far it is turned from there is made of sums, products and roots of k: no angle
is needed before the best k is known.
"""

from __future__ import annotations

from math import nan
from typing import Generic, NamedTuple

from allegro_twin.kinematics.closed_form.forms.maths import Maths, T
from allegro_twin.kinematics.closed_form.forms.planar import TOUCH

_WIDE = 0.3
"""The sine of the widest β at which one posture in the middle and two at the ends show that there is one minimum."""
_ALIKE = 4.0
"""So many times may one half of the way rise as steeply as the other."""
_TOUCHED = TOUCH * TOUCH
_STEPS = 4
_CLOSE = 1e-8


class Place(NamedTuple, Generic[T]):
    """The thumb at one k."""

    slope: T
    """Of minus the trace of the rotation left, by β."""
    square: T
    """From joint 2 to the tip, m²."""
    growth: T
    """Half of what that grows, by β."""


class NearestTurn(Generic[T]):
    """The postures that reach one point with a positive elbow and cos q₁ > 0."""

    def __init__(
        self,
        m: Maths[T],
        point: tuple[T, T, T],
        view: tuple[T, ...],
        rise: tuple[float, float],
        links: tuple[float, ...],
    ) -> None:
        """Of a point, m, an orientation as `Thumb.view` has it, and the offset, the rise and both links, m."""
        x, y, z = point
        _, swing, psi, c, s = view
        self._m: Maths[T] = m
        self._rise, self._links = rise, links
        self._point: tuple[T, T, T] = x, c * y - s * z, s * y + c * z
        self._swing: tuple[T, T] = m.circle(swing)
        self._psi: tuple[T, T] = m.circle(psi)

    def nearest(self, angle: T, most: float) -> tuple[T, object]:
        """The k of the posture turned nearest, and whether it is sure to be.

        One is known to be off by an angle, rad, and with d² of less than `most`, m², no other side or elbow will do.
        As the tip's y axis lies at longitude -q₀ about x, sin β is at most sin θ / cos q₁*.
        """
        m, cosine = self._m, self._swing[0]
        sine = m.sin(angle) / m.choose(cosine > _WIDE, cosine, _WIDE)
        sine = m.choose((sine < _WIDE) & (angle < 1.0), sine, nan)
        edge = sine / (1.0 + m.root(1.0 - sine * sine))
        low, middle, high = self._at(-edge), self._at(edge * 0.0), self._at(edge)
        fall, rise = middle.slope - low.slope, high.slope - middle.slope
        sure = (low.slope < 0.0) & (high.slope > 0.0) & (fall < _ALIKE * rise) & (rise < _ALIKE * fall)
        sure = sure & (low.square < most) & (middle.square < most) & (high.square < most)
        sure = sure & ((low.growth <= 0.0) | (high.growth >= 0.0))
        if not m.anywhere(sure):
            return edge, sure
        k, moved = self._flat([(-edge, low.slope), (edge, high.slope), (edge * 0.0, middle.slope)])
        return k, sure & (abs(moved) < _CLOSE) & (abs(k) < edge)

    def _flat(self, places: list[tuple[T, T]]) -> tuple[T, T]:
        """Where the slope is zero, as of the parabola through its last three values each time, and the last step."""
        m = self._m
        (a, sa), (b, sb), (c, sc) = places
        first = (sb - sa) / (b - a)
        for step in range(_STEPS):
            apart, wide = c - b, c - a
            done = abs(apart) < _CLOSE  # Others of the batch are not; two slopes as near differ by rounding alone.
            second = m.choose(done, first, (sc - sb) / m.choose(done, 1.0, apart))
            steep = second + (second - first) * apart / m.choose(wide == 0.0, 1.0, wide)
            moved = -sc / m.choose(steep > 0.0, steep, nan)
            a, b, c, first, sb = b, c, c + moved, second, sc
            if step == _STEPS - 1 or not m.anywhere(abs(moved) > _CLOSE):
                break
            sc = self._at(c).slope
        return c, moved

    def _at(self, k: T) -> Place[T]:
        m, (x, y, z), (aside, up), (link, tip) = self._m, self._point, self._rise, self._links
        cosine, sine = (1.0 - k * k) / (1.0 + k * k), (k + k) / (1.0 + k * k)
        across, above = cosine * y + sine * z, cosine * z - sine * y
        b, h = across - aside, above - up
        flat = x * x + b * b
        r, square = m.copysign(m.root(m.choose(flat > _TOUCHED, flat, nan)), x), flat + h * h
        # (sin ψ, cos ψ) is the direction from joint 2 to the tip, turned by the angle from there to the last link.
        along = (square + tip * tip - link * link) / (2.0 * tip * square)
        aslant = m.root(1.0 / square - along * along)
        aslant = m.choose(aslant > 0.0, aslant, nan)
        sp, cp = along * r + aslant * h, along * h - aslant * r
        swings = above * x / (r * r)
        bends = (across * (h - tip * cp) - b * above / r * (r - tip * sp)) / (tip * aslant * square)
        slope = self._slope((cosine, sine), (x / r, b / r), (cp, sp), swings, bends)
        return Place(slope, square, up * across - aside * above)

    def _slope(self, turn: tuple[T, T], swing: tuple[T, T], psi: tuple[T, T], swings: T, bends: T) -> T:
        """With the cosines and sines of β, q₁ and ψ, and how fast q₁ and ψ go with β: of Rx(β) Rz(q₁) Ry(ψ) and R*."""
        (cb, sb), (c, s), (cp, sp), (cn, sn), (ct, st) = turn, swing, psi, self._swing, self._psi
        cg, sg = cp * ct + sp * st, sp * ct - cp * st
        by_turn = sg * cb * (sn + s) - sb * (cg * (1.0 + sn * s) + cn * c)
        by_swing = c * (cg * sn * cb + sg * sb + sn) - cn * s * (cg + cb)
        by_psi = cg * sb * (sn + s) - sg * (cn * c + sn * cb * s + cb)
        slope: T = -(by_turn + swings * by_swing + bends * by_psi)
        return slope
