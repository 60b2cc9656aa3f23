"""A closed surface from points: of a whole scan, or of a view from one side, whose far side is assumed and said."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.sim.objects import mesh_repair as fix
from allegro_twin.sim.objects.mesh_repair import Repair, Soup
from allegro_twin.sim.objects.remesh import Grid, flood, surface_of, surface_samples
from allegro_twin.sim.objects.scan_files import Numbers, Scan, find_unit

FEWEST = 200
"""Points of a cloud."""
SPARSE = 0.05
"""Share of the size beyond whose distance neighbouring points show no surface."""
GAPS = (2.2, 3.5, 6.0)
"""Multiples of the points' spacing: points nearer to each other than twice that close the surface towards the
outside."""
HALF = 0.5
"""Share of points with the outside on both sides from which on a cloud is a view from one side."""
PLANAR = 0.03
"""Share of the size within which an outline counts as planar, and as symmetric to its mirror image."""
FLAT = 0.04
"""Share of the size below whose depth a view shows no solid."""
GRAZING = 0.45
"""Cosine between view and normal, below which a point of the outline is of the silhouette."""
ASTRAY = 2.0
"""Multiples of the points' spacing, from which on a surface is not that of its points; good ones stay below 1."""
SURE = 0.25
"""Cosine between view and normal, from which a point that is seen shows by itself to which side it looks."""
OPPOSED = 0.01
"""Share of points whose nearest neighbour looks the other way, from which on normals say nothing of the sides."""
WALLS = 0.3
"""Share of a surface."""
EVEN = 0.6
"""Share of the points per area, against a surface that faces an end, from which the sides were seen from more than
there."""
TABLE = 0.3
"""Share of the points of a scan, from which on their plane may be a table."""
STEEP = 0.85
"""Cosine between view and axis, above which a view along the axis shows no side."""
PLATE = 0.03
"""Largest thickness of a closed plate, in extents of the scan."""
_NEIGHBOURS = 14
_OUTLINE = np.radians(130.0)
"""A point without neighbours in so wide an angle is of the outline."""


class ClosedCloud(NamedTuple):
    """A cloud as a solid."""

    solid: Soup
    points: Numbers
    """That were read and used, m."""
    spacing: float
    """Between neighbours that were used, m."""
    unit: str
    scale: float


class Oriented(NamedTuple):
    """Points of a surface and its normals there, which look outwards."""

    points: Numbers
    normals: Numbers
    spacing: float
    """Between neighbours, m."""

    def of(self, rows: Numbers) -> Oriented:
        """Some of them."""
        return self._replace(points=self.points[rows], normals=self.normals[rows])


def close_cloud(path: Path, scan: Scan, scale: float | None, repair: Repair) -> ClosedCloud:
    """The solid that points show. `scale`: as in `find_unit`. Raises ConfigError."""
    points, normals = whole_points(scan, repair)
    if len(points) < FEWEST:
        raise ConfigError(f"{path}: {len(points)} points show no surface; at least {FEWEST}, or --hull")
    unit, factor = find_unit(path, scan, scale, points)
    points = points * factor
    if (plate := find_plate(points)) is not None:
        raise table_error(path, plate)
    cloud = _thinned(path, points, normals)
    solid = _closed(path, cloud, normals is not None, repair, points)
    return ClosedCloud(solid, points, cloud.spacing, unit, factor)


def whole_points(scan: Scan, repair: Repair) -> tuple[Numbers, Numbers | None]:
    """Points and normals of a cloud without broken and stray ones."""
    whole = np.isfinite(scan.points).all(axis=1)
    repair.add(int((~whole).sum()), "point without a place left out", "points without a place left out")
    points, normals = scan.points[whole], None if scan.normals is None else scan.normals[whole]
    if len(points) < FEWEST:
        return points, normals
    kept = ~_stray(points)
    repair.add(int((~kept).sum()), "stray point left out", "stray points left out")
    return points[kept], None if normals is None else normals[kept]


def complete_surface(path: Path, soup: Soup, repair: Repair) -> Soup:
    """The solid of which triangles show one side."""
    spacing = max(0.001, float(np.sqrt(fix.areas(soup).sum() / 60_000)))
    points, normals = surface_samples(soup, spacing)
    return _closed(path, _thinned(path, points, normals), True, repair)


