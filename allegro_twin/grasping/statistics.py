"""Statistics of success rates: intervals, and comparison of two grasps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import NormalDist
from typing import NamedTuple

from allegro_twin.errors import ConfigError


class Interval(NamedTuple):
    """Confidence interval of a probability."""

    low: float
    high: float


class PairedCounts(NamedTuple):
    """Two that were tried in the same draws."""

    both: int
    only_first: int
    only_second: int
    neither: int

    @property
    def draws(self) -> int:
        return sum(self)

    @property
    def difference(self) -> float:
        """Rate of the first less that of the second; NaN without draws."""
        return (self.only_first - self.only_second) / self.draws if self.draws else math.nan

    @property
    def p_value(self) -> float:
        """Two-sided p of the exact McNemar test: how often a difference at least so large comes up where there is
        none."""
        return mcnemar(self.only_first, self.only_second)


def wilson(successes: int, draws: int, confidence: float = 0.95) -> Interval:
    """The score interval of a rate (Wilson, JASA 22(158), 1927), without correction for continuity:

    (p + z²/2n ± z √(p (1 − p)/n + z²/4n²)) / (1 + z²/n). Without draws nothing is known: 0 to 1. Raises ConfigError.
    """
    if not 0 <= successes <= draws:
        raise ConfigError(f"{successes} successes in {draws} draws: there cannot be more, or fewer than none")
    z = _quantile(confidence)
    if draws == 0:
        return Interval(0.0, 1.0)
    rate, part = successes / draws, z * z / draws
    middle, half = rate + part / 2.0, z * math.sqrt(rate * (1.0 - rate) / draws + part / (4.0 * draws))
    low, high = (middle - half) / (1.0 + part), (middle + half) / (1.0 + part)
    return Interval(0.0 if successes == 0 else low, 1.0 if successes == draws else high)


def count_pairs(first: Sequence[bool], second: Sequence[bool]) -> PairedCounts:
    """Counts of two outcomes, draw by draw. Raises ConfigError where the draws are not the same number."""
    if len(first) != len(second):
        raise ConfigError(f"{len(first)} draws of the one and {len(second)} of the other: pairs need the same draws")
    counts = [0, 0, 0, 0]
    for a, b in zip(first, second, strict=True):
        counts[2 * (not a) + (not b)] += 1
    return PairedCounts(*counts)


def mcnemar(only_first: int, only_second: int) -> float:
    """Two-sided p of the exact McNemar test (Psychometrika 12, 1947): draws in which both did alike say nothing; of the
    others each is as likely to be the first's as the second's. Twice the smaller tail, at most 1."""
    if min(only_first, only_second) < 0:
        raise ConfigError(f"counts of draws are not below 0: {only_first}, {only_second}")
    pairs, fewer = only_first + only_second, min(only_first, only_second)
    tail, ways = 0, 1
    for k in range(fewer + 1):
        tail += ways
        ways = ways * (pairs - k) // (k + 1)  # The next binomial coefficient from the last: large ones are slow alone.
    return min(1.0, float(2 * tail / 2**pairs)) if pairs else 1.0


def pairs_needed(found: PairedCounts, level: float = 0.05, power: float = 0.8) -> int | None:
    """How many draws in all would show the difference that was found, were it the true one, at a `level` and with a
    `power`; None where no difference was found.

    n = (z₁₋ₗ/₂ √ψ + z_power √(ψ − δ²))² / δ² (Connor, Biometrics 43, 1987), ψ: the share of draws in which they differ,
    δ: the difference. By the normal distribution: the exact test wants some more.
    """
    if not 0.0 < power < 1.0:
        raise ConfigError(f"a power is between 0 and 1, not {power}")
    if found.only_first == found.only_second:
        return None
    differ, difference = (found.only_first + found.only_second) / found.draws, found.difference
    root = _quantile(1.0 - level) * math.sqrt(differ)
    root += NormalDist().inv_cdf(power) * math.sqrt(differ - difference**2)
    return math.ceil((root / difference) ** 2)


def comparison_text(found: PairedCounts, first: str, second: str, level: float = 0.05) -> str:
    """Which is better, how sure that is, and how many more draws it would take, in a sentence."""
    better = first if found.difference > 0 else second
    counts = f"{found.only_first} draws only {first}, {found.only_second} only {second}, p = {found.p_value:.2g}"
    if found.p_value < level:
        return f"{better} is better: of {found.draws}, {counts}"
    needed = pairs_needed(found, level)
    if needed is None:
        return f"no difference in {found.draws} draws: {counts}"
    more = max(needed - found.draws, 1)
    return f"not shown that {better} is better: of {found.draws}, {counts}; about {more} more draws would show it"


def _quantile(confidence: float) -> float:
    """z such that a normal value is within ±z with that confidence. Raises ConfigError."""
    if not 0.0 < confidence < 1.0:
        raise ConfigError(f"a confidence is between 0 and 1, not {confidence}")
    return NormalDist().inv_cdf(0.5 + confidence / 2.0)
