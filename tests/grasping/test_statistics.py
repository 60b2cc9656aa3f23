"""Intervals and tests against published values and against SciPy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import binom, binomtest  # type: ignore[import-untyped]  # Its types are a package of their own.

from allegro_twin.errors import ConfigError
from allegro_twin.grasping.statistics import PairedCounts, comparison_text, count_pairs, mcnemar, pairs_needed, wilson

# Newcombe, "Two-sided confidence intervals for the single proportion", Stat. Med. 17, 1998, Table I, method 3.
NEWCOMBE = [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)]


@pytest.mark.parametrize(("successes", "draws", "low", "high"), NEWCOMBE)
def test_wilsons_interval_is_the_published_one(successes: int, draws: int, low: float, high: float) -> None:
    assert wilson(successes, draws) == pytest.approx((low, high), abs=5e-5)


@pytest.mark.parametrize("confidence", [0.8, 0.95, 0.99])
def test_wilsons_interval_is_scipys(confidence: float) -> None:
    for draws in (1, 2, 7, 50, 333):
        for successes in {0, 1, draws // 3, draws - 1, draws}:
            theirs = binomtest(successes, draws).proportion_ci(confidence, method="wilson")
            assert wilson(successes, draws, confidence) == pytest.approx((theirs.low, theirs.high), abs=1e-12)


def test_without_draws_nothing_is_known_and_certainty_ends_at_the_edges() -> None:
    assert wilson(0, 0) == (0.0, 1.0)
    assert wilson(0, 9).low == 0.0
    assert wilson(9, 9).high == 1.0


def test_mcnemars_test_is_the_binomial_one() -> None:
    assert mcnemar(9, 1) == 2 * (1 + 10) / 1024
    assert mcnemar(0, 0) == mcnemar(3, 3) == 1.0
    for first in range(0, 40, 3):
        for second in range(0, 40, 4):
            theirs = binomtest(first, first + second).pvalue if first + second else 1.0
            assert mcnemar(first, second) == pytest.approx(theirs, abs=1e-12)
    assert mcnemar(4000, 4200) == pytest.approx(binomtest(4000, 8200).pvalue, rel=1e-9)


def test_pairs_are_counted_draw_by_draw() -> None:
    found = count_pairs([True, True, False, False, True], [True, False, True, False, False])
    assert found == PairedCounts(both=1, only_first=2, only_second=1, neither=1)
    assert (found.draws, found.p_value) == (5, 1.0)
    assert found.difference == pytest.approx(0.2)
    assert math.isnan(PairedCounts(0, 0, 0, 0).difference)


@pytest.mark.parametrize(("only_first", "only_second", "rest"), [(12, 6, 82), (8, 2, 40), (30, 20, 50), (5, 0, 95)])
def test_so_many_draws_show_the_difference_four_times_in_five(only_first: int, only_second: int, rest: int) -> None:
    found = PairedCounts(rest, only_first, only_second, 0)
    needed = pairs_needed(found)
    assert needed is not None
    differ = (only_first + only_second) / found.draws
    power = 0.0  # Of the exact test, summed over how many draws differ, and how many of those are the first's.
    rejects = -1  # The most of the rarer kind with which it still rejects: no fewer with more pairs.
    for pairs in range(needed + 1):
        while rejects + 1 <= pairs and mcnemar(rejects + 1, pairs - rejects - 1) < 0.05:
            rejects += 1
        firsts = np.arange(pairs + 1)
        rejected = np.minimum(firsts, pairs - firsts) <= rejects
        share = binom.pmf(firsts, pairs, only_first / (only_first + only_second))[rejected].sum()
        power += binom.pmf(pairs, needed, differ) * share
    assert 0.66 < power < 0.84


def test_connors_number_of_draws_is_the_published_one() -> None:
    """ψ 0.3 and δ 0.2 at 5 % and 90 %, worked by hand: (1.95996 √0.3 + 1.28155 √0.26)² / 0.04 = 74.6."""
    assert pairs_needed(PairedCounts(70, 25, 5, 0), power=0.9) == 75
    assert pairs_needed(PairedCounts(70, 5, 25, 0), power=0.9) == 75
    assert pairs_needed(PairedCounts(10, 5, 5, 0)) is None


def test_the_verdict_is_a_sentence() -> None:
    assert comparison_text(PairedCounts(10, 9, 1, 0), "A", "B") == (
        "A is better: of 20, 9 draws only A, 1 only B, p = 0.021"
    )
    assert comparison_text(PairedCounts(10, 2, 2, 6), "A", "B").startswith("no difference in 20 draws")
    assert comparison_text(PairedCounts(10, 1, 3, 6), "A", "B") == (
        "not shown that B is better: of 20, 1 draws only A, 3 only B, p = 0.62; about 135 more draws would show it"
    )


WRONG = [
    (lambda: wilson(5, 4), "5 successes in 4 draws"),
    (lambda: wilson(1, 4, 1.0), "a confidence is between 0 and 1, not 1.0"),
    (lambda: mcnemar(-1, 4), "counts of draws are not below 0: -1, 4"),
    (lambda: count_pairs([True], []), "1 draws of the one and 0 of the other"),
    (lambda: pairs_needed(PairedCounts(1, 2, 1, 0), power=1.0), "a power is between 0 and 1, not 1.0"),
]


@pytest.mark.parametrize(("call", "answer"), WRONG)
def test_what_cannot_be_is_answered_in_a_line(call: object, answer: str) -> None:
    with pytest.raises(ConfigError, match=answer):
        call()  # type: ignore[operator]  # Each is a function without arguments.
