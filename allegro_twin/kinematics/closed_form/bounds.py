"""One finger's limits, less a margin: as its hand has them, and as the right hand's that is solved in its place."""

from __future__ import annotations

from functools import cached_property
from math import pi

from allegro_twin.kinematics.closed_form.forms.finger import ImaFinger
from allegro_twin.kinematics.closed_form.forms.maths import T
from allegro_twin.kinematics.closed_form.forms.planar import TOLERANCE, Branch
from allegro_twin.kinematics.closed_form.forms.thumb import Thumb
from allegro_twin.kinematics.closed_form.search.fingers import FingerSearch, Search, ThumbSearch
from allegro_twin.types import Vector, frozen


class Bounds:
    """Where every joint is to stay, and the search inside."""

    def __init__(self, chain: ImaFinger | Thumb, lower: Vector, upper: Vector, signs: Vector) -> None:
        self.lower, self.upper = frozen(lower), frozen(upper)
        ends = [sorted((a * s, b * s)) for a, b, s in zip(lower.tolist(), upper.tolist(), signs.tolist(), strict=True)]
        self._chain, self._low, self._high = chain, [low for low, _ in ends], [high for _, high in ends]
        self._ranges = tuple((low - TOLERANCE, high + TOLERANCE) for low, high in ends)

    def within(self, q: Branch[T]) -> object:
        """Which postures are inside, to 1e-9 rad: a flag, or one for each."""
        (a, b), (c, d), (e, f), (g, h) = self._ranges
        q0, q1, q2, q3 = q
        return (q0 >= a) & (q0 <= b) & (q1 >= c) & (q1 <= d) & (q2 >= e) & (q2 <= f) & (q3 >= g) & (q3 <= h)

    @cached_property
    def search(self) -> Search:
        """Inside the limits."""
        return _search(self._chain, self._low, self._high)

    @cached_property
    def anywhere(self) -> Search:
        """By geometry alone: every joint turns once about the middle of its range."""
        middles = [(low + high) / 2 for low, high in zip(self._low, self._high, strict=True)]
        return _search(self._chain, [middle - pi for middle in middles], [middle + pi for middle in middles])


def _search(chain: ImaFinger | Thumb, low: list[float], high: list[float]) -> Search:
    if isinstance(chain, ImaFinger):
        return FingerSearch(chain.links, low, high)
    return ThumbSearch(chain.links, chain.aside, chain.up, low, high)
