"""`quartic.solve_fixed_bend` on plain numbers: roots between two bends, bracketed by those of the derivatives."""

from __future__ import annotations

from math import atan, atan2, copysign, cos, hypot, inf, sin, sqrt, tan

from allegro_twin.kinematics.planar import TOUCH

Root = tuple[float, float, float]
"""θ, q₀, q₁, rad."""
Quartic = tuple[float, float, float, float, float]
"""Coefficients of a polynomial, the highest power's first."""
_POLISHES = 6
_HIDDEN = 1e-9
"""An extremum this close to zero beside the sum of the coefficients is tried too: a million times their rounding."""


def solve_fixed_bend(
    dx: float, y: float, z: float, ay: float, length: float, e: float, g: float, low: float, high: float
) -> list[Root]:
    """The solutions with θ in [low, high], rad, within ±3 rad; lengths m. The equations are those of `quartic`."""
    k0 = y * y + z * z - ay * ay + dx * dx - length * length - e * e - g * g
    k = (k0 + 2 * length * g, -4 * length * e, k0 - 2 * length * g)
    a, b, n = _square(k), _square((e, 2 * length, e)), 4 * ay * ay
    m = n * dx * dx
    c = (a[0] - n * b[0] + m, a[1] - n * b[1], a[2] - n * b[2] + 2 * m, a[3] - n * b[3], a[4] - n * b[4] + m)
    found: list[Root] = []
    for u in _starts(c, tan(low / 2) - 1e-6, tan(high / 2) + 1e-6):
        root = _polished(2 * atan(u), k0, dx, y, z, ay, length, e, g)
        if root is None:
            continue
        new = all(abs(sin((root[0] - o[0]) / 2)) + abs(sin((root[2] - o[2]) / 2)) >= 1e-10 for o in found)
        if new:
            found.append(root)
    return found


def _square(p: tuple[float, float, float]) -> Quartic:
    a, b, c = p
    return a * a, 2 * a * b, b * b + 2 * a * c, 2 * b * c, c * c


def _starts(c: Quartic, low: float, high: float) -> list[float]:
    """Where the quartic changes sign, and those of its extrema at which rounding may hide a pair of roots."""
    slope: Quartic = (0.0, 4 * c[0], 3 * c[1], 2 * c[2], c[3])
    bends = _quadratic(12 * c[0], 6 * c[1], 2 * c[2])
    extrema = _crossings(slope, [low, *sorted(u for u in bends if low < u < high), high])
    touch = _HIDDEN * sum(map(abs, c))
    return [*_crossings(c, [low, *extrema, high]), *(u for u in extrema if abs(_value(c, u)) <= touch)]


def _quadratic(a: float, b: float, c: float) -> list[float]:
    square = b * b - 4 * a * c
    if square < 0:
        return []
    q = -(b + copysign(sqrt(square), b)) / 2
    return [v / w for v, w in ((q, a), (c, q)) if w]


def _crossings(c: Quartic, knots: list[float]) -> list[float]:
    """One root of a polynomial in every interval at whose ends it has opposite signs."""
    values = [_value(c, u) for u in knots]
    return [
        _crossing(c, knots[k], knots[k + 1], values[k], values[k + 1])
        for k in range(len(knots) - 1)
        if values[k] * values[k + 1] <= 0
    ]


def _crossing(c: Quartic, a: float, b: float, fa: float, fb: float) -> float:
    """The root between a and b, to about 1e-9: Newton's steps, or a bisection where one would leave the bracket."""
    c4, c3, c2, c1, c0 = c
    u = a if fa == fb else (a * fb - b * fa) / (fb - fa)
    for _ in range(100):
        f = (((c4 * u + c3) * u + c2) * u + c1) * u + c0
        slope = ((4 * c4 * u + 3 * c3) * u + 2 * c2) * u + c1
        if (f < 0) == (fb < 0):
            b = u
        else:
            a = u
        newer = u - f / slope if slope else inf
        if not a <= newer <= b:
            newer = (a + b) / 2
        if abs(newer - u) < 1e-9:
            return newer
        u = newer
    return u


def _value(c: Quartic, u: float) -> float:
    return (((c[0] * u + c[1]) * u + c[2]) * u + c[3]) * u + c[4]


def _polished(
    theta: float, k0: float, dx: float, y: float, z: float, ay: float, length: float, e: float, g: float
) -> Root | None:
    """Newton steps on r cos q₁ = Δ and K = 2 a_y r sin q₁; none if they do not end on the target."""
    r = length * sin(theta) + e
    swing = (k0 - 2 * length * (e * sin(theta) + g * cos(theta))) / (2 * ay)
    q1 = atan2(copysign(swing, r * swing), copysign(dx, r * dx))
    best, least = (theta, q1), inf
    for _ in range(_POLISHES):
        st, ct, s1, c1 = sin(theta), cos(theta), sin(q1), cos(q1)
        r, dr = length * st + e, length * ct
        f, w = r * c1 - dx, k0 - 2 * length * (e * st + g * ct) - 2 * ay * r * s1
        off = abs(f) + abs(w / (2 * ay))
        if off >= least:  # At rounding; where roots meet, a step from there leads anywhere.
            break
        best, least = (theta, q1), off
        w_theta, w_q1 = -2 * length * (e * ct - g * st) - 2 * ay * dr * s1, -2 * ay * r * c1
        det = dr * c1 * w_q1 + r * s1 * w_theta
        if abs(det) < 1e-18:
            break
        theta -= min(0.5, max(-0.5, (f * w_q1 + r * s1 * w) / det))
        q1 -= min(0.5, max(-0.5, (dr * c1 * w - f * w_theta) / det))
    theta, q1 = best
    r = length * sin(theta) + e
    vy, vz = ay + r * sin(q1), g + length * cos(theta)
    if abs(r * cos(q1) - dx) > TOUCH or abs(hypot(vy, vz) - hypot(y, z)) > TOUCH:
        return None
    return theta, atan2(vz, vy) - atan2(z, y), q1
