"""Other objects on the table: where they are, as boxes that arm and hand keep clear of."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from allegro_twin.cell.camera.camera import CameraFrame
from allegro_twin.cell.camera.intrinsics import Cloud
from allegro_twin.cell.perception.cloud import Mask, finite
from allegro_twin.cell.perception.clusters import find_clusters
from allegro_twin.cell.perception.pipeline import Detection
from allegro_twin.cell.perception.segmentation import SPECK, TablePlane
from allegro_twin.cell.perception.settings import PerceptionSettings
from allegro_twin.cell.settings import TraySettings
from allegro_twin.sim.contact.obstacle_clearance import TableObject
from allegro_twin.types import Array

_REACH = 0.6
"""m: further from the middle of the table than this nothing is looked at; the table reaches 0.45 m."""
_TOP = 0.6
"""m: what is higher hangs in the air."""
_SURE = 5.0
"""Standard deviations above the table from which a point is of an object."""
_OWN = 0.012
"""m. What is this near to the chosen object's points, seen from above, is its own."""
_RIM = 0.01
"""m: what is seen so near to the tray is the tray: so well is known where it stands, and what the camera sees."""
_OVERHANG = 0.2
"""m: so far what is in the tray may reach over its walls."""
_DEEP = 0.12
"""m."""
_GROWN, _NEW = 0.015, 100
"""m, and points of a whole picture: what is higher by so much, at so many, is new in a tray."""
_ALMOST_ALL = 0.995
"""Share of a tray's points that count as it; the rest are strays."""
_FEW = 12
"""Thinned points of an object that arm and hand keep clear of; fewer are strays."""


def other_objects(
    frame: CameraFrame, cloud: Cloud, found: Detection, settings: PerceptionSettings, tray: TraySettings | None = None,
    detected: Sequence[Detection] = (),
) -> tuple[Array, ...]:  # fmt: skip
    """Points of each other object, (k, 3) in the world, m, also of those outside perception's region.

    `cloud`: of `frame`, without arm and hand; `found`: the chosen object; `tray`: in which none of them is; `detected`:
    other objects that are left out. Their far sides are not seen: each object is taken to be as deep as it is wide, up
    to `_DEEP`.
    """
    thin = cloud[:: settings.stride, :: settings.stride].reshape(-1, 3)
    known: Array = thin[finite(thin)].astype(np.float64)
    world = frame.pose.world(known)
    own = np.concatenate([found.points, *(each.points for each in detected)])
    depth = float(np.median(((found.points - frame.pose.position) @ frame.pose.rotation)[:, 2]))
    height = found.table.height(world)
    mine = height > np.maximum(settings.object.above, _SURE * found.sigma * (known[:, 2] / depth) ** 2)
    mine &= (height < _TOP) & (np.abs(world[:, :2]).max(axis=1) < _REACH)
    if tray is not None:
        mine &= ~on_tray(world, height, tray, settings.object.gap)
    world = world[mine]
    world = world[~near_points(world, own, _OWN)]
    return tuple(_deepened(points, frame.pose.position) for points in _clusters(world, settings, _FEW))


def protruding_parts(found: Detection, settings: PerceptionSettings) -> tuple[Array, ...]:
    """Points of each part of the chosen object that its solid leaves out, (k, 3), m, world: fingers that come down on a
    handle do not get to where they grasp."""
    return tuple(_clusters(found.protruding, settings, settings.object.least))


def stray_objects(
    frame: CameraFrame, cloud: Cloud, settings: PerceptionSettings, tray: TraySettings, table: TablePlane
) -> tuple[Array, ...]:
    """The middle, (3,), world, m, of each thing that stands on the table outside perception's region and the tray.
    `cloud`: of `frame`, without arm and hand."""
    thin = cloud[:: settings.stride, :: settings.stride].reshape(-1, 3)
    known = thin[finite(thin)].astype(np.float64)
    world = frame.pose.world(known)
    height, region = table.height(world), settings.region
    scatter = settings.disparity / (frame.lens.fx * settings.baseline) * known[:, 2] ** 2
    inside = ((world > region.lower) & (world < region.upper)).all(axis=1)
    mine = (height > np.maximum(settings.object.above, _SURE * scatter)) & (height < _TOP)
    mine &= (np.abs(world[:, :2]).max(axis=1) < _REACH) & ~on_tray(world, height, tray, settings.object.gap)
    clusters = _clusters(world[mine & ~inside], settings, SPECK)
    return tuple((points.min(axis=0) + points.max(axis=0)) / 2.0 for points in clusters)


