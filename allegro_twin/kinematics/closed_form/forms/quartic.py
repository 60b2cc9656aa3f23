"""The thumb with one bending angle fixed: the free one, θ, is a root of a quartic, polished to rounding.

The section is r = ℓ sin θ + e, ζ = G + ℓ cos θ, and the tip before joint 0 is v = (aₓ + r cos q₁, a_y + m, ζ) with
m = r sin q₁. With Δ = pₓ - aₓ, |v|² = |p|² gives 2 a_y m = K(θ) = k₀ - 2ℓ (e sin θ + G cos θ), where
k₀ = p_y² + p_z² - a_y² + Δ² - ℓ² - e² - G²; and r cos q₁ = Δ. Eliminating q₁, f(θ) = m² + Δ² - r² = 0: with θ counted
from the direction of (e, G), where K has no sine, a quartic in u = tan(θ/2).
"""

from __future__ import annotations

from typing import Generic

import numpy as np

from allegro_twin.kinematics.closed_form.forms.two_links import TOUCH
from allegro_twin.kinematics.maths import Maths, T

Direction = tuple[T, T]
"""cos θ and sin θ."""
_POLISHES = 3
_SPLIT = 134217729.0  # 2²⁷ + 1: Veltkamp's split leaves the upper half of a number's digits.
_BESIDE = 1e-7  # m from joint 1's axis; there two roots are nearly one, and Ferrari's are only good to 1e-8 rad.
_AROUND, _STRAIGHT = 1e-5, 1e-6  # rad from the axis: which two they are, and how far K is a line there.
_NEAR = 1e-3  # rad that a start can be from its root; a complex pair is not to wander to another's.
_SAME, _ALIKE = 1e-10, 1e-3  # rad of θ and of q₁ between two roots that are one.
_LEAST = 1e-300


