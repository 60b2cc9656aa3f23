"""A closed surface on a grid: of triangles that enclose a solid in any way, of a wall without thickness, of points.

What the outside cannot reach is solid; the surface is where the distance to the triangles, or to the planes of the
nearest points, is zero (marching cubes).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from allegro_twin.sim.objects.mesh_repair import Soup, areas, crossings, face_normals
from allegro_twin.sim.objects.scan_files import Numbers

NODES = 4e6
"""Most nodes of the grid."""
FINEST = 7e-4
"""m between them, at least."""
_NEAREST = 3
"""Triangles that a node's distance is taken to."""


class Grid(NamedTuple):
    """Nodes at `low + step · (i, j, k)`."""

    low: Numbers
    step: float
    shape: tuple[int, int, int]

    @classmethod
    def around(cls, points: Numbers, margin: float, finest: float = FINEST) -> Grid:
        """A grid that holds all points and a margin, m."""
        size = np.ptp(points, axis=0) + 2 * margin
        step = max(finest, float((np.prod(size) / NODES) ** (1 / 3)))
        low = points.min(axis=0) - margin - step * np.array([2.3137, 2.4142, 2.2718])
        x, y, z = (np.ceil((size + 5 * step) / step) + 1).astype(int).tolist()
        return cls(low, step, (x, y, z))

    def nodes(self, mask: Numbers) -> Numbers:
        """Places of the nodes of a mask, (k, 3), m."""
        return np.asarray(np.argwhere(mask) * self.step + self.low)

    def near(self, points: Numbers, distance: float) -> Numbers:
        """A mask of all nodes within a distance of the points, and of a few more."""
        from scipy.ndimage import binary_dilation  # type: ignore[import-untyped]  # Its types are a package of their own.

        mask = np.zeros(self.shape, dtype=bool)
        at = np.round((points - self.low) / self.step).astype(int)
        mask[tuple(at.T)] = True
        reach = int(np.ceil(distance / self.step)) + 1
        for axis in range(3):  # A cube around each.
            shape = [1, 1, 1]
            shape[axis] = 2 * reach + 1
            mask = binary_dilation(mask, np.ones(shape, dtype=bool))
        return mask


class Surface:
    """Samples of triangles, and distances to them."""

    def __init__(self, soup: Soup, spacing: float) -> None:
        from scipy.spatial import cKDTree  # type: ignore[import-untyped]  # Its types are a package of their own.

        self.corners = soup.vertices[soup.faces]
        self.face, self.points = sample(soup, spacing)
        self._tree = cKDTree(self.points)

    def distance(self, points: Numbers, within: float = np.inf) -> tuple[Numbers, Numbers]:
        """To the nearest triangle, m, (k,), inf beyond `within`; and which triangle that is, −1 for none."""
        count = min(_NEAREST, len(self.points))
        far, found = self._tree.query(points, k=count, distance_upper_bound=within)
        far, found = far.reshape(len(points), count), found.reshape(len(points), count)
        best, which = np.full(len(points), np.inf), np.full(len(points), -1)
        for k in range(far.shape[1]):
            rows = np.flatnonzero(np.isfinite(far[:, k]))
            face = self.face[found[rows, k]]
            there = to_triangle(points[rows], self.corners[face])
            nearer = there < best[rows]
            best[rows[nearer]], which[rows[nearer]] = there[nearer], face[nearer]
        return best, which


def sample(soup: Soup, spacing: float) -> tuple[Numbers, Numbers]:
    """Points on triangles, no further apart than the spacing or so: of which triangle, (k,), and where, (k, 3).

    The middles of pieces that are cut at their longest edge until all are short."""
    corners, face = soup.vertices[soup.faces], np.arange(len(soup.faces))
    faces, points = [], []
    while len(face):
        edges = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
        short = np.maximum.reduce(edges, axis=1) <= spacing
        points.append(corners[short].mean(axis=1))
        faces.append(face[short])
        corners, face, edges = corners[~short], face[~short], edges[~short]
        first = (edges.argmax(axis=1)[:, None] + [0, 1, 2]) % 3
        a, b, c = (np.take_along_axis(corners, first[:, k, None, None], axis=1)[:, 0] for k in range(3))
        half = (a + b) / 2
        corners = np.concatenate([np.stack([a, half, c], axis=1), np.stack([half, b, c], axis=1)])
        face = np.concatenate([face, face])
    return np.concatenate(faces), np.concatenate(points)


def surface_samples(soup: Soup, spacing: float) -> tuple[Numbers, Numbers]:
    """Points on triangles, and the normals there, each (k, 3); faces of places that are none left out."""
    soup = Soup(
        soup.vertices, soup.faces[np.logical_and.reduce(np.isfinite(soup.vertices), axis=1)[soup.faces].all(axis=1)]
    )
    face, points = sample(soup, spacing)
    normals = face_normals(soup)
    return points, (normals / np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None])[face]


