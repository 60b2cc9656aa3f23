"""Coupled joints: joints that move with driven ones, and their positions when nothing is in their way."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from allegro_twin.types import Array, Vector


@dataclass(frozen=True, slots=True, eq=False)
class CoupledJoint:
    """A joint that follows a driven one where nothing is in its way."""

    name: str
    """Its name in the description file."""
    driven: int
    """The index of the one that it follows."""
    positions: Vector
    """Where it is, rad or m, for positions of the driven one evenly from its lowest to its highest, shape (k,)."""


class CoupledTable(NamedTuple):
    """Interpolation tables of the m coupled joints with tables of one length; the same bits as `np.interp` for each."""

    places: list[int]
    """Indices of these coupled joints."""
    driven: list[int]
    lower: Vector
    """Lowest positions of the driven joints, (m,), rad."""
    span: Vector
    parts: Vector
    """Parts of the span at which the tables have their entries, (k,)."""
    table: Array
    """(m, k), rad or m."""
    slopes: Array
    """(m, k - 1)."""

    def at(self, position: Array) -> Array:
        """(..., n) → (..., m)."""
        return self.each(position[..., self.driven])

    def each(self, motors: Array) -> Array:
        """As if each had a motor to itself, at `motors`, (..., m) → (..., m)."""
        part = (motors - self.lower) / self.span
        stretch = np.minimum(np.maximum(self.parts.searchsorted(part, "right") - 1, 0), len(self.parts) - 2)
        row = np.arange(len(self.driven))
        between = self.slopes[row, stretch] * (part - self.parts[stretch]) + self.table[row, stretch]
        return np.where(part >= 1.0, self.table[:, -1], np.where(part <= 0.0, self.table[:, 0], between))


def coupled_tables(followers: Sequence[CoupledJoint], lower: Vector, upper: Vector) -> list[CoupledTable]:
    """Tables of all coupled joints of a hand with the joint limits `lower` and `upper`, (n,), rad."""
    made = []
    for length in sorted({len(each.positions) for each in followers}):
        places = [k for k, each in enumerate(followers) if len(each.positions) == length]
        driven = [followers[k].driven for k in places]
        parts, table = np.linspace(0.0, 1.0, length), np.stack([followers[k].positions for k in places])
        slopes = np.diff(table) / np.diff(parts)
        made.append(CoupledTable(places, driven, lower[driven], (upper - lower)[driven], parts, table, slopes))
    return made
