"""Other objects on the table are kept clear of or named in a refusal, and the object that was chosen is judged."""

from __future__ import annotations

import numpy as np
import pytest

from allegro_twin.cell.assembly import Cell
from allegro_twin.cell.motion.other_objects import (
    bounding_box,
    box_around,
    height_around,
    other_objects,
    points_in_tray,
    protruding_parts,
    stray_objects,
    tray_filled,
)
from allegro_twin.cell.perception.pipeline import Detection
from allegro_twin.cell.perception.segmentation import TablePlane
from allegro_twin.cell.planning.object_selection import ObjectSelector, SelectedObject
from allegro_twin.cell.planning.reachability import plan_grasp
from allegro_twin.cell.run import perform
from allegro_twin.cell.settings import TraySettings
from allegro_twin.errors import ConfigError
from allegro_twin.sim.contact.obstacle_clearance import OTHERS, TableObject
from allegro_twin.types import Array
from tests.cell.test_run import cell_of

APPLE = {"name": "apple", "at": [0.0, 0.03]}


TRAY = TraySettings()


def looked(cell: Cell) -> tuple[Detection, tuple[Array, ...]]:
    """What a first look finds, and what is beside it."""
    cell.robot.arm.reset()
    frame = cell.camera.capture(cell.robot.world.data)
    seen = cell.pipeline.detect(frame.cloud, frame.pose.position, frame.pose.rotation)
    assert isinstance(seen, Detection)
    cloud = cell.self_filter.remove_robot(frame.cloud, cell.posture, cell.open)
    return seen, other_objects(frame, cloud, seen, cell.settings.perception)


def test_one_object_alone_has_nothing_beside_it() -> None:
    for name in ("apple", "cracker_box", "chips_can", "mug"):
        assert looked(cell_of(objects=[{"name": name, "at": [0.02, -0.04], "yaw": 30.0}]))[1] == ()


def test_a_mugs_handle_stands_out_of_the_solid_that_it_is_taken_for_and_nothing_of_a_can_does() -> None:
    for name in ("chips_can", "cracker_box", "pear"):
        cell = cell_of(objects=[{"name": name, "at": [0.02, -0.04]}])
        assert protruding_parts(looked(cell)[0], cell.settings.perception) == ()
    cell = cell_of(objects=[{"name": "mug", "at": [0.0, 0.0], "yaw": 90.0}])
    seen, _ = looked(cell)
    (handle,) = protruding_parts(seen, cell.settings.perception)
    away = np.linalg.norm(handle[:, :2] - seen.solid.position[:2], axis=1)
    assert seen.solid.shape == "cylinder"
    assert away.min() > seen.solid.size[1] / 2.0 + 0.005


def test_a_grasp_has_room_to_the_objects_own_handle_where_it_can(monkeypatch: pytest.MonkeyPatch) -> None:
    cell, asked = cell_of(objects=[{"name": "mug", "at": [0.0, 0.0], "yaw": 90.0}]), list[tuple[int, float]]()
    seen, _ = looked(cell)
    frame = cell.camera.capture(cell.robot.world.data)
    alone = cell.self_filter.remove_robot(frame.cloud, cell.posture, cell.open)
    fitting = 3

    def plan(self: ObjectSelector, solid: object, obstacles: list[TableObject], clear: float) -> str:
        asked.append((len(obstacles), clear))
        if len(asked) < fitting:
            raise ConfigError("no room")
        return "a way"

    monkeypatch.setattr(ObjectSelector, "_plan", plan)
    chosen = ObjectSelector(cell).one(seen, frame, alone)
    assert isinstance(chosen, SelectedObject)
    assert asked == [(1, 0.015), (1, 0.005), (0, 0.015)]  # The handle, the handle with less room, and none.
    fitting = 0
    ObjectSelector(cell).one(seen, frame, alone)
    assert asked[3:] == [(1, 0.015)]


def test_objects_beside_it_are_found_wherever_they_stand_on_the_table() -> None:
    places = [(0.12, -0.1), (-0.1, -0.2), (0.3, 0.3)]  # The last is outside of perception's region.
    others = [
        {"name": name, "at": at} for name, at in zip(("lemon", "golf_ball", "tuna_fish_can"), places, strict=True)
    ]
    seen, found = looked(cell_of(objects=[*others, APPLE]))
    np.testing.assert_allclose(seen.solid.position[:2], [0.0, 0.03], atol=0.003)
    middles = sorted(bounding_box(points)[0][:2].tolist() for points in found)
    np.testing.assert_allclose(middles, sorted(map(list, places)), atol=0.03)  # Their far sides are not seen.


