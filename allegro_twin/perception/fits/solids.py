"""Which solid it is: the one that explains the points best."""

from __future__ import annotations

import numpy as np

from allegro_twin.perception.fits.model import Model, Solid
from allegro_twin.perception.fits.round import LYING_EGG, SPHERE, STANDING_EGG
from allegro_twin.perception.fits.sample import Sample, thinned
from allegro_twin.perception.fits.solver import Fit, solve
from allegro_twin.perception.fits.straight import BOX, LYING_CYLINDER, STANDING_CYLINDER
from allegro_twin.types import Vector

UPRIGHT, OTHERS = (STANDING_CYLINDER, BOX), (SPHERE, LYING_EGG, STANDING_EGG, LYING_CYLINDER)
_FEW, _MANY = 160, 600
"""Points with which all solids are compared, and with which the best are fitted."""
_GLANCE, _FIRST, _THEN = 3, 4, 12
"""Steps to see whether it can be that at all, then to compare, then to fit."""
_HOPELESS = 2.5
"""So many times the least error after a glance is given up."""
_GOOD, _FLOOR = 1.1, 0.0004
"""An upright solid whose error is below so many of the camera's scatter, and of what steps in depth and the drawing
of round things add to it, m, is it: nothing else has a level top and upright sides."""
_STARTS = 2
"""Tried of those that a solid may have."""
_CLOSE = 1.35
"""A solid whose first error is within this factor of the least is fitted too."""
_SIZES = (0.004, 1.0)
"""Edges that a thing on a table may have, m."""


def fitted(seen: Sample, draws: np.random.Generator) -> list[Solid]:
    """The solids that may be it, the best first; none where none converges to a size that a thing can have."""
    few, many = thinned(seen, _FEW, draws), thinned(seen, _MANY, draws)
    scale = max(0.002, 1.5 * seen.sigma)
    found, least = [], np.inf
    for model in UPRIGHT + OTHERS:
        if model is OTHERS[0] and least < _GOOD * np.hypot(seen.sigma, _FLOOR):
            break
        fit = _compared(model, few, scale, least)
        if fit is not None and _possible(model.solid(*fit)):
            found.append((model, fit))
            least = min(least, fit.error)
    close = [
        model.solid(*_solved(model, many, fit.parameters, scale, _THEN))
        for model, fit in found
        if fit.error <= _CLOSE * least
    ]
    return sorted(filter(_possible, close), key=lambda solid: solid.error)


def _compared(model: Model, seen: Sample, scale: float, least: float) -> Fit | None:
    """The better of its fits, or None where none is worth more than a glance beside the `least` error so far."""
    glances = [_solved(model, seen, start, scale, _GLANCE) for start in _best_starts(model, seen, scale)]
    fits = [_solved(model, seen, fit.parameters, scale, _FIRST) for fit in glances if fit.error <= _HOPELESS * least]
    return min(fits, key=lambda fit: fit.error, default=None)


def _solved(model: Model, seen: Sample, start: Vector, scale: float, steps: int) -> Fit:
    return solve(model.residuals(seen), start, model.counts(seen), scale, steps)


def _best_starts(model: Model, seen: Sample, scale: float) -> list[Vector]:
    """Those with the least loss."""
    starts = model.starts(seen)
    if len(starts) <= _STARTS:
        return starts
    loss = np.log1p(np.square(model.residuals(seen)(np.stack(starts)) / scale)) @ model.counts(seen)
    return [starts[k] for k in np.argsort(loss)[:_STARTS]]


def _possible(solid: Solid) -> bool:
    return bool(np.isfinite(solid.error)) and all(_SIZES[0] < edge < _SIZES[1] for edge in solid.size)
