"""A shape is drawn as triangles that lie on it."""

from __future__ import annotations

import numpy as np
import pytest

from allegro_twin.hands.description.appearance import VisualShape, object_appearance
from allegro_twin.types import Array
from allegro_twin.viewing.surfaces import join_surfaces, surface_of


@pytest.mark.parametrize(
    ("shape", "triangles"),
    [
        (VisualShape("sphere", (0.02,)), 24 * 12 * 2),
        (VisualShape("sphere", (0.02,), paint="golf_ball"), (4 * 24) * (4 * 12) * 2),
        (VisualShape("ellipsoid", (0.01, 0.02, 0.03)), 24 * 12 * 2),
        (VisualShape("box", (0.01, 0.02, 0.03)), 6 * 2),
        (VisualShape("box", (0.01, 0.02, 0.03), paint="rubiks_cube"), 6 * 7 * 7 * 2),
        (VisualShape("capsule", (0.01, 0.02)), 24 * 9 * 2),
        (VisualShape("cylinder", (0.01, 0.02)), 24 * 5 * 2),
        (VisualShape("cylinder", (0.01, 0.02), paint="mug"), (2 * 24) * 43 * 2),
    ],
)
def test_a_shape_has_as_many_triangles_as_its_size_needs_and_more_where_it_is_painted(
    shape: VisualShape, triangles: int
) -> None:
    found = surface_of(shape)
    assert found.vertices.shape == found.normals.shape == (3 * triangles, 3)
    assert found.colors.shape == (3 * triangles, 4)


def test_an_ellipsoids_triangles_lie_on_it_and_look_outwards() -> None:
    half = np.array([0.01, 0.02, 0.03])
    found = surface_of(VisualShape("ellipsoid", tuple(half)))
    np.testing.assert_allclose(np.square(found.vertices / half).sum(axis=1), 1.0, atol=1e-12)
    gradient = found.vertices / half**2
    np.testing.assert_allclose(found.normals, gradient / np.linalg.norm(gradient, axis=1, keepdims=True), atol=1e-9)
    np.testing.assert_allclose(np.abs(found.vertices).max(axis=0), half, rtol=0.01)


def test_a_capsules_triangles_are_a_radius_from_its_axis() -> None:
    radius, half = 0.01, 0.02
    found = surface_of(VisualShape("capsule", (radius, half)))
    nearest = np.zeros_like(found.vertices)
    nearest[:, 2] = np.clip(found.vertices[:, 2], -half, half)
    np.testing.assert_allclose(np.linalg.norm(found.vertices - nearest, axis=1), radius, atol=1e-12)
    np.testing.assert_allclose(found.vertices - nearest, radius * found.normals, atol=1e-12)
    assert np.ptp(found.vertices[:, 2]) == pytest.approx(2 * (radius + half))


@pytest.mark.parametrize("paint", ["", "mug"])
def test_a_cylinders_triangles_lie_on_its_wall_or_its_ends(paint: str) -> None:
    found = surface_of(VisualShape("cylinder", (0.01, 0.02), paint=paint))
    around, up = np.hypot(found.vertices[:, 0], found.vertices[:, 1]), found.vertices[:, 2]
    wall = found.normals[:, 2] == 0.0
    np.testing.assert_allclose(around[wall], 0.01)
    np.testing.assert_allclose(up[~wall], 0.02 * found.normals[~wall, 2])
    assert {round(float(height), 9) for height in np.unique(np.abs(up[~wall]))} == {0.02}
    np.testing.assert_allclose(np.linalg.norm(found.normals, axis=1), 1.0)
    assert 0.0 in around


def normals_of(vertices: Array) -> Array:
    a, b, c = np.moveaxis(vertices.reshape(-1, 3, 3), 1, 0)
    normal = np.cross(b - a, c - a)
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))


def test_a_box_and_a_mesh_are_flat_between_their_edges() -> None:
    half = np.array([0.01, 0.02, 0.03])
    found = surface_of(VisualShape("box", tuple(half)))
    assert (np.isclose(np.abs(found.vertices), half).sum(axis=1) == 3).all()
    np.testing.assert_allclose(normals_of(found.vertices), found.normals[::3], atol=1e-12)
    corners = np.array([[0.0, 0.0, 0.0], [0.04, 0.0, 0.0], [0.0, 0.04, 0.0], [0.0, 0.0, 0.04]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    mesh = surface_of(VisualShape("mesh", (), vertices=corners, triangles=faces))
    np.testing.assert_array_equal(mesh.vertices, corners[faces].reshape(-1, 3))
    np.testing.assert_allclose(mesh.normals[::3], normals_of(mesh.vertices))
    np.testing.assert_allclose(mesh.normals[9], np.full(3, 3**-0.5))


def test_a_shape_stands_on_its_body_where_it_is_said_to() -> None:
    quarter = (np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))  # About z.
    shape = VisualShape("box", (0.01, 0.02, 0.03), (0.1, 0.2, 0.3), quarter, (1.0, 0.5, 0.0, 0.2))
    found = surface_of(shape)
    np.testing.assert_allclose(found.vertices.min(axis=0), [0.08, 0.19, 0.27])
    np.testing.assert_allclose(found.vertices.max(axis=0), [0.12, 0.21, 0.33])
    np.testing.assert_allclose(normals_of(found.vertices), found.normals[::3], atol=1e-12)
    assert set(map(tuple, found.colors.tolist())) == {(255, 128, 0, 51)}


def test_a_painted_shape_has_both_colours_of_its_look_one_for_each_triangle() -> None:
    look = object_appearance("foam_brick")
    found = surface_of(VisualShape("box", (0.025, 0.04, 0.025), color=(0.0, 0.0, 0.0, 0.5), paint="foam_brick"))
    painted = found.colors.reshape(-1, 3, 4)
    assert (painted == painted[:, :1]).all()
    assert (found.colors[:, 3] == 128).all()
    seen = {tuple(color) for color in found.colors[:, :3].tolist()}
    expected = {tuple(np.round(255 * np.array(color)).astype(int).tolist()) for color in (look.color, look.second)}
    assert seen <= expected
    assert tuple(np.round(255 * np.array(look.color)).astype(int).tolist()) in seen


def test_many_surfaces_are_one() -> None:
    one, other = surface_of(VisualShape("box", (0.01, 0.02, 0.03))), surface_of(VisualShape("sphere", (0.02,)))
    both = join_surfaces([one, other])
    np.testing.assert_array_equal(both.vertices, np.concatenate([one.vertices, other.vertices]))
    np.testing.assert_array_equal(both.normals[len(one.normals) :], other.normals)
    np.testing.assert_array_equal(both.colors[: len(one.colors)], one.colors)


@pytest.mark.parametrize("name", ["rubiks_cube", "gelatin_box", "potted_meat_can"])
def test_a_painted_box_changes_its_colour_only_where_its_pattern_does(name: str) -> None:
    half = np.array([0.02, 0.03, 0.04])
    found = surface_of(VisualShape("box", tuple(half), paint=name))
    corners, colors = found.vertices.reshape(-1, 3, 3), found.colors[::3, :3]
    for weights in ((0.9, 0.05, 0.05), (0.05, 0.9, 0.05), (0.05, 0.05, 0.9)):  # Just inside each corner.
        places = np.einsum("fcx,c->fx", corners, weights) / half
        painted = np.round(255 * object_appearance(name).paint(places))
        np.testing.assert_array_equal(painted, colors)