class FixedBend(Generic[T]):
    """A target Δ, y, z, counted from joint 1's axis, m, and ℓ, e, G of the section, m: one of each, or arrays (N,)."""

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
        """θ, q₀, q₁, rad, of at most four branches; NaN where there is none."""
        branches = self._starts()
        if self._m.any(abs(self._dx) < _BESIDE):
            branches = self._beside_axis(branches)
        found: list[tuple[T, T, T]] = []
        done: list[tuple[T, T, T]] = []
        for branch in branches:
            c, s, swing, r = self._polished(branch)
            again = c != c
            for other, aside, then in done:
                alike = (abs(s * other - c * aside) < _SAME) & (c * other + s * aside > 0.0)
                again = again | alike & (abs(swing - then) <= _ALIKE * abs(r))  # Beside the axis q₁ tells two apart.
            done.append((c, s, swing))
            found.append(self._finished(c, s, swing, r, self._m.where(again, np.nan, 0.0)))
        return found

    def _starts(self) -> list[Direction[T]]:
        """Ferrari's roots; of a complex pair the real part."""
        m, length, k0, n = self._m, self._length, self._k0, 4.0 * self._ay * self._ay
        far = m.root(self._e * self._e + self._g * self._g)
        far = m.copysign(m.where(far > _LEAST, far, _LEAST), k0)  # Counted from the side on which the roots are.
        cosine, sine = self._g / far, self._e / far
        # K and r, times 1 + u²: of degree two.
        a, b = k0 - 2.0 * length * far, k0 + 2.0 * length * far
        r0, r1, r2, dd = self._e + length * sine, 2.0 * length * cosine, self._e - length * sine, self._dd
        lead = b * b - n * (r2 * r2 - dd)
        lead = m.where(lead > _LEAST, lead, _LEAST)
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

    def _beside_axis(self, branches: list[Direction[T]]) -> list[Direction[T]]:
        """Better starts where r and Δ are next to nothing: near r = 0 K is a line, and f a hyperbola."""
        m, length = self._m, self._length
        sine = -self._e / length
        for side in (1.0, -1.0):
            cosine = side * m.root(1.0 - sine * sine)
            swing, slope = self._swing(cosine, sine), self._slope(cosine, sine)
            lean = slope * slope - length * length * cosine * cosine
            lean = m.where(abs(lean) > _LEAST, lean, _LEAST)
            part = m.root(length * length * cosine * cosine * (swing * swing + self._dd) - slope * slope * self._dd)
            beside = (abs(self._dx) < _BESIDE) & (abs(swing) < _BESIDE) & (abs(sine) < 1.0)
            step, other = (-swing * slope + part) / lean, (-swing * slope - part) / lean
            moved = []
            for c, s in branches:
                near = beside & (abs(s * cosine - c * sine) < _AROUND) & (c * cosine + s * sine > 0.0)
                near = near & (abs(step) < _STRAIGHT)
                to = _turn(m, cosine, sine, step)
                moved.append((m.where(near, to[0], c), m.where(near, to[1], s)))
                step = m.where(near, other, step)
            branches = moved
        return branches

    def _swing(self, c: T, s: T) -> T:
        """m of θ, m."""
        swing: T = (self._k0 - 2.0 * self._length * (self._e * s + self._g * c)) / (2.0 * self._ay)
        return swing

    def _slope(self, c: T, s: T) -> T:
        """dm/dθ, m."""
        slope: T = (self._g * s - self._e * c) * self._length / self._ay
        return slope

    def _polished(self, branch: Direction[T]) -> tuple[T, T, T, T]:
        """Newton's steps on f, as long as they lead nearer: cos θ, sin θ, m and r."""
        m, (c, s), length, dd = self._m, branch, self._length, self._dd
        swing, r = self._swing(c, s), length * s + self._e
        off = swing * swing + dd - r * r
        for _ in range(_POLISHES):
            slope = 2.0 * (swing * self._slope(c, s) - r * length * c)
            small = abs(off) < _NEAR * abs(slope)
            newer, aside = _turn(m, c, s, -m.where(small, off, 0.0) / m.where(small, slope, 1.0))
            swings, reach = self._swing(newer, aside), length * aside + self._e
            then = swings * swings + dd - reach * reach
            nearer = abs(then) < abs(off)
            if not m.any(nearer):
                break
            c, s, swing = m.where(nearer, newer, c), m.where(nearer, aside, s), m.where(nearer, swings, swing)
            r, off = m.where(nearer, reach, r), m.where(nearer, then, off)
        return c, s, swing, r

    def _finished(self, c: T, s: T, swing: T, r: T, hole: T) -> tuple[T, T, T]:
        """θ, q₀, q₁ where they lead to the target, else NaN."""
        m, along, across, up = self._m, self._dx, self._ay + swing, self._g + self._length * c
        missed = abs(m.root(swing * swing + self._dd) - abs(r)) > TOUCH
        missed |= abs(m.root(across * across + up * up) - m.root(self._square)) > TOUCH
        hole = m.where(missed, np.nan, hole)
        side = m.copysign(1.0 + r * 0.0, r)
        q1 = m.where(abs(r) <= TOUCH, 0.0, m.atan2(side * swing, side * along))  # On the axis every q₁ does.
        q0 = m.atan2(up, across) - m.atan2(self._z, self._y)
        return m.atan2(s, c) + hole, q0 + hole, q1 + hole


def _turn(m: Maths[T], c: T, s: T, angle: T) -> Direction[T]:
    """A direction turned by a small angle, rad."""
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
    v = q / m.where(w > _LEAST, w, np.inf)
    found = []
    for side in (1.0, -1.0):
        part = m.root(-z - 2.0 * p + side * 2.0 * v) / 2.0
        found += [-side * w / 2.0 + part - h, -side * w / 2.0 - part - h]
    return found


def _largest(m: Maths[T], a: T, b: T, c: T) -> T:
    """The largest root of z³ + a z² + b z + c, to rounding; the same digits for a number and for an array."""
    third = a / 3.0
    q, r = third * third - b / 3.0, third * third * third - third * b / 2.0 + c / 2.0
    cube = q * q * q
    three = r * r < cube
    scale = m.root(q)
    ratio = m.where(three, -r / m.where(three, scale * scale * scale, 1.0), 1.0)
    one = -m.copysign(m.cbrt(abs(r) + m.root(r * r - cube)), r)
    one = one + q / m.where(abs(one) > _LEAST, one, np.inf)
    ratio = m.where(abs(ratio) <= 1.0, ratio, m.copysign(1.0 + 0.0 * ratio, ratio))
    z = m.where(three, 2.0 * scale * m.cos(m.acos(ratio) / 3.0), one) - third
    z = _SPLIT * z - (_SPLIT * z - z)  # What an arc cosine and a cube root leave in the last digits goes.
    for _ in range(2):
        slope = (3.0 * z + 2.0 * a) * z + b
        z = z - (((z + a) * z + b) * z + c) / m.where(abs(slope) > _LEAST, slope, np.inf)
    return z
