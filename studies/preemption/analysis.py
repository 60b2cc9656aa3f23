"""From outcomes to the answer, as the protocol says."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from allegro_twin.grasping.evaluation import Interval, PairedCounts, wilson
from allegro_twin.types import Array
from studies.preemption import paired_tests as together
from studies.preemption.bootstrap import over_clusters
from studies.preemption.dose_response import Dose, fit
from studies.preemption.measures import Row
from studies.preemption.outcomes import Outcomes, outcomes_of
from studies.preemption.protocol import Analysis, Study


class Arm(NamedTuple):
    """What one policy did."""

    policy: str
    held: int
    trials: int
    rate: Interval
    """Wilson's."""
    seconds: float
    """Mean cycle time."""
    per_success: float
    """Expected time per success, s."""
    premature: float
    """Mean time in contact before the arm was there, s."""
    carried: float
    """How far the object was moved meanwhile, mean, mm."""
    peak: float
    """Largest total contact force, mean, N."""


class Versus(NamedTuple):
    """One policy against another in the same trials."""

    first: str
    second: str
    counts: PairedCounts
    interval: Interval
    """Newcombe's, of the difference of the rates."""
    clustered: Interval
    """By a bootstrap over objects."""
    p_value: float
    """Exact McNemar."""
    inferior: float
    """One-sided p that it is not inferior."""
    seconds: float
    """Mean difference of cycle times."""
    faster: Interval
    """Of it, by a bootstrap over objects."""


@dataclass(frozen=True, slots=True)
class Finding:
    """Of one hand."""

    hand: str
    chosen: str
    trained: int
    """Pairs on which the overlap was chosen."""
    choices: Mapping[str, float]
    """How often each would have been, of such pairs drawn again."""
    arms: tuple[Arm, ...]
    primary: Versus
    versus: tuple[Versus, ...]
    """Every policy against the baseline, then the chosen one against the report's."""
    dose: Dose
    by_sigma: Mapping[float, tuple[Dose, tuple[tuple[float, int, int], ...]]]
    """For each standard deviation of the place, mm: the curve, and overlap, held and tried."""
    check: tuple[int, int, int, int]
    """Of the force check: held and said so, held and not said, not held and said, neither."""


class Answer(NamedTuple):
    """Over hands."""

    findings: tuple[Finding, ...]
    mcnemar: Mapping[str, float]
    """p of the primary comparisons, after Holm."""
    inferior: Mapping[str, float]
    """Likewise, not to be inferior."""
    beats: Mapping[str, bool]


def analysed(rows: Sequence[Row], study: Study) -> Answer:
    """Of the hands that have a whole block of test, and have been trained on."""
    found = []
    for hand in study.hands:
        train, test = outcomes_of(rows, study, hand, "train"), outcomes_of(rows, study, hand, "test")
        if train.trials and test.trials:
            found.append(finding(hand, train, test, study))
    primary = {each.hand: each.primary for each in found}
    inferior = together.holm({hand: versus.inferior for hand, versus in primary.items()})
    return Answer(
        tuple(found),
        together.holm({hand: versus.p_value for hand, versus in primary.items()}),
        inferior,
        {hand: inferior[hand] < study.analysis.alpha and versus.faster.high < 0.0 for hand, versus in primary.items()},
    )


def chosen(train: Outcomes, analysis: Analysis) -> str:
    """The longest of the candidates, which are in order, that loses no more than is allowed on train; else the
    first."""
    least = sum(train.held(analysis.baseline)) / len(train.trials) - analysis.allowance
    good = [name for name in analysis.candidates if sum(train.held(name)) / len(train.trials) >= least - 1e-12]
    return good[-1] if good else analysis.candidates[0]