class Plate(NamedTuple):
    """A plane of a scan, wider than the rest of it."""

    edges: tuple[float, float]
    """The longer and the shorter one, m."""
    normal: Numbers
    """(3,)."""

    def __str__(self) -> str:
        return f"{1000 * self.edges[0]:.0f} × {1000 * self.edges[1]:.0f} mm"


CROP = "crop it off in the scanner's program, or in MeshLab or CloudCompare"


def table_error(path: Path, plate: Plate) -> ConfigError:
    """What refuses a scan with its table."""
    return ConfigError(
        f"{path}: a plane of some {plate}, wider than the thing on it, is the table that it was scanned on: {CROP}"
    )


def find_plate(points: Numbers, *, closed: bool = False) -> Plate | None:
    """What a thing stands on, where points, spread evenly over a surface, are of both: a plane that is wider than the
    rest on three sides or four, with nothing behind it. `closed`: a plate with both its faces, so that one has half the
    points and the other may be behind it."""
    least, thick = (TABLE / 2, PLATE) if closed else (TABLE, 0.01)
    rng = np.random.default_rng(0)
    some = points[rng.choice(len(points), min(len(points), 20_000), replace=False)]
    size = float(np.ptp(some, axis=0).max())
    few, best = some[rng.choice(len(some), min(len(some), 3_000), replace=False)], (0, some[0], some[0])
    for corners in some[rng.integers(len(some), size=(300, 3))]:
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        if (length := np.linalg.norm(normal)) < 1e-3 * size**2:
            continue
        near = int((np.abs((few - corners[0]) @ normal) < 0.006 * size * length).sum())
        best = max(best, (near, corners[0], normal / length), key=lambda each: each[0])
    if best[0] < least * len(few):
        return None
    at, normal = _plane(some[np.abs((some - best[1]) @ best[2]) < 0.006 * size])
    height = (some - at) @ normal
    height *= np.sign((height > 0.03 * size).sum() - (height < -0.03 * size).sum()) or 1.0
    plane, rest = some[np.abs(height) < 0.01 * size], some[height > 0.03 * size]
    if len(rest) < 0.01 * len(some) or (height < -thick * size).sum() > 0.01 * len(some):
        return None
    across = np.linalg.svd(normal[None])[2][1:].T
    turns = [across @ [[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]] for a in np.radians(np.arange(0, 90, 5))]
    frame = min(turns, key=lambda each: float(np.prod(np.ptp(plane @ each, axis=0))))
    (low, high), (inner, outer) = (np.quantile(each @ frame, [0.005, 0.995], axis=0) for each in (plane, rest))
    margin = np.concatenate([inner - low, high - outer])
    if (margin > 0.1 * float((outer - inner).max())).sum() < 3:
        return None
    shorter, longer = np.sort(high - low).tolist()
    return Plate((longer, shorter), normal)


def _stray(points: Numbers) -> Numbers:
    """Which points are none of the object: far from their neighbours, or in a small group far from the others."""
    from scipy.spatial import cKDTree  # type: ignore[import-untyped]  # Its types are a package of their own.

    cells = points
    if len(points) > 60_000:
        cells = points[np.random.default_rng(0).choice(len(points), 60_000, replace=False)]
    tree = cKDTree(cells)
    typical = float(np.median(tree.query(cells, k=7)[0][:, -1])) or 1e-9
    lonely = tree.query(points, k=7)[0][:, -1] > 4 * typical
    near = np.flatnonzero(~(tree.query(cells, k=7)[0][:, -1] > 4 * typical))
    if not len(near):
        return np.zeros(len(points), dtype=bool)
    inner = cKDTree(cells[near])
    label = fix.group(len(near), inner.query_pairs(3 * typical, output_type="ndarray"))
    size = np.bincount(label)
    mine = label[inner.query(points)[1]]
    return np.asarray(lonely | (size[mine] < 0.03 * size.max()))


