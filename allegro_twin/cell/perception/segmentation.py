"""Segmentation: from an organised cloud to the points of each object on the table, or why there are none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from allegro_twin.cell.perception.cloud import Mask, OrganizedCloud, Points, pass_through
from allegro_twin.cell.perception.clusters import ClusterGrid, find_clusters
from allegro_twin.cell.perception.errors import PerceptionRefusal, position_text
from allegro_twin.cell.perception.settings import PerceptionSettings
from allegro_twin.types import Array, Vector

_SAMPLE = 600  # Points by which the drawn planes are judged.


@dataclass(frozen=True, slots=True, eq=False)
class TablePlane:
    """All points p with normal · p = offset."""

    normal: Array
    """Unit, out of the table, (3,)."""
    offset: float
    """m."""
    part: float
    """Share of the examined points that lie on it."""

    def height(self, points: Points) -> Array:
        """Above it, (..., 3) → (...), m."""
        return np.asarray(points @ self.normal - self.offset)

    def axes(self, towards: Array) -> Array:
        """Rows of (3, 3): x along the plane as `towards` (3,) goes, y, and z the normal."""
        along = towards - (towards @ self.normal) * self.normal
        if np.linalg.norm(along) < 1e-6:  # Straight down: any direction will do.
            along = np.cross(self.normal, np.eye(3)[np.argmin(np.abs(self.normal))])
        x = along / np.linalg.norm(along)
        return np.stack([x, np.cross(self.normal, x), self.normal])


def find_plane(
    points: Points, up: Array, draws: np.random.Generator, *, near: float, tilt: float, tries: int = 64
) -> TablePlane | None:
    """The plane on which most points (n, 3) lie within `near`, m, its normal within `tilt`, rad, of `up` (3,).

    None where no three of the drawn points span one. Its `part` says whether it is a table.
    """
    if len(points) < 3:
        return None
    sample = points[draws.integers(len(points), size=_SAMPLE)].astype(np.float64)
    a, b, c = sample[draws.integers(_SAMPLE, size=(3, tries))]
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    normals *= np.copysign(1.0 / np.maximum(lengths, 1e-12), normals @ up)[:, None]
    level = (lengths > 1e-6) & (normals @ up > np.cos(tilt))
    if not level.any():
        return None
    normals, offsets = normals[level], np.add.reduce(normals * a, axis=1)[level]
    hits = np.count_nonzero(np.abs(sample @ normals.T - offsets) < near, axis=0)
    best = int(np.argmax(hits))
    return _refined(points, TablePlane(normals[best], float(offsets[best]), 0.0), near)


def _refined(points: Points, plane: TablePlane, near: float) -> TablePlane:
    """Least squares over the points near it, twice: the second time nearer."""
    for reach in (near, near / 2.0):
        on = points[np.abs(plane.height(points)) < reach].astype(np.float64)
        if len(on) < 3:
            return plane
        middle = on.mean(axis=0)
        normal = np.linalg.eigh((on - middle).T @ (on - middle))[1][:, 0]
        normal *= np.copysign(1.0, normal @ plane.normal)
        plane = TablePlane(normal, float(normal @ middle), 0.0)
    part = np.count_nonzero(np.abs(plane.height(points)) < near) / len(points)
    return TablePlane(plane.normal, plane.offset, part)


_ENOUGH = 200
"""Thinned points in the region without which there is no use in looking for a plane."""
_SHARE = 11
"""Stride through the thinned points in the search for the plane."""
_SCATTER = 3.5
"""A point of the table is this many standard deviations above it so rarely that it makes no thing."""
_MOST = 1800
"""Points of a thing, about: a large thing is thinned to it."""
_TOP = 0.9
"""What is higher than this part of a thing is its top."""
SPECK = 4
"""Thinned points that touch; fewer are taken for the camera's scatter."""
_DEVIATION = 1.4826  # Of a normal deviate, the standard deviation by the median of what is off.
_NOISY = 0.5
"""Times the height from which points are of things: a table that scatters further makes things by itself."""
_SIDES = ("left", "upper", "right", "lower")


