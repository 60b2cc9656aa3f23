"""The thumb with one bend fixed: the free bend θ is a root of a quartic, polished to rounding.

The section is r = ℓ sin θ + e, ζ = G + ℓ cos θ, and the tip before joint 0 is v = (aₓ + r cos q₁, a_y + m, ζ) with
m = r sin q₁. With Δ = pₓ - aₓ, |v|² = |p|² gives 2 a_y m = K(θ) = k₀ - 2ℓ (e sin θ + G cos θ), where
k₀ = p_y² + p_z² - a_y² + Δ² - ℓ² - e² - G²; and r cos q₁ = Δ. Eliminating q₁, f(θ) = m² + Δ² - r² = 0: with θ counted
from the direction of (e, G), where K has no sine, a quartic in u = tan(θ/2).
"""

from __future__ import annotations

from typing import Generic

import numpy as np

from allegro_twin.kinematics.closed_form.forms.maths import Maths, T
from allegro_twin.kinematics.closed_form.forms.planar import TOUCH

Way = tuple[T, T]
"""cos θ and sin θ."""
_POLISHES = 3
_SPLIT = 134217729.0  # 2²⁷ + 1: Veltkamp's split leaves the upper half of a number's digits.
_BESIDE = 1e-7  # m from joint 1's axis; there two roots are nearly one, and Ferrari's are only good to 1e-8 rad.
_AROUND, _STRAIGHT = 1e-5, 1e-6  # rad from the axis: which two they are, and how far K is a line there.
_NEAR = 1e-3  # rad that a start can be from its root; a complex pair is not to wander to another's.
_SAME, _ALIKE = 1e-10, 1e-3  # rad of θ and of q₁ between two roots that are one.
_LEAST = 1e-300


class FixedBend(Generic[T]):
    """A target Δ, y, z from joint 1's axis, and the section ℓ, e, G, m: of one target or of a row for each."""

    def __init__(self, m: Maths[T], target: tuple[T, T, T], ay: float, length: float, e: T, g: T) -> None:
        self._m: Maths[T] = m
        self._ay, self._length = ay, length
        self._dx: T = target[0]
        self._y: T = target[1]
        self._z: T = target[2]
        self._e: T = e
        self._g: T = g
        self._dd: T = self._dx * self._dx
        self._square: T = self._y * self._y + self._z * self._z
        self._k0: T = self._square - ay * ay + self._dd - length * length - e * e - g * g

    def roots(self) -> list[tuple[T, T, T]]:
        """θ, q₀, q₁, rad, of at most four ways; NaN where there is none."""
        ways = self._starts()
        if self._m.anywhere(abs(self._dx) < _BESIDE):
            ways = self._beside_axis(ways)
        found: list[tuple[T, T, T]] = []
        done: list[tuple[T, T, T]] = []
        for way in ways:
            c, s, swing, r = self._polished(way)
            again = c != c
            for other, aside, then in done:
                alike = (abs(s * other - c * aside) < _SAME) & (c * other + s * aside > 0.0)
                again = again | alike & (abs(swing - then) <= _ALIKE * abs(r))  # Beside the axis q₁ tells two apart.
            done.append((c, s, swing))
            found.append(self._finished(c, s, swing, r, self._m.choose(again, np.nan, 0.0)))
        return found

    def _starts(self) -> list[Way[T]]:
        """Ferrari's roots; of a pair that is complex, what is real."""
        m, length, k0, n = self._m, self._length, self._k0, 4.0 * self._ay * self._ay
        far = m.root(self._e * self._e + self._g * self._g)
        far = m.copysign(m.choose(far > _LEAST, far, _LEAST), k0)  # Counted from the side on which the roots are.
        cosine, sine = self._g / far, self._e / far
        # K and r, times 1 + u²: of degree two.
        a, b = k0 - 2.0 * length * far, k0 + 2.0 * length * far
        r0, r1, r2, dd = self._e + length * sine, 2.0 * length * cosine, self._e - length * sine, self._dd
        lead = b * b - n * (r2 * r2 - dd)
        lead = m.choose(lead > _LEAST, lead, _LEAST)
        found = []
        for u in _quartic(
            m,
            -2.0 * n * r1 * r2 / lead,
            (2.0 * a * b - n * (r1 * r1 + 2.0 * r0 * r2 - 2.0 * dd)) / lead,
            -2.0 * n * r0 * r1 / lead,
            (a * a - n * (r0 * r0 - dd)) / lead,
        ):
            square = u * u
            whole = 1.0 + square
            c, s = (1.0 - square) / whole, (u + u) / whole
            found.append((c * cosine - s * sine, s * cosine + c * sine))
        return found

    def _beside_axis(self, ways: list[Way[T]]) -> list[Way[T]]:
        """Where r and Δ are next to nothing, the roots next to r = 0: there K is a line, and f a hyperbola."""
        m, length = self._m, self._length
        sine = -self._e / length
        for side in (1.0, -1.0):
            cosine = side * m.root(1.0 - sine * sine)
            swing, slope = self._swing(cosine, sine), self._slope(cosine, sine)
            lean = slope * slope - length * length * cosine * cosine
            lean = m.choose(abs(lean) > _LEAST, lean, _LEAST)
            part = m.root(length * length * cosine * cosine * (swing * swing + self._dd) - slope * slope * self._dd)
            beside = (abs(self._dx) < _BESIDE) & (abs(swing) < _BESIDE) & (abs(sine) < 1.0)
            step, other = (-swing * slope + part) / lean, (-swing * slope - part) / lean
            moved = []
            for c, s in ways:
                near = beside & (abs(s * cosine - c * sine) < _AROUND) & (c * cosine + s * sine > 0.0)
                near = near & (abs(step) < _STRAIGHT)
                to = _turned(m, cosine, sine, step)
                moved.append((m.choose(near, to[0], c), m.choose(near, to[1], s)))
                step = m.choose(near, other, step)
            ways = moved
        return ways

    def _swing(self, c: T, s: T) -> T:
        """m of θ, m."""
        swing: T = (self._k0 - 2.0 * self._length * (self._e * s + self._g * c)) / (2.0 * self._ay)
        return swing

    def _slope(self, c: T, s: T) -> T:
        """dm/dθ, m."""
        slope: T = (self._g * s - self._e * c) * self._length / self._ay
        return slope

    def _polished(self, way: Way[T]) -> tuple[T, T, T, T]:
        """Newton's steps on f, as long as they lead nearer: cos θ, sin θ, m and r."""
        m, (c, s), length, dd = self._m, way, self._length, self._dd
        swing, r = self._swing(c, s), length * s + self._e
        off = swing * swing + dd - r * r
        for _ in range(_POLISHES):
            slope = 2.0 * (swing * self._slope(c, s) - r * length * c)
            small = abs(off) < _NEAR * abs(slope)
            newer, aside = _turned(m, c, s, -m.choose(small, off, 0.0) / m.choose(small, slope, 1.0))
            swings, reach = self._swing(newer, aside), length * aside + self._e
            then = swings * swings + dd - reach * reach
            nearer = abs(then) < abs(off)
            if not m.anywhere(nearer):
                break
            c, s, swing = m.choose(nearer, newer, c), m.choose(nearer, aside, s), m.choose(nearer, swings, swing)
            r, off = m.choose(nearer, reach, r), m.choose(nearer, then, off)
        return c, s, swing, r

    def _finished(self, c: T, s: T, swing: T, r: T, hole: T) -> tuple[T, T, T]:
        """All three angles, if they lead to the target."""
        m, along, across, up = self._m, self._dx, self._ay + swing, self._g + self._length * c
        missed = abs(m.root(swing * swing + self._dd) - abs(r)) > TOUCH
        missed |= abs(m.root(across * across + up * up) - m.root(self._square)) > TOUCH
        hole = m.choose(missed, np.nan, hole)
        side = m.copysign(1.0 + r * 0.0, r)
        q1 = m.choose(abs(r) <= TOUCH, 0.0, m.atan2(side * swing, side * along))  # On the axis every q₁ does.
        q0 = m.atan2(up, across) - m.atan2(self._z, self._y)
        return m.atan2(s, c) + hole, q0 + hole, q1 + hole


