"""Two links in a plane: the one inverse problem that every closed form here comes down to."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from allegro_twin.kinematics.maths import Maths, T

TOUCH = 1e-13
"""A target this far outside the workspace counts as on its border, m: far above rounding, far below any use."""
TOLERANCE = 1e-9
"""A joint this far beyond its limit counts as on it, rad: the same as `HandSpec.posture`."""
_LEAST = 1e-300
Branch = tuple[T, T, T, T]
"""The joints of one way to reach a target, rad; NaN where there is none."""


class TwoLinks(NamedTuple):
    """Two links, the first at `towards` ∓ `lead` from h towards r, the second turned by ± the elbow ε from it."""

    even: float
    """(l₁ - l₂) / (l₁ + l₂)."""
    inner: float
    """(l₁ - l₂)², m²."""
    outer: float
    """(l₁ + l₂)², m²."""
    below: float
    """The least d² that counts as reached, m²."""
    above: float
    """The most."""


def two_links_of(first: float, second: float) -> TwoLinks:
    """Two links, m."""
    total, apart = first + second, abs(first - second)
    inner, outer = apart * apart, total * total
    return TwoLinks((first - second) / total, inner, outer, inner - 2 * apart * TOUCH, outer + 2 * total * TOUCH)


def bend(m: Maths[T], square: T, pair: TwoLinks) -> tuple[T, T, T]:
    """ε/2 and the lead λ of two links whose ends are √square apart, rad, and zero, or NaN where they cannot be.

    tan(ε/2) = √((outer - d²) / (d² - inner)) keeps its digits at a straight elbow, where the arc cosine loses half of
    them; and by the law of tangents λ = ε/2 - atan((l₁ - l₂) / (l₁ + l₂) tan(ε/2)).
    """
    folded = square - pair.inner
    tangent = m.root((pair.outer - square) / m.where(folded > _LEAST, folded, _LEAST))
    hole = m.where((square < pair.below) | (square > pair.above), np.nan, 0.0)
    half = m.atan(tangent) + hole
    return half, half - m.atan(pair.even * tangent), hole
