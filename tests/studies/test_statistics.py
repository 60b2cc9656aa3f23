"""The study's statistics, against figures from books and by other ways."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import minimize  # type: ignore[import-untyped]  # SciPy has no types.
from scipy.stats import binomtest  # type: ignore[import-untyped]  # Likewise.

from allegro_twin.grasping.statistics import PairedCounts, pairs_needed
from studies.preemption.bootstrap import over_clusters
from studies.preemption.dose_response import fit
from studies.preemption.paired_tests import bound, holm, newcombe, not_inferior, pairs_not_inferior


@pytest.mark.parametrize(
    ("difference", "differ", "pairs"),
    [(0.10, 0.25, 194), (0.05, 0.20, 626), (0.05, 0.10, 312), (0.03, 0.15, 1306), (0.02, 0.10, 1960)],
)
def test_as_many_pairs_show_a_difference_as_were_planned(difference: float, differ: float, pairs: int) -> None:
    only = round(5000 * (differ + difference)), round(5000 * (differ - difference))
    assert pairs_needed(PairedCounts(10_000 - sum(only), *only, 0)) == pairs


@pytest.mark.parametrize(("margin", "differ", "pairs"), [(0.05, 0.20, 495), (0.03, 0.15, 1031)])
def test_as_many_pairs_show_that_nothing_is_lost_as_were_planned(margin: float, differ: float, pairs: int) -> None:
    assert pairs_not_inferior(differ, margin) == pairs


def test_mcnemar_is_the_binomial_test_of_the_pairs_that_differ() -> None:
    # Approval of a prime minister, asked twice (Agresti, Categorical Data Analysis, table 10.1): 150 and 86 of 1,600.
    found = PairedCounts(794, 150, 86, 570)
    assert found.p_value == pytest.approx(binomtest(86, 236).pvalue, rel=1e-12)
    assert found.difference == pytest.approx(0.04)


@pytest.mark.parametrize(
    ("counts", "low", "high"),
    # Newcombe, Statistics in Medicine 17 (1998) 2635-2650, table II, method 10.
    [(PairedCounts(36, 12, 2, 0), 0.0569, 0.3404)],
)
def test_newcombes_interval_is_that_of_his_paper(counts: PairedCounts, low: float, high: float) -> None:
    assert newcombe(counts) == pytest.approx((low, high), abs=5e-5)


def test_turning_the_pairs_round_turns_the_interval_round() -> None:
    low, high = newcombe(PairedCounts(50, 9, 4, 21))
    assert newcombe(PairedCounts(50, 4, 9, 21)) == pytest.approx((-high, -low))


def test_newcombes_interval_has_the_difference_as_often_as_it_says() -> None:
    random, inside = np.random.default_rng(3), 0
    for _ in range(2000):
        found = PairedCounts(*random.multinomial(200, (0.6, 0.12, 0.08, 0.2)).tolist())
        low, high = newcombe(found)
        inside += low <= 0.04 <= high
    assert 0.935 <= inside / 2000 <= 0.97


def test_p_of_not_being_inferior_is_where_the_bound_meets_the_margin() -> None:
    found = PairedCounts(120, 8, 10, 30)
    p = not_inferior(found, 0.03)
    assert newcombe(found, 1.0 - 2.0 * p).low == pytest.approx(-0.03, abs=1e-9)
    assert not_inferior(found, 0.2) < 1e-4
    assert not_inferior(PairedCounts(60, 0, 60, 0), 0.03) > 0.999
    assert bound(found, 0.5) == pytest.approx(found.difference, abs=1e-6)


def test_holms_values_are_those_of_a_worked_example() -> None:
    assert holm({"a": 0.01, "b": 0.04, "c": 0.03, "d": 0.005}) == pytest.approx(
        {"a": 0.03, "b": 0.06, "c": 0.06, "d": 0.02}
    )
    assert holm({"only": 0.3}) == {"only": 0.3}


def test_objects_and_not_trials_are_drawn_again() -> None:
    objects = [name for name in "abcd" for _ in range(25)]
    alike = np.repeat([0.0, 0.0, 1.0, 1.0], 25)

    def mean(sums: np.ndarray) -> np.ndarray:
        return np.asarray(sums[:, 0] / sums[:, 1])

    low, high = over_clusters(mean, objects, alike[:, None], 4000, seed=1)
    assert (low, high) == (0.0, 1.0)  # Four objects say little, however many trials there are.
    assert over_clusters(mean, objects, alike[:, None], 4000, seed=1) == (low, high)
    assert over_clusters(mean, ["a"] * 100, alike[:, None], 400, seed=1) == (0.5, 0.5)
    many = np.random.default_rng(0).normal(size=2000)
    low, high = over_clusters(mean, [str(k) for k in range(2000)], many[:, None], 4000, seed=1)
    half = 1.96 * many.std() / math.sqrt(2000)
    assert (low, high) == pytest.approx((many.mean() - half, many.mean() + half), abs=0.06 * half)


def test_the_curve_is_the_most_likely_one() -> None:
    random = np.random.default_rng(5)
    overlap = random.choice([0.0, 0.25, 0.5, 0.75, 0.9], 600)
    held = (random.uniform(size=600) < 1.0 / (1.0 + np.exp(-(2.0 - 3.0 * overlap)))).astype(float)

    def against(x: np.ndarray) -> float:
        z = x[0] + x[1] * overlap
        return float(np.sum(np.logaddexp(0.0, z) - held * z))

    best = minimize(against, np.zeros(2)).x
    found = fit(overlap, held)
    assert (found.a, found.b) == pytest.approx(best, abs=1e-4)
    assert found.rate(found.half) == pytest.approx(0.5 * found.rate(0.0))
    assert fit(overlap, np.ones(600)).half == math.inf


def test_a_cliff_at_the_end_is_found_at_the_end() -> None:
    overlap = np.repeat([0.0, 0.25, 0.5, 0.75, 0.9], 21)
    held = np.ones(105)
    held[-2:] = 0.0
    found = fit(overlap, held)
    assert found.rate(0.9) == pytest.approx(19 / 21, abs=0.005)
    assert found.rate(0.75) > 0.99
    assert 0.9 < found.half < 1.0


@pytest.mark.parametrize("alpha", [0.6, 0.9, 0.975, 0.9999])
def test_a_bound_that_is_mostly_too_high_is_the_upper_end_of_an_interval(alpha: float) -> None:
    """Of the confidence 2 α - 1; and the bounds of α and of 1 - α are those of one interval."""
    found = PairedCounts(60, 14, 8, 18)
    assert bound(found, alpha) == newcombe(found, 2.0 * alpha - 1.0).high
    assert bound(found, 1.0 - alpha) == pytest.approx(newcombe(found, 2.0 * alpha - 1.0).low, abs=1e-12)
    assert bound(found, 0.4) < bound(found, 0.5) < bound(found, alpha)
