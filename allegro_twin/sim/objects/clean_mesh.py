"""A scan as a closed solid: read, repaired, decimated, compared with what was read, and kept in the cache."""

from __future__ import annotations

import json
import shlex
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import cache_folder
from allegro_twin.files.atomic_write import atomic_file
from allegro_twin.files.fingerprints import fingerprint
from allegro_twin.sim.objects import mesh_repair as fix
from allegro_twin.sim.objects.mesh_repair import Repair, Soup
from allegro_twin.sim.objects.point_clouds import (
    CROP,
    PLATE,
    Plate,
    close_cloud,
    complete_surface,
    find_plate,
    is_walled,
    table_error,
    whole_points,
)
from allegro_twin.sim.objects.remesh import Surface, remesh, sample, thicken
from allegro_twin.sim.objects.scan_files import (
    INSTALL,
    LARGEST,
    Numbers,
    Scan,
    check_file,
    find_unit,
    missing_module,
    read_scan,
    stated_unit,
)

if TYPE_CHECKING:
    import manifold3d

TOLERANCE = 0.001
"""m that the result may deviate from what was read, both ways; a hole that is closed does not count."""
COUNTS = (3_000, 8_000, 20_000, 40_000)
"""Triangles of the result: the first that changes the surface by at most LOSS."""
LOSS = 0.0004
"""m."""
TRIMMED = 0.995
"""Share of a cloud's points that its deviation is of: the others are noise."""
_TRIED = 250_000
"""Triangles of a surface that a deviation is measured to, at most: of a scan of millions one in several."""
_SHELLS = 40
"""Most shells of one solid; more are a tangle, which is made anew."""
_TABLE = 0.25
"""m: a closed plate that is wider than that is no part of a thing for a hand."""
_THIN = "if it is a thin wall, allegro-twin mesh --wall 2mm"
"""Note on an open surface that was closed over much of its area."""
_ALLOWED = 0.1
"""Largest tolerance that is offered, in smallest extents of the result: fingers close across that one, and a surface
that is off by more of it is another object to them."""
_WALL = 0.002
"""m: thickness of a wall that a file shows as a surface without one."""


@dataclass(frozen=True)
class ScanSettings:
    """Options of a scan."""

    scale: float | None = None
    """Unit of the file, m; None: as the file or its size says."""
    tolerance: float = TOLERANCE
    """m."""
    wall: float | None = None
    """m: what is open is a wall of this thickness, and is not closed."""


@dataclass(frozen=True)
class Report:
    """Report of the changes to a scan."""

    file: str
    unit: str
    """As it was understood: `mm by its size`, for example."""
    scale: float
    """m."""
    extents: tuple[float, float, float]
    """Extents of the result, m."""
    done: tuple[str, ...]
    """In words."""
    triangles: tuple[int, int]
    """Before and after."""
    points: int
    """Number of points of a cloud."""
    volume: tuple[float, float]
    """Before and after, m³; NaN before where the surface encloses none."""
    deviation: float
    """Largest distance between the surfaces before and after, m."""
    largest_hole: float
    """Width of the largest hole that was closed, m."""

    @property
    def same(self) -> bool:
        """Whether the triangles are those of the file."""
        return self.deviation == 0.0 and self.triangles[0] == self.triangles[1]

    def line(self) -> str:
        """All of it in one line."""
        size = " × ".join(f"{1000 * edge:.3g}" for edge in self.extents)
        parts = [f"{size} mm ({self.unit})", *self.done]
        before, after = self.triangles
        if self.points:
            parts.append(f"{self.points:,} points → {after:,} triangles")
        elif before != after:
            parts.append(f"{before:,} → {after:,} triangles")
        was, now = (1e6 * each for each in self.volume)
        parts.append(f"volume {was:.4g} → {now:.4g} cm³" if np.isfinite(was) else f"volume {now:.4g} cm³")
        parts.append(f"largest deviation {np.round(1000 * self.deviation, 2):g} mm")
        return f"{Path(self.file).name}: {'; '.join(parts)}"


@dataclass(frozen=True)
class CleanMesh:
    """A closed surface, in m, in the axes of its file."""

    vertices: Numbers
    faces: Numbers
    report: Report


