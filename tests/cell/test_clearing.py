"""A table is cleared: one object after the other goes into the tray, and what cannot is named."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from allegro_twin.cell.actions.cell_actions import CellActions
from allegro_twin.cell.actions.cell_pictures import without_tray
from allegro_twin.cell.assembly import Cell
from allegro_twin.cell.camera.camera import CameraFrame
from allegro_twin.cell.camera.intrinsics import Cloud
from allegro_twin.cell.checks.camera_check import CameraCheck
from allegro_twin.cell.checks.grasp_check import check_grasp
from allegro_twin.cell.ground_truth import ObjectPlaces, object_places, objects_in_hand
from allegro_twin.cell.motion.empty_grasp import empty_grasp
from allegro_twin.cell.motion.other_objects import on_tray
from allegro_twin.cell.perception.cloud import Mask
from allegro_twin.cell.perception.errors import PerceptionRefusal
from allegro_twin.cell.perception.fits.model import Solid
from allegro_twin.cell.perception.pipeline import Detection
from allegro_twin.cell.perception.touching import make_compound
from allegro_twin.cell.planning.object_selection import ObjectSelector, SelectedObject, _least_count, shows_at_fingers
from allegro_twin.cell.planning.reachability import GraspPlan, plain_grasps, plan_grasp
from allegro_twin.cell.planning.release import _PLACES, ReleasePath, _emptiest_first, reaches_tray, release_path
from allegro_twin.cell.planning.stored_grasps import stored_grasps, table_object
from allegro_twin.cell.run import _Story, other_than_cleared, other_than_counted, perform
from allegro_twin.cell.settings import TraySettings
from allegro_twin.cell.states import CellOutcome, MachineState, OutcomeKind
from allegro_twin.drivers.realsense import RealSenseSource
from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.pose import Pose
from allegro_twin.types import Array
from tests.cell.test_run import SETTINGS, cell_of

TRAY = TraySettings()
BALL = Solid("sphere", np.array([0.0, 0.0, 0.0365]), np.eye(3), (0.073, 0.073, 0.073), 0.0)


@pytest.mark.slow
def test_two_that_touch_and_one_that_lies_apart_end_in_the_tray() -> None:
    cell = cell_of(
        tray=TRAY.model_dump(),
        objects=[
            {"name": "foam_brick", "at": [0.0, 0.0]}, {"name": "rubiks_cube", "at": [0.068, 0.01]},
            {"name": "rod", "shape": "cylinder", "size": [0.04, 0.11], "mass": 0.08, "up": "x", "at": [-0.02, -0.1]},
        ],
    )  # fmt: skip
    report = perform(cell)
    assert (str(report.end), report.released) == ("cleared", 3)
    assert set(report.in_tray) == {"foam_brick", "rubiks_cube", "rod"}


@pytest.mark.slow
def test_what_is_too_large_is_left_and_named_and_the_rest_is_put_away() -> None:
    cell = cell_of(
        tray=TRAY.model_dump(),
        objects=[
            {"name": "slab", "shape": "box", "size": [0.16, 0.16, 0.14], "mass": 0.5, "at": [0.08, 0.06]},
            {"name": "golf_ball", "at": [-0.02, -0.2]},
        ],
    )  # fmt: skip
    report = perform(cell)
    assert (str(report.end), report.in_tray) == ("missed: left", ("golf_ball",))
    assert "1 object put away; left: " in report.end.sentence
    assert re.search(r"box of 1(5[5-9]|6[0-5]) x", report.end.sentence), report.end.sentence


def test_the_hand_opens_above_the_tray_with_the_object_in_its_middle() -> None:
    cell = cell_of(tray=TRAY.model_dump())
    plan = plain_grasps(table_object(BALL), cell.robot, cell.posture, cell.settings.lift)[0]
    way, lifted = plan.candidate, plan.there[1]
    path = release_path(TRAY, way, way.palm, BALL, (), lifted, cell)
    turn = path.palm.rotation @ way.palm.rotation.T
    middle = path.palm.position + turn @ (BALL.position - way.palm.position)
    np.testing.assert_allclose(middle[:2], TRAY.at, atol=1e-9)
    assert middle[2] - 0.0365 == pytest.approx(TRAY.height + TRAY.above)
    np.testing.assert_allclose(turn[2], [0.0, 0.0, 1.0], atol=1e-9)  # What is held stays upright.
    reached = cell.robot.base.rotation @ cell.robot.model.pose(path.across).position + cell.robot.base.position
    assert np.linalg.norm(reached[:2] - TRAY.at) < 0.3
    second = release_path(TRAY, way, way.palm, BALL, (), lifted, cell, used=1)
    assert np.hypot(*(second.palm.position - path.palm.position)[:2]) > 0.03  # Not on top of the first.
    heap = np.array([[*(np.array(TRAY.at) + 0.1), 0.1 - 1e-3 * k] for k in range(2)])
    full = release_path(TRAY, way, way.palm, BALL, (), lifted, cell, inside=heap)
    assert full.palm.position[2] - path.palm.position[2] == pytest.approx(0.1 - TRAY.height, abs=1e-4)
    tower = (np.array([[0.1, 0.1, 0.0], [0.14, 0.14, 0.3]]),)
    high = release_path(TRAY, way, way.palm, BALL, tower, lifted, cell).over.position[2]
    assert high - way.palm.position[2] > 0.3  # Over all that stands on the table.


@pytest.mark.parametrize("empty", range(5))
def test_an_object_is_let_go_where_the_tray_is_emptiest_and_at_the_next_place_where_all_are_alike(empty: int) -> None:
    middle, edges = np.array(TRAY.at), np.array(TRAY.size)
    full = np.array([[*(middle + place * edges), 0.07] for k, place in enumerate(_PLACES) if k != empty])
    for used in range(3):
        chosen = _emptiest_first(TRAY, BALL, full, used)[0]
        np.testing.assert_array_equal(chosen, _PLACES[empty])
        np.testing.assert_array_equal(_emptiest_first(TRAY, BALL, full[:0], used)[0], _PLACES[used])


@pytest.mark.slow
def test_what_has_no_way_to_the_tray_is_put_back_where_it_stood_and_the_run_goes_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def no_way(*_: object) -> ReleasePath:
        raise ConfigError("fer does not get to the tray")

    monkeypatch.setattr("allegro_twin.cell.actions.cell_actions.release_path", no_way)
    cell = cell_of(tray=TRAY.model_dump(), objects=[{"name": "foam_brick", "at": [0.0, 0.0]}])
    before = cell.robot.object_pose("foam_brick").position
    report = perform(cell)
    states = [state for _, state in report.events]
    assert states[states.index("ToReleasePose") :][:4] == ["ToReleasePose", "PutBack", "OpeningHand", "ToSecurityPose"]
    assert (str(report.end), report.released, report.in_tray) == ("missed: left", 0, ())
    assert "fer does not get to the tray" in report.end.sentence
    assert np.linalg.norm((cell.robot.object_pose("foam_brick").position - before)[:2]) < 0.01


@pytest.mark.slow
def test_a_tray_out_of_reach_is_refused_with_its_place() -> None:
    cell = cell_of(tray=TRAY.model_dump())
    plan = plain_grasps(table_object(BALL), cell.robot, cell.posture, cell.settings.lift)[0]
    far = TRAY.model_copy(update={"at": (1.5, 0.3)})
    with pytest.raises(ConfigError, match=r"does not get to the tray at \(1.5, 0.3\) with the sphere"):
        release_path(far, plan.candidate, plan.candidate.palm, BALL, (), plan.there[1], cell)
    assert reaches_tray(TRAY, plan.candidate.palm, BALL, plan.there[1], cell)
    assert not reaches_tray(far, plan.candidate.palm, BALL, plan.there[1], cell)


def test_a_tray_out_of_reach_is_refused_before_anything_moves() -> None:
    cell = cell_of(tray=TRAY.model_dump() | {"at": [1.5, 0.3]}, objects=[{"name": "apple", "at": [0.0, 0.03]}])
    with pytest.raises(ConfigError, match=r"tray.at: fer does not reach above \(1.5, 0.3\)"):
        perform(cell)


def test_what_cannot_be_brought_to_the_tray_is_not_taken() -> None:
    cell = cell_of(tray=TRAY.model_dump(), objects=[{"name": "apple", "at": [0.0, 0.03]}])
    asked = list[GraspPlan]()

    def never(plan: GraspPlan) -> bool:
        asked.append(plan)
        return False

    with pytest.raises(ConfigError, match="from where it would hold it, it does not get to the tray"):
        plan_grasp(BALL, cell, deliverable=never)
    assert len(asked) > 1
    first = asked[0].candidate.palm.position
    chosen = plan_grasp(BALL, cell, deliverable=lambda plan: not np.allclose(plan.candidate.palm.position, first))
    assert not np.allclose(chosen.candidate.palm.position, first)


def test_a_grasp_that_is_preferred_comes_first_and_any_will_do_where_none_is() -> None:
    cell = cell_of()
    first = plan_grasp(BALL, cell).candidate.palm.position
    other = plan_grasp(BALL, cell, prefer=lambda plan: not np.allclose(plan.candidate.palm.position, first))
    assert not np.allclose(other.candidate.palm.position, first)
    np.testing.assert_array_equal(plan_grasp(BALL, cell, prefer=lambda plan: False).candidate.palm.position, first)


def test_fingers_tell_a_grasp_that_rests_far_from_where_it_would_close_on_nothing() -> None:
    cell = cell_of()
    way = plan_grasp(BALL, cell).candidate
    nothing = empty_grasp(cell.settings.hand, way.card.grasp, way.palm.rotation).position
    closing = np.sign(way.card.grasp.squeeze - way.card.grasp.preshape)
    for rest, told in ((None, True), (nothing, False), (nothing - 0.3 * closing, True)):
        one = replace(way, card=replace(way.card, rest=rest))
        assert shows_at_fingers(one, cell) == told


@pytest.mark.slow
def test_what_meets_something_above_the_tray_is_let_go_there_and_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    nobody_sees = np.zeros((0, 3))
    monkeypatch.setattr("allegro_twin.cell.actions.cell_pictures.points_in_tray", lambda *_: nobody_sees)
    cell = cell_of(
        tray=TRAY.model_dump(),
        objects=[
            {"name": "foam_brick", "at": [0.0, 0.0]},
            {"name": "tower", "shape": "box", "size": [0.22, 0.22, 0.1], "mass": 9.0, "at": [*TRAY.at, 0.0565]},
        ],
    )
    met = list[str]()
    report = perform(cell, on_state=lambda now: met.append(now.state))
    assert (str(report.end), report.released) == ("cleared", 1)
    assert "Retreat" not in met
    assert met[met.index("ToReleasePose") + 1] == "OpeningHand"


def test_the_way_back_goes_up_across_and_down_unless_the_palm_is_above_already() -> None:
    cell = cell_of(tray=TRAY.model_dump())
    work = CellActions(cell)
    plan = plain_grasps(table_object(BALL), cell.robot, cell.posture, cell.settings.lift)[0]
    work._grasped = plan.candidate.palm
    for posture, ways in ((plan.there[1], 1), (cell.posture, 3)):
        above, left = work._way_back(replace(cell.arm.reset(), position=posture))
        assert len(left) == ways
        assert left[-1] is plan.candidate.palm
        np.testing.assert_allclose(above.position[:2], plan.candidate.palm.position[:2])
        assert all(isinstance(each, Pose) and each.position[2] >= plan.candidate.palm.position[2] for each in left)
        assert above.position[2] > plan.candidate.palm.position[2] + 0.1


def test_what_meets_something_where_it_comes_down_has_arrived_and_is_led_away_from_anything_before() -> None:
    cell = cell_of(tray=TRAY.model_dump())
    work, state = CellActions(cell), cell.arm.reset()
    reflex = CellOutcome("fault", "cartesian_reflex", "the force on the flange of fer along z is 41 N")
    work.motion.set_touchdown(cell.robot.palm(state))
    for left, place, met in (([], "ToReleasePose", None), ([], "PutBack", None), ([state.position], "PutBack", reflex)):
        work._reflex, work.motion.ahead = reflex, list(left)
        seen = work.observe(MachineState(place, 0.0), state)  # type: ignore[arg-type]
        assert (seen.done, seen.reflex) == (met is None, met)
    work._reflex, work.motion.ahead = reflex, []
    work.motion.set_touchdown(cell.security)
    aside = replace(state, position=state.position + np.array([0.3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    assert work.observe(MachineState("PutBack", 0.0), aside).reflex == reflex


@pytest.mark.slow
def test_another_grasp_is_taken_of_what_is_alike_after_a_miss_and_the_same_where_there_is_no_other() -> None:
    cell = cell_of(tray=TRAY.model_dump(), objects=[{"name": "apple", "at": [0.0, 0.03]}])
    selector, (frame, alone, seen) = ObjectSelector(cell), looked(cell)
    first = selector.first(seen, frame, alone)
    assert isinstance(first, SelectedObject)
    selector.missed(first.plan.candidate.card, first.found.solid, leave=False)
    second = selector.first(seen, frame, alone)
    assert isinstance(second, SelectedObject)
    assert second.plan.candidate.card.name != first.plan.candidate.card.name
    for card in stored_grasps("allegro"):
        selector.missed(card, first.found.solid, leave=False)
    assert isinstance(selector.first(seen, frame, alone), SelectedObject)
    selector.missed(first.plan.candidate.card, first.found.solid, leave=True)
    left = selector.first(seen, frame, alone)
    assert isinstance(left, CellOutcome)
    assert "was not held" in left.sentence


def test_an_empty_table_on_which_things_were_seen_says_so_and_what_stands_outside_is_named() -> None:
    full = cell_of(tray=TRAY.model_dump(), objects=[{"name": "apple", "at": [0.0, 0.03]}])
    selector, (frame, alone, seen) = ObjectSelector(full), looked(full)
    selector.first(seen, frame, alone)
    empty = cell_of(tray=TRAY.model_dump(), objects=[{"name": "tomato_soup_can", "at": [0.05, -0.4]}])
    frame, alone, seen = looked(empty)
    found = selector.first(seen, frame, alone)
    assert isinstance(found, CellOutcome)
    assert (found.reason, selector.warning) == ("outside", "1 object was seen: see what has become of 1")
    selector.put_away()
    selector.first(seen, frame, alone)
    assert not selector.warning


def test_a_check_of_one_object_is_not_told_of_the_next_that_was_selected(monkeypatch: pytest.MonkeyPatch) -> None:
    cell = cell_of(tray=TRAY.model_dump(), objects=[{"name": "apple", "at": [0.0, 0.03]}])
    work, (frame, alone, seen) = CellActions(cell), looked(cell)
    chosen = work.selector.first(seen, frame, alone)
    work.held.found = check_grasp(0.2, 0.053, 1.0, 1.0, CameraCheck(), cell.settings.validation)
    for answer in (None, chosen):
        monkeypatch.setattr(work.table, "look", lambda *_, answer=answer: answer)
        work.observe(MachineState("Look", 0.0), cell.arm.reset())
        assert (work.held.found is None) == (answer is not None)


def test_what_slipped_out_of_the_hand_into_the_tray_is_not_sought() -> None:
    full = cell_of(tray=TRAY.model_dump(), objects=[{"name": "apple", "at": [0.0, 0.03]}])
    selector, (frame, alone, seen) = ObjectSelector(full), looked(full)
    selector.first(seen, frame, alone)
    selector.put_away()
    empty = cell_of(tray=TRAY.model_dump(), objects=[{"name": "apple", "at": [0.42, -0.42]}])
    frame, alone, seen = looked(empty)
    selector.first(seen, frame, alone)
    assert not selector.warning


def looked(cell: Cell) -> tuple[CameraFrame, Cloud, list[Detection | PerceptionRefusal]]:
    """A picture, the same without arm and hand, and what is seen in it."""
    cell.arm.reset(), cell.hand.reset()
    frame = cell.camera.capture(cell.robot.world.data)
    alone = cell.self_filter.remove_robot(frame.cloud, cell.posture, cell.open)
    cloud = without_tray(frame.cloud, frame, cell)
    return frame, alone, cell.pipeline.detect_all(cloud, frame.pose.position, frame.pose.rotation)


def mask(points: Array) -> Mask:
    return on_tray(points, points[:, 2], TRAY, 0.008)


def test_what_is_in_the_tray_is_not_on_the_table() -> None:
    x, y = TRAY.at
    points = np.array([[x, y, 0.03], [x + TRAY.size[0] / 2.0, y, 0.02], [0.0, 0.0, 0.02]])
    assert mask(points).tolist() == [True, True, False]


def bar(first: float, last: float, low: float) -> Array:
    """Points of a bar along x, from and to so far beyond the tray's edge, and from a height on, m."""
    edge = TRAY.at[0] + TRAY.size[0] / 2.0
    across, up = np.meshgrid(np.arange(edge + first, edge + last, 0.004), np.arange(low, 0.1, 0.004))
    return np.stack([across.ravel(), np.full(across.size, TRAY.at[1]), up.ravel()], axis=1)