@dataclass(frozen=True, slots=True, eq=False)
class Cluster:
    """The points of one thing, with what is known of how they were seen."""

    points: Array
    """(n, 3), m, in `axes` from the world's origin, but heights above the table."""
    axes: Array
    """Rows of (3, 3) in the world: x away from the camera along the table, y, and z its normal."""
    plane: TablePlane
    """In the world."""
    depth: float
    """Median depth of its points, m."""
    pixel: float
    """How far two neighbours are apart across the ray, m."""
    elevation: float
    """By how much the camera looks down at its top, rad."""
    others: int
    """Things beside it."""
    sigma: float
    """The camera's scatter at its depth, m."""
    around: Array
    """All that is seen in the part of the picture where it is, itself too, and as densely, (m, 3), m, in the world."""
    eye: Vector
    """The camera, (3,), m, in the world."""

    def world(self, points: Array) -> Array:
        """Points (n, 3) in its axes, m, in the world."""
        return np.asarray((points + np.array([0.0, 0.0, self.plane.offset])) @ self.axes)


@dataclass(frozen=True, slots=True, eq=False)
class _Gathered:
    """Clusters on the table: those with enough points, largest first, and why the rest cannot be known."""

    large: list[_Found]
    small: list[PerceptionRefusal]


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """The points above the table, thinned."""

    pixels: NDArray[np.int_]
    """Row and column in the thinned picture, (2, n)."""
    points: Points
    """(n, 3), m, in the world."""
    grid: ClusterGrid
    label: int
    members: Mask
    others: int


def depth_scatter(view: OrganizedCloud, settings: PerceptionSettings) -> float:
    """Depth's standard deviation at 1 m, s/(f·B), m; at z it is z² as much."""
    return settings.disparity / (view.focal * settings.baseline)


def find_objects(
    view: OrganizedCloud, settings: PerceptionSettings, draws: np.random.Generator
) -> list[Cluster | PerceptionRefusal]:
    """The points of each thing on the table, or why it cannot be known; first what has most points in
    the picture, so that a near one may come before a larger one. At least one entry."""
    thin = view.cloud[:: settings.stride, :: settings.stride]
    flat = thin.reshape(-1, 3)
    world = view.world(flat)
    inside = np.flatnonzero(pass_through(world, *_bounds(settings)))
    if len(inside) < _ENOUGH:
        return [_empty(flat, len(inside), settings)]
    world, depths = world[inside], flat[inside, 2]
    plane = _table(world, settings, draws)
    if isinstance(plane, PerceptionRefusal):
        return [plane]
    axes = plane.axes(view.rotation[:, 2])
    least = np.maximum(settings.object.above, _SCATTER * depth_scatter(view, settings) * depths**2)
    height = plane.height(world)
    noisy = _too_noisy(height, least, settings)
    if noisy is not None:
        return [noisy]
    above = height > least
    above[above] = view.not_robot(world[above])
    pixels = np.stack(np.divmod(inside[above], thin.shape[1]))
    found = _gathered(pixels, world[above], axes, _cell(view, depths[above], plane, settings), settings)
    if found is None:
        return [_nothing(_SCATTER * depth_scatter(view, settings) * float(depths.max()) ** 2, settings)]
    clear = [_cut_off(one, thin.shape, settings) or _closely(view, one, plane, axes, settings) for one in found.large]
    return [*clear, *found.small]


def find_table(
    view: OrganizedCloud, settings: PerceptionSettings, draws: np.random.Generator
) -> TablePlane | PerceptionRefusal:
    """The table's top, in the world, or why it cannot be known."""
    flat = view.cloud[:: settings.stride, :: settings.stride].reshape(-1, 3)
    world = view.world(flat)
    world = world[pass_through(world, *_bounds(settings))]
    return _empty(flat, len(world), settings) if len(world) < _ENOUGH else _table(world, settings, draws)


def _table(world: Points, settings: PerceptionSettings, draws: np.random.Generator) -> TablePlane | PerceptionRefusal:
    table = settings.table
    plane = find_plane(world[::_SHARE], np.array([0.0, 0.0, 1.0]), draws, near=table.near, tilt=table.tilt)
    if plane is None or plane.part < table.part:
        part = 0.0 if plane is None else plane.part
        said = f"no table: the largest level plane has {part:.0%} of {len(world)} points, and {table.part:.0%} make one"
        return PerceptionRefusal("no_plane", f"{said}; turn the camera towards the table, or set `region` around it")
    return _table_off(plane, settings) or plane


