"""Of two policies in the same trials: how far apart their rates are, how sure that is, and what many such answers say
together."""

from __future__ import annotations

import math
from collections.abc import Mapping
from statistics import NormalDist

from allegro_twin.grasping.evaluation import Interval, PairedCounts, wilson


def newcombe(found: PairedCounts, confidence: float = 0.95) -> Interval:
    """Of the difference of two rates in the same trials (Newcombe, Statistics in Medicine 17, 1998, method 10):

    Δ - √(dl₁² - 2 φ dl₁ du₂ + du₂²) to Δ + √(du₁² - 2 φ du₁ dl₂ + dl₂²), with dlᵢ and duᵢ from a rate to the ends of
    its Wilson interval, and φ the correlation of the two outcomes, drawn towards 0 where it is positive. -1 to 1
    without trials.
    """
    n = found.draws
    if n == 0:
        return Interval(-1.0, 1.0)
    first, second = found.both + found.only_first, found.both + found.only_second
    (low1, high1), (low2, high2) = wilson(first, n, confidence), wilson(second, n, confidence)
    p1, p2, phi = first / n, second / n, _correlation(found)
    below = (p1 - low1) ** 2 - 2.0 * phi * (p1 - low1) * (high2 - p2) + (high2 - p2) ** 2
    above = (high1 - p1) ** 2 - 2.0 * phi * (high1 - p1) * (p2 - low2) + (p2 - low2) ** 2
    difference = p1 - p2
    return Interval(difference - math.sqrt(max(below, 0.0)), difference + math.sqrt(max(above, 0.0)))


def _correlation(found: PairedCounts) -> float:
    a, b, c, d = found
    margins = (a + b) * (c + d) * (a + c) * (b + d)
    if not margins:
        return 0.0
    product = a * d - b * c
    if product > 0:  # A correction for continuity, which does not turn the sign.
        product = max(product - (a + b + c + d) / 2.0, 0.0)  # type: ignore[assignment]  # From a count to a real number.
    return product / math.sqrt(margins)


def not_inferior(found: PairedCounts, margin: float) -> float:
    """One-sided p that the first is not worse than the second by `margin` or more: the level at which the lower bound
    of Newcombe's interval would be -margin."""
    low, high = 0.0, 1.0  # Of the bound's level, α: the more may be wrong, the higher the bound.
    for _ in range(60):
        middle = 0.5 * (low + high)
        if bound(found, middle) > -margin:
            high = middle
        else:
            low = middle
    return high


def bound(found: PairedCounts, alpha: float) -> float:
    """The lower bound of the difference that is too high with a probability of `alpha`, from 0 to 1."""
    alpha = min(max(alpha, 1e-15), 1.0 - 1e-15)
    if alpha <= 0.5:
        return newcombe(found, max(1.0 - 2.0 * alpha, 1e-12)).low
    return newcombe(found, 2.0 * alpha - 1.0).high


def pairs_not_inferior(differ: float, margin: float, alpha: float = 0.05, power: float = 0.8) -> int:
    """So many pairs show that one is not inferior, where the two are alike and differ in a share `differ` of the pairs:
    n = (z₁₋ₐ + z_power)² ψ / margin²."""
    normal = NormalDist()
    return math.ceil((normal.inv_cdf(1.0 - alpha) + normal.inv_cdf(power)) ** 2 * differ / margin**2)


def holm(values: Mapping[str, float]) -> dict[str, float]:
    """p-values made larger for how many there are (Holm, Scandinavian Journal of Statistics 6, 1979)."""
    found, least = dict[str, float](), 0.0
    for rank, name in enumerate(sorted(values, key=lambda each: values[each])):
        least = max(least, min(1.0, (len(values) - rank) * values[name]))
        found[name] = least
    return {name: found[name] for name in values}