def test_what_reaches_from_the_tray_over_its_wall_is_in_it_and_what_stands_beside_it_is_not() -> None:
    assert mask(bar(-0.1, 0.07, 0.06)).all()
    assert not mask(bar(0.012, 0.04, 0.0)).any()
    assert not mask(bar(0.3, 0.34, 0.06)).any()
    both = mask(np.concatenate([bar(-0.1, 0.0, 0.06), bar(0.014, 0.04, 0.0)]))
    low = np.concatenate([bar(-0.1, 0.0, 0.06), bar(0.014, 0.04, 0.0)])[:, 2] < 0.04
    assert not both[low].any()  # Behind what is in the tray it still shows by its foot.


def test_what_stands_right_beside_the_tray_is_seen_and_named() -> None:
    at = [TRAY.at[0] + TRAY.size[0] / 2.0 + 0.016, 0.3]
    stick = {"name": "stick", "shape": "cylinder", "size": [0.026, 0.1], "mass": 0.05, "at": at}
    cell = cell_of(tray=TRAY.model_dump(), objects=[stick])
    frame, alone, seen = looked(cell)
    found = ObjectSelector(cell).first(seen, frame, alone)
    assert isinstance(found, CellOutcome)
    assert found.reason != "no_object"
    assert "(-0.17" in found.sentence