@lru_cache(maxsize=32)
def clean_mesh(path: Path, settings: ScanSettings = ScanSettings()) -> CleanMesh:
    """The solid that a scan shows, from the cache where it was made before. Raises ConfigError in a line that says what
    to do."""
    if (missing := missing_module()) is not None:
        raise ConfigError(f"{path}: needs repair ({missing} is missing): {INSTALL}")
    kept = cache_folder("scans", "a repaired mesh") / f"{_cache_key(path, settings)}.npz"
    if kept.is_file():
        return _load(kept, path)
    made = make_clean(path, settings)
    _store(kept, made)
    return made


def make_clean(path: Path, settings: ScanSettings = ScanSettings()) -> CleanMesh:
    """Make the solid that a scan shows, without the cache. Raises ConfigError."""
    scan = read_scan(path)
    return _close(path, scan, settings) if len(scan.faces) else _close_points(path, scan, settings)


def _close_points(path: Path, scan: Scan, settings: ScanSettings) -> CleanMesh:
    repair = Repair(list(scan.notes))
    found = close_cloud(path, scan, settings.scale, repair)
    solid = reduce_triangles(found.solid)
    far = Surface(solid, max(5e-4, 0.3 * found.spacing)).distance(found.points)[0]
    volumes, counts = (float("nan"), fix.volume(solid)), (0, len(solid.faces))
    report = Report(str(path), found.unit, found.scale, _extents(solid), tuple(repair.done), counts, len(scan.points),
                    volumes, float(np.quantile(far, TRIMMED)), 0.0)  # fmt: skip
    return checked(path, CleanMesh(solid.vertices, solid.faces, report), settings)


def _close(path: Path, scan: Scan, settings: ScanSettings) -> CleanMesh:
    repair = Repair(list(scan.notes))
    soup = fix.clean(scan.points, scan.faces, repair)
    if not len(soup.faces):
        raise ConfigError(f"{path}: not a readable mesh: it has no face with an area")
    soup = fix.drop_flecks(soup, repair)
    unit, scale = find_unit(path, scan, settings.scale, soup.vertices)
    soup = Soup(soup.vertices * scale, soup.faces)
    if settings.wall is None and fix.is_flat(soup):
        raise ConfigError(f"{path}: is flat and encloses no volume: allegro-twin mesh --wall 2mm makes a plate of it")
    closed = fix.is_closed(soup)
    if settings.wall is None and not (closed and fix.loose_parts(soup).max() == 0):
        face, some = sample(soup, float(np.sqrt(fix.areas(soup).sum() / 20_000)))
        plate = find_plate(some)
        if plate is not None and (not closed or plate.edges[1] >= _TABLE):
            raise table_error(path, plate)
        weight = (fix.areas(soup) / np.maximum(np.bincount(face, minlength=len(soup.faces)), 1))[face]
        even = some[np.random.default_rng(0).choice(len(some), 20_000, p=weight / weight.sum())]  # Slivers have more.
        if closed and (plate := find_plate(even, closed=True)) is not None:  # It may be the lid below a knob.
            repair.done.append(_plate_note(plate, soup))
    before = soup = fix.drop_flaps(soup, repair)  # Without flecks and flaps.
    if len(soup.faces) > fix.MANY:
        soup = fix.decimate(soup, fix.FEW)
    solid = _solid(path, soup, before, repair, settings)
    whole = solid
    for smoothed in (True, False):
        solid = reduce_triangles(whole, smoothed)
        far = deviation(before, solid, repair.filled, inside=repair.inside, back=not repair.side)
        if far <= settings.tolerance:
            break
    far = max(0.0, far - repair.wall / 2)  # Half the wall is on each side.
    was = abs(fix.volume(before)) if not len(repair.filled) and fix.is_closed(before) else float("nan")
    report = Report(str(path), unit, scale, _extents(solid), tuple(repair.done), (len(scan.faces), len(solid.faces)), 0,
                    (was, fix.volume(solid)), far, repair.largest_hole)  # fmt: skip
    return checked(path, CleanMesh(solid.vertices, solid.faces, report), settings)


def _plate_note(plate: Plate, soup: Soup) -> str:
    part, volumes = fix.loose_parts(soup), list[tuple[bool, float]]()
    size = float(np.ptp(soup.vertices, axis=0).max())
    for k in range(part.max() + 1):
        shell = fix.compact(Soup(soup.vertices, soup.faces[part == k]))
        flat = np.ptp(shell.vertices @ plate.normal) < PLATE * size
        volumes.append((bool(flat), abs(fix.volume(shell))))
    share = sum(volume for flat, volume in volumes if flat) / sum(volume for _, volume in volumes)
    some = f", {100 * share:.2g} % of the volume," if share else ""
    return f"a flat plate of some {plate}{some} is taken as a part of it: if it is the table, {CROP}"


