"""Stills show the grip: the camera turns to it, shadows are in the picture, and their edges are smooth."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np
import pytest

from allegro_twin.app import Rig, assemble, scenario_config
from allegro_twin.errors import ConfigError
from allegro_twin.types import Array
from allegro_twin.viewing.camera import _AZIMUTHS, _BETTER, Camera
from allegro_twin.viewing.gl_context import OffscreenRenderer


@pytest.fixture(params=[("lemon", "right"), ("mug", "right"), ("mug", "left"), ("model_o_lemon", None)])
def scene(request: pytest.FixtureRequest) -> Iterator[tuple[Rig, str]]:
    name, side = request.param
    rig = assemble(scenario_config(name, side))
    rig.backend.reset()
    yield rig, name.removeprefix("model_o_")
    rig.backend.close()


def camera_of(rig: Rig, view: str = "auto") -> Camera:
    assert rig.sim is not None
    try:
        return Camera(rig.sim, width=240, height=240, view=view)
    except ConfigError as error:
        pytest.skip(str(error))


def test_the_camera_turns_to_the_azimuth_that_shows_most_of_object_and_fingertips(scene: tuple[Rig, str]) -> None:
    rig, thing = scene
    camera = camera_of(rig)
    seen = np.array([camera._pixels(step, [thing]) for step in range(_AZIMUTHS)], dtype=float)
    shares = seen / np.maximum(seen.max(axis=0), 1.0)
    score = shares[:, 0] + shares[:, 1:].mean(axis=1)
    camera.turn([thing])
    assert score[camera._step] * _BETTER >= score.max()
    assert shares[camera._step, 0] > 0.5, "the object is hidden"
    camera.close()


def test_a_pixel_of_a_segmentation_is_of_the_body_that_stands_there(scene: tuple[Rig, str]) -> None:
    rig, thing = scene
    assert rig.sim is not None
    camera = camera_of(rig)
    model, data = rig.sim.model, rig.sim.data
    eye = mujoco.MjvCamera()
    eye.lookat, eye.distance, eye.elevation = data.body(thing).xpos, 0.4, -89.0
    for geom in range(model.ngeom):  # Nothing between.
        if model.body_rootid[model.geom_bodyid[geom]] not in (0, model.body_rootid[model.body(thing).id]):
            model.geom_group[geom] = 5
    seen = camera._screen.draw_segments(data, eye, 99)
    assert model.body_rootid[model.geom_bodyid[seen[49, 49]]] == model.body_rootid[model.body(thing).id]
    assert (seen[0] != seen[49, 49]).all()
    camera.close()


def test_a_left_hands_still_is_the_mirror_image_of_the_rights_and_a_little_gain_does_not_turn_the_camera() -> None:
    stills = {}
    for side in ("right", "left"):
        rig = assemble(scenario_config("gelatin_box", side))  # Of those that are turned to.
        rig.backend.reset()
        camera = camera_of(rig)
        stills[side] = camera.take_still(["gelatin_box"]).astype(float)
        step = camera._step
        camera._turned, camera._step = None, 0
        assert step != 0
        camera._pixels = lambda at, objects: [100 + 5 * at, 100]  # type: ignore[method-assign, assignment]
        camera.turn(["gelatin_box"])
        assert camera._step == 0, "a gain of less than a fifth is not worth a turn"
        camera.close()
        rig.backend.close()
    assert np.abs(stills["left"][:, ::-1] - stills["right"]).mean() < 3.0


def test_a_still_of_what_has_not_moved_is_not_rendered_again() -> None:
    rig = assemble(scenario_config("lemon", "right"))
    assert rig.sim is not None
    rig.backend.reset()
    camera = camera_of(rig)
    first = camera.take_still(["lemon"])
    assert camera.take_still(["lemon"]) is first
    rig.sim.data.qpos[-7] += 0.02
    mujoco.mj_forward(rig.sim.model, rig.sim.data)
    assert (camera.take_still(["lemon"]) != first).any()
    camera.close()


def shadow(rig: Rig, shadows: float) -> Array:
    """How much darker each pixel is for the shadow, as a share of the most."""
    assert rig.sim is not None
    model, data = rig.sim.model, rig.sim.data
    eye = mujoco.MjvCamera()
    eye.lookat, eye.distance, eye.elevation, eye.azimuth = [0.0, 0.0, 0.05], 0.5, -30.0, 100.0
    pictures = []
    for cast in (True, False):
        model.light_castshadow[:] = cast
        screen = OffscreenRenderer(model, 240, 240, shadows=shadows)
        pictures.append(screen.draw(data, eye).astype(float).sum(axis=2))
        screen.close()
    darker = pictures[1] - pictures[0]
    return np.asarray(darker / darker.max())


def test_edges_of_shadows_are_smooth() -> None:
    rig = assemble(scenario_config("lemon", "right"))
    rig.backend.reset()
    camera_of(rig).close()
    between = [
        np.mean((part > 0.15) & (part < 0.5)) / np.mean(part > 0.5) for part in (shadow(rig, 0.4), shadow(rig, 0.0))
    ]
    assert between[0] > 1.4 * between[1]


@pytest.mark.parametrize("name", ["apple", "mug", "tennis_ball"])
def test_the_shadow_of_what_is_lifted_is_in_the_picture(name: str) -> None:
    rig = assemble(scenario_config(name, "right"))
    assert rig.sim is not None
    rig.backend.reset()
    model, data = rig.sim.model, rig.sim.data
    camera = camera_of(rig)
    data.qpos[model.joint("wrist_z").qposadr[0]] += 0.08
    mujoco.mj_forward(model, data)
    model.light_castshadow[:] = True
    dark = camera.take().astype(float).sum(axis=2)
    model.light_castshadow[:] = False
    light = camera.take().astype(float).sum(axis=2)
    table = camera._screen.draw_segments(data, camera._aimed(), 240) == model.geom("table").id
    assert (table & (light - dark > 60.0)).mean() > 0.01
    camera.close()