def test_an_empty_table_with_a_tray_shows_nothing_whatever_the_cameras_noise() -> None:
    for seed in range(3):
        cell = cell_of(tray=TRAY.model_dump(), objects=[{"name": "apple", "at": [0.42, -0.42]}], seed=seed)
        frame, alone, seen = looked(cell)
        found = ObjectSelector(cell).first(seen, frame, alone)
        assert isinstance(found, CellOutcome)
        assert found.reason == "no_object", found.sentence


def test_a_thing_that_is_too_small_to_be_known_is_named_beside_one_that_is_known() -> None:
    cube = {"name": "cube", "shape": "box", "size": [0.02] * 3, "mass": 0.02, "at": [-0.1, -0.1]}
    cell = cell_of(tray=TRAY.model_dump(), objects=[cube])
    frame, alone, seen = looked(cell)
    selector = ObjectSelector(cell)
    selector._most = 1  # It was larger in an earlier picture.
    found = selector.first(seen, frame, alone)
    assert isinstance(found, CellOutcome)
    assert (found.reason, selector.warning) == ("small", "")


def test_the_parts_of_what_may_be_one_body_count_once() -> None:
    part = looked(cell_of(objects=[{"name": "apple", "at": [0.0, 0.03]}]))[2]
    assert isinstance(part[0], Detection)
    whole = replace(part[0], solid=make_compound([part[0].solid, replace(BALL, position=BALL.position + 0.05)]))
    parts = [replace(part[0], instead=(whole,)), replace(part[0], instead=(whole,))]
    nothing = PerceptionRefusal("no_object", "nothing stands on the table")
    small, large = PerceptionRefusal("small", "something"), PerceptionRefusal("unclear", "the thing")
    assert _least_count(parts) == 1
    assert _least_count([*parts, part[0], large, small]) == 3
    assert _least_count([nothing]) == 0


