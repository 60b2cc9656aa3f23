"""The nearest point of a polytope, where one can see it."""

from __future__ import annotations

import numpy as np
import pytest

from allegro_twin.grasping.metrics.nearest_point import nearest_point
from allegro_twin.types import Array, Vector


def of_corners(corners: Array) -> Vector:
    return nearest_point(lambda direction: corners[(corners @ direction).argmin()], corners.shape[1])


def test_it_is_a_corner_an_edge_a_face_or_the_middle_itself() -> None:
    square = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]])
    np.testing.assert_allclose(of_corners(square + [3.0, 4.0]), [2.0, 3.0], atol=1e-12)  # noqa: RUF005  # A sum.
    np.testing.assert_allclose(of_corners(square + [3.0, 0.5]), [2.0, 0.0], atol=1e-12)  # noqa: RUF005  # A sum.
    np.testing.assert_allclose(of_corners(square), [0.0, 0.0], atol=1e-12)
    triangle = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(of_corners(triangle), [1 / 3] * 3, atol=1e-12)
    np.testing.assert_allclose(of_corners(triangle[:1]), triangle[0])


@pytest.mark.parametrize("seed", range(20))
def test_no_corner_is_nearer_along_its_own_direction(seed: int) -> None:
    """What makes a point the nearest: x · p ≥ x · x for every corner p. With repeated and with flat corners too."""
    rng = np.random.default_rng(seed)
    corners = rng.normal(size=(30, 6)) + rng.normal(size=6) * (seed % 4)
    corners = np.vstack([corners, corners[:5]])
    corners[:, 5] *= seed % 2
    point = of_corners(corners)
    assert (corners @ point).min() >= point @ point - 1e-12
