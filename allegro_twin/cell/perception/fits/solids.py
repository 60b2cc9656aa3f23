"""Choice of the solid that explains the points of an object best."""

from __future__ import annotations

import numpy as np

from allegro_twin.cell.perception.fits.model import PointSample, Solid, SolidFit, SolidModel, solve, thinned
from allegro_twin.cell.perception.fits.round import LYING_EGG, SPHERE, STANDING_EGG
from allegro_twin.cell.perception.fits.straight import BOX, LYING_CYLINDER, STANDING_CYLINDER
from allegro_twin.types import Vector

_UPRIGHT = (STANDING_CYLINDER, BOX)
Models = tuple[tuple[SolidModel, tuple[SolidModel, ...]], ...]
MODELS: Models = (
    (STANDING_CYLINDER, ()),
    (BOX, (STANDING_CYLINDER,)),
    (SPHERE, ()),
    (LYING_EGG, _UPRIGHT),
    (STANDING_EGG, _UPRIGHT),
    (LYING_CYLINDER, (*_UPRIGHT, SPHERE)),
)
"""In the order in which they are tried, each with those of which a good one makes it needless: nothing else has a
level top and upright sides. An egg may look like a ball, and a small ball far away like a can."""
_AGAIN: Models = ((LYING_EGG, ()), (LYING_CYLINDER, ()))
"""Those that may have been looked for in the wrong places."""
_FEW, _MANY = 120, 400
"""Points with which all solids are compared, and with which the best are fitted."""
_GLANCE, _FIRST, _THEN = 3, 4, 12
"""Steps to see whether it can be that at all, then to compare, then to fit."""
_HOPELESS = 2.5
"""So many times the least error after a glance is given up."""
_GOOD, _FLOOR = 0.95, 0.0004
"""A solid is good when its error is below so many of the camera's scatter, and of what steps in depth and the drawing
of round things add to it, m."""
_CLEARLY = 0.93
"""It is a ball, or what was found first, unless another's error is below this part of it."""
_STARTS, _MORE = 2, 6
"""Tried of those that a solid may have: at first, and where that makes nothing good."""
_CLOSE = 1.25
"""What has an error within this factor of the least is followed too."""
_SIZES = (0.004, 1.0)
"""Edges that a thing on a table may have, m."""


def fit_solids(sample: PointSample, draws: np.random.Generator) -> list[Solid]:
    """The solids that may be it, the best first; none where none converges to a size that a thing can have."""
    few, many = thinned(sample, _FEW, draws), thinned(sample, _MANY, draws)
    good = _GOOD * float(np.hypot(sample.sigma, _FLOOR))
    found = _best(MODELS, few, many, good, _STARTS)
    if found and found[0].error <= good:
        return found
    least = found[0].error if found else np.inf
    better = [solid for solid in _best(_AGAIN, few, many, good, _MORE) if solid.error < _CLEARLY * least]
    return better + found


def _best(models: Models, few: PointSample, many: PointSample, good: float, starts: int) -> list[Solid]:
    """Those of them whose error with few points is near the least, with many points."""
    scale = max(0.002, 1.5 * few.sigma)
    tried = _tried(models, few, scale, good, starts)
    least = min((fit.error for _, fit in tried), default=0.0)
    ball = next((fit.error for model, fit in tried if model is SPHERE), np.inf)
    close = [(model, fit) for model, fit in tried if fit.error <= _CLOSE * least]
    if least > _CLEARLY * ball:
        close = [(model, fit) for model, fit in close if model is SPHERE]
    found = [model.solid(*_solved(model, many, fit.parameters, scale, _THEN)) for model, fit in close]
    return sorted(filter(_possible, found), key=lambda solid: solid.error)


def _tried(
    models: Models, few: PointSample, scale: float, good: float, starts: int
) -> list[tuple[SolidModel, SolidFit]]:
    """One fit of each solid that it may be, from so many starts, until one is so `good` that the rest are needless."""
    found: list[tuple[SolidModel, SolidFit]] = []
    least = np.inf
    for model, needless in models:
        if any(fit.error < good for other, fit in found if other in needless):
            continue
        fit = _compared(model, few, scale, least, starts)
        if fit is not None and _possible(model.solid(*fit)):
            found.append((model, fit))
            least = min(least, fit.error)
    return found


def _compared(model: SolidModel, sample: PointSample, scale: float, least: float, starts: int) -> SolidFit | None:
    """The best of its fits, or None where none is worth more than a glance beside the `least` error so far."""
    glances = [_solved(model, sample, start, scale, _GLANCE) for start in _best_starts(model, sample, scale, starts)]
    most = min(_HOPELESS * least, _CLOSE * min(fit.error for fit in glances))
    fits = [_solved(model, sample, fit.parameters, scale, _FIRST) for fit in glances if fit.error <= most]
    return min(fits, key=lambda fit: fit.error, default=None)


def _solved(model: SolidModel, sample: PointSample, start: Vector, scale: float, steps: int) -> SolidFit:
    return solve(model.residuals(sample), start, model.counts(sample), scale, steps)


def _best_starts(model: SolidModel, sample: PointSample, scale: float, most: int) -> list[Vector]:
    """Those with the least loss, so many at most."""
    starts = model.starts(sample)
    if len(starts) <= most:
        return starts
    loss = np.log1p(np.square(model.residuals(sample)(np.stack(starts)) / scale)) @ model.counts(sample)
    return [starts[k] for k in np.argsort(loss)[:most]]


def _possible(solid: Solid) -> bool:
    return bool(np.isfinite(solid.error)) and all(_SIZES[0] < edge < _SIZES[1] for edge in solid.size)