def test_in_truth_an_object_is_in_the_tray_when_the_tray_carries_it_and_its_middle_is_inside_the_walls() -> None:
    brick: dict[str, object] = {"shape": "box", "size": [0.06, 0.06, 0.04], "mass": 0.1}
    x, y = TRAY.at
    edge, low = x + TRAY.size[0] / 2.0, 0.0259
    places = {"below": (x, y, low), "above": (x, y, low + 0.0399), "beside": (edge + 0.0299, y, 0.0199),
              "on_the_wall": (edge + 0.02, y + 0.09, 0.0599), "in_the_air": (x, y - 0.07, 0.2),
              "off": (0.6, 0.0, 0.0)}  # fmt: skip
    bar = {"name": "leaning", "shape": "box", "size": [0.3, 0.02, 0.02], "mass": 0.1, "at": [0.1, 0.0]}
    things = [{**brick, "name": name, "at": [0.3, 0.1 * k - 0.3]} for k, name in enumerate(places)]
    cell = cell_of(tray=TRAY.model_dump(), objects=[*things, bar])
    model, data = cell.robot.world.model, cell.robot.world.data
    for name, at in places.items():
        data.joint(name).qpos[:3] = at
    lean = np.radians(18.0)  # Its foot is on the table, its middle over the tray.
    foot = 0.15 * np.sin(lean) + 0.01 * np.cos(lean) - 1e-4
    data.joint("leaning").qpos[:] = [edge - 0.02, y - 0.09, foot, np.cos(lean / 2.0), 0.0, np.sin(lean / 2.0), 0.0]
    mujoco.mj_forward(model, data)
    assert object_places(cell) == (("below", "above"), ("beside", "on_the_wall", "in_the_air", "leaning"), ("off",))