@pytest.mark.slow
def test_what_stands_outside_the_region_is_found_and_neither_arm_nor_tray_is() -> None:
    ball: dict[str, object] = {"name": "tennis_ball", "at": [0.0, 0.03]}
    can = {"name": "tomato_soup_can", "at": [0.05, -0.4]}
    for objects, places in (([ball], []), ([ball, can], [(0.05, -0.4)])):
        cell = cell_of(tray=TRAY.model_dump(), objects=objects)
        cell.arm.reset(), cell.hand.reset()
        frame = cell.camera.capture(cell.robot.world.data)
        alone = cell.self_filter.remove_robot(frame.cloud, cell.posture, cell.open)
        table = cell.pipeline.find_table(alone, frame.pose.position, frame.pose.rotation)
        assert isinstance(table, TablePlane)
        strays = stray_objects(frame, alone, cell.settings.perception, TRAY, table)
        assert len(strays) == len(places)
        for stray, place in zip(strays, places, strict=True):
            assert np.hypot(*(stray[:2] - place)) < 0.04  # Its far side is not seen.
        inside = points_in_tray(frame.pose.world(alone.astype(float)), TRAY)
        assert height_around(inside, np.array(TRAY.at), 0.3) == pytest.approx(TRAY.height, abs=0.004)


def test_a_tray_is_as_high_as_what_is_in_it_and_no_points_have_no_height() -> None:
    inside, beside = [[*TRAY.at, 0.01 * k] for k in range(12)], [[0.0, 0.0, 0.3]]
    found, middle = points_in_tray(np.array(inside + beside), TRAY), np.array(TRAY.at)
    assert height_around(found, middle, 0.1) == pytest.approx(0.11, abs=0.001)
    assert height_around(found, middle + 0.05, 0.02) == 0.0
    assert height_around(points_in_tray(np.array(beside), TRAY), middle, 0.1) == 0.0


@pytest.mark.slow
def test_the_object_that_is_chosen_is_judged_whichever_the_config_names_first_and_the_other_stays() -> None:
    report = perform(cell_of(objects=[{"name": "golf_ball", "at": [0.12, 0.12]}, {"name": "tomato_soup_can"}]))
    assert (str(report.end), report.object_name, report.grasp) == ("held", "tomato_soup_can", "tomato_soup_can")
    assert report.is_lifted
    assert report.error < 0.003
    assert report.moved == ()
    assert report.checked is not None
    assert report.checked.warning == ""


def test_an_object_in_every_way_is_refused_and_named() -> None:
    cell = cell_of()
    seen, _ = looked(cell)
    wall = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.07, 0.13) for z in (0.0, 0.2)])
    with pytest.raises(
        ConfigError, match=r"mm (from|deep in) another object .* other objects at \(0.000, 0.030, 0.100\)"
    ):
        plan_grasp(seen.solid, cell, [box_around(wall)])
    plan_grasp(seen.solid, cell)


def test_more_objects_than_can_be_kept_clear_of_are_refused() -> None:
    cell = cell_of()
    seen, _ = looked(cell)
    with pytest.raises(ConfigError, match=f"{OTHERS + 1} other objects are on the table"):
        plan_grasp(seen.solid, cell, [box_around(np.full((3, 3), 0.3))] * (OTHERS + 1))


@pytest.mark.long
@pytest.mark.parametrize("seed", range(12))
def test_nothing_is_said_to_be_held_that_is_not_and_no_other_object_is_swept_away(seed: int) -> None:
    from benchmarks.lab_clutter import drawn

    draws = np.random.default_rng((77, seed))
    names = ["apple", "sugar_box", "tuna_fish_can", "golf_ball", "chips_can", "foam_brick"]
    cell = cell_of(objects=[each.model_dump() for each in drawn(names, draws)], seed=seed)
    report = perform(cell)
    assert report.is_lifted or report.end.kind != "held"
    assert report.moved == ()


def test_a_tray_is_fuller_by_what_fell_into_it_and_not_by_the_cameras_scatter() -> None:
    draws = np.random.default_rng(1)
    x, y = (each.ravel() for each in np.meshgrid(np.arange(0.0, 0.26, 0.003), np.arange(0.0, 0.26, 0.003)))
    wall = (np.minimum(x, y) < 0.006) | (np.maximum(x, y) > 0.252)
    empty = np.stack([x, y, np.where(wall, 0.04, 0.006)], axis=1)

    def picture(points: Array) -> Array:
        return np.asarray(points + draws.normal(0.0, 0.002, points.shape))

    full = empty.copy()
    full[np.hypot(x - 0.1, y - 0.1) < 0.02, 2] = 0.045
    assert tray_filled(picture(empty), picture(full), 0.008)
    assert not tray_filled(picture(empty), picture(empty), 0.008)
    assert not tray_filled(picture(full), picture(full), 0.008)
    assert not tray_filled(empty[:0], full, 0.008)