def _thinned(path: Path, points: Numbers, normals: Numbers | None) -> Oriented:
    """About a point in each cell of a grid, with a normal: given, or that of the plane of its neighbours."""
    from scipy.spatial import cKDTree

    size = float(np.ptp(points, axis=0).max())
    cell = max(0.0007, float(np.prod(np.sort(np.ptp(points, axis=0))[1:])) ** 0.5 / 170)
    _, first, place = np.unique(
        np.floor(points / cell).astype(np.int64), axis=0, return_index=True, return_inverse=True
    )
    place = place.ravel()
    count = np.bincount(place)[:, None]
    thin = np.stack([np.bincount(place, points[:, k]) for k in range(3)], axis=1) / count
    if normals is not None:
        given = normals / np.maximum(np.linalg.norm(normals, axis=1), 1e-12)[:, None]
        given = np.nan_to_num(given)
        mean = np.stack([np.bincount(place, given[:, k]) for k in range(3)], axis=1)
        if (
            np.linalg.norm(mean / count, axis=1) < 0.7
        ).mean() < 0.2:  # Else two walls in one cell: the points as they are.
            normals = mean / np.maximum(np.linalg.norm(mean, axis=1), 1e-12)[:, None]
        else:
            thin, normals = points[first], given[first]
    tree = cKDTree(thin)
    k = min(_NEIGHBOURS, len(thin))
    far, near = tree.query(thin, k=k)
    spacing = float(np.median(far[:, min(4, k - 1)]))
    if spacing > SPARSE * size:
        raise ConfigError(
            f"{path}: {len(points)} points, {1000 * spacing:.2g} mm apart, show no surface: scan more of them"
        )
    if normals is None:
        around = thin[near] - thin[near].mean(axis=1, keepdims=True)
        _, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", around, around))
        normals = vectors[:, :, 0]
    return Oriented(thin, normals, spacing)


def _closed(path: Path, cloud: Oriented, given: bool, repair: Repair, scanned: Numbers | None = None) -> Soup:
    """A closed surface of points, of all that were scanned some."""
    grid, outside = _outside(cloud)
    above, below = (_is_outside(cloud, grid, outside, sign) for sign in (1, -1))
    if given and (below & ~above).sum() > (above & ~below).sum():
        cloud, above, below = cloud._replace(normals=-cloud.normals), below, above
        if not (above & below).mean() > HALF:
            repair.done.append("normals turned outwards")
    if (above & below).mean() > HALF and not _thin_walled(cloud, given):
        trial = Repair()
        standing = _capped(cloud, trial, walled=True, scanned=scanned)
        if trial.done:  # Scanned all around, but for what it stands on.
            there, around = _outside(standing)
            both = _is_outside(standing, there, around, 1) & _is_outside(standing, there, around, -1)
            if both.mean() <= HALF:
                repair.done += trial.done
                return _made(path, standing if given else _turned(standing, there, around), there, around)
        cloud = _completed(path, cloud, repair)
        grid, outside = _outside(cloud)
        given = True
    elif not given:
        cloud = _turned(cloud, grid, outside)
    return _made(path, cloud, grid, outside)


def _made(path: Path, cloud: Oriented, grid: Grid, outside: Numbers) -> Soup:
    made = _surface(cloud, grid, outside)
    if made is None:
        raise ConfigError(
            f"{path}: its points enclose nothing: scan it from more sides, or take their convex hull, --hull"
        )
    from scipy.spatial import cKDTree

    far = float(np.quantile(cKDTree(cloud.points).query(made.vertices)[0], 0.9))
    if far > ASTRAY * cloud.spacing:
        raise ConfigError(
            f"{path}: the surface of its points lies up to {1000 * far:.2g} mm beside them, since their normals "
            "contradict each other: make normals that agree in the scanner's program or MeshLab, or --hull"
        )
    return made


