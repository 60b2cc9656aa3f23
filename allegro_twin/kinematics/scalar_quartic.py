"""`quartic.solve_fixed_bend` on plain numbers: roots between two bends, bracketed by those of the derivatives."""

from __future__ import annotations

from math import atan, atan2, copysign, cos, hypot, inf, sin, sqrt, tan

from allegro_twin.kinematics.planar import TOUCH

Root = tuple[float, float, float]
"""θ, q₀, q₁, rad."""
_POLISHES = 6


def solve_fixed_bend(
    dx: float, y: float, z: float, ay: float, length: float, e: float, g: float, low: float, high: float
) -> list[Root]:
    """The solutions with θ in [low, high], rad, within ±3 rad; lengths m. The equations are those of `quartic`."""
    k0 = y * y + z * z - ay * ay + dx * dx - length * length - e * e - g * g
    k = (k0 + 2 * length * g, -4 * length * e, k0 - 2 * length * g)
    c = [
        a - 4 * ay * ay * (b - dx * dx * w)
        for a, b, w in zip(_square(k), _square((e, 2 * length, e)), (1.0, 0.0, 2.0, 0.0, 1.0), strict=True)
    ]
    found: list[Root] = []
    for u in _starts(c, tan(low / 2) - 1e-6, tan(high / 2) + 1e-6):
        root = _polished(2 * atan(u), k0, dx, y, z, ay, length, e, g)
        if root is None:
            continue
        new = all(abs(sin((root[0] - o[0]) / 2)) + abs(sin((root[2] - o[2]) / 2)) >= 1e-10 for o in found)
        if new:
            found.append(root)
    return found


def _square(p: tuple[float, float, float]) -> tuple[float, ...]:
    a, b, c = p
    return a * a, 2 * a * b, b * b + 2 * a * c, 2 * b * c, c * c


def _starts(c: list[float], low: float, high: float) -> list[float]:
    """Where the quartic changes sign, and its extrema, where rounding may hide a pair of roots."""
    cubic = [4 * c[0], 3 * c[1], 2 * c[2], c[3]]
    bends = _quadratic(3 * cubic[0], 2 * cubic[1], cubic[2])
    extrema = _crossings(cubic, [low, *sorted(u for u in bends if low < u < high), high])
    return [*_crossings(c, [low, *extrema, high]), *extrema]


def _quadratic(a: float, b: float, c: float) -> list[float]:
    square = b * b - 4 * a * c
    if square < 0:
        return []
    q = -(b + copysign(sqrt(square), b)) / 2
    return [v / w for v, w in ((q, a), (c, q)) if w]


def _crossings(c: list[float], knots: list[float]) -> list[float]:
    """One root of a polynomial in every interval at whose ends it has opposite signs, to about 1e-8."""
    found = []
    values = [_value(c, u) for u in knots]
    for k in range(len(knots) - 1):
        a, b, fa, fb = knots[k], knots[k + 1], values[k], values[k + 1]
        if fa * fb > 0:
            continue
        for turn in range(90):  # The Illinois variant of the false position, with a bisection every third turn.
            u = (a + b) / 2 if turn % 3 == 2 or fb == fa else (a * fb - b * fa) / (fb - fa)
            f = _value(c, u)
            if f * fb < 0:
                a, fa = b, fb
            else:
                fa /= 2
            b, fb = u, f
            if abs(a - b) < 1e-8 or f == 0:
                break
        found.append(b)
    return found


def _value(c: list[float], u: float) -> float:
    value = 0.0
    for coefficient in c:
        value = value * u + coefficient
    return value


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