def _table_off(plane: TablePlane, settings: PerceptionSettings) -> PerceptionRefusal | None:
    """Whether a table stands where the cell has it, z = 0, all over the workspace."""
    most, space = settings.table.off, settings.workspace
    if most is None:
        return None
    corners = np.array([(x, y) for x in (space.lower[0], space.upper[0]) for y in (space.lower[1], space.upper[1])])
    heights = (plane.offset - corners @ plane.normal[:2]) / plane.normal[2]
    worst = int(np.argmax(np.abs(heights)))
    height = float(heights[worst])
    if abs(height) <= most:
        return None
    x, y = corners[worst]
    said = (
        f"the table stands {abs(height) * 1e3:.0f} mm {'higher' if height > 0.0 else 'lower'} than the cell's, z = 0, "
        f"at ({x:.3f}, {y:.3f}), and {most * 1e3:g} mm are allowed (`perception.table.off`)"
    )
    return PerceptionRefusal(
        "table", f"{said}; put it level with the arm's base, or calibrate the camera's pose and lens"
    )


def _too_noisy(height: Points, least: Points, settings: PerceptionSettings) -> PerceptionRefusal | None:
    """Whether the table's own points, of heights (n,), m, scatter so far that they make things: those higher than
    `least` (n,), m, are taken for some."""
    on = np.abs(height) < settings.table.near
    part = _DEVIATION * float(np.median(np.abs(height[on]) / least[on])) if on.any() else 0.0
    if part <= _NOISY:
        return None
    scatter = 1e3 * _DEVIATION * float(np.median(np.abs(height[on])))
    said = (
        f"the table's own points scatter by {scatter:.1f} mm, and what is {1e3 * float(np.median(least[on])):.1f} mm "
        f"high is taken for a thing: the camera is noisier than `perception.disparity` says, {settings.disparity:g}"
    )
    return PerceptionRefusal("table", f"{said}; set it to what the camera has, or light the table evenly")


def _bounds(settings: PerceptionSettings) -> tuple[Array, Array]:
    return np.array(settings.region.lower), np.array(settings.region.upper)


def _empty(flat: Points, left: int, settings: PerceptionSettings) -> PerceptionRefusal:
    seen = np.count_nonzero(np.isfinite(flat[:, 2]))
    if seen < _ENOUGH:
        said = f"the cloud is empty: {seen} of {len(flat)} points are known"
        return PerceptionRefusal("empty", f"{said}; move the camera back from what it looks at, or uncover its lens")
    said = f"no table: {left} of {seen} points are in the region {settings.region.lower} to {settings.region.upper}"
    return PerceptionRefusal("no_plane", f"{said}; turn the camera towards it, or set `region` around the table")


def _cell(view: OrganizedCloud, depths: Points, plane: TablePlane, settings: PerceptionSettings) -> float:
    """Edge of the grid's cells, m: no less than what lies on the table between one looked at pixel and the next."""
    if len(depths) == 0:
        return settings.object.gap
    across = settings.stride * float(np.quantile(depths, 0.9)) / view.focal
    return max(settings.object.gap, 1.1 * across / max(float(-view.rotation[:, 2] @ plane.normal), 0.3))


def _gathered(
    pixels: NDArray[np.int_], points: Points, axes: Array, cell: float, settings: PerceptionSettings
) -> _Gathered | None:
    """None: no points, or nothing but specks."""
    if len(points) == 0:
        return None
    places = points @ axes[:2].T.astype(points.dtype)
    grid, sizes = find_clusters(places, cell)
    order = np.argsort(-sizes, kind="stable")
    seen = int(np.count_nonzero(sizes >= SPECK))
    if not seen:
        return None
    enough = int(np.count_nonzero(sizes >= settings.object.least))
    labels = grid.of(places)
    large = [_Found(pixels, points, grid, int(label), labels == label, enough - 1) for label in order[:enough] + 1]
    small = [_too_small(points[labels == label], settings) for label in order[enough:seen] + 1]
    return _Gathered(large, small)