def test_in_truth_the_hand_carries_what_it_touches_and_what_touches_that_and_nothing_on_the_table() -> None:
    ball: dict[str, object] = {"shape": "sphere", "size": [0.04], "mass": 0.05}
    names = ("first", "second", "apart", "stands")
    cell = cell_of(objects=[{**ball, "name": name, "at": [0.1 * k - 0.1, 0.3]} for k, name in enumerate(names)])
    cell.arm.reset(), cell.hand.reset()
    model, data = cell.robot.world.model, cell.robot.world.data
    assert objects_in_hand(cell) == ()
    tip = data.site(cell.hand.spec.fingers[0].tip).xpos.copy()
    for k, name in enumerate(names[:3]):
        data.joint(name).qpos[:3] = tip + np.array([0.0, 0.0, (0.0, -0.0399, -0.1)[k]])
    mujoco.mj_forward(model, data)
    assert objects_in_hand(cell) == ("first", "second")


@pytest.mark.slow
def test_what_the_camera_does_not_see_is_known_to_a_simulation_and_the_table_is_not_cleared() -> None:
    things = [{"name": "apple", "at": [0.0, 0.03]}, {"name": "golf_ball", "at": [0.35, 0.0]}]
    report = perform(cell_of(tray=TRAY.model_dump(), objects=things))
    assert (str(report.end), str(report.believed)) == ("missed: left", "cleared")
    assert (report.in_tray, report.on_table, report.off_table) == (("apple",), ("golf_ball",), ())
    assert "in truth golf_ball still on the table" in report.end.sentence


