"""Robust least squares with few parameters: damped Gauss-Newton steps, derivatives by difference."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from allegro_twin.types import Array, Vector

Residuals = Callable[[Array], Array]
"""Of parameters (k, m), a row each, (k, n), m."""
_STEP = 1e-6  # Of a difference, m and rad.


class Fit(NamedTuple):
    """Where the steps ended."""

    parameters: Vector
    error: float
    """The root of the mean square of what is left, m, in which nothing counts for more than twice the scale."""


def solve(residuals: Residuals, start: Vector, counts: Vector, scale: float, steps: int) -> Fit:
    """The least of Σ c log(1 + r²/s²), Cauchy's loss, under which what is many `scale`, m, away hardly counts.

    `counts` (n,) are the c: for how many points each residual stands.
    """
    now, damping, n = np.asarray(start, dtype=np.float64), 1e-3, len(start)
    every = np.concatenate([np.zeros((1, n)), _STEP * np.eye(n)])
    values = residuals(now + every)
    loss = _loss(values[0], counts, scale)
    for _ in range(steps):
        r, slopes = values[0], (values[1:] - values[0]) / _STEP
        weighted = slopes * (counts / (1.0 + np.square(r / scale)))
        curve = weighted @ slopes.T
        curve.flat[:: n + 1] += damping * curve.flat[:: n + 1] + 1e-9
        step = np.linalg.solve(curve, -(weighted @ r))
        trial = residuals(now + step + every)
        tried = _loss(trial[0], counts, scale)
        if tried < loss:
            now, values, loss, damping = now + step, trial, tried, damping * 0.3
            if np.abs(step).max() < 5e-5:  # 0.05 mm
                break
        else:
            damping *= 10.0
    most = np.minimum(np.square(values[0]), (2.0 * scale) ** 2)
    return Fit(now, float(np.sqrt(most @ counts / counts.sum())))


def _loss(residuals: Array, counts: Vector, scale: float) -> float:
    return float(np.log1p(np.square(residuals / scale)) @ counts)