def _outside(cloud: Oriented) -> tuple[Grid, Numbers]:
    """What is reached from far away without passing between points, for the narrowest gap that encloses anything."""
    from scipy.ndimage import distance_transform_edt  # type: ignore[import-untyped]  # Its types are a package of their own.

    grid = Grid.around(cloud.points, 3 * cloud.spacing * GAPS[-1], min(0.001, 0.7 * cloud.spacing))
    mask = np.ones(grid.shape, dtype=bool)
    mask[tuple(np.round((cloud.points - grid.low) / grid.step).astype(int).T)] = False
    distance = distance_transform_edt(mask) * grid.step
    best = None
    for gap in GAPS:
        reach = gap * cloud.spacing
        outside = flood(distance > reach)
        deep = ((distance > reach) & ~outside).sum()
        if best is None or deep > 0:
            from_outside = distance_transform_edt(~outside) * grid.step
            best = from_outside < reach - 0.5 * grid.step
        if deep > 0:
            break
    assert best is not None
    return grid, best


def _is_outside(cloud: Oriented, grid: Grid, outside: Numbers, sign: int) -> Numbers:
    at = cloud.points + sign * (2.5 * cloud.spacing + grid.step) * cloud.normals
    index = np.clip(np.round((at - grid.low) / grid.step).astype(int), 0, np.array(grid.shape) - 1)
    return np.asarray(outside[tuple(index.T)])


