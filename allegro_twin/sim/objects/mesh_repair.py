"""A closed surface from the triangles of a scan: welded, turned outwards, holes filled, shells joined.

Exact where it can be: the triangles stay where they are. What cannot be mended so (walls inside, faces that cross each
other) is made anew on a grid, see `remesh`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from allegro_twin.sim.objects.scan_files import Numbers, fill_polygon

if TYPE_CHECKING:
    import manifold3d

WELD = 1e-6
"""Share of the size below whose distance vertices are one."""
FLAT = 1e-5
"""Share of the size below whose depth a surface encloses nothing."""
SEAM = 2e-4
"""m: vertices of open edges nearer than that are one."""
FLECK = 0.01
"""Share of the largest part's area below which a loose part is a fleck of the scan."""
MANY, FEW = 400_000, 200_000
"""More triangles than that are decimated to so many before anything else."""
OVERLAP = 0.003
"""Share of the volume that may be counted twice, or inside out, in what passes as one solid."""
SIDE = 0.3
"""Share of the whole area from which a hole is the unseen side of a view from one side."""
DOUBLE = 0.5
"""Share of faces that are there twice, seen from both sides, from which on a surface is a wall without thickness."""


_CARE = 3
"""Aggressiveness of the decimation, from 1 to 10, careful to hasty: at its usual 7 single vertices are off by a
millimetre."""
_PASSES = 8
"""Passes of the smoothing."""


class Soup(NamedTuple):
    """Triangles of any quality, in m."""

    vertices: Numbers
    faces: Numbers


@dataclass
class Repair:
    """Findings and changes of a repair; the lines of the report."""

    done: list[str] = field(default_factory=list)
    filled: Numbers = field(default_factory=lambda: np.empty((0, 3, 3)))
    """Corners of the triangles that close holes, (m, 3, 3), m."""
    largest_hole: float = 0.0
    """Its width, m."""
    hole_area: float = 0.0
    """Area of all holes, m²."""
    inside: bool = False
    """Faces inside the solid are left out."""
    side: bool = False
    """Only one side was seen; the other is assumed."""
    wall: float = 0.0
    """Thickness that an open surface was given, m."""
    double: bool = False
    """Most faces are there twice, once from each side."""

    def add(self, count: int, one: str, many: str | None = None) -> None:
        """Note something that was done to `count` things."""
        if count:
            self.done.append(f"{count:,} {one if count == 1 else many or one + 's'}")


def areas(soup: Soup) -> Numbers:
    """Areas of the triangles, (m,), m²."""
    return np.asarray(np.linalg.norm(face_normals(soup), axis=1) / 2)


def face_normals(soup: Soup) -> Numbers:
    """Normals of the triangles, with twice the area as length, (m, 3), m²."""
    a, b, c = (soup.vertices[soup.faces[:, k]] for k in range(3))
    return np.asarray(np.cross(b - a, c - a))