def to_triangle(points: Numbers, corners: Numbers) -> Numbers:
    """Distance of each point (k, 3) to its triangle (k, 3, 3), m."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    best = np.minimum(np.minimum(_to_segment(points, a, b), _to_segment(points, b, c)), _to_segment(points, c, a))
    normal = np.cross(b - a, c - a)
    square = np.einsum("ij,ij->i", normal, normal)
    ahead = points - a
    inside = square > 1e-30
    for start, end in ((a, b), (b, c), (c, a)):
        inside &= np.einsum("ij,ij->i", np.cross(end - start, points - start), normal) >= 0.0
    height = np.abs(np.einsum("ij,ij->i", ahead, normal)) / np.sqrt(np.maximum(square, 1e-300))
    return np.asarray(np.where(inside, np.minimum(height, best), best))


def _to_segment(points: Numbers, start: Numbers, end: Numbers) -> Numbers:
    along = end - start
    square = np.maximum(np.einsum("ij,ij->i", along, along), 1e-300)
    share = np.clip(np.einsum("ij,ij->i", points - start, along) / square, 0.0, 1.0)
    return np.asarray(np.linalg.norm(points - start - share[:, None] * along, axis=1))


def remesh(soup: Soup, gap: float = 0.0) -> Soup | None:
    """What triangles enclose, where holes up to twice `gap` (m) do not let the outside in; None for nothing."""
    grid = Grid.around(soup.vertices, 3 * FINEST + gap)
    surface = Surface(soup, 0.7 * grid.step)
    reach = max(gap, 1.2 * grid.step)
    near = grid.near(surface.points, reach + grid.step)
    distance = np.full(grid.shape, np.inf)
    distance[near] = surface.distance(grid.nodes(near), reach + 3 * grid.step)[0]
    outside = flood(distance > reach)
    open_ways = [~_blocked(soup, grid, axis) for axis in range(3)]
    for _ in range(int(np.ceil(reach / grid.step)) + 1):
        outside |= _step(outside, open_ways)
    if float((~outside).sum()) * grid.step**3 < 0.3 * reach * float(areas(soup).sum()) and gap == 0.0:
        return None
    value = np.minimum(distance, 3 * grid.step)
    return _marching_cubes(np.where(outside, value, -value), grid)


def thicken(soup: Soup, wall: float) -> Soup:
    """A wall of that thickness (m) along triangles."""
    grid = Grid.around(soup.vertices, wall, min(FINEST, wall / 3))
    surface = Surface(soup, 0.7 * grid.step)
    near = grid.near(surface.points, wall / 2 + 2 * grid.step)
    distance = np.full(grid.shape, np.inf)
    distance[near] = surface.distance(grid.nodes(near), wall / 2 + 4 * grid.step)[0]
    made = _marching_cubes(np.minimum(distance, wall + 3 * grid.step) - wall / 2, grid)
    assert made is not None
    return made


def flood(free: Numbers) -> Numbers:
    """The nodes that are connected with the rim of the grid through free ones."""
    from scipy.ndimage import label

    parts, _ = label(free)
    return np.asarray(free & (parts == parts[0, 0, 0]))


def _blocked(soup: Soup, grid: Grid, axis: int) -> Numbers:
    """Whether a triangle lies between each node and the next along an axis."""
    u, v = (axis + 1) % 3, (axis + 2) % 3
    found = crossings(soup, axis, grid.low, grid.step, grid.shape)
    at = np.floor((found.place - grid.low[axis]) / grid.step).astype(int)
    mask = np.zeros(grid.shape, dtype=bool)
    index: list[Numbers] = [at, at, at]
    index[u], index[v] = found.line // grid.shape[v], found.line % grid.shape[v]
    mask[tuple(index)] = True
    return mask


def _step(outside: Numbers, open_ways: list[Numbers]) -> Numbers:
    """What a node reaches in one step."""
    found = outside.copy()
    for axis in range(3):
        here, there = [slice(None)] * 3, [slice(None)] * 3
        here[axis], there[axis] = slice(0, -1), slice(1, None)
        one, two, way = tuple(here), tuple(there), open_ways[axis][tuple(here)]
        found[two] |= outside[one] & way
        found[one] |= outside[two] & way
    return found


def _marching_cubes(value: Numbers, grid: Grid) -> Soup | None:
    """The surface where a value is 0, negative inside."""
    from skimage.measure import marching_cubes

    value = np.where(np.abs(value) < 1e-3 * grid.step, 1e-3 * grid.step, value)  # No vertex in a node.
    if not (value < 0).any():
        return None
    places, faces, _, _ = marching_cubes(value, 0.0, spacing=(grid.step,) * 3)
    return Soup(places.astype(np.float64) + grid.low, faces.astype(np.int64))


def surface_of(value_at: Callable[[Numbers], Numbers], outside: Numbers, near: Numbers, grid: Grid) -> Soup | None:
    """The surface where a function of places (k, 3) is 0, from its values at the nodes `near`; elsewhere a mask says
    what is outside."""
    value = np.where(outside, 1.0, -1.0) * 3 * grid.step
    value[near] = np.clip(value_at(grid.nodes(near)), -3 * grid.step, 3 * grid.step)
    return _marching_cubes(value, grid)
