"""Things that touch, taken apart: the two or three solids that explain the points of one cluster together.

Points are grouped, a solid is fitted to each group, and each point goes to the solid whose surface is nearest, until
nothing changes; from several first groupings, of which the best is kept.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from allegro_twin.cell.perception.fits.model import Solid
from allegro_twin.types import Array

Groups = NDArray[np.int_]
_REGROUPED = 4
_MEANS = 4
"""First groupings by the nearest of drawn middles, beside those along the longest direction."""
_CUTS = (0.35, 0.5, 0.65)
_DEEP = 0.5
"""Of the smaller one's half extents: a middle deeper inside another solid is no thing of its own."""


class Separated(NamedTuple):
    """A solid and its points."""

    solid: Solid
    members: NDArray[np.bool_]
    """Of the cluster's points, (n,)."""


def separate_solids(
    points: Array, fit: Callable[[Array], Solid | None], good: Callable[[Separated], bool], least: int,
    draws: np.random.Generator,
) -> list[Separated]:  # fmt: skip
    """The solids that explain points, (n, 3), m, together, the one with most points first: two, or else three; none
    where these do not. `fit`: a solid for some of them; `good`: whether one explains its points; `least`: so many
    points has each."""
    for count in (2, 3):
        best, error = list[Separated](), np.inf
        for groups in _first_groups(points, count, draws):
            found = _regrouped(points, groups, count, fit, least)
            off = max((each.solid.error for each in found), default=np.inf)
            if off < error and all(map(good, found)) and not _nested(found):
                best, error = found, off
        if best:
            return sorted(best, key=lambda each: -int(each.members.sum()))
    return []


def _regrouped(
    points: Array, groups: Groups, count: int, fit: Callable[[Array], Solid | None], least: int
) -> list[Separated]:
    """Solids after some rounds of fitting and grouping; none where a group becomes too small or fits nothing."""
    solids: list[Solid] = []
    for _ in range(_REGROUPED):
        if np.bincount(groups, minlength=count).min() < least:
            return []
        fitted = [fit(points[groups == k]) for k in range(count)]
        solids = [solid for solid in fitted if solid is not None]
        if len(solids) < count:
            return []
        after = np.argmin([np.abs(surface_distance(solid, points)) for solid in solids], axis=0)
        if (after == groups).all():
            break
        groups = after
    if np.bincount(groups, minlength=count).min() < least:
        return []
    return [Separated(solid, groups == k) for k, solid in enumerate(solids)]


def _first_groups(points: Array, count: int, draws: np.random.Generator) -> Iterator[Groups]:
    spread = points - points.mean(axis=0)
    if count == 2:
        along = spread @ np.linalg.svd(spread, full_matrices=False)[2][0]
        for part in _CUTS:
            yield (along > np.quantile(along, part)).astype(np.int_)
    for _ in range(_MEANS):
        middles = points[draws.integers(len(points), size=count)]
        groups = np.zeros(len(points), np.int_)
        for _ in range(8):
            groups = np.argmin(np.linalg.norm(points[:, None] - middles, axis=2), axis=1)
            if np.bincount(groups, minlength=count).min() == 0:
                break
            middles = np.stack([points[groups == k].mean(axis=0) for k in range(count)])
        yield groups


def _nested(found: list[Separated]) -> bool:
    """Whether a solid is inside another: then they are two halves of one, or fits of nothing."""
    return any(
        float(surface_distance(other.solid, one.solid.position[None])[0]) < -_DEEP * min(one.solid.size) / 2.0
        for one in found
        for other in found
        if one is not other
    )


def surface_distance(solid: Solid, points: Array) -> Array:
    """From the surface to points (n, 3), m; negative inside. Of an ellipsoid to first order."""
    own, half = (points - solid.position) @ solid.axes, np.array(solid.size) / 2.0
    match solid.shape:
        case "sphere":
            return np.asarray(np.linalg.norm(own, axis=1) - half[0])
        case "ellipsoid":
            part, slope = np.linalg.norm(own / half, axis=1), np.linalg.norm(own / half**2, axis=1)
            return np.asarray(part * (part - 1.0) / np.maximum(slope, 1e-9))
        case "cylinder":
            beyond = np.stack([np.abs(own[:, 0]) - half[0], np.hypot(own[:, 1], own[:, 2]) - half[1]], axis=1)
        case _:
            beyond = np.abs(own) - half
    return np.asarray(np.linalg.norm(np.maximum(beyond, 0.0), axis=1) + np.minimum(beyond.max(axis=1), 0.0))