def volume(soup: Soup) -> float:
    """Enclosed, m³, negative where faces look inwards."""
    middle = soup.vertices.mean(axis=0)
    a, b, c = (soup.vertices[soup.faces[:, k]] - middle for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def is_flat(soup: Soup) -> bool:
    """Whether all of it is in one plane."""
    size = float(np.ptp(soup.vertices, axis=0).max())
    some = soup.vertices - soup.vertices.mean(axis=0)
    normal = np.linalg.eigh(some.T @ some)[1][:, 0]
    return bool(np.ptp(some @ normal) < FLAT * size)


def compact(soup: Soup) -> Soup:
    """Without vertices that no face uses."""
    used, place = np.unique(soup.faces, return_inverse=True)
    return Soup(soup.vertices[used], place.reshape(-1, 3))


def clean(vertices: Numbers, faces: Numbers, repair: Repair) -> Soup:
    """Welded, without broken, empty and repeated faces."""
    whole = np.logical_and.reduce((faces >= 0) & (faces < len(vertices)), axis=1)
    whole[whole] = np.logical_and.reduce(np.isfinite(vertices), axis=1)[faces[whole]].all(axis=1)
    repair.add(int((~whole).sum()), "face without a place left out", "faces without a place left out")
    if not whole.any():
        return Soup(np.empty((0, 3)), np.empty((0, 3), dtype=np.int64))
    soup = _welded(compact(Soup(vertices, faces[whole])))
    if not len(soup.faces):
        return soup
    rows = np.sort(soup.faces, axis=1)
    _, first, count = np.unique(_key(rows, len(soup.vertices)), return_index=True, return_counts=True)
    if len(first) < len(rows):
        repair.add(len(rows) - len(first), "repeated face left out", "repeated faces left out")
        repair.double = bool((count > 1).sum() > DOUBLE * len(first)) and _both_sides(soup.faces, rows)
    return compact(Soup(soup.vertices, soup.faces[np.sort(first)]))


def _both_sides(faces: Numbers, rows: Numbers) -> bool:
    """Whether most repeated faces have the opposite sense of those that they repeat."""
    start = faces == rows[:, :1]
    turned = np.take_along_axis(faces, (start.argmax(axis=1)[:, None] + [0, 1, 2]) % 3, axis=1)
    even = turned[:, 1] == rows[:, 1]
    return bool(abs(even.mean() - 0.5) < 0.2)


def _key(rows: Numbers, count: int) -> Numbers:
    """One integer for each row of indices."""
    found = rows[:, 0].astype(np.int64)
    for column in range(1, rows.shape[1]):
        if count ** rows.shape[1] < 2**62:
            found = found * count + rows[:, column]
        else:  # Rank pairs first.
            _, found = np.unique(found * count + rows[:, column], return_inverse=True)
    return np.asarray(found)


def _welded(soup: Soup) -> Soup:
    low, size = soup.vertices.min(axis=0), float(np.ptp(soup.vertices, axis=0).max()) or 1.0
    steps = np.round((soup.vertices - low) / (size * WELD)).astype(np.int64)
    packed = (steps[:, 0] << 42) | (steps[:, 1] << 21) | steps[:, 2]
    _, first, place = np.unique(packed, return_index=True, return_inverse=True)
    return _without_empty(Soup(soup.vertices[first], place[soup.faces]))


def _without_empty(soup: Soup) -> Soup:
    a, b, c = soup.faces.T
    return Soup(soup.vertices, soup.faces[(a != b) & (b != c) & (c != a)])


def decimate(soup: Soup, count: int) -> Soup:
    """Fewer triangles, by quadric errors."""
    import fast_simplification

    middle = soup.vertices.mean(axis=0)  # Single precision, about the middle and in units of the size.
    size = float(np.ptp(soup.vertices, axis=0).max()) or 1.0
    places, faces = fast_simplification.simplify(
        ((soup.vertices - middle) / size).astype(np.float32), soup.faces.astype(np.int32), target_count=count, agg=_CARE
    )
    return compact(_without_empty(Soup(places.astype(np.float64) * size + middle, faces.astype(np.int64))))


def decimate_closed(soup: Soup, count: int) -> Soup | None:
    """Simplify a closed surface, and separate parts that then touch at an edge. None where the result is no solid."""
    found = decimate(soup, count)
    solid = manifold_of(found)
    if solid is None or is_closed(found):
        return None if solid is None else found
    apart = soup_of(solid)
    return apart if is_closed(apart) else None


def smooth(soup: Soup) -> Soup:
    """The surface without noise that is finer than a few edges, and not smaller (Taubin, SIGGRAPH 1995)."""
    from scipy.sparse import coo_array, diags_array  # type: ignore[import-untyped]  # Its types are a package of their own.

    count, (a, b) = len(soup.vertices), (soup.faces.ravel(), soup.faces[:, [1, 2, 0]].ravel())
    joined = coo_array((np.ones(len(a)), (a, b)), shape=(count, count)).tocsr()
    mean = diags_array(1.0 / np.maximum(joined.sum(axis=1), 1.0)) @ joined
    places = soup.vertices
    for _ in range(_PASSES):
        for step in (0.5, -0.53):
            places = places + step * (mean @ places - places)
    return Soup(places, soup.faces)


class _Edges(NamedTuple):
    """Edges of triangles: three each, one after the other."""

    start: Numbers
    end: Numbers
    edge: Numbers
    """Number of the edge that each is of."""
    faces: Numbers
    """How many meet at each edge."""


def _edges(soup: Soup) -> _Edges:
    start, end = soup.faces.ravel(), soup.faces[:, [1, 2, 0]].ravel()
    low, high = np.minimum(start, end), np.maximum(start, end)
    _, edge, count = np.unique(low * len(soup.vertices) + high, return_inverse=True, return_counts=True)
    return _Edges(start, end, edge, count)


def _pairs(edges: _Edges) -> tuple[Numbers, Numbers]:
    """Faces that share an edge with exactly one other, (k, 2), and whether they run along it in opposite directions."""
    inner: Numbers = np.flatnonzero(edges.faces[edges.edge] == 2)
    inner = inner[np.argsort(edges.edge[inner], kind="stable")].reshape(-1, 2)
    return inner // 3, edges.start[inner[:, 0]] != edges.start[inner[:, 1]]


def patches(soup: Soup) -> Numbers:
    """Number of each face's part of the surface: parts meet at most at edges of three faces or more."""
    pairs, _ = _pairs(_edges(soup))
    return group(len(soup.faces), pairs)


def group(count: int, pairs: Numbers) -> Numbers:
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components  # type: ignore[import-untyped]  # Its types are a package of their own.

    graph = coo_array((np.ones(len(pairs), dtype=np.int8), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1])


def sew(soup: Soup) -> Soup:
    """Vertices of open edges that all but coincide as one."""
    from scipy.spatial import cKDTree  # type: ignore[import-untyped]  # Its types are a package of their own.

    edges = _edges(soup)
    single = edges.faces[edges.edge] == 1
    loose = np.unique(np.concatenate([edges.start[single], edges.end[single]]))
    if not len(loose):
        return soup
    size = float(np.ptp(soup.vertices, axis=0).max())
    length = np.linalg.norm(soup.vertices[edges.start[single]] - soup.vertices[edges.end[single]], axis=1)
    near = min(SEAM, 1e-3 * size, 0.2 * float(np.median(length)))
    pairs = cKDTree(soup.vertices[loose]).query_pairs(near, output_type="ndarray")
    if not len(pairs):
        return soup
    label = group(len(loose), pairs)
    place = np.arange(len(soup.vertices))
    first = np.full(label.max() + 1, -1)
    first[label[::-1]] = loose[::-1]
    place[loose] = first[label]
    return compact(_without_empty(Soup(soup.vertices, place[soup.faces])))


def orient(soup: Soup, repair: Repair) -> Soup | None:
    """Neighbours run along their edge in opposite directions, each part as most of its area did; None where a part has
    one side only. Solved at once: of two copies of each face, one turned, those are connected that fit each other."""
    pairs, fit = _pairs(_edges(soup))
    count = len(soup.faces)
    if fit.all():
        return soup
    other = np.where(fit, pairs[:, 1], pairs[:, 1] + count)
    again = np.where(fit, pairs[:, 1] + count, pairs[:, 1])
    both = np.concatenate([np.stack([pairs[:, 0], other], axis=1), np.stack([pairs[:, 0] + count, again], axis=1)])
    label = group(2 * count, both)
    if (label[:count] == label[count:]).any():
        return None
    area = areas(soup)
    kept = np.bincount(label[:count], area, label.max() + 1)
    as_is = kept[label[:count]] >= kept[label[count:]]
    repair.add(int((~as_is).sum()), "face turned round", "faces turned round")
    return Soup(soup.vertices, np.where(as_is[:, None], soup.faces, soup.faces[:, ::-1]))


def drop_flaps(soup: Soup, repair: Repair) -> Soup:
    """Without small open parts that hang on an edge that two other faces close."""
    edges = _edges(soup)
    if not (edges.faces > 2).any():
        return soup
    part, area = patches(soup), areas(soup)
    share = np.bincount(part, area) / area.sum()
    at_edge = np.bincount(part, (edges.faces[edges.edge] > 2).reshape(-1, 3).any(axis=1)) > 0
    is_open = np.bincount(part, (edges.faces[edges.edge] == 1).reshape(-1, 3).any(axis=1)) > 0
    flap = at_edge & is_open & (share < 0.1)
    if not flap.any() or flap.all():
        return soup
    repair.add(int(flap.sum()), "flap left out")
    return compact(Soup(soup.vertices, soup.faces[~flap[part]]))


def split(soup: Soup) -> Soup:
    """Each part with vertices of its own, so that parts that meet at an edge are apart."""
    part = patches(soup)
    key = (soup.faces * (part.max() + 1) + part[:, None]).ravel()
    kept, place = np.unique(key, return_inverse=True)
    return Soup(soup.vertices[kept // (part.max() + 1)], place.reshape(-1, 3))


def loose_parts(soup: Soup) -> Numbers:
    """Number of each face's connected part; parts do not share a vertex."""
    a, b, c = soup.faces.T
    label = group(len(soup.vertices), np.concatenate([np.stack([a, b], 1), np.stack([b, c], 1)]))
    return np.unique(label[a], return_inverse=True)[1]


def drop_flecks(soup: Soup, repair: Repair) -> Soup:
    """Without loose parts of less than a hundredth of the largest one's area, in all less than a twentieth."""
    part = loose_parts(soup)
    area = np.bincount(part, areas(soup))
    small = area < FLECK * area.max()
    if not small.any() or area[small].sum() > 0.05 * area.sum():
        return soup
    share = 100 * area[small].sum() / area.sum()
    count = int(small.sum())
    repair.done.append(f"{count:,} {'fleck' if count == 1 else 'flecks'} left out ({share:.2g} % of the area)")
    return compact(Soup(soup.vertices, soup.faces[~small[part]]))


def open_loops(soup: Soup) -> list[Numbers]:
    """Holes: rings of vertices along open edges, each as the triangles that fill it run along it."""
    edges = _edges(soup)
    single = edges.faces[edges.edge] == 1
    ahead: dict[int, list[int]] = {}
    for a, b in zip(edges.end[single].tolist(), edges.start[single].tolist(), strict=True):
        ahead.setdefault(a, []).append(b)
    loops = []
    while ahead:
        path = [next(iter(ahead))]
        seen = {path[0]: 0}
        while True:
            after = ahead.get(path[-1])
            if not after:  # The faces around do not agree: no ring.
                ahead.pop(path[-1], None)
                break
            step = after.pop()
            if not after:
                del ahead[path[-1]]
            if step in seen:  # Where rings touch, the inner one is complete first.
                begin = seen[step]
                loops.append(np.array(path[begin:]))
                for each in path[begin + 1 :]:
                    del seen[each]
                path = path[: begin + 1]
                if len(path) == 1 and path[0] not in ahead:
                    break
            else:
                seen[step] = len(path)
                path.append(step)
    return [loop for loop in loops if len(loop) >= 3]


def fill(soup: Soup, repair: Repair) -> Soup:
    """All holes closed, each by triangles between the vertices of its rim."""
    loops = open_loops(soup)
    if not loops:
        return soup
    made = [fill_polygon(soup.vertices, loop) for loop in loops]
    whole = Soup(soup.vertices, np.concatenate([soup.faces, *made]))
    patch = Soup(soup.vertices, np.concatenate(made))
    area = areas(patch)
    bounds = np.cumsum([0, *(len(each) for each in made)])
    sizes = np.add.reduceat(area, bounds[:-1])
    widths = [float(np.ptp(soup.vertices[loop], axis=0).max()) for loop in loops]
    real = [k for k, size in enumerate(sizes) if size > 1e-3 * max(widths[k], 1e-9) ** 2]
    if real:
        widest = max(widths[k] for k in real)
        word = "hole closed" if len(real) == 1 else "holes closed, the largest"
        repair.done.append(f"{len(real):,} {word} {1000 * widest:.3g} mm wide")
        repair.largest_hole = max(repair.largest_hole, widest)
        repair.hole_area += float(sizes[real].sum())
    repair.add(len(loops) - len(real), "crack closed", "cracks closed")
    repair.filled = np.concatenate([repair.filled, soup.vertices[patch.faces]])
    return whole


def is_closed(soup: Soup) -> bool:
    """Whether each edge joins exactly two faces, which run along it in opposite directions."""
    edges = _edges(soup)
    if not len(soup.faces) or not (edges.faces == 2).all():
        return False
    return bool(_pairs(edges)[1].all())


class Crossings(NamedTuple):
    """Crossings of lines along one axis with triangles."""

    line: Numbers
    """Number of the line, row by row of the other two axes."""
    place: Numbers
    """Along the axis, m."""
    sign: Numbers
    """+1 where the line goes in, −1 out, by the triangle's own sense; 0 along it."""


def crossings(soup: Soup, axis: int, low: Numbers, step: float, shape: tuple[int, ...]) -> Crossings:
    """Crossings of a surface with the lines along `axis` through the nodes `low + step · (i, j, k)` of a grid."""
    u, v = (axis + 1) % 3, (axis + 2) % 3
    flat = (soup.vertices[:, [u, v]] - low[[u, v]]) / step
    a, b, c = (flat[soup.faces[:, k]] for k in range(3))
    first = np.ceil(np.minimum(np.minimum(a, b), c)).astype(np.int64)
    last = np.floor(np.maximum(np.maximum(a, b), c)).astype(np.int64)
    first, last = np.maximum(first, 0), np.minimum(last, [shape[u] - 1, shape[v] - 1])
    wide = np.maximum(last - first + 1, 0)
    count = wide[:, 0] * wide[:, 1]
    face = np.repeat(np.arange(len(count)), count)
    number = np.arange(len(face)) - np.repeat(np.cumsum(count) - count, count)
    i = first[face, 0] + number // np.maximum(wide[face, 1], 1)
    j = first[face, 1] + number % np.maximum(wide[face, 1], 1)
    points = np.stack([i, j], axis=1).astype(np.float64)
    corners = soup.faces[face]
    sides = [_side(flat, corners[:, k], corners[:, (k + 1) % 3], points) for k in range(3)]
    inside = (np.stack(sides) > 0).all(axis=0) | (np.stack(sides) < 0).all(axis=0)
    face, i, j = face[inside], i[inside], j[inside]
    weights = np.stack([sides[1][inside], sides[2][inside], sides[0][inside]])
    place = (weights * soup.vertices[soup.faces[face], axis].T).sum(axis=0) / weights.sum(axis=0)
    return Crossings(i * shape[v] + j, place, -np.sign(weights[0]))


def _side(flat: Numbers, start: Numbers, end: Numbers, points: Numbers) -> Numbers:
    """On which side of an edge points are, the same for both faces at it; on it counts as one of them."""
    turned = start > end
    low, high = flat[np.where(turned, end, start)], flat[np.where(turned, start, end)]
    along, across = high - low, points - low
    found = along[:, 0] * across[:, 1] - along[:, 1] * across[:, 0]
    found = np.where(found == 0.0, 1e-300, found)
    return np.where(turned, -found, found)


class Filled:
    """The nodes of a grid that a closed surface encloses."""

    def __init__(self, soup: Soup) -> None:
        size = np.ptp(soup.vertices, axis=0)
        self._step = float((np.prod(size + 1e-4) / 3e6) ** (1 / 3))
        self._low = soup.vertices.min(axis=0) - self._step * np.array([0.3137, 0.4142, 0.2718])
        shape = tuple((np.ceil(size / self._step) + 3).astype(int).tolist())
        found = crossings(soup, 2, self._low, self._step, shape)
        depth = np.zeros(shape, dtype=np.int32)
        at = np.ceil((found.place - self._low[2]) / self._step).astype(int)
        np.add.at(depth, (found.line // shape[1], found.line % shape[1], at), found.sign.astype(np.int32))
        self._mask = np.cumsum(depth, axis=2) > 0

    def holds(self, points: Numbers) -> Numbers:
        """Which points (k, 3) are enclosed, but for those within a step of the surface."""
        index = np.round((points - self._low) / self._step).astype(int)
        index = np.clip(index, 0, np.array(self._mask.shape) - 1)
        return np.asarray(self._mask[tuple(index.T)])


def overlap(soup: Soup) -> float:
    """Share of the volume that the surface encloses twice, or inside out."""
    low, size = soup.vertices.min(axis=0), np.ptp(soup.vertices, axis=0)
    step = float((np.prod(size) / 2e6) ** (1 / 3)) or 1e-3
    low = low - step * np.array([0.3137, 0.4142, 0.2718])
    shape = tuple((np.ceil(size / step) + 2).astype(int))
    line, place, sign = crossings(soup, int(np.argmin(size)), low, step, shape)
    order = np.lexsort((place, line))
    line, place, sign = line[order], place[order], sign[order]
    depth = np.cumsum(sign)  # Zero again after each line of a closed surface.
    length = np.where(np.diff(line, append=-1) == 0, np.diff(place, append=0.0), 0.0)
    wrong = length[(depth > 1.5) | (depth < -0.5)].sum()
    right = length[depth > 0.5].sum()
    return float(wrong / max(right, 1e-12))


def manifold_of(soup: Soup) -> manifold3d.Manifold | None:
    """The solid, None for what is none."""
    import manifold3d

    solid = manifold3d.Manifold(
        manifold3d.Mesh64(np.ascontiguousarray(soup.vertices), np.ascontiguousarray(soup.faces.astype(np.uint64)))
    )
    return solid if solid.status() == manifold3d.Error.NoError and solid.num_tri() else None


def soup_of(solid: manifold3d.Manifold) -> Soup:
    """Its triangles."""
    mesh = solid.to_mesh64()
    return Soup(np.asarray(mesh.vert_properties)[:, :3].copy(), np.asarray(mesh.tri_verts).astype(np.int64))