def choices(train: Outcomes, analysis: Analysis, seed: int) -> dict[str, float]:
    """How often each candidate is chosen when the training pairs are drawn again with replacement: shares, in order.
    An overlap that another draw of so many pairs would not choose says little of the hand."""
    names = (analysis.baseline, *analysis.candidates)
    held = np.array([train.held(name) for name in names], np.int64)  # (1 + candidates, pairs)
    drawn = np.random.default_rng(seed).integers(0, held.shape[1], (analysis.resamples, held.shape[1]))
    rates = held[:, drawn].mean(axis=2)  # (1 + candidates, resamples)
    good = rates[1:] >= rates[0] - analysis.allowance - 1e-12
    last = np.where(good.any(axis=0), len(good) - 1 - np.argmax(good[::-1], axis=0), 0)
    return {name: float((last == k).mean()) for k, name in enumerate(analysis.candidates)}


def finding(hand: str, train: Outcomes, test: Outcomes, study: Study) -> Finding:
    """Everything that is said of one hand."""
    analysis, best = study.analysis, chosen(train, study.analysis)

    def against(first: str, second: str) -> Versus:
        return versus(test, first, second, study)

    others = [name for name in test.rows if name != analysis.baseline]
    doses = {policy.name: policy.overlap for policy in study.policies
             if policy.name in (analysis.baseline, *analysis.candidates)}  # fmt: skip
    sigmas = sorted({float(row["sigma_mm"]) for row in test.rows[analysis.baseline]})
    held = [row["held"] for name in test.rows for row in test.rows[name]]
    said = [row["said_held"] for name in test.rows for row in test.rows[name]]
    return Finding(
        hand, best, len(train.trials), choices(train, analysis, study.seed),
        tuple(arm(test, name, study) for name in test.rows),
        against(best, analysis.baseline),
        (*(against(name, analysis.baseline) for name in others), against(best, analysis.report),
         *(against(*pair) for pair in study.compared)),
        _dose(test, doses, None)[0], {sigma: _dose(test, doses, sigma) for sigma in sigmas},
        tuple(sum(h == a and s == b for h, s in zip(held, said, strict=True))
              for a, b in ((True, True), (True, False), (False, True), (False, False))),
    )  # fmt: skip


def arm(test: Outcomes, policy: str, study: Study) -> Arm:
    """What one policy did."""
    held, n = sum(test.held(policy)), len(test.trials)
    seconds = float(np.nanmean(test.numbers(policy, "cycle_s")))
    premature, carried, peak = (
        float(np.mean(test.numbers(policy, c))) for c in ("premature_s", "carried_mm", "peak_n")
    )
    return Arm(policy, held, n, wilson(held, n), seconds, seconds * n / held if held else float("inf"), premature,
               carried, peak)  # fmt: skip


def versus(test: Outcomes, first: str, second: str, study: Study) -> Versus:
    """One policy against another. Cycle times are compared where both have one."""
    counts, objects, margin = test.pairs(first, second), test.objects(), study.analysis.margin
    outcome = np.array(test.held(first), float) - np.array(test.held(second), float)
    later = test.numbers(first, "cycle_s") - test.numbers(second, "cycle_s")
    timed = np.isfinite(later)
    draw = _drawn(study)
    return Versus(
        first, second, counts, together.newcombe(counts), draw(objects, outcome), counts.p_value,
        together.not_inferior(counts, margin), float(later[timed].mean()) if timed.any() else float("nan"),
        draw([name for name, yes in zip(objects, timed, strict=True) if yes], later[timed]),
    )  # fmt: skip


def _drawn(study: Study) -> Callable[[Sequence[str], Array], Interval]:
    """The interval of a mean, over objects."""
    return lambda objects, values: over_clusters(
        lambda sums: sums[:, 0] / sums[:, 1], objects, values[:, None], study.analysis.resamples, study.seed
    )


def _dose(
    test: Outcomes, doses: Mapping[str, float], sigma: float | None
) -> tuple[Dose, tuple[tuple[float, int, int], ...]]:
    """The curve over overlaps, and what it is drawn through."""
    points, overlap, held = [], list[float](), list[bool]()
    for name, dose in doses.items():
        mine = [bool(row["held"]) for row in test.rows[name] if sigma is None or float(row["sigma_mm"]) == sigma]
        points.append((dose, sum(mine), len(mine)))
        overlap += [dose] * len(mine)
        held += mine
    return fit(np.array(overlap), np.array(held, dtype=np.float64)), tuple(points)