def checked(path: Path, made: CleanMesh, settings: ScanSettings) -> CleanMesh:
    """Return the solid, or raise ConfigError for one that deviates too much from its scan."""
    report = made.report
    if report.deviation > settings.tolerance:
        most = np.ceil(1e4 * report.deviation) / 1e4
        own = f" --scale {settings.scale:g}" if settings.scale is not None else ""
        own += f" --wall {1000 * settings.wall:g}mm" if settings.wall is not None else ""
        command = f"allegro-twin mesh {shlex.quote(path.name)}{own}"
        out = f"--out {shlex.quote(path.with_name(f'{path.stem}_clean.obj').name)}"
        ways = [f"it is open: make a thin wall of it, {command} --wall 2mm {out}"] if _THIN in report.done else []
        if most <= _ALLOWED * min(report.extents):
            ways.append(f"allow it, {command} --tolerance {1000 * most:.1f}mm {out}")
        done = "; ".join(each for each in report.done if each != _THIN)
        raise ConfigError(
            f"{path}: repaired ({done}), its surface deviates by {1000 * report.deviation:.2g} mm, more than "
            f"{1000 * settings.tolerance:.2g} mm: {', or '.join([*ways, 'take its convex hull, --hull'])}"
        )
    return made


def _extents(soup: Soup) -> tuple[float, float, float]:
    x, y, z = np.ptp(soup.vertices, axis=0).tolist()
    return x, y, z


def _solid(path: Path, soup: Soup, before: Soup, repair: Repair, settings: ScanSettings) -> Soup:
    """A closed surface of what triangles show."""
    soup = fix.sew(soup)
    wall = settings.wall or (_WALL if repair.double and not _mostly_closed(soup) else None)
    if settings.wall is not None and fix.is_closed(soup):
        raise ConfigError(
            f"{path}: --wall {1000 * settings.wall:.2g}mm is for an open surface, and this one is closed: leave it out"
        )
    if wall is not None:
        repair.done.append(f"an open surface without thickness is a wall of {1000 * wall:.2g} mm")
        repair.filled = np.empty((0, 3, 3))
        repair.wall = wall
        return thicken(soup, wall)
    oriented = fix.orient(fix.split(soup), repair)
    if oriented is not None:
        mended = fix.fill(oriented, repair)
        if repair.hole_area > fix.SIDE * fix.areas(mended).sum():
            whole = None if _stands(mended, repair) else _completed(path, oriented, settings, repair)
            if whole is not None:
                return whole
            repair.done.append(_THIN)
        if fix.is_closed(mended) and (joined := _joined(mended, repair)) is not None:
            return joined
        soup = mended
    repair.inside = True
    repair.done.append("faces that cross or lie inside replaced by the surface around them")
    size = float(np.ptp(soup.vertices, axis=0).max())
    for gap in (0.0, 0.002, 0.005, 0.03 * size):
        found = remesh(soup, gap)
        if found is not None:
            if (best := _largest(found)) is None:
                break
            return best
    raise ConfigError(
        f"{path}: its faces have no inside, they enclose no volume: allegro-twin mesh --wall 2mm makes a wall of them; "
        "--hull"
    )


def _stands(soup: Soup, repair: Repair) -> bool:
    """Whether walls go up from the closed holes: it was seen from all around, but for what it stands on."""
    a, b, c = (repair.filled[:, k] for k in range(3))
    axis = np.linalg.svd(np.cross(b - a, c - a), full_matrices=False)[2][0]
    area = fix.areas(soup)
    return is_walled(fix.face_normals(soup) / np.maximum(2 * area, 1e-300)[:, None], area, axis)


def _completed(path: Path, before: Soup, settings: ScanSettings, repair: Repair) -> Soup | None:
    """The solid of which an oriented surface shows one side, by symmetry; None where no symmetry fits."""
    trial = Repair()
    try:
        whole = complete_surface(path, before, trial)
    except ConfigError:
        return None
    spacing = float(np.sqrt(fix.areas(before).sum() / 30_000))
    if Surface(whole, spacing).distance(before.vertices)[0].max() > settings.tolerance:
        return None
    repair.done = [*(each for each in repair.done if "hole" not in each), *trial.done]
    repair.filled, repair.inside, repair.largest_hole, repair.side = np.empty((0, 3, 3)), False, 0.0, True
    return whole


