"""Two links in a plane: the one inverse problem that every closed form here comes down to."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from allegro_twin.types import Array

TOUCH = 1e-13
"""A target this far outside the workspace counts as on its border, m: far above rounding, far below any use."""
Flags = NDArray[np.bool_]


class Bend(NamedTuple):
    """Both ways to reach a point: the first link at `towards` ∓ `lead`, the second turned by ± `elbow` from it.

    Angles rad, from h towards r. Where `reached` is false the links point straight at the target, or fold.
    """

    towards: Array
    lead: Array
    elbow: Array
    reached: Flags


def two_link(r: Array, h: Array, first: float | Array, second: float | Array) -> Bend:
    """Solve first (sin α, cos α) + second (sin(α + ε), cos(α + ε)) = (r, h), any shape, m.

    With d² = r² + h², A² = (l₁ + l₂)² - d² and B² = d² - (l₁ - l₂)²: tan(ε/2) = A/B, and α = atan2(r, h) - λ with
    λ = atan2(l₂ sin ε, l₁ + l₂ cos ε) = atan2(A B / 2 l₁, l₁ + (B² - A²) / 4 l₁). The half-angle keeps its digits
    at a straight elbow, where the arc cosine loses half of them.
    """
    square = r * r + h * h
    outer, inner = np.asarray(first + second), np.abs(np.asarray(first - second))
    straight, folded = outer * outer - square, square - inner * inner
    reached = (straight >= -2 * outer * TOUCH) & (folded >= -2 * inner * TOUCH)
    straight, folded = np.maximum(straight, 0.0), np.maximum(folded, 0.0)
    a, b = np.sqrt(straight), np.sqrt(folded)
    lead = np.arctan2(a * b / (2 * first), first + (folded - straight) / (4 * first))
    return Bend(np.arctan2(r, h), lead, 2.0 * np.arctan2(a, b), reached)
