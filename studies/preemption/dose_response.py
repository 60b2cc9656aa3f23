"""Success against overlap: a logistic curve, and the overlap at which half of the success is gone."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from allegro_twin.types import Array

_TURNS = 200
_STEEP = 1e-6
"""Of a ridge that keeps the fit finite where all, or none, succeed."""


class Dose(NamedTuple):
    """logit p = a + b φ."""

    a: float
    b: float

    def rate(self, overlap: float) -> float:
        """p at φ."""
        return 1.0 / (1.0 + math.exp(-min(max(self.a + self.b * overlap, -500.0), 500.0)))

    @property
    def half(self) -> float:
        """φ₅₀, where the rate is half of that at 0; infinite where it does not fall."""
        target = 0.5 * self.rate(0.0)
        if self.b >= 0.0 or target <= 0.0:
            return math.inf
        return (math.log(target / (1.0 - target)) - self.a) / self.b


def fit(overlap: Array, held: Array) -> Dose:
    """The most likely curve for some trials, (k,) each."""
    found = logistic(np.column_stack([np.ones(len(overlap)), overlap]), held, np.full(2, _STEEP))
    return Dose(float(found[0]), float(found[1]))


def logistic(design: Array, held: Array, ridge: Array) -> Array:
    """The weights w, (m,), of logit p = X w for trials with a design X, (k, m), and outcomes, (k,), under a ridge of
    ½ Σ λ w², by Newton's method (iteratively reweighted least squares). Its steps are halved until they lead to a
    likelier one: where failures begin at one place, the curve is steep."""
    found = np.zeros(design.shape[1])

    def cost(at: Array) -> float:
        z = design @ at
        return float(np.sum(np.logaddexp(0.0, z) - held * z) + 0.5 * (ridge * at) @ at)

    for _ in range(_TURNS):
        p = 1.0 / (1.0 + np.exp(-np.clip(design @ found, -500.0, 500.0)))
        slope = design.T @ (held - p) - ridge * found
        curve = (design * (p * (1.0 - p))[:, None]).T @ design + np.diag(ridge)
        step = np.linalg.solve(curve, slope)
        while cost(found + step) > cost(found) and np.abs(step).max() > 1e-12:
            step = 0.5 * step
        found = found + step
        if np.abs(step).max() < 1e-10:
            break
    return np.asarray(found)
