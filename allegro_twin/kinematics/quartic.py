"""The thumb with one bend fixed: the free bend θ is a root of a quartic, polished to rounding.

The section is r = ℓ sin θ + e, ζ = G + ℓ cos θ, and the tip before joint 0 is v = (aₓ + r cos q₁, a_y + r sin q₁, ζ).
With Δ = pₓ - aₓ, |v|² = |p|² gives 2 a_y r sin q₁ = K(θ) = k₀ - 2ℓ (e sin θ + G cos θ), where
k₀ = p_y² + p_z² - a_y² + Δ² - ℓ² - e² - G²; and r cos q₁ = Δ. Eliminating q₁, K² = 4 a_y² (r² - Δ²): a quartic in
u = tan(θ/2). Its roots lie in close pairs because a_y is 5 mm, so they are polished in (θ, q₁), where they lie apart.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from allegro_twin.kinematics.planar import TOUCH, Flags
from allegro_twin.types import Array

_POLISHES = 4
_NEARLY_REAL = 1e-3
"""A double root comes out as a pair with an imaginary part of the square root of rounding; the residual decides."""


def solve_fixed_bend(
    dx: Array, y: Array, z: Array, ay: float, length: float | Array, e: Array, g: Array
) -> tuple[Array, Array, Array, Flags]:
    """θ, q₀, q₁ (4, N), rad, and which of the four roots reach the target; inputs (N,), m."""
    k0 = y * y + z * z - ay * ay + dx * dx - length * length - e * e - g * g
    roots = _roots(k0, dx, ay, length, e, g)  # (4, N), complex
    theta = 2 * np.arctan(roots.real)
    r = length * np.sin(theta) + e
    swing = (k0 - 2 * length * (e * np.sin(theta) + g * np.cos(theta))) / (2 * ay)
    q1 = np.arctan2(np.copysign(1.0, r) * swing, np.copysign(1.0, r) * dx)
    off = _off(theta, q1, k0, dx, ay, length, e, g)
    for _ in range(_POLISHES):
        newer = _polished(theta, q1, k0, dx, ay, length, e, g)
        then = _off(*newer, k0, dx, ay, length, e, g)
        nearer = then < off  # Where roots meet, a step from rounding leads anywhere.
        theta, q1 = np.where(nearer, newer[0], theta), np.where(nearer, newer[1], q1)
        off = np.where(nearer, then, off)
    r = length * np.sin(theta) + e
    vy, vz = ay + r * np.sin(q1), g + length * np.cos(theta)
    real = (np.abs(r * np.cos(q1) - dx) <= TOUCH) & (np.abs(np.hypot(vy, vz) - np.hypot(y, z)) <= TOUCH)
    q0 = np.arctan2(vz, vy) - np.arctan2(z, y)
    real &= np.abs(roots.imag) <= _NEARLY_REAL * (1 + np.abs(roots.real))
    return theta, q0, q1, real


def _roots(k0: Array, dx: Array, ay: float, length: float | Array, e: Array, g: Array) -> NDArray[np.complex128]:
    """The roots u = tan(θ/2), complex, shape (4, N), by the eigenvalues of the companion matrix.

    Multiplied by 1 + u², K becomes k(u) and r becomes m(u), of degree two: k² - 4 a_y² (m² - Δ² (1 + u²)²) = 0.
    """
    k = (k0 + 2 * length * g, -4 * length * e, k0 - 2 * length * g)
    m = (e, 2 * length * np.ones_like(e), e)
    one = (1.0, 0.0, 1.0)
    squares = [(a[0] * a[0], 2 * a[0] * a[1], a[1] * a[1] + 2 * a[0] * a[2], 2 * a[1] * a[2], a[2] * a[2])
               for a in (k, m, one)]  # fmt: skip
    c = np.stack([s - 4 * ay * ay * (t - dx * dx * w) for s, t, w in zip(*squares, strict=True)])  # (5, N)
    scale = np.abs(c).max(axis=0)
    c[0] = np.where(np.abs(c[0]) < 1e-14 * scale, 1e-14 * scale + 1e-300, c[0])  # A root at θ = π; polishing mends it.
    companion = np.zeros((c.shape[1], 4, 4))
    companion[:, 0, :] = -(c[1:] / c[0]).T
    companion[:, [1, 2, 3], [0, 1, 2]] = 1.0
    return np.asarray(np.linalg.eigvals(companion).T, dtype=np.complex128)


def _off(theta: Array, q1: Array, k0: Array, dx: Array, ay: float, length: float | Array, e: Array, g: Array) -> Array:
    """How far the two equations are from holding, (4, N), m."""
    st, ct, s1, c1 = np.sin(theta), np.cos(theta), np.sin(q1), np.cos(q1)
    r = length * st + e
    swing = (k0 - 2 * length * (e * st + g * ct)) / (2 * ay) - r * s1
    return np.asarray(np.abs(r * c1 - dx) + np.abs(swing))


def _polished(
    theta: Array, q1: Array, k0: Array, dx: Array, ay: float, length: float | Array, e: Array, g: Array
) -> tuple[Array, Array]:
    """One Newton step on r cos q₁ = Δ and K = 2 a_y r sin q₁, in θ and q₁."""
    st, ct, s1, c1 = np.sin(theta), np.cos(theta), np.sin(q1), np.cos(q1)
    r, dr = length * st + e, length * ct
    f = r * c1 - dx
    w = k0 - 2 * length * (e * st + g * ct) - 2 * ay * r * s1
    f_theta, f_q1 = dr * c1, -r * s1
    w_theta, w_q1 = -2 * length * (e * ct - g * st) - 2 * ay * dr * s1, -2 * ay * r * c1
    det = f_theta * w_q1 - f_q1 * w_theta
    det = np.where(np.abs(det) < 1e-18, np.inf, det)  # Singular: stay.
    step_theta = np.clip((f * w_q1 - f_q1 * w) / det, -0.5, 0.5)
    step_q1 = np.clip((f_theta * w - f * w_theta) / det, -0.5, 0.5)
    return theta - step_theta, q1 - step_q1
