"""One looks from named places, the left hand from the mirrored ones, and at any size; nonsense is one line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from allegro_twin.app import assemble, scenario_config
from allegro_twin.errors import ConfigError
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.sim.model.appearance import hand_bodies
from allegro_twin.spec import Side
from allegro_twin.viewing.camera import Camera, Picture
from allegro_twin.viewing.skeleton import Skeleton, bodies_of
from allegro_twin.viewing.views import NAMES, View, aimed_view, checked, size
from tests.conftest import MakeSim
from tests.sim.test_foreign import menagerie_like


@pytest.mark.parametrize(
    "text", ["1280", "1280x", "x720", "1280x-720", "12.5x3", "0x0", "99999x10", "²x³", "1280x720x3"]
)
def test_a_size_that_is_none_is_refused_with_an_example_or_the_bounds(text: str) -> None:
    with pytest.raises(ConfigError, match=rf"--size {text}: .*(1280x720|16 to 8192)"):
        size(text)
    assert size("1280x720") == (1280, 720)


@pytest.mark.parametrize(
    "text", ["", "behind", "1,2", "1,2,3,4", "a,b,c", "0,0,nan", "inf,0,1", "0,91,1", "0,0,0", "0,0,99"]
)
def test_a_camera_that_is_none_is_refused_with_the_names_or_the_bounds(text: str) -> None:
    with pytest.raises(ConfigError, match=r"--camera .*(front, side, top, palm|AZIMUTH|within)"):
        checked(text)
    assert checked("-120,-20,0.4") == "-120,-20,0.4"


@pytest.mark.parametrize("name", NAMES)
def test_every_name_is_another_place_and_the_left_hand_has_the_mirror_image(name: str, side: Side) -> None:
    spec = load_spec(side=side)
    tips = Skeleton(bodies_of(spec), spec).tips()
    _, place = aimed_view(name, side, *tips, np.eye(3))
    others = [aimed_view(other, side, *tips, np.eye(3))[1] for other in NAMES if other != name]
    assert all(place.direction() @ other.direction() < 0.98 for other in others)
    mirrored = load_spec(side="left" if side == "right" else "right")
    _, image = aimed_view(name, mirrored.side, *Skeleton(bodies_of(mirrored), mirrored).tips(), np.eye(3))
    np.testing.assert_allclose(place.direction(side), image.direction(mirrored.side) * [1, -1, 1], atol=1e-6)


def test_a_foreign_hand_and_ours_have_their_links_at_the_same_places(tmp_path: Path) -> None:
    spec, theirs = load_spec(), load_spec(serial=str(menagerie_like(tmp_path, "right")))
    postures = np.random.default_rng(0).uniform(spec.lower, spec.upper, (5, 16))
    ours, other = Skeleton(bodies_of(spec), spec), Skeleton(hand_bodies(theirs), theirs)
    for finger in spec.fingers:
        for joint in finger.joints:
            places = [
                skeleton.places(postures)[[body.joint for body in skeleton.bodies].index(joint)]
                for skeleton in (ours, other)
            ]
            np.testing.assert_allclose(places[0][0], places[1][0], atol=1e-6)
            np.testing.assert_allclose(places[0][1], places[1][1], atol=1e-5)
    assert sum(len(body.shapes) for body in other.bodies) == sum(len(body.shapes) for body in ours.bodies)


def taken(make_sim: MakeSim, width: int, height: int, view: str | View) -> Picture:
    backend = make_sim(load_spec())
    backend.reset()
    try:
        camera = Camera(backend, width=width, height=height, view=view)
    except ConfigError as error:
        pytest.skip(str(error))
    picture = camera.take()
    camera.close()
    return picture


def test_a_picture_may_be_larger_than_the_scene_was_made_for(make_sim: MakeSim) -> None:
    assert taken(make_sim, 1441, 1001, View(0.0, -10.0, 0.5)).shape == (1001, 1441, 3)


def test_by_default_one_sees_the_object_between_thumb_and_fingers() -> None:
    rig = assemble(scenario_config("lemon", "right"))
    assert rig.sim is not None
    rig.backend.reset()
    try:
        camera = Camera(rig.sim, width=160, height=160)
    except ConfigError as error:
        pytest.skip(str(error))
    picture = camera.take().astype(float) / 255
    camera.close()
    rig.backend.close()
    yellow = (picture[..., 0] > 0.45) & (picture[..., 1] > 0.35) & (picture[..., 2] < 0.3)
    assert yellow.mean() > 0.005, "the lemon is hidden"
