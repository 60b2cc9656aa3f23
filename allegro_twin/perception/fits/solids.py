"""Which solid it is: the one that explains the points best."""

from __future__ import annotations

import numpy as np

from allegro_twin.perception.fits.model import Model, Solid
from allegro_twin.perception.fits.round import LYING_EGG, SPHERE, STANDING_EGG
from allegro_twin.perception.fits.sample import Sample, thinned
from allegro_twin.perception.fits.solver import Fit, solve
from allegro_twin.perception.fits.straight import BOX, LYING_CYLINDER, STANDING_CYLINDER
from allegro_twin.types import Vector

MODELS = (SPHERE, STANDING_CYLINDER, BOX, LYING_CYLINDER, LYING_EGG, STANDING_EGG)
_FEW, _MANY = 160, 600
"""Points with which all solids are compared, and with which the best are fitted."""
_FIRST, _THEN = 6, 12
"""Steps likewise."""
_CLOSE = 1.35
"""A solid whose first error is within this factor of the least is fitted too."""
_SIZES = (0.004, 1.0)
"""Edges that a thing on a table may have, m."""


def fitted(seen: Sample, draws: np.random.Generator) -> list[Solid]:
    """The solids that may be it, the best first; none where none converges to a size that a thing can have."""
    few, many = thinned(seen, _FEW, draws), thinned(seen, _MANY, draws)
    scale = max(0.002, 1.5 * seen.sigma)
    first = [(model, _solved(model, few, _best_start(model, few, scale), scale, _FIRST)) for model in MODELS]
    first = [(model, fit) for model, fit in first if _possible(model.solid(*fit))]
    least = min((fit.error for _, fit in first), default=0.0)
    found = [
        model.solid(*_solved(model, many, fit.parameters, scale, _THEN))
        for model, fit in first
        if fit.error <= _CLOSE * least
    ]
    return sorted(filter(_possible, found), key=lambda solid: solid.error)


def _solved(model: Model, seen: Sample, start: Vector, scale: float, steps: int) -> Fit:
    return solve(model.residuals(seen), start, model.counts(seen), scale, steps)


def _best_start(model: Model, seen: Sample, scale: float) -> Vector:
    starts = model.starts(seen)
    if len(starts) == 1:
        return starts[0]
    off = model.residuals(seen)(np.stack(starts))
    return starts[int(np.argmin(np.log1p(np.square(off / scale)) @ model.counts(seen)))]


def _possible(solid: Solid) -> bool:
    return bool(np.isfinite(solid.error)) and all(_SIZES[0] < edge < _SIZES[1] for edge in solid.size)
