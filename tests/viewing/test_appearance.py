"""An object looks the same wherever it is drawn, and a user's own mesh and hand are drawn as they are."""

from __future__ import annotations

import colorsys
import json
from pathlib import Path

import mujoco
import numpy as np
import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root, read_yaml
from allegro_twin.hands.description.appearance import (
    ObjectAppearance,
    VisualShape,
    lighten,
    object_appearance,
    parse_color,
    series_color,
)
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.sim.model.appearance import scene_appearance, simplified
from allegro_twin.sim.model.scene import Stage, compile_scene
from allegro_twin.sim.objects.catalogue import GraspObject, PlacedObject, load_object, object_catalogue
from allegro_twin.viewing.scenery import scenery
from allegro_twin.viewing.surfaces import surface_of
from tests.sim.test_foreign import menagerie_like


def scene_of(*things: GraspObject) -> mujoco.MjModel:
    placed = [PlacedObject(thing, (0.3 * k, 0.5, 0.1), (1.0, 0.0, 0.0, 0.0)) for k, thing in enumerate(things)]
    return compile_scene(load_spec(), Stage(np.zeros(3), np.array([1.0, 0, 0, 0]), objects=placed, table=True))


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


def test_a_colour_is_read_in_parts_of_255_and_a_lighter_one_is_half_way_to_white() -> None:
    assert parse_color("#ff8000") == (1.0, 128 / 255, 0.0)
    assert parse_color("0033cc") == (0.0, 0.2, 0.8)
    assert lighten((1.0, 0.5, 0.0)) == (1.0, 0.75, 0.5)
    for text in ("#ff80", "#ff800000", "red"):
        with pytest.raises(ConfigError, match="is no colour like #2a5fa8"):
            parse_color(text)


def test_the_first_eight_series_are_the_palettes_and_others_go_round_the_circle_of_hues() -> None:
    assert series_color(0) == parse_color("#0072b2")
    assert series_color(7) == parse_color("#8c8c00")
    hue, saturation, value = colorsys.rgb_to_hsv(*series_color(8))
    assert (hue, saturation, value) == pytest.approx((8 * 0.6180339887 % 1.0, 0.75, 0.7))


def test_a_thing_without_a_look_has_a_calm_one_that_is_of_its_name() -> None:
    look = object_appearance("no such thing")
    hue = sum(ord(letter) * (7 + place) for place, letter in enumerate("no such thing")) * 0.6180339887 % 1.0
    assert colorsys.rgb_to_hsv(*look.color) == pytest.approx((hue, 0.6, 0.85))
    assert colorsys.rgb_to_hsv(*look.second) == pytest.approx((hue, 0.6, 0.6))
    assert object_appearance("another thing") != look


def test_the_handle_of_a_mug_is_in_metres_and_radians() -> None:
    row = read_yaml(data_root() / "conf" / "appearance" / "objects.yaml")["mug"]["handle"]
    handle = object_appearance("mug").handle
    assert handle is not None
    assert handle.height == pytest.approx(1e-3 * row["height"])
    assert (handle.reach, handle.thick) == pytest.approx((1e-3 * row["reach"], 1e-3 * row["thick"]))
    assert handle.at == pytest.approx(np.radians(row["at"]))


WHITE, BLACK = (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("pattern", "plain", "second"),
    [
        ("plain", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.5)], []),
        ("band", [(1.0, 0.0, 0.46), (0.3, 0.2, 1.0), (0.0, 0.1, 0.2)], [(1.0, 0.0, 0.44), (0.0, -1.0, -0.44)]),
        ("lines", [(1.0, 0.08, 0.3), (0.5, 0.5, -0.5)], [(1.0, 0.06, 0.3), (0.0, 1.0, 1.0)]),
        (
            "halves",  # On either side of x + y + z / 2 = 0.3.
            [(-0.25, 0.0, 1.0), (0.0, -0.25, 1.0), (1.0, -0.75, 0.0)],
            [(-0.15, 0.0, 1.0), (0.0, -0.15, 1.0), (1.0, -0.65, 0.0)],
        ),
    ],
)
def test_a_pattern_is_where_it_is_said_to_be(
    pattern: str, plain: list[tuple[float, ...]], second: list[tuple[float, ...]]
) -> None:
    look = ObjectAppearance(WHITE, BLACK, pattern)
    assert (look.paint(np.array(plain)) == 1.0).all()
    assert not second or (look.paint(np.array(second)) == 0.0).all()


def test_a_cube_of_faces_has_nine_stickers_a_face_with_lines_between_them() -> None:
    look = ObjectAppearance(WHITE, (0.5, 0.5, 0.5), "faces")
    colors = ("#c41e3a", "#ff5800", "#009e60", "#0051ba", "#ffd500", "#ffffff")
    for number, color in enumerate(colors):
        axis, sign = number // 2, 1.0 if number % 2 == 0 else -1.0
        for across in (-2 / 3, 0.0, 2 / 3):
            for up in (-2 / 3, 0.0, 2 / 3):
                place = np.roll([sign, across, up], axis)
                np.testing.assert_allclose(look.paint(0.7 * place[None])[0], parse_color(color), err_msg=str(place))
        for line in (-1 / 3, 1 / 3, 0.98):
            place = np.roll([sign, line, 0.0], axis)
            np.testing.assert_array_equal(look.paint(place[None])[0], [0.5, 0.5, 0.5])
        wide = np.roll([sign, 1 / 3 + 0.08, 0.0], axis)  # A line is 0.2 of a sticker's edge, 2/3, wide.
        np.testing.assert_allclose(look.paint(wide[None])[0], parse_color(color))