def test_a_table_that_a_simulation_knows_is_not_cleared_is_missed_with_what_the_cell_believes_and_what_is_true() -> (
    None
):
    cell = cell_of(tray=TRAY.model_dump())
    end = CellOutcome("cleared", "", "2 objects put away")
    found = other_than_cleared(end, ObjectPlaces(("apple",), ("ball",), ("tall",)), cell)
    assert str(found) == "missed: left"
    assert found.sentence.startswith("2 objects put away, so the cell takes it for cleared; in truth ball still on the")
    assert "tall neither in the tray nor on the table" in found.sentence
    assert other_than_cleared(end, ObjectPlaces(("apple",)), cell) is end
    fault = CellOutcome("fault", "camera", "no picture")
    assert other_than_cleared(fault, ObjectPlaces((), ("ball",)), cell) is fault


@pytest.mark.parametrize("kind", ["cleared", "missed"])
def test_objects_that_were_taken_at_once_are_counted_as_they_are_and_as_the_cell_does(kind: OutcomeKind) -> None:
    cell = cell_of(tray=TRAY.model_dump())
    rest = "" if kind == "cleared" else "; left: a box"
    end = CellOutcome(kind, "", f"1 object put away{rest}")
    found = other_than_counted(end, 3, 1, cell)
    assert found.sentence == f"3 objects put away (the cell counts 1: what it took at once is one to it){rest}"
    assert other_than_counted(end, 1, 1, cell) is end
    none = CellOutcome(kind, "", f"0 objects put away{rest}")
    assert other_than_counted(none, 1, 0, cell).sentence == f"1 object put away (the cell counts 0){rest}"
    camera = cell.settings.camera.model_copy(update={"source": RealSenseSource()})
    real = replace(cell, settings=cell.settings.model_copy(update={"camera": camera}))
    assert other_than_counted(end, 3, 1, real) is end  # How many real objects it was nobody knows.