def _mostly_closed(soup: Soup) -> bool:
    loops = fix.open_loops(soup)
    size = float(np.ptp(soup.vertices, axis=0).max())
    return all(np.ptp(soup.vertices[loop], axis=0).max() < 0.2 * size for loop in loops)


def _joined(soup: Soup, repair: Repair) -> Soup | None:
    """One solid of closed shells: turned outwards, what overlaps united, what lies in another left out unless it is a
    cavity; None where one of them crosses itself."""
    part = fix.loose_parts(soup)
    if part.max() >= _SHELLS:
        return None
    shells = [fix.compact(Soup(soup.vertices, soup.faces[part == k])) for k in range(part.max() + 1)]
    volumes = [fix.volume(shell) for shell in shells]
    order = np.argsort(-np.abs(volumes))
    whole = abs(volumes[order[0]])
    kept: list[Soup] = []
    cavities: list[Soup] = []
    solid: list[fix.Filled] = []
    turned = inside = 0
    for k in order:
        shell, sign = shells[k], np.sign(volumes[k])
        if abs(volumes[k]) < 1e-9 * whole:  # Two layers of one face.
            continue
        outward = shell if sign > 0 else Soup(shell.vertices, shell.faces[:, ::-1])
        some = shell.vertices[:: max(1, len(shell.vertices) // 50)]
        held = any(each.holds(some).all() for each in solid)
        if held and sign != np.sign(volumes[order[0]]):
            cavities.append(Soup(outward.vertices, outward.faces[:, ::-1]))
            turned += sign > 0
        elif held:
            inside += 1
        else:
            kept.append(outward)
            if len(shells) > 1:
                solid.append(fix.Filled(outward))
            turned += sign < 0
    repair.inside |= inside > 0 or len(kept) > 1
    repair.add(int(turned), "shell turned inside out", "shells turned inside out")
    repair.add(inside, "shell inside another left out", "shells inside others left out")
    if any(
        fix.overlap(shell) > fix.OVERLAP for shell in (*kept, *(Soup(c.vertices, c.faces[:, ::-1]) for c in cavities))
    ):
        return None
    if len(kept) == 1:
        return _stacked([*kept, *cavities])
    solids = [fix.manifold_of(each) for each in kept]
    if any(each is None for each in solids):
        return None
    return _united([each for each in solids if each is not None], cavities, sum(abs(v) for v in volumes), repair)


def _united(solids: list[manifold3d.Manifold], cavities: list[Soup], volumes: float, repair: Repair) -> Soup:
    import manifold3d

    union = manifold3d.Manifold.batch_boolean(solids, manifold3d.OpType.Add)
    parts = sorted(union.decompose(), key=lambda part: -part.volume())
    apart = len(parts)
    if apart < len(solids):
        repair.done.append(f"{len(solids)} shells united into {apart}" if apart > 1 else f"{len(solids)} shells united")
    if apart > 1:
        gap = min(parts[0].min_gap(each, LARGEST) for each in parts[1:])
        repair.done.append(
            f"{apart} separate things, {1000 * gap:.3g} mm apart, all taken as one: for one alone, delete the others"
        )
    return _stacked([fix.soup_of(union), *cavities])


def _stacked(soups: list[Soup]) -> Soup:
    offsets = np.cumsum([0, *(len(each.vertices) for each in soups)])
    return Soup(
        np.concatenate([each.vertices for each in soups]),
        np.concatenate([each.faces + offset for each, offset in zip(soups, offsets, strict=False)]),
    )


def _largest(soup: Soup) -> Soup | None:
    """Without bubbles: parts of less than a hundredth of the volume; None where nothing is enclosed."""
    part = fix.loose_parts(soup)
    large = np.flatnonzero(np.bincount(part) > 20)
    shells = [fix.compact(Soup(soup.vertices, soup.faces[part == k])) for k in large]
    volumes = [fix.volume(shell) for shell in shells]
    if max(volumes, default=0.0) <= 0.0:
        return None
    return _stacked([shell for shell, each in zip(shells, volumes, strict=True) if each > 0.01 * max(volumes)])


def reduce_triangles(soup: Soup, smoothed: bool = True) -> Soup:
    """Simplify a surface: smoothed, with the least triangles of COUNTS that change it little."""
    if len(soup.faces) <= COUNTS[2]:
        return soup
    smooth = fix.smooth(soup) if smoothed else soup
    soup = smooth if fix.is_closed(smooth) and fix.manifold_of(smooth) is not None else soup
    for count in COUNTS:
        if len(soup.faces) <= count:
            return soup
        found = fix.decimate_closed(soup, count)
        if found is not None and deviation(soup, found) <= LOSS:
            return found
    if found is not None:
        return found
    solid = fix.manifold_of(soup)
    if solid is None:
        return soup
    return fix.soup_of(solid.simplify(LOSS / 2))


def deviation(
    before: Soup, after: Soup, filled: Numbers | None = None, *, inside: bool = False, back: bool = True
) -> float:
    """The largest distance between two surfaces by samples, both ways or, without `back`, from the first one, m.

    Places of the result that are nearest to a closed hole do not count, nor, with `inside`, places of the first
    that the result encloses."""
    if len(before.faces) == len(after.faces) and np.array_equal(
        before.vertices[before.faces].sum(axis=1), after.vertices[after.faces].sum(axis=1)
    ):
        return 0.0
    if filled is not None and len(after.faces) == len(before.faces) + len(filled) and _holds(after, before):
        return 0.0
    spacing = max(7e-4, float(np.sqrt(fix.areas(after).sum() / 30_000)))
    result = Surface(after, spacing)
    there = before.vertices[:: max(1, len(before.vertices) // 60_000)]
    if len(before.faces) < 1e5:
        there = np.concatenate([there, sample(before, 1.5 * spacing)[1]])
    far = result.distance(there)[0]
    if inside:
        far[fix.Filled(after).holds(there)] = 0.0
    if not back:
        return float(far.max())
    corners = before.vertices[before.faces[:: max(1, len(before.faces) // _TRIED)]]
    count = len(corners)
    corners = np.concatenate([corners, filled]) if filled is not None else corners
    whole = Soup(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))
    other, which = Surface(whole, spacing).distance(np.concatenate([after.vertices, result.points]))
    return max(float(far.max()), float(other[which < count].max(initial=0.0)))


def _holds(after: Soup, before: Soup) -> bool:
    """Whether all triangles of one are triangles of the other, whichever way round."""
    keys = [np.round(each.vertices[each.faces].sum(axis=1) @ [1.0, np.pi, np.e] * 1e9) for each in (before, after)]
    return bool(np.isin(*keys).all())


def _cache_key(path: Path, settings: ScanSettings) -> str:
    check_file(path)
    versions = [version(name) for name in ("fast-simplification", "manifold3d", "scikit-image", "trimesh")]
    beside = sorted(path.parent.glob("*.bin")) if path.suffix.lower() == ".gltf" else []
    code = sorted(Path(__file__).parent.glob("*.py"))
    name = stated_unit(path) or ""
    return fingerprint(path, path.suffix.lower(), name, beside, asdict(settings), versions, code)


def _store(path: Path, made: CleanMesh) -> None:
    with atomic_file(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, v=made.vertices, f=made.faces, report=np.array(json.dumps(asdict(made.report))))


def _load(kept: Path, path: Path) -> CleanMesh:
    with np.load(kept) as file:
        said = json.loads(str(file["report"]))
        said = {key: tuple(value) if isinstance(value, list) else value for key, value in said.items()}
        return CleanMesh(file["v"], file["f"], replace(Report(**said), file=str(path)))


def hull_points(path: Path, scale: float | None) -> tuple[Numbers, str]:
    """The points of a scan of which its convex hull is, m, without flecks and strays; and what was left out, in a line.
    Raises ConfigError."""
    scan = read_scan(path)
    repair = Repair(list(scan.notes))
    if len(scan.faces):
        points = fix.drop_flecks(fix.clean(scan.points, scan.faces, repair), repair).vertices
    else:
        points = whole_points(scan, repair)[0]
    unit, factor = find_unit(path, scan, scale, points)
    size = " × ".join(f"{1000 * factor * edge:.3g}" for edge in np.ptp(points, axis=0))
    return points * factor, f"{path.name}: {'; '.join([f'{size} mm ({unit})', *repair.done, 'its convex hull'])}"
