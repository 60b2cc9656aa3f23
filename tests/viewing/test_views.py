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
from allegro_twin.viewing.views import NAMES, Aim, View, aim, aimed_view, checked, size, view
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
    with pytest.raises(ConfigError, match=r"camera .*(front, side, top, palm|AZIMUTH|within)"):
        checked(text)
    assert checked("-120,-20,0.4") == "-120,-20,0.4"


@pytest.mark.parametrize("name", NAMES)
def test_every_name_is_another_place_and_the_left_hand_has_the_mirror_image(name: str, side: Side) -> None:
    spec = load_spec(side=side)
    tips = Skeleton(bodies_of(spec), spec).tips()
    _, place = aimed_view(name, side, *tips, np.eye(3))
    others = [
        aimed_view(other, side, *tips, np.eye(3))[1]
        for other in NAMES
        if other != name and {name, other} != {"auto", "side"}
    ]
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


def test_a_named_view_is_where_its_name_says() -> None:
    """Of a hand whose fingers point along x and curl downwards: z out of the palm is down, and y is across to -y."""
    target = Aim(np.array([0.1, 0.0, -0.05]), np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, -1.0]))
    found = {name: view(name, target, np.eye(3)) for name in NAMES}
    degrees = {
        "auto": (np.degrees(np.arctan2(-1.0, -0.35)), -25.0, 0.45),
        "front": (180.0, -15.0, 0.42),  # From ahead, against x; what is inward has no azimuth.
        "side": (np.degrees(np.arctan2(-1.0, -0.35)), -14.0, 0.42),  # From y, which is where the thumb is, and ahead.
        "top": (0.0, -80.0, 0.5),  # Ahead is up in the picture.
        "palm": (180.0, -8.0, 0.42),  # From below would be through the table.
    }
    for name, (azimuth, elevation, distance) in degrees.items():
        got = found[name]
        assert np.cos(np.radians(got.azimuth - azimuth)) == pytest.approx(1.0, abs=1e-12), name
        assert (got.elevation, got.distance) == pytest.approx((elevation, distance)), name


def test_a_palm_that_faces_sideways_is_looked_into_and_one_that_faces_up_from_ahead() -> None:
    forward, up = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
    sideways = view("palm", Aim(np.zeros(3), up, forward), np.eye(3))
    assert (abs(sideways.azimuth), sideways.elevation) == (180.0, -8.0)
    leaning = np.array([0.6, 0.0, 0.8])
    assert view("palm", Aim(np.zeros(3), up, leaning), np.eye(3)).elevation == pytest.approx(-53.13010235)
    facing = view("palm", Aim(np.zeros(3), np.array([0.0, 1.0, 0.0]), up), np.eye(3))
    assert (facing.azimuth, facing.elevation) == pytest.approx((-90.0, -60.0))
    side = view("side", Aim(np.zeros(3), up, forward), np.eye(3))  # Across is forward × up = -y.
    assert side.azimuth == pytest.approx(np.degrees(np.arctan2(-1.0, -0.15)))
    front = view("front", Aim(np.zeros(3), np.array([0.0, 1.0, 0.0]), forward), np.eye(3))
    assert front.azimuth == pytest.approx(np.degrees(np.arctan2(-1.0, -0.35)))


def test_a_view_looks_along_its_angles_and_the_left_hands_is_mirrored() -> None:
    np.testing.assert_allclose(View(90.0, 0.0, 1.0).direction(), [0.0, 1.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(View(60.0, -30.0, 1.0).direction(), [0.4330127, 0.75, -0.5], atol=1e-7)
    np.testing.assert_allclose(View(60.0, -30.0, 1.0).direction("left"), [0.4330127, -0.75, -0.5], atol=1e-7)


def test_the_middle_of_a_grasp_lies_a_third_of_the_way_to_straight_and_bent_fingertips() -> None:
    target = aim(np.array([[0.0, 0.1, 0.0], [0.0, -0.1, 0.2]]), np.array([[0.1, 0.1, 0.0], [0.1, -0.1, 0.1]]))
    np.testing.assert_allclose(target.middle, [0.1 / 3, 0.0, 0.05])
    np.testing.assert_allclose(target.ahead, [0.0, 0.0, 1.0])
    np.testing.assert_allclose(target.inward, [1.0, 0.0, 0.0])


def test_a_larger_hand_is_seen_from_farther_and_a_smaller_one_from_no_nearer() -> None:
    """The middle of the larger one's grasp is 240 mm from its palm, twice what a hand has at most."""
    straight, bent = np.array([[0.0, 0.0, 0.36]]), np.array([[1e-3, 0.0, 0.36]])
    assert aimed_view("side", "right", straight, bent, np.eye(3))[1].distance == pytest.approx(0.84, abs=1e-3)
    assert aimed_view("side", "right", straight / 10, bent / 10, np.eye(3))[1].distance == 0.42
    assert aimed_view("0,0,0.3", "right", straight, bent, np.eye(3))[1] == View(0.0, 0.0, 0.3)
    assert aimed_view(View(1.0, 2.0, 3.0), "left", straight, bent, np.eye(3))[1] == View(1.0, 2.0, 3.0)


@pytest.mark.parametrize("text", ["0,90,0.05", "7,-90,10"])
def test_a_camera_may_stand_as_near_and_as_steep_as_the_bounds(text: str) -> None:
    assert checked(text) == text


@pytest.mark.parametrize("text", ["0,0,0.04999", "0,0,10.001", "0,90.01,1"])
def test_a_camera_beyond_the_bounds_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="within ±90"):
        checked(text)


def test_a_picture_may_have_16_to_8192_pixels_along_an_edge() -> None:
    assert size("16X8192") == (16, 8192)
    assert size("8192x16") == (8192, 16)
    for text in ("15x100", "100x15", "8193x100", "100x8193"):
        with pytest.raises(ConfigError, match="16 to 8192"):
            size(text)