def test_what_was_in_the_tray_before_anything_moved_is_not_counted_as_put_away() -> None:
    cell = cell_of(tray=TRAY.model_dump(), objects=[{"name": "apple"}, {"name": "golf_ball", "at": [0.1, 0.0]}])
    data = cell.robot.world.data
    data.joint("golf_ball").qpos[:3] = [*TRAY.at, 0.03]
    mujoco.mj_step(cell.robot.world.model, data, 100)
    story = _Story(cell, CellActions(cell))
    story.enter(MachineState("ToSecurityPose", 0.0), lambda now: None)
    assert object_places(cell).in_tray == ("golf_ball",)
    end = CellOutcome("missed", "left", "0 objects put away; left: an apple")
    assert story.report(MachineState("Done", 1.0, end=end)).end == end


@pytest.mark.slow
def test_two_slabs_that_are_seen_as_one_box_and_taken_at_once_are_two_that_were_put_away() -> None:
    slab = {"shape": "box", "size": [0.06, 0.0295, 0.09], "mass": 0.08}
    cell = cell_of(
        tray=TRAY.model_dump(),
        objects=[slab | {"name": "one", "at": [0.0, -0.015]}, slab | {"name": "two", "at": [0.0, 0.015]}],
    )
    report = perform(cell)
    assert (str(report.end), report.released, report.in_tray) == ("cleared", 1, ("one", "two"))
    assert report.end.sentence.startswith("2 objects put away (the cell counts 1")


@pytest.mark.slow
def test_a_bottle_s_scan_with_holes_is_taken_for_about_a_solid_and_held(tmp_path: Path) -> None:
    around, heights = 2.0 * np.pi * np.arange(48) / 48, [(33, 0), (35, 5), (35, 90), (30, 115), (14, 135), (13, 165)]
    points = [[r * np.cos(a), r * np.sin(a), z] for r, z in heights for a in around]  # mm; open at both ends.
    rings = [(48 * k + i, 48 * k + (i + 1) % 48) for k in range(len(heights) - 1) for i in range(48)]
    faces = [face for a, b in rings for face in ((a, b, a + 48), (b, b + 48, a + 48))]
    rows = ["v {:.4f} {:.4f} {:.4f}".format(*p) for p in points]
    rows += [f"f {a + 1} {b + 1} {c + 1}" for k, (a, b, c) in enumerate(faces) if k % 50]  # Some are lost.
    scan = tmp_path / "bottle.obj"
    scan.write_text("\n".join(rows))
    cell = cell_of(
        perception=SETTINGS.perception.model_dump() | {"object": {"loose": 0.006}},
        objects=[
            {"name": "bottle", "shape": "mesh", "file": scan, "mass": 0.2, "at": [0.0, 0.03]},
            {"name": "golf_ball", "at": [0.0, -0.15]},
        ],
    )  # fmt: skip
    report = perform(cell)
    assert (str(report.end), report.object_name, report.is_lifted) == ("held", "bottle", True)
