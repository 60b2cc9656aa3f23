"""Things that touch, and things with a notch: the two or three solids that explain the points of one cluster together.

Points are grouped, a solid is fitted to each group, and each point goes to the solid whose surface is nearest, until
nothing changes; from several first groupings, of which the best is kept. Whether these solids are one body no picture
tells for certain: `forms_one_body` says which is likelier.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from allegro_twin.cell.perception.fits.model import UP, Solid, half_width
from allegro_twin.types import Array, Vector

Groups = NDArray[np.int_]
_REGROUPED = 4
_MEANS = 4
"""First groupings by the nearest of drawn middles, beside those along the longest direction."""
_CUTS = (0.35, 0.5, 0.65)
_DEEP = 0.5
"""Share of the smaller solid's half extents: a middle deeper inside another solid is no object of its own."""
_RAYS, _BACK = 1500, 0.006 * np.arange(1, 31)
"""So many rays are looked at, and where on each, m before what is seen there."""
_LEVEL, _PARALLEL, _JOINED = 0.004, np.radians(6.0), 0.006
"""m between tops that are one, an angle between edges that are parallel, and m between faces that meet."""
_SHARED = 0.6
"""Share of the narrower solid's width: solids that meet along so much of a face are one body."""


class Separated(NamedTuple):
    """A solid and its points."""

    solid: Solid
    members: NDArray[np.bool_]
    """Membership of the cluster's points, (n,)."""


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


def see_through_share(solid: Solid, points: Array, eye: Vector, deep: float) -> float:
    """How many of points, (n, 3), m, the camera, at `eye`, (3,), m, sees through a solid, more than `deep` inside of
    its surface, m: as a part of those that are seen on it or in it. What is one solid hides what is behind it."""
    inside, at = _along_rays(solid, points, eye)
    through = int(np.count_nonzero(inside < -deep))
    return through / max(through + int(np.count_nonzero(np.abs(at) < deep)), 1)


def background_share(solid: Solid, points: Array, eye: Vector, deep: float) -> float:
    """Share of points, (n, 3), m, that the camera at `eye`, (3,), m, sees behind a solid, through more than `deep`, m,
    of it: what is in a hollow of it does not count."""
    inside, at = _along_rays(solid, points, eye)
    behind = int(np.count_nonzero((inside < -deep) & (at > deep)))
    return behind / max(behind + int(np.count_nonzero(np.abs(at) < deep)), 1)


def _along_rays(solid: Solid, points: Array, eye: Vector) -> tuple[Vector, Vector]:
    """Least signed distances to a solid's surface along the rays to some of the points, before the point and at it,
    (k,) each, m; negative inside."""
    points = points[:: max(1, len(points) // _RAYS)]
    away = points - eye
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    before = points[:, None] - _BACK[:, None] * away[:, None]
    inside = surface_distance(solid, before.reshape(-1, 3)).reshape(len(points), -1).min(axis=1)
    return inside, surface_distance(solid, points)


def forms_one_body(solids: Sequence[Solid]) -> bool:
    """Whether solids that touch are taken for one body: boxes whose tops are level, whose edges are parallel, and that
    meet along a face. Boxes that somebody has put side by side seldom are all that."""
    if any(solid.shape != "box" for solid in solids):
        return False
    tops = [float(solid.position[2]) + half_width(solid, UP) for solid in solids]
    turns = np.array([_turn(solid) for solid in solids])
    off = (turns - turns[0] + np.pi / 4.0) % (np.pi / 2.0) - np.pi / 4.0
    if max(tops) - min(tops) > _LEVEL or np.abs(off).max() > _PARALLEL:
        return False
    linked = {0}
    for _ in solids:
        pairs = [pair for pair in combinations(range(len(solids)), 2) if linked & set(pair)]
        linked |= {k for one, other in pairs if _share_a_face(solids[one], solids[other]) for k in (one, other)}
    return len(linked) == len(solids)


def _share_a_face(one: Solid, other: Solid) -> bool:
    """Whether two boxes with parallel edges meet along most of a face."""
    axes = _level_axes(one)[:2]
    half = np.array([[half_width(solid, axis) for axis in axes] for solid in (one, other)])
    gaps = np.abs(axes @ (other.position - one.position)) - half.sum(axis=0)
    meets, along = (0, 1) if gaps[0] > gaps[1] else (1, 0)
    return bool(gaps[meets] < _JOINED and -gaps[along] > _SHARED * 2.0 * half[:, along].min())


def make_compound(solids: Sequence[Solid]) -> Solid:
    """Solids as one body, in the box around them whose edges are those of the first."""
    axes = _level_axes(solids[0])
    ends = np.array([
        [[axis @ solid.position + way * half_width(solid, axis) for axis in axes] for way in (-1.0, 1.0)]
        for solid in solids
    ])  # fmt: skip
    low, high = ends[:, 0].min(axis=0), ends[:, 1].max(axis=0)
    order = np.argsort(low - high, kind="stable")
    columns = axes[order].T
    columns[:, 2] *= np.linalg.det(columns)
    x, y, z = (high - low)[order].tolist()
    error = max(solid.error for solid in solids)
    return Solid("compound", (low + high) / 2.0 @ axes, columns, (x, y, z), error, tuple(solids))


def _level_axes(solid: Solid) -> Array:
    """Rows of (3, 3): two level ones, along its edges or axis where it has a level one, and the vertical."""
    turn = _turn(solid)
    return np.array([[np.cos(turn), np.sin(turn), 0.0], [-np.sin(turn), np.cos(turn), 0.0], UP])


def _turn(solid: Solid) -> float:
    """The angle of an axis of it that is level, rad."""
    level = min(solid.axes.T, key=lambda axis: abs(float(axis[2])))
    return float(np.arctan2(level[1], level[0]))


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
