"""Intervals by drawing again: whole objects, since trials on one object are alike."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from allegro_twin.grasping.evaluation import Interval
from allegro_twin.types import Array


def over_clusters(
    of: Callable[[Array], Array],
    clusters: Sequence[str],
    columns: Array,
    resamples: int,
    seed: int,
    level: float = 0.95,
) -> Interval:
    """The percentile interval of a statistic of means, when whole clusters are drawn with replacement.

    `columns` are what is averaged, (trials, k), whose sums over the trials that were drawn, with how many these are as
    a last column, `of` takes, (resamples, k + 1), and turns into a value each, (resamples,). NaN without trials.
    """
    names, members = np.unique(np.asarray(clusters), return_inverse=True)
    if not len(names):
        return Interval(float("nan"), float("nan"))
    values = np.column_stack([columns, np.ones(len(columns))])
    sums = np.zeros((len(names), values.shape[1]))
    np.add.at(sums, members, values)
    counts = _counts(len(names), resamples, seed)
    with np.errstate(invalid="ignore", divide="ignore"):
        found = of(counts @ sums)
    low, high = np.nanpercentile(found, [50.0 * (1.0 - level), 50.0 * (1.0 + level)]).tolist()
    return Interval(low, high)


def _counts(clusters: int, resamples: int, seed: int) -> NDArray[np.float64]:
    """How often each cluster is drawn in each resample, (resamples, clusters)."""
    random = np.random.default_rng(seed)
    chosen = random.integers(clusters, size=(resamples, clusters))
    counts = np.zeros((resamples, clusters))
    np.add.at(counts, (np.arange(resamples)[:, None], chosen), 1.0)
    return counts
