"""Rows of the study as arrays: whose outcome it is, trial by trial, so that policies stand beside each other."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from allegro_twin.grasping.evaluation import PairedCounts, count_pairs
from allegro_twin.types import Array
from studies.preemption.draws import block
from studies.preemption.learning import learn
from studies.preemption.measures import Row
from studies.preemption.protocol import ArmStudy, Set, Study


@dataclass(frozen=True, slots=True, eq=False)
class Outcomes:
    """Of one hand on one set: trials that every policy has made, in whole blocks."""

    trials: tuple[int, ...]
    rows: Mapping[str, Sequence[Row]]
    """By policy, in the order of `trials`."""

    def held(self, policy: str) -> list[bool]:
        return [bool(row["held"]) for row in self.rows[policy]]

    def numbers(self, policy: str, column: str) -> Array:
        """(trials,); NaN for what a trial has not shown."""
        return np.array([row[column] for row in self.rows[policy]], dtype=np.float64)

    def objects(self) -> list[str]:
        return [str(row["object"]) for row in next(iter(self.rows.values()))]

    def pairs(self, first: str, second: str) -> PairedCounts:
        return count_pairs(self.held(first), self.held(second))


def outcomes_of(rows: Iterable[Row], study: Study, hand: str, set_: Set) -> Outcomes:
    """What there is of a hand on a set."""
    rows = list(rows)
    names = list(study.trained) if set_ == "train" else [policy.name for policy in study.policies]
    found: dict[str, dict[int, Row]] = {name: {} for name in names}
    for row in rows:
        if row["hand"] == hand and row["set"] == set_ and not row["control"] and row["policy"] in found:
            found[row["policy"]][int(row["trial"])] = row
    whole = _whole(study, set_, set.intersection(*(set(each) for each in found.values())))
    made = {name: [found[name][trial] for trial in whole] for name in names}
    if set_ == "test" and isinstance(study, ArmStudy):
        train = outcomes_of(rows, study, hand, "train")
        if train.trials and whole:
            made[study.learned.name] = _learned(study, train.rows, made)
    return Outcomes(whole, made)


def _learned(study: ArmStudy, train: Mapping[str, Sequence[Row]], test: Mapping[str, Sequence[Row]]) -> list[Row]:
    """The trials of the learned policy: each is one of the policy that it chooses."""
    choice = learn(study, train)
    asked = test[study.analysis.baseline]
    return [test[choice.policy(row)][k] for k, row in enumerate(asked)]


def _whole(study: Study, set_: Set, there: set[int]) -> tuple[int, ...]:
    """The trials of a prefix of whole blocks, or of the whole set."""
    count, size = getattr(study.pairs, set_), block(study, set_)
    done = 0
    while done < count and set(range(done, min(done + size, count))) <= there:
        done = min(done + size, count)
    return tuple(range(done))


def control_of(rows: Iterable[Row], study: Study, hand: str, control: str) -> list[tuple[Row, Row | None]]:
    """The rows of a control, each beside what the study itself has of the trial under the same policy."""
    mine = [row for row in rows if row["hand"] == hand and row["set"] == "test"]
    plain = {(row["trial"], row["policy"]): row for row in mine if not row["control"]}
    return [(row, plain.get((row["trial"], row["policy"]))) for row in mine if row["control"] == control]
