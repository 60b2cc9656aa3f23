"""What a search sees of an object: its surface, its symmetry, palms that look at it, fingers that close on it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from allegro_twin.errors import ConfigError
from allegro_twin.grasping.metrics.quality import imbalance
from allegro_twin.grasping.plan.candidate import (
    Candidate,
    ObjectSymmetry,
    candidate_scenario,
    grasp_distance,
    is_different,
    object_symmetry,
    palm_distance,
)
from allegro_twin.grasping.plan.proposals.close_in_geometry import close_fingers, metric_contacts
from allegro_twin.grasping.plan.proposals.poses import guess_poses, sample_placed_surface, sample_surface
from allegro_twin.grasping.plan.proposals.propose import weight_loads
from allegro_twin.grasping.plan.templates import grasp_templates
from allegro_twin.grasping.scenario import load_protocol, load_scenario
from allegro_twin.grasping.timeline import make_stage
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.kinematics.orientation import matrix_from_quaternion
from allegro_twin.sim.contact.grasp_scene import GraspScene, TouchPoints, wrist_coordinates
from allegro_twin.sim.objects.catalogue import GraspObject, PlacedObject, load_object
from allegro_twin.spec import SIDES, Side
from allegro_twin.surfaces.cli.grasps.plan import scenario_of
from allegro_twin.types import Array

SPEC = load_spec()
TEMPLATES = grasp_templates(SPEC)
MADE = {
    "sphere": GraspObject("a", "sphere", (0.06,), 0.1),
    "cylinder": GraspObject("a", "cylinder", (0.06, 0.1), 0.1),
    "box": GraspObject("a", "box", (0.03, 0.06, 0.1), 0.1),
    "ellipsoid": GraspObject("a", "ellipsoid", (0.05, 0.08), 0.1),
}
UPRIGHT = (1.0, 0.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def bench() -> GraspScene:
    return bench_of("tennis_ball")


def bench_of(name: str) -> GraspScene:
    scenario = scenario_of(name, "z", None, None, 0.8)
    return GraspScene(SPEC, make_stage(scenario, load_protocol("table_pick"), "right", Path()))


def candidate(position: tuple[float, float, float] = (0.0, 0.0, 0.1), turn: float = 0.0) -> Candidate:
    """A palm that looks down."""
    c, s = np.cos(turn), np.sin(turn)
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
    zero = np.zeros(SPEC.n_joints)
    return Candidate(np.array(position), rotation, np.array([0, 0, 0.1]), zero, zero, zero, zero, zero, "grasp_3")


@pytest.mark.parametrize("shape", sorted(MADE))
def test_points_lie_on_the_surface_and_normals_point_out_of_it(shape: str) -> None:
    thing, random = MADE[shape], np.random.default_rng(0)
    points, normals = sample_surface(thing, 500, random)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)
    inside, outside = (inside_of(thing, points + step * normals) for step in (-1e-4, 1e-4))
    assert inside.all()
    assert not outside.any()


def inside_of(thing: GraspObject, points: Array) -> NDArray[np.bool_]:
    half = thing.half_extents()
    match thing.shape:
        case "box":
            return np.array((np.abs(points) <= half).all(axis=1))
        case "cylinder":
            return np.array((np.linalg.norm(points[:, :2], axis=1) <= half[0]) & (np.abs(points[:, 2]) <= half[2]))
    return np.array(np.linalg.norm(points / half, axis=1) <= 1.0)


def test_points_are_spread_evenly_over_faces_of_different_size() -> None:
    _, normals = sample_surface(MADE["box"], 20_000, np.random.default_rng(1))
    share = np.abs(normals).sum(axis=0) / 20_000
    areas = np.array([0.06 * 0.1, 0.03 * 0.1, 0.03 * 0.06])
    np.testing.assert_allclose(share, areas / areas.sum(), atol=0.01)


def test_an_ellipsoid_has_no_more_points_at_its_ends_than_their_area() -> None:
    points, _ = sample_surface(MADE["ellipsoid"], 20_000, np.random.default_rng(1))
    e = np.sqrt(1.0 - (0.025 / 0.04) ** 2)
    x = np.linspace(-0.04, 0.04, 20_001)
    ring = np.sqrt(1.0 - (e * x / 0.04) ** 2)  # Area of a ring of width dx, but for a constant.
    cap = ring[x > 0.02].sum() / ring.sum()
    assert (points[:, 0] > 0.02).mean() == pytest.approx(cap, abs=0.01)


def test_an_mjcf_has_no_surface_to_look_at() -> None:
    with pytest.raises(ConfigError, match="give it as a mesh"):
        sample_surface(GraspObject("a", "mjcf", (), 0.1, Path("a.xml")), 5, np.random.default_rng(0))


@pytest.mark.parametrize(
    ("name", "count"),
    [
        ("tennis_ball", 36),
        ("tomato_soup_can", 36),
        ("rubiks_cube", 4),
        ("wood_block", 4),
        ("sugar_box", 2),
        ("lemon", 2),
    ],
)
def test_an_object_has_the_turns_that_leave_it_as_it_is(name: str, count: int) -> None:
    assert len(object_symmetry(PlacedObject(load_object(name), (0.0, 0.0, 0.0), UPRIGHT)).turns) == count


def test_a_lemon_that_stands_on_its_tip_has_any_turn_and_so_has_a_can_on_its_head() -> None:
    half = float(np.sqrt(0.5))
    for name, quaternion in (("lemon", (half, 0.0, -half, 0.0)), ("tomato_soup_can", (0.0, 1.0, 0.0, 0.0))):
        assert len(object_symmetry(PlacedObject(load_object(name), (0.0, 0.0, 0.0), quaternion)).turns) == 36


def test_the_same_grasp_from_another_side_of_a_can_is_no_other_grasp() -> None:
    can = object_symmetry(PlacedObject(load_object("tomato_soup_can"), (0.0, 0.0, 0.0), UPRIGHT))
    here, there = candidate((0.1, 0.0, 0.1)), candidate((0.0, 0.1, 0.1), np.pi / 2)
    assert is_different(there, [here], ObjectSymmetry(np.zeros(3)))
    assert not is_different(there, [here], can)
    for distance in (grasp_distance, palm_distance):
        far, turned = distance(here, there, can)
        assert far < 1e-9
        assert turned < 1e-6


def test_a_long_palm_that_leans_by_a_few_degrees_over_the_same_ball_is_no_other_grasp() -> None:
    """Its origin, 0.21 m above the ball, moves by 26 mm; the ball stays where it was in the palm."""
    ball = object_symmetry(PlacedObject(load_object("tennis_ball"), (0.0, 0.0, 0.033), UPRIGHT))
    above, tilt, spin = candidate((0.0, 0.0, 0.243)), np.radians(7.0), np.radians(64.0)
    lean = np.array([[np.cos(tilt), 0.0, np.sin(tilt)], [0.0, 1.0, 0.0], [-np.sin(tilt), 0.0, np.cos(tilt)]])
    yaw = np.array([[np.cos(spin), -np.sin(spin), 0.0], [np.sin(spin), np.cos(spin), 0.0], [0.0, 0.0, 1.0]])
    turn = yaw @ lean
    leaning = replace(above, position=ball.centre + turn @ (0.0, 0.0, 0.21), rotation=turn @ above.rotation)
    assert palm_distance(leaning, above, ball)[0] > 0.02
    far, turned = grasp_distance(leaning, above, ball)
    assert far < 1e-9
    assert np.degrees(turned) == pytest.approx(7.0, abs=3.0)  # The yaw is told in steps of 10°.
    assert not is_different(leaning, [above], ball)
    assert is_different(leaning, [above], ObjectSymmetry(ball.centre))


def test_from_above_and_from_the_side_a_ball_is_grasped_differently_on_a_table_and_alike_in_the_air() -> None:
    ball = object_symmetry(PlacedObject(load_object("tennis_ball"), (0.0, 0.0, 0.0), UPRIGHT))
    above, over = candidate((0.0, 0.0, 0.1)), np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    side = replace(above, position=over @ above.position, rotation=over @ above.rotation)
    assert is_different(side, [above], ball)
    assert not is_different(side, [above], replace(ball, ball=True))
    further = replace(side, position=1.3 * side.position)
    assert is_different(further, [above], replace(ball, ball=True))


@pytest.mark.parametrize("side", SIDES)
def test_a_trial_has_the_palm_where_the_search_had_it_for_either_hand(side: Side) -> None:
    """Scenarios are written for the right hand: of a left one the mirror image."""
    spec, scenario = load_spec(side=side), load_scenario("lemon")[0]
    there = replace(candidate((0.02, 0.03, 0.1), 0.4), retreat=np.array([0.01, 0.02, 0.1]))
    stage = make_stage(scenario, load_protocol("table_pick"), side, Path())
    there = replace(there, position=there.position + stage.objects[0].position)
    written = candidate_scenario(there, GraspScene(spec, stage), scenario)
    assert written.side == side
    again = make_stage(written, load_protocol("table_pick"), side, Path())
    np.testing.assert_allclose(again.position, there.position + there.retreat, atol=1e-4)
    np.testing.assert_allclose(matrix_from_quaternion(again.quaternion), there.rotation, atol=1e-3)


def test_what_the_fingers_do_makes_no_grasp_another_one() -> None:
    here = candidate((0.1, 0.0, 0.1))
    assert not is_different(replace(here, close=here.close + 1.0), [here], ObjectSymmetry(np.zeros(3)))


@given(st.integers(0, 10_000))
def test_palms_are_in_front_of_the_points_that_they_look_at(seed: int) -> None:
    random, thing = np.random.default_rng(seed), PlacedObject(MADE["box"], (0.1, 0.0, 0.05), UPRIGHT)
    on = sample_placed_surface(thing, 8, random)
    found = guess_poses(on, np.eye(3), TEMPLATES, SPEC, random)
    for row in range(8):
        rotation = found.rotation[row]
        np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), atol=1e-9)
        assert np.linalg.det(rotation) > 0.0
        ahead = rotation.T @ (on.points[row] - found.position[row])
        assert 0.012 <= ahead[0] <= 0.085
    assert (found.preshape >= SPEC.lower).all()
    assert (found.preshape <= SPEC.upper).all()


@given(st.integers(0, 10_000))
def test_the_wrists_coordinates_put_the_palm_where_it_was_asked_to_be(seed: int) -> None:
    random = np.random.default_rng(seed)
    rotation = np.linalg.qr(random.normal(size=(3, 3)))[0]
    rotation *= np.sign(np.linalg.det(rotation))
    a, b, c = wrist_coordinates(np.zeros(3), rotation)[3:]
    turn = np.eye(3)
    for axis, angle in enumerate((a, b, c)):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        one = np.eye(3)
        one[i, i] = one[j, j] = np.cos(angle)
        one[i, j], one[j, i] = -np.sin(angle), np.sin(angle)
        turn = turn @ one
    np.testing.assert_allclose(turn, rotation, atol=1e-7)


def test_the_workbench_has_the_palm_where_it_is_put(bench: GraspScene) -> None:
    guess = candidate((0.03, -0.02, 0.2), 0.7)
    bench.place(guess.position, guess.rotation, guess.preshape)
    np.testing.assert_allclose(bench.data.body("palm_link").xpos, guess.position, atol=1e-12)
    np.testing.assert_allclose(bench.data.body("palm_link").xmat.reshape(3, 3), guess.rotation, atol=1e-9)
    assert not bench.meets_anything()
    bench.place(np.array([0.0, 0.0, 0.03]), guess.rotation, guess.preshape)
    assert bench.meets_anything()


def test_fingers_stop_where_they_meet_the_ball_and_are_not_deep_in_it(bench: GraspScene) -> None:
    grasp = next(t for t in TEMPLATES if t.name == "sphere_4_finger")
    guess = replace(
        candidate((-0.02, 0.0, 0.12)), preshape=grasp.preshape, closing=np.sign(grasp.squeeze - grasp.preshape)
    )
    done, touch = close_fingers(bench, guess)
    assert len(set(touch.part.tolist())) >= 2
    middle = np.array(bench.placed.position)
    np.testing.assert_allclose(np.linalg.norm(touch.points - middle, axis=1), 0.0324, atol=0.01)
    assert (np.einsum("ki,ki->k", touch.normals, middle - touch.points) > 0.0).all()  # Into the ball.
    assert (done.close >= SPEC.lower).all()


def pinched(friction: float, off: float = 0.0) -> float:
    touch = TouchPoints(
        np.array([[0.03, 0.0, 0.0], [-0.03, off, 0.0], [0.0, 0.0, 0.03]]),
        np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]), np.array([0, 1, 2]), np.zeros(3),
        np.zeros(3, int),
    )  # fmt: skip
    return imbalance(metric_contacts(touch, np.zeros(3), friction))


def test_fingers_that_face_each_other_balance_and_fingers_on_one_side_do_not() -> None:
    assert pinched(0.8) < 1e-6
    assert pinched(0.1, off=0.03) > 0.1
    same = TouchPoints(
        np.array([[0.03, 0.0, 0.0], [0.03, 0.01, 0.0]]),
        np.array([[-1.0, 0, 0]] * 2),
        np.zeros(2, int),
        np.zeros(2),
        np.zeros(2, int),
    )
    assert imbalance(metric_contacts(same, np.zeros(3), 0.8)) > 0.9


def test_the_weight_turns_with_the_palm() -> None:
    rotation = candidate().rotation
    found = weight_loads(rotation, 0.5, (0.0, np.pi))
    np.testing.assert_allclose(found[0, :3], [0.0, 0.0, -4.905])
    np.testing.assert_allclose(found[1, :3], [0.0, 0.0, 4.905], atol=1e-9)  # The palm looks down: its z is level.
    assert not found[:, 3:].any()


def test_templates_close_several_joints_and_can_be_of_one_type() -> None:
    assert len(TEMPLATES) > 30
    assert {grasp.kind.name for grasp in grasp_templates(SPEC, "Tripod")} == {"Tripod"}


def test_for_a_type_that_the_library_does_not_show_any_template_is_a_beginning() -> None:
    assert [grasp.name for grasp in grasp_templates(SPEC, "Writing Tripod")] == ["tripod"]
    assert len(grasp_templates(SPEC, "Stick")) == len(TEMPLATES)
    with pytest.raises(ConfigError, match="did you mean 'Medium Wrap'"):
        grasp_templates(SPEC, "Medium Warp")