def _thin_walled(cloud: Oriented, given: bool) -> bool:
    """Whether behind most points there is another that looks the other way: a wall seen from both sides."""
    if not given:
        return False
    from scipy.spatial import cKDTree

    tree = cKDTree(cloud.points)
    some = np.arange(0, len(cloud.points), max(1, len(cloud.points) // 3000))
    near = tree.query_ball_point(cloud.points[some], max(0.008, 4 * cloud.spacing))
    opposite = [bool((cloud.normals[rows] @ cloud.normals[k] < -0.6).any()) for k, rows in zip(some, near, strict=True)]
    return float(np.mean(opposite)) > 0.6


def _turned(cloud: Oriented, grid: Grid, outside: Numbers) -> Oriented:
    """With normals that look to the outside."""
    from scipy.ndimage import gaussian_filter

    field = gaussian_filter(outside.astype(np.float32), 2.5 * cloud.spacing / grid.step)
    index = np.clip(np.round((cloud.points - grid.low) / grid.step).astype(int), 1, np.array(grid.shape) - 2)
    slope = np.stack(
        [field[tuple((index + step).T)] - field[tuple((index - step).T)] for step in np.eye(3, dtype=int)], axis=1
    )
    sign = np.sign(np.einsum("ij,ij->i", slope, cloud.normals))
    return cloud._replace(normals=cloud.normals * np.where(sign == 0, 1, sign)[:, None])


def _surface(cloud: Oriented, grid: Grid, outside: Numbers) -> Soup | None:
    """Where the mean height over the planes of the nearest points is 0 (implicit moving least squares)."""
    from scipy.spatial import cKDTree

    tree = cKDTree(cloud.points)
    width = 1.3 * cloud.spacing

    def height(places: Numbers) -> Numbers:
        found = np.empty(len(places))
        for at in range(0, len(places), 200_000):
            rows = places[at : at + 200_000]
            far, near = tree.query(rows, k=min(12, len(cloud.points)))
            weights = np.exp(-((far - far[:, :1]) / width) * (far + far[:, :1]) / width) + 1e-9
            there = np.einsum("nkj,nkj->nk", rows[:, None] - cloud.points[near], cloud.normals[near])
            agree = np.einsum("nkj,nj->nk", cloud.normals[near], cloud.normals[near[:, 0]]) > -0.2
            weights *= agree  # The other side of a thin wall has no say.
            found[at : at + 200_000] = (weights * there).sum(axis=1) / weights.sum(axis=1)
        return found

    from scipy.ndimage import distance_transform_edt

    mask = np.ones(grid.shape, dtype=bool)
    mask[tuple(np.round((cloud.points - grid.low) / grid.step).astype(int).T)] = False
    near = distance_transform_edt(mask) * grid.step < max(2.5 * cloud.spacing, 2.5 * grid.step)
    made = surface_of(height, outside, near, grid)
    if made is None:
        return None
    part = fix.loose_parts(made)
    shells = [fix.compact(Soup(made.vertices, made.faces[part == k])) for k in range(part.max() + 1)]
    volumes = [fix.volume(shell) for shell in shells]
    best = shells[int(np.argmax(volumes))]
    return best if fix.is_closed(best) and max(volumes) > 0 else None


def _completed(path: Path, cloud: Oriented, repair: Repair) -> Oriented:
    """With the far side: the near one turned about an axis or about the middle of a symmetric outline, or its mirror
    image in the plane of its silhouette; else flat. Raises ConfigError for a view without depth."""
    cloud = _facing(cloud)
    size = float(np.ptp(cloud.points, axis=0).max())
    edge = _is_outline(cloud)
    rim, view = cloud.points[edge], cloud.normals.mean(axis=0)
    view /= np.linalg.norm(view)
    if np.ptp(cloud.points @ view) < FLAT * size or len(rim) < 10:
        raise ConfigError(
            f"{path}: a view from one side, without depth: scan it from a second side, or name its shape in a scenario"
        )
    if (around := _revolved(cloud, view)) is not None:
        repair.done.append("a view from one side: the far side is assumed, turned about an axis that fits the near one")
        return _capped(around, repair)
    middle, silhouette = _middle(rim), rim[cloud.normals[edge] @ view < GRAZING]
    if _mirror_gap(rim, middle) < PLANAR * size:
        back, turned = 2 * middle - cloud.points, -cloud.normals
        said = "the near one turned about the middle of its outline"
    elif len(silhouette) > 0.2 * len(rim):
        at, normal = _plane(silhouette, view)
        height = (cloud.points - at) @ normal
        height -= np.quantile((silhouette - at) @ normal, 0.1)  # Of points around it, the plane is behind most.
        cloud = cloud.of(height > 0.0)
        back = cloud.points - 2 * height[height > 0.0, None] * normal
        turned = cloud.normals - 2 * (cloud.normals @ normal)[:, None] * normal
        said = "the mirror image of the near one in the plane of its silhouette"
    else:
        return _hull(cloud, repair)
    wide = np.sort(np.ptp(rim, axis=0))[::-1]
    repair.done.append(
        f"a view from one side: the far side is assumed, {said} ({1000 * wide[0]:.3g} × {1000 * wide[1]:.3g} mm)"
    )
    whole = Oriented(np.concatenate([cloud.points, back]), np.concatenate([cloud.normals, turned]), cloud.spacing)
    return _capped(whole, repair)


def _revolved(cloud: Oriented, view: Numbers) -> Oriented | None:
    """Turned about the line that all normals meet, in quarters; None where a small turn does not leave it as it is."""
    from scipy.spatial import cKDTree
    from scipy.spatial.transform import Rotation  # type: ignore[import-untyped]  # Its types are a package of their own.

    at, size = cloud.points.mean(axis=0), float(np.ptp(cloud.points, axis=0).max())
    moment = np.cross((cloud.points - at) / size, cloud.normals)
    own, mixed, turns = cloud.normals.T @ cloud.normals, cloud.normals.T @ moment, moment.T @ moment
    solved = np.linalg.pinv(own, rcond=1e-2) @ mixed
    misfit = turns - mixed.T @ solved
    across = np.linalg.svd(view[None])[2][1:].T
    axes = [np.linalg.eigh(misfit)[1][:, 0], across @ np.linalg.eigh(across.T @ misfit @ across)[1][:, 0]]
    axis = axes[0] if abs(axes[0] @ view) < STEEP else axes[1]  # A ball has any axis.
    at = at + size * np.cross(axis, -solved @ axis)

    def turned(degrees: float) -> Oriented:
        turn = Rotation.from_rotvec(np.radians(degrees) * axis).as_matrix()
        return cloud._replace(points=(cloud.points - at) @ turn.T + at, normals=cloud.normals @ turn.T)

    tree = cKDTree(cloud.points)
    for angle in (-20.0, 20.0):
        if np.quantile(tree.query(turned(angle).points)[0], 0.75) > 1.2 * cloud.spacing + 3e-4:
            return None
    copies = [turned(angle) for angle in (0.0, 90.0, 180.0, 270.0)]
    return Oriented(np.concatenate([each.points for each in copies]),
                    np.concatenate([each.normals for each in copies]), cloud.spacing)  # fmt: skip


def _plane(points: Numbers, view: Numbers | None = None) -> tuple[Numbers, Numbers]:
    """A point of the plane that fits points best, and its normal, which looks to a viewer; outliers left out."""
    kept = points
    for _ in range(4):
        at = kept.mean(axis=0)
        normal = np.linalg.svd(kept - at, full_matrices=False)[2][2]
        if view is not None:
            normal = view if abs(normal @ view) < 0.9 else normal * np.sign(normal @ view)  # They are on one line.
        far = np.abs((points - at) @ normal)
        kept = points[far <= np.quantile(far, 0.7)]
    return at, normal


def is_walled(normals: Numbers, weights: Numbers, axis: Numbers) -> bool:
    """Whether so much of a surface is along an axis that no view along it shows it: it was seen from all around."""
    along = np.abs(normals @ axis) < 0.2
    return bool(weights[along].sum() > WALLS * weights.sum())


def _is_even(cloud: Oriented, scanned: Numbers, axis: Numbers) -> bool:
    """Whether points are as dense where a surface is along an axis as where it faces it: no view along it shows that,
    for of what is at an angle to it, it sees less."""
    from scipy.spatial import cKDTree

    some = cloud.of(np.arange(0, len(cloud.points), max(1, len(cloud.points) // 4000)))
    dense = cKDTree(scanned).query(some.points, k=20)[0][:, -1] ** -2.0
    cosine = np.abs(some.normals @ axis)
    side, face = (cosine > 0.1) & (cosine < 0.4), cosine > 0.7
    if min(side.sum(), face.sum()) < 20:
        return False
    return bool(np.median(dense[side]) > EVEN * np.median(dense[face]))


def _capped(cloud: Oriented, repair: Repair, *, walled: bool = False, scanned: Numbers | None = None) -> Oriented:
    """With flat openings closed: ends that no view from the side shows; `walled`: only where walls go up from them, or
    where `scanned`, all points, are as dense on the sides."""
    from scipy.spatial import Delaunay, cKDTree

    rim = cloud.points[_is_outline(cloud)]
    if not len(rim):
        return cloud
    group = fix.group(len(rim), cKDTree(rim).query_pairs(4 * cloud.spacing, output_type="ndarray"))
    points, normals = [cloud.points], [cloud.normals]
    for number in range(group.max() + 1):
        ring = rim[group == number]
        if len(ring) < 8:
            continue
        at, normal = _plane(ring)
        ring = ring[np.abs((ring - at) @ normal) < 1.5 * cloud.spacing]
        first = np.linalg.svd(ring - at, full_matrices=False)[2][0]
        frame = np.stack([first, np.cross(normal, first)])
        flat = (ring - at) @ frame.T
        beyond = np.sort((cloud.points - at) @ normal)
        if len(ring) < 0.5 * (group == number).sum() or np.ptp(flat, axis=0).min() < 4 * cloud.spacing:
            continue
        around = is_walled(cloud.normals, np.ones(len(cloud.normals)), normal)
        if walled and not (around or (scanned is not None and _is_even(cloud, scanned, normal))):
            continue
        if min(beyond[-1], -beyond[0]) > 3 * cloud.spacing:  # No end of the thing.
            continue
        steps = [np.arange(low, high, cloud.spacing) for low, high in zip(flat.min(0), flat.max(0), strict=True)]
        cells = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 2)
        inside = cells[Delaunay(flat).find_simplex(cells) >= 0]
        normal = normal * (np.sign((at - cloud.points.mean(axis=0)) @ normal) or 1.0)
        points.append(at + inside @ frame)
        normals.append(np.tile(normal, (len(inside), 1)))
    repair.add(len(points) - 1, "end closed flat", "ends closed flat")
    return Oriented(np.concatenate(points), np.concatenate(normals), cloud.spacing)


def _hull(cloud: Oriented, repair: Repair) -> Oriented:
    """With the faces of the convex hull that are behind."""
    import manifold3d

    hull = fix.soup_of(manifold3d.Manifold.hull_points(np.ascontiguousarray(cloud.points)))
    points, normals = surface_samples(hull, cloud.spacing)
    behind = normals @ cloud.normals.mean(axis=0) < 0.0
    repair.done.append("a view from one side: the far side is assumed, as flat as the convex hull of what is seen")
    return Oriented(np.concatenate([cloud.points, points[behind]]), np.concatenate([cloud.normals, normals[behind]]),
                    cloud.spacing)  # fmt: skip


def _facing(cloud: Oriented) -> Oriented:
    """With normals to the side from which it was seen: where it bulges.

    Normals that agree with their neighbours' stay or turn all together: what bends around beyond the outline looks away
    from the viewer. Others turn one by one; what is seen at a grazing angle follows its neighbours."""
    normals = cloud.normals
    view = np.linalg.eigh(normals.T @ normals)[1][:, 2]
    if _agree(cloud):
        view = normals.mean(axis=0) / np.linalg.norm(normals.mean(axis=0))
    else:
        for _ in range(5):
            normals = normals * np.where(normals @ view < 0, -1, 1)[:, None]
            view = normals.mean(axis=0) / np.linalg.norm(normals.mean(axis=0))
        normals = _followed(cloud.points, normals, np.abs(normals @ view) > SURE)
    rim = cloud.points[_is_outline(cloud)]
    bulge = (cloud.points.mean(axis=0) - rim.mean(axis=0)) @ view if len(rim) else 1.0
    return cloud._replace(normals=normals if bulge >= 0 else -normals)


def _agree(cloud: Oriented) -> bool:
    """Whether normals look to the same side of the surface as their neighbours'."""
    from scipy.spatial import cKDTree

    _, near = cKDTree(cloud.points).query(cloud.points, k=2)
    against = np.einsum("nj,nj->n", cloud.normals, cloud.normals[near[:, 1]]) < -0.5
    return float(against.mean()) < OPPOSED


def _followed(points: Numbers, normals: Numbers, sure: Numbers) -> Numbers:
    """Normals, turned to the side of their neighbours' where they are not sure themselves, from those that are on."""
    from scipy.spatial import cKDTree

    if not sure.any():
        return normals
    _, near = cKDTree(points).query(points, k=min(_NEIGHBOURS, len(points)))
    normals, known = normals.copy(), sure.copy()
    while not known.all():
        rows = np.flatnonzero(~known & (known[near].sum(axis=1) > 2))
        if not len(rows):
            break
        beside = np.einsum("nk,nkj->nj", known[near[rows]].astype(float), normals[near[rows]])
        normals[rows] *= np.where(np.einsum("nj,nj->n", beside, normals[rows]) < 0, -1, 1)[:, None]
        known[rows] = True
    return normals


def _is_outline(cloud: Oriented) -> Numbers:
    """Which points have no neighbour in a wide angle of their plane."""
    from scipy.spatial import cKDTree

    _, near = cKDTree(cloud.points).query(cloud.points, k=min(22, len(cloud.points)))
    first = np.cross(cloud.normals, np.eye(3)[np.argmin(np.abs(cloud.normals), axis=1)])
    first /= np.maximum(np.linalg.norm(first, axis=1), 1e-12)[:, None]
    second = np.cross(cloud.normals, first)
    ahead = cloud.points[near[:, 1:]] - cloud.points[:, None]
    angle = np.sort(np.arctan2(np.einsum("nkj,nj->nk", ahead, second), np.einsum("nkj,nj->nk", ahead, first)), axis=1)
    gaps = np.diff(angle, axis=1, append=angle[:, :1] + 2 * np.pi)
    return np.asarray(gaps.max(axis=1) > _OUTLINE)


def _middle(rim: Numbers) -> Numbers:
    """The point through which an outline is nearest to its own mirror image, from the middle of its box on."""
    middle: Numbers = (rim.min(axis=0) + rim.max(axis=0)) / 2
    from scipy.spatial import cKDTree

    tree = cKDTree(rim)
    for _ in range(20):
        turned = 2 * middle - rim
        step = (rim[tree.query(turned)[1]] - turned).mean(axis=0) / 2
        middle = middle + step
    return middle


def _mirror_gap(rim: Numbers, middle: Numbers) -> float:
    from scipy.spatial import cKDTree

    return float(np.quantile(cKDTree(rim).query(2 * middle - rim)[0], 0.9))
