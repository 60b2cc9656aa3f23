"""Joints that move with driven ones: where they are when nothing is in their way."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from allegro_twin.types import Array, Vector


@dataclass(frozen=True, slots=True, eq=False)
class CoupledJoint:
    """A joint that follows a driven one, wherever nothing is in its way."""

    name: str
    """In the description file."""
    driven: int
    """The index of the one that it follows."""
    positions: Vector
    """Where it is, rad or m, for positions of the driven one evenly from its lowest to its highest, shape (k,)."""


class CoupledTable(NamedTuple):
    """How those followers go whose tables are equally long, m of them, as `np.interp` has it for one, to the bit."""

    places: list[int]
    """Which followers they are."""
    driven: list[int]
    lower: Vector
    """Of the driven joints, as `span`, (m,), rad."""
    span: Vector
    parts: Vector
    """Of the span, where the tables have their entries, (k,)."""
    table: Array
    """(m, k), rad or m."""
    slopes: Array
    """(m, k - 1)."""

    def at(self, position: Array) -> Array:
        """(..., n) → (..., m)."""
        part = (position[..., self.driven] - self.lower) / self.span
        stretch = np.minimum(np.maximum(self.parts.searchsorted(part, "right") - 1, 0), len(self.parts) - 2)
        row = np.arange(len(self.driven))
        between = self.slopes[row, stretch] * (part - self.parts[stretch]) + self.table[row, stretch]
        return np.where(part >= 1.0, self.table[:, -1], np.where(part <= 0.0, self.table[:, 0], between))


def coupled_tables(followers: Sequence[CoupledJoint], lower: Vector, upper: Vector) -> list[CoupledTable]:
    """All the ways of a hand whose driven joints go from `lower` to `upper`, (n,), rad."""
    made = []
    for length in sorted({len(each.positions) for each in followers}):
        places = [k for k, each in enumerate(followers) if len(each.positions) == length]
        driven = [followers[k].driven for k in places]
        parts, table = np.linspace(0.0, 1.0, length), np.stack([followers[k].positions for k in places])
        slopes = np.diff(table) / np.diff(parts)
        made.append(CoupledTable(places, driven, lower[driven], (upper - lower)[driven], parts, table, slopes))
    return made