def _clusters(points: Array, settings: PerceptionSettings, least: int) -> list[Array]:
    """Those of each thing, (k, 3), seen from above; what has fewer points than `least` is left out."""
    if len(points) < least:
        return []
    grid, sizes = find_clusters(points[:, :2], 2.0 * settings.object.gap)
    labels = grid.of(points[:, :2])
    return [points[labels == label + 1] for label in np.flatnonzero(sizes >= least)]


def on_tray(points: Array, height: Array, tray: TraySettings, gap: float) -> Mask:
    """Which points, (n, 3), m, world, are of a tray or of what is in it, (n,). `height`: theirs above the table, (n,),
    m; `gap`: what is nearer than this touches, m. What reaches over a wall is in the tray where most of what is seen of
    it above the walls is: what stands beside the tray is not, however near."""
    away = (np.abs(points[:, :2] - tray.at) - np.array(tray.size) / 2.0).max(axis=1)
    over = away <= _RIM
    high = np.flatnonzero((height > tray.height + _RIM) & (away <= _OVERHANG))
    if len(high):
        grid, sizes = find_clusters(points[high, :2], 2.0 * gap)
        labels = grid.of(points[high, :2])
        inside = np.bincount(labels, weights=over[high], minlength=len(sizes) + 1)
        over[high] |= inside[labels] > 0.5 * np.concatenate([[np.inf], sizes])[labels]
    return np.asarray(over)


def points_in_tray(points: Array, tray: TraySettings) -> Array:
    """Select the points, (..., 3), world, m, that belong to a tray and its contents, (k, 3)."""
    inside = (np.abs(points[..., :2] - tray.at) <= np.array(tray.size) / 2.0).all(axis=-1)
    return np.asarray(points[inside & (points[..., 2] < _TOP)])


def tray_filled(before: Array, after: Array, gap: float) -> bool:
    """Whether something lies in a tray that was not there before. Points of it in two pictures, (k, 3), m; `gap`: what
    is nearer than this is the same place seen from above, m."""
    if not len(before) or not len(after):
        return False
    corner = np.minimum(before.min(axis=0), after.min(axis=0))[:2]
    old, new = (np.floor((points[:, :2] - corner) / gap).astype(int) + 1 for points in (before, after))
    height = np.zeros(np.maximum(old.max(axis=0), new.max(axis=0)) + 2)
    for x, y in ((i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)):
        np.maximum.at(height, (old[:, 0] + x, old[:, 1] + y), before[:, 2])
    return int((after[:, 2] > height[new[:, 0], new[:, 1]] + _GROWN).sum()) >= _NEW


def height_around(points: Array, at: Array, radius: float) -> float:
    """How high points, (k, 3), world, m, reach within a radius of a place, (2,), m; 0 where none are."""
    heights = points[np.linalg.norm(points[:, :2] - at, axis=1) < radius, 2]
    return float(np.quantile(heights, _ALMOST_ALL)) if len(heights) else 0.0


def box_around(points: Array) -> TableObject:
    """The upright box along the world's axes around points, (k, 3), m, down to the table."""
    middle, extents = bounding_box(points)
    return TableObject("box", (float(extents[0]), float(extents[1]), float(extents[2])), 0.0, middle)


def bounding_box(points: Array) -> tuple[Array, Array]:
    """The middle and the extents, (3,) each, m, of the upright box around points, (k, 3), down to the table."""
    low, high = points.min(axis=0), points.max(axis=0)
    low[2] = 0.0
    return (low + high) / 2.0, high - low


def _deepened(points: Array, eye: Array) -> Array:
    """The points, and some behind them where the object may reach."""
    away = points[:, :2].mean(axis=0) - eye[:2]
    away /= max(float(np.linalg.norm(away)), 1e-9)
    deep, wide = np.ptp(points[:, :2] @ away), np.ptp(points[:, :2] @ [-away[1], away[0]])
    more = min(float(wide), _DEEP) - float(deep)
    if more <= 0.0:
        return points
    behind = points.copy()
    behind[:, :2] += more * away
    return np.concatenate([points, behind])


def near_points(points: Array, others: Array, within: float) -> Mask:
    """Which points, (n, 3), are seen from above within about so much, m, of one of the others, (k, 3)."""
    cells = {(x + i, y + j) for x, y in {tuple(cell) for cell in np.floor(others[:, :2] / within).astype(int).tolist()}
             for i in (-1, 0, 1) for j in (-1, 0, 1)}  # fmt: skip
    return np.array([tuple(cell) in cells for cell in np.floor(points[:, :2] / within).astype(int).tolist()], bool)