def _nothing(noise: float, settings: PerceptionSettings) -> PerceptionRefusal:
    """`noise`: height, m, up to which points may be noise where the region is furthest."""
    above = settings.object.above
    said = f"nothing stands on the table that is higher than {max(above, noise):.2g} m and seen"
    fix = "put a thing into the region"
    if noise > above:
        said += f", for `perception.disparity` {settings.disparity:g} makes noise of what is lower"
        fix += ", or bring the camera nearer"
    return PerceptionRefusal("no_object", f"{said}; {fix}")


def _too_small(points: Points, settings: PerceptionSettings) -> PerceptionRefusal:
    said = f"something at {position_text(points.mean(axis=0))} is too small to be known from there"
    fix = "move the camera nearer, or lower `perception.object.least`"
    return PerceptionRefusal("small", f"{said}: {len(points)} points, and {settings.object.least} are needed; {fix}")


def _cut_off(found: _Found, shape: tuple[int, ...], settings: PerceptionSettings) -> PerceptionRefusal | None:
    """A thing of which a part may not have been seen has no middle."""
    rows, columns = found.pixels[:, found.members]
    ends = (columns.min() == 0, rows.min() == 0, columns.max() == shape[1] - 1, rows.max() == shape[0] - 1)
    points = found.points[found.members]
    middle = position_text(points.mean(axis=0))
    if any(ends):
        side = _SIDES[ends.index(True)]
        said = f"the thing at {middle} reaches the picture's {side} edge"
        return PerceptionRefusal("cut_off", f"{said}; turn the camera towards it, or move it back")
    lower, upper = _bounds(settings)
    gap = settings.object.gap
    over = points.max(axis=0) > upper - gap
    over[:2] |= points.min(axis=0)[:2] < lower[:2] + gap  # The table cuts off what is below.
    if over.any():
        axis = "xyz"[int(np.argmax(over))]
        said = f"the thing at {middle} reaches the end of `region` along {axis}"
        return PerceptionRefusal("cut_off", f"{said}; move it, or make `region` larger")
    return None


def _closely(
    view: OrganizedCloud, found: _Found, plane: TablePlane, axes: Array, settings: PerceptionSettings
) -> Cluster | PerceptionRefusal:
    """All of its pixels, or as many as are enough."""
    stride, (rows, columns) = settings.stride, found.pixels[:, found.members]
    step = max(1, int(np.sqrt(len(rows) * stride**2 / _MOST)))
    first = [max(int(ends.min() - 1) * stride, 0) for ends in (rows, columns)]
    last = [int(ends.max() + 2) * stride for ends in (rows, columns)]
    near = view.cloud[first[0] : last[0] : step, first[1] : last[1] : step].reshape(-1, 3)
    near = near[pass_through(view.world(near), *_bounds(settings))]  # What is unknown is nowhere.
    world = view.world(near)
    points = world @ axes.T.astype(near.dtype)
    points[:, 2] -= plane.offset
    mine = points[:, 2] > np.maximum(settings.object.above, _SCATTER * depth_scatter(view, settings) * near[:, 2] ** 2)
    mine &= found.grid.spread().of(points[:, :2]) == found.label
    mine[mine] = view.not_robot(world[mine])
    count = np.count_nonzero(mine)
    if count < settings.object.least:
        said = (
            f"of the thing at {position_text(found.points[found.members].mean(axis=0))} {count} points are known, and "
        )
        return PerceptionRefusal(
            "unclear", f"{said}{settings.object.least} are needed; light it evenly, or dull its surface"
        )
    depth = float(np.median(near[mine, 2]))
    mine_points = points[mine].astype(np.float64)
    top = mine_points[mine_points[:, 2] > _TOP * mine_points[:, 2].max()].mean(axis=0)
    way = top @ axes + plane.offset * plane.normal - view.position
    elevation = float(np.arcsin(np.clip(-way @ plane.normal / np.linalg.norm(way), 0.0, 1.0)))
    sigma = depth_scatter(view, settings) * depth**2
    pixel = step * depth / view.focal
    around = world.astype(np.float64)
    return Cluster(mine_points, axes, plane, depth, pixel, elevation, found.others, sigma, around, view.position)
