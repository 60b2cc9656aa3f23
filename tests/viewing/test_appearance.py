"""An object looks the same wherever it is drawn, and a user's own mesh and hand are drawn as they are."""

from __future__ import annotations

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest

from allegro_twin.hands.description.appearance import VisualShape, object_appearance, series_color
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.sim.model.appearance import scene_appearance, simplified
from allegro_twin.sim.model.scene import Stage, compile_scene
from allegro_twin.sim.objects.catalogue import GraspObject, PlacedObject, load_object, object_catalogue
from allegro_twin.viewing.scenery import scenery
from allegro_twin.viewing.surfaces import surface_of
from tests.sim.test_foreign import menagerie_like


def scene_of(*things: GraspObject) -> mujoco.MjModel:
    placed = [PlacedObject(thing, (0.3 * k, 0.5, 0.1), (1.0, 0.0, 0.0, 0.0)) for k, thing in enumerate(things)]
    return compile_scene(load_spec(), Stage(np.zeros(3), np.array([1.0, 0, 0, 0]), things=placed, table=True))


def tetrahedron(path: Path) -> Path:
    path.write_text("v 0 0 0\nv 40 0 0\nv 0 40 0\nv 0 0 40\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    return path


def test_every_object_of_the_catalogue_has_a_colour_of_its_own_choosing() -> None:
    looks = [object_appearance(name) for name in object_catalogue()]
    assert len({(look.color, look.second) for look in looks}) == len(looks)
    assert object_appearance("no such thing") == object_appearance("no such thing")


def test_joints_beyond_the_palette_have_colours_too() -> None:
    assert len({series_color(k) for k in range(24)}) == 24


def test_a_mug_has_a_handle_that_weighs_nothing_and_touches_nothing() -> None:
    model = scene_of(load_object("mug"))
    body = model.body("mug").id
    geoms = np.flatnonzero(model.geom_bodyid == body)
    assert len(geoms) > 3
    assert not model.geom_contype[geoms[1:]].any()
    assert not model.geom_conaffinity[geoms[1:]].any()
    assert model.body_mass[body] == pytest.approx(0.118)
    bare = scene_of(GraspObject("bare", "cylinder", (0.08, 0.082), 0.118))
    np.testing.assert_allclose(model.body_inertia[body], bare.body("bare").inertia, rtol=1e-12)


def test_the_simulators_texture_and_reruns_triangles_show_the_same_pattern() -> None:
    model = scene_of(load_object("rubiks_cube"))
    texture = model.texture("rubiks_cube_look")
    side = texture.width[0]
    sides = model.tex_data[texture.adr[0] :][: 6 * side * side * 3].reshape(6, side, side, 3)
    shapes = scenery(load_spec(), {"look": scene_appearance(model, load_spec(), ("rubiks_cube",))}).objects[
        "rubiks_cube"
    ]
    drawn = surface_of(shapes[0])
    middles = drawn.vertices.reshape(-1, 3, 3).mean(axis=1)
    for axis, face in ((0, 0), (1, 2), (2, 4)):  # MuJoCo's first, third and fifth sides are +x, +y, +z.
        near = np.argmin(np.linalg.norm(middles - 0.0285 * np.eye(3)[axis], axis=1))
        np.testing.assert_array_equal(drawn.colors[3 * near][:3], sides[face, side // 2, side // 2])


@pytest.mark.parametrize(
    ("shape", "volume"),
    [
        (VisualShape("box", (0.01, 0.02, 0.03)), 8 * 6e-6),
        (VisualShape("sphere", (0.02,)), 4 / 3 * np.pi * 8e-6),
        (VisualShape("cylinder", (0.01, 0.02)), np.pi * 4e-6),
        (VisualShape("capsule", (0.01, 0.02)), np.pi * 4e-6 + 4 / 3 * np.pi * 1e-6),
        (VisualShape("box", (0.01, 0.02, 0.03), paint="rubiks_cube"), 8 * 6e-6),
    ],
    ids=lambda value: value.kind if isinstance(value, VisualShape) else "",
)
def test_surfaces_are_closed_turned_outwards_and_as_large_as_the_shape(shape: VisualShape, volume: float) -> None:
    corners = surface_of(shape).vertices.reshape(-1, 3, 3)
    inside = np.einsum("fi,fi->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    assert inside == pytest.approx(volume, rel=0.05)
    normals = surface_of(shape).normals.reshape(-1, 3, 3).mean(axis=1)
    assert (np.einsum("fi,fi->f", normals, corners.mean(axis=1)) > -1e-9).all()


def test_a_users_own_mesh_goes_into_a_recording_as_it_is(tmp_path: Path) -> None:
    vase = GraspObject("vase", "mesh", (), 0.1, tetrahedron(tmp_path / "vase.obj"), 0.001)
    look = json.loads(json.dumps(scene_appearance(scene_of(vase), load_spec(), ("vase",))))
    drawn = surface_of(scenery(load_spec(), {"look": look}).objects["vase"][0])
    assert len(drawn.vertices) == 4 * 3
    edges = np.linalg.norm(np.diff(drawn.vertices.reshape(-1, 3, 3), axis=1), axis=2)
    assert {round(float(edge), 3) for edge in edges.reshape(-1)} == {0.04, 0.057}


def test_a_foreign_hand_goes_into_a_recording_with_its_own_links(tmp_path: Path) -> None:
    spec = load_spec(serial=str(menagerie_like(tmp_path, "right")))
    look = json.loads(json.dumps(scene_appearance(compile_scene(spec, Stage(np.zeros(3), np.eye(4)[0])), spec, ())))
    bodies = scenery(load_spec(), {"look": look}).bodies  # What reads a recording knows nothing of the file.
    assert {"palm", "ff_distal", "th_distal"} <= {body.name for body in bodies}
    assert sorted(body.joint for body in bodies if body.joint >= 0) == list(range(16))


def test_a_large_mesh_is_thinned_and_keeps_its_extent() -> None:
    steps = np.linspace(0, 2 * np.pi, 101)[:-1]
    grid = np.stack([np.cos(steps)[:, None] * np.ones(50), np.sin(steps)[:, None] * np.ones(50),
                     np.ones(100)[:, None] * np.linspace(0, 2, 50)], axis=2)  # fmt: skip
    index = np.arange(5000).reshape(100, 50)
    a, b, c = index[:, :-1], np.roll(index, -1, axis=0)[:, :-1], index[:, 1:]
    vertices, triangles = simplified(grid.reshape(-1, 3), np.stack([a, b, c], axis=2).reshape(-1, 3), 600)
    assert 50 < len(triangles) <= 600
    np.testing.assert_allclose(np.ptp(vertices[triangles.reshape(-1)], axis=0), [2, 2, 2], atol=0.3)