def _turned(m: Maths[T], c: T, s: T, angle: T) -> Way[T]:
    """A direction turned by a small angle."""
    length = m.root(1.0 + angle * angle)
    return (c - s * angle) / length, (s + c * angle) / length


def _quartic(m: Maths[T], b: T, c: T, d: T, e: T) -> list[T]:
    """The roots of u⁴ + b u³ + c u² + d u + e; of a complex pair the real part, twice."""
    h = b / 4.0
    p = c - 6.0 * h * h
    q = d - 2.0 * c * h + 8.0 * h * h * h
    r = e - d * h + c * h * h - 3.0 * h * h * h * h
    z = _largest(m, 2.0 * p, p * p - 4.0 * r, -q * q)
    w = m.root(z)
    v = q / m.choose(w > _LEAST, w, np.inf)
    found = []
    for side in (1.0, -1.0):
        part = m.root(-z - 2.0 * p + side * 2.0 * v) / 2.0
        found += [-side * w / 2.0 + part - h, -side * w / 2.0 - part - h]
    return found


def _largest(m: Maths[T], a: T, b: T, c: T) -> T:
    """The largest root of z³ + a z² + b z + c, to rounding, by the same digits for a number and an array."""
    third = a / 3.0
    q, r = third * third - b / 3.0, third * third * third - third * b / 2.0 + c / 2.0
    cube = q * q * q
    three = r * r < cube
    scale = m.root(q)
    ratio = m.choose(three, -r / m.choose(three, scale * scale * scale, 1.0), 1.0)
    one = -m.copysign(m.cbrt(abs(r) + m.root(r * r - cube)), r)
    one = one + q / m.choose(abs(one) > _LEAST, one, np.inf)
    ratio = m.choose(abs(ratio) <= 1.0, ratio, m.copysign(1.0 + 0.0 * ratio, ratio))
    z = m.choose(three, 2.0 * scale * m.cos(m.acos(ratio) / 3.0), one) - third
    z = _SPLIT * z - (_SPLIT * z - z)  # What an arc cosine and a cube root leave in the last digits goes.
    for _ in range(2):
        slope = (3.0 * z + 2.0 * a) * z + b
        z = z - (((z + a) * z + b) * z + c) / m.choose(abs(slope) > _LEAST, slope, np.inf)
    return z
