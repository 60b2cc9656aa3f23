"""The pieces of the pipeline, each against something simpler that is surely right."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix  # type: ignore[import-untyped]  # Its types are a package of their own.
from scipy.sparse.csgraph import connected_components  # type: ignore[import-untyped]
from scipy.spatial import cKDTree  # type: ignore[import-untyped]

from allegro_twin.cell.perception.cloud import finite, pass_through
from allegro_twin.cell.perception.clusters import find_clusters
from allegro_twin.cell.perception.fits.model import solve
from allegro_twin.cell.perception.segmentation import find_plane
from allegro_twin.types import Array
from benchmarks.principal_frame import voxel

UP = np.array([0.0, 0.0, 1.0])


def test_a_region_keeps_what_is_in_it_and_nothing_unknown() -> None:
    points = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.21, 0.0, 0.0], [np.nan, 0.0, 0.0], [0.0, np.nan, 0.0]])
    kept = pass_through(points, np.full(3, -0.1), np.full(3, 0.2))
    assert kept.tolist() == [True, True, False, False, False]
    assert finite(points).tolist() == [True, True, True, False, False]
    assert not finite(np.array([[0.0, 0.0, np.inf]])).any()


def test_a_voxel_has_the_mean_of_its_points() -> None:
    points = np.random.default_rng(0).uniform(-0.05, 0.05, (2000, 3))
    cells: dict[tuple[int, ...], list[Array]] = {}
    for point in points:
        cells.setdefault(tuple(int(k) for k in (point - points.min(axis=0)) // 0.02), []).append(point)
    means = np.array([np.mean(cell, axis=0) for cell in cells.values()])
    found = voxel(points, 0.02)
    assert len(found) == len(means)
    np.testing.assert_allclose(found[np.lexsort(found.T)], means[np.lexsort(means.T)], atol=1e-12)
    assert voxel(np.empty((0, 3)), 0.02).shape == (0, 3)


def test_the_plane_of_a_table_is_found_among_other_things() -> None:
    draws = np.random.default_rng(1)
    table = np.stack([*draws.uniform(-0.4, 0.4, (2, 3000)), 0.001 * draws.standard_normal(3000)], axis=1)
    tilt = 0.1
    turned = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(tilt), -np.sin(tilt)], [0.0, np.sin(tilt), np.cos(tilt)]])
    rest = draws.uniform(-0.2, 0.2, (2000, 3)) + np.array([0.0, 0.0, 0.25])
    plane = find_plane(np.concatenate([table @ turned.T + [0.0, 0.0, 0.1], rest]), UP, draws, near=0.01, tilt=0.26)
    assert plane is not None
    assert np.degrees(np.arccos(plane.normal @ turned[:, 2])) < 0.1
    assert abs(plane.height(np.array([0.0, 0.0, 0.1]))) < 0.0003
    assert 0.6 < plane.part < 0.66
    axes = plane.axes(np.array([1.0, 0.0, -1.0]))
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(axes[2], plane.normal)


def test_a_wall_is_no_table_and_points_on_a_line_are_no_plane() -> None:
    draws = np.random.default_rng(1)
    wall = np.stack([np.zeros(500), *draws.uniform(-0.4, 0.4, (2, 500))], axis=1)
    assert find_plane(wall, UP, draws, near=0.01, tilt=0.26) is None
    assert find_plane(np.outer(np.arange(50.0), UP), UP, draws, near=0.01, tilt=0.26) is None
    assert find_plane(np.zeros((2, 3)), UP, draws, near=0.01, tilt=0.26) is None


def test_clusters_on_a_grid_are_those_of_single_linkage_when_things_lie_apart() -> None:
    draws = np.random.default_rng(2)
    blobs = [middle + 0.02 * draws.uniform(-1.0, 1.0, (400, 2)) for middle in ([0.0, 0.0], [0.08, 0.0], [0.0, 0.07])]
    places = np.concatenate(blobs)[draws.permutation(1200)]
    pairs = cKDTree(places).query_pairs(0.01, output_type="ndarray")
    links = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(1200, 1200))
    count, expected = connected_components(links, directed=False)
    grid, sizes = find_clusters(places, 0.008)
    labels = grid.of(places)
    assert count == len(sizes) == 3
    assert sorted(sizes) == sorted(np.bincount(expected))
    assert len(set(zip(labels.tolist(), expected.tolist(), strict=True))) == 3
    assert grid.of(np.array([[9.0, 9.0]])).tolist() == [0]
    beside = np.array([places[:, 0].min() - 0.004, places[places[:, 0].argmin(), 1]])[None]
    assert grid.of(beside).tolist() == [0]
    assert grid.spread().of(beside).tolist() == [labels[places[:, 0].argmin()]]


def test_the_solver_finds_the_least_and_does_not_follow_strays() -> None:
    x = np.linspace(0.0, 1.0, 50)
    y = 0.3 * x + 0.1
    y[::10] += 1.0

    def residuals(p: Array) -> Array:
        return p[:, :1] * x + p[:, 1:] - y

    fit = solve(residuals, np.zeros(2), np.ones(50), 0.01, 50)
    np.testing.assert_allclose(fit.parameters, [0.3, 0.1], atol=1e-3)
    assert fit.error < 0.01
