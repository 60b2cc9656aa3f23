"""The table that a report is made from, whatever it came as."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Protocol, TypeAlias

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.types import Array

Row: TypeAlias = Mapping[str, Any]


class Columnar(Protocol):
    """A table that can be had as rows: one of PyArrow, say."""

    def to_pylist(self) -> list[dict[str, Any]]: ...


class Rows:
    """Results, a row a grasp. Raises ConfigError without any, and where a row says nothing of its object or outcome."""

    def __init__(self, given: Sequence[Row] | Columnar) -> None:
        self.all: list[Row] = [*(given if isinstance(given, Sequence) else given.to_pylist())]
        if not self.all:
            raise ConfigError("a report needs at least one result")
        self.columns = list(dict.fromkeys(key for row in self.all for key in row))
        for needed in ("object", "held"):
            bare = [number for number, row in enumerate(self.all) if row.get(needed) is None]
            if bare:
                raise ConfigError(f"result {bare[0]} has no `{needed}`; a report needs it in every row")
        self.held: Array = np.array([float(bool(row["held"])) for row in self.all])

    def __len__(self) -> int:
        return len(self.all)

    def numbers(self, column: str) -> Array:
        """(k,); NaN where a row has no number there."""
        return np.array([_number(row.get(column)) for row in self.all])

    def starting(self, prefix: str) -> list[str]:
        """Columns by how their name begins, in their order."""
        return [column for column in self.columns if column.startswith(prefix)]

    def groups(self, column: str) -> Iterator[tuple[str, list[int]]]:
        """The rows of each value of a column, in the order in which the values first come."""
        found: dict[str, list[int]] = {}
        for number, row in enumerate(self.all):
            if row.get(column) is not None:
                found.setdefault(str(row[column]), []).append(number)
        yield from found.items()

    def tried(self) -> tuple[Array, Array] | None:
        """Successes and draws of each row under uncertainty; None where the table has none."""
        share, draws = self.numbers("success"), self.numbers("n")
        if np.isnan(share * draws).all():
            return None
        known = ~np.isnan(share * draws)
        return np.where(known, np.rint(share * draws), 0.0), np.where(known, draws, 0.0)

    def goodness(self) -> Array:
        """What rows are ranked by, (k,): the rate under uncertainty, or held; then the least margin; then ε."""
        first = np.nan_to_num(self.numbers("success"), nan=-1.0) + self.held
        margins = [self.numbers(column) for column in self.starting("margin_")]
        least = np.nan_to_num(np.min(margins, axis=0), nan=-1e3) if margins else np.zeros(len(self))
        ball = np.nan_to_num(self.numbers("epsilon"), nan=0.0)
        place = np.empty(len(self))
        place[np.lexsort((ball, least, first))] = np.arange(len(self))
        return place


def shown(value: object) -> str:
    """A value as a person wants to read it."""
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if value is None or (isinstance(value, float | np.floating) and math.isnan(value)):
        return "–"
    if isinstance(value, float | np.floating):
        return f"{value:.4g}"
    return str(value)


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float | np.number | np.bool_) else math.nan
