"""How well a figure tells success from failure."""

from __future__ import annotations

import math

import numpy as np

from allegro_twin.types import Array


def auc(values: Array, outcome: Array) -> float:
    """The area under the ROC curve: how often a success has the larger value than a failure, a tie counting half.

    From ranks, (R₊ − n₊(n₊ + 1)/2) / (n₊ n₋), where equal values share their mean rank (Hanley and McNeil, Radiology
    143, 1982). `values`: (k,), NaN where there is none, which is left out; `outcome`: (k,), true where it succeeded.
    NaN where all that is left had the same outcome.
    """
    known = ~np.isnan(values)
    figures, good = values[known], outcome[known].astype(bool)
    above, below = int(good.sum()), int((~good).sum())
    if not above or not below:
        return math.nan
    _, place, count = np.unique(figures, return_inverse=True, return_counts=True)
    rank = (np.cumsum(count) - (count - 1) / 2.0)[place]
    return float((rank[good].sum() - above * (above + 1) / 2.0) / (above * below))
