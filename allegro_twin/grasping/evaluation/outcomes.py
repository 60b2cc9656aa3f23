"""Outcomes of many trials: a row a grasp, rates with their intervals, and two grasps in the same draws."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from allegro_twin.errors import ConfigError
from allegro_twin.grasping.evaluation.campaign import EvaluationTarget
from allegro_twin.grasping.statistics import PairedCounts, count_pairs, wilson
from allegro_twin.grasping.uncertainty import Perturbation

Row = Mapping[str, Any]
_OWN = ("key", "error")
"""Columns of every sweep."""


class Rate(NamedTuple):
    """Success rate with its 95 % Wilson interval."""

    name: str
    held: int
    n: int
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.held} of {self.n} ({100 * self.low:.0f}–{100 * self.high:.0f} %)"


def make_rate(name: str, held: int, n: int) -> Rate:
    return Rate(name, held, n, *wilson(held, n))


def summarise(targets: Sequence[EvaluationTarget], trials: Sequence[Row]) -> list[dict[str, Any]]:
    """A row for each target from the rows of the trials of a `Campaign`: that of the trial without a draw, and under
    draws `n`, `success` (a share) and its interval `low` to `high`. A trial that could not be made is not held, and a
    draw that could not be is not counted. Raises ConfigError where not one could be, of all or of a target's draws."""
    each = len(trials) // len(targets)
    if all(row["error"] is not None for row in trials):
        raise ConfigError(str(trials[0]["error"]))
    names = [name for name in trials[0] if name not in _OWN]
    found = []
    for number, target in enumerate(targets):
        nominal, *drawn = trials[number * each : (number + 1) * each]
        row = {"target": target.name} | {name: nominal.get(name) for name in names}
        if nominal["error"] is not None:
            row |= {"object": target.case.scenario.objects[0].name, "grasp": target.case.grasp.name,
                    "side": target.side, "held": False, "reason": nominal["error"]}  # fmt: skip
        if drawn:
            made = [bool(trial["held"]) for trial in drawn if trial["error"] is None]
            if not made:
                raise ConfigError(f"{target.name}: no draw could be tried: {drawn[0]['error']}")
            of = make_rate(target.name, sum(made), len(made))
            row |= {"success": of.held / of.n, "n": of.n, "low": of.low, "high": of.high}
        found.append(row)
    return found


def row_rate(row: Row) -> Rate:
    """Success rate of one target under draws."""
    return make_rate(str(row["target"]), round(row["success"] * row["n"]), row["n"])


def rates(rows: Sequence[Row], column: str) -> list[Rate]:
    """Success rates of the targets with the same value of `column`, all draws together; without draws, whether they
    held. Right and left hand, which perform the same draws, are apart: together they would count for twice as many."""
    found: dict[str, list[int]] = {}
    both = len({row["side"] for row in rows}) > 1
    for row in rows:
        held, n = (row_rate(row).held, row["n"]) if "n" in row else (int(row["held"]), 1)
        total = found.setdefault(f"{row[column]}, {row['side']}" if both else str(row[column]), [0, 0])
        total[0], total[1] = total[0] + held, total[1] + n
    return [make_rate(name, held, n) for name, (held, n) in found.items()]


def compare_pairs(trials: Sequence[Row]) -> PairedCounts:
    """The first target against the second, draw by draw, of two whose trials were made together. Raises ConfigError
    for a trial that could not be made."""
    for row in trials:
        if row["error"] is not None:
            raise ConfigError(str(row["error"]))
    half = len(trials) // 2
    first, second = ([bool(row["held"]) for row in part[1:]] for part in (trials[:half], trials[half:]))
    return count_pairs(first, second)


def sample_columns(targets: Sequence[EvaluationTarget], items: Sequence[Mapping[str, Any]]) -> dict[str, list[Any]]:
    """Columns that say which trial a row is of: target, number of the draw (none: without), and the draw itself."""
    each = len(items) // len(targets)
    columns: dict[str, list[Any]] = {
        "target": [target.name for target in targets for _ in range(each)],
        "draw": [number - 1 if number else None for _ in targets for number in range(each)],
    }
    for name in Perturbation.__dataclass_fields__:
        columns[f"draw_{name}"] = [None if item["draw"] is None else item["draw"][name] for item in items]
    return columns
