"""Where an object is wanted for by its name, what looks like it is taken, and another one that is held is a miss."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from allegro_twin.cell.actions.cell_actions import CellActions
from allegro_twin.cell.assembly import Cell, make_cell
from allegro_twin.cell.perception.pipeline import Detection
from allegro_twin.cell.planning.wanted_object import resting_extents, unlikeness, wanted_first
from allegro_twin.cell.run import other_than_wanted
from allegro_twin.cell.settings import LabSettings
from allegro_twin.cell.states import CellOutcome, MachineState
from allegro_twin.sim.objects.catalogue import GraspObject, load_object
from allegro_twin.types import Array
from tests.cell.test_clearing import looked
from tests.cell.test_run import SETTINGS
from tests.sim.dirty_meshes import obj

OBJECTS = [{"name": "lemon", "at": [-0.1, 0.1]}, {"name": "sugar_box", "at": [0.08, -0.06], "yaw": 20.0}]
"""The box has more points in the picture; the lemon comes first, as what `lab --object` names does."""


def cell_wanting(wanted: str | None, **changes: Any) -> Cell:
    settings = LabSettings.model_validate(SETTINGS.model_dump() | {"objects": OBJECTS} | changes)
    return make_cell(settings, wanted=wanted)


@pytest.fixture(scope="module")
def cell() -> Cell:
    return cell_wanting("lemon")


def place(seen: object) -> Array:
    assert isinstance(seen, Detection)
    return seen.solid.position[:2]


def test_of_several_things_the_one_that_is_like_what_was_asked_for_comes_first(cell: Cell) -> None:
    seen = looked(cell)[2]
    np.testing.assert_allclose(place(seen[0]), [0.08, -0.06], atol=0.005)
    assert cell.wanted is not None
    np.testing.assert_allclose(place(wanted_first(seen, cell.wanted)[0]), [-0.1, 0.1], atol=0.005)
    assert wanted_first(seen, load_object("sugar_box"))[0] is seen[0]


def test_what_is_like_nothing_that_was_seen_leaves_the_order_as_it_is(cell: Cell) -> None:
    seen = looked(cell)[2]
    assert wanted_first(seen, GraspObject("pea", "sphere", (0.008,), 0.001)) is seen


def test_an_mjcf_is_as_large_as_the_boxes_around_its_parts(tmp_path: Path) -> None:
    file = tmp_path / "thing.xml"
    file.write_text(
        "<mujoco><worldbody><body pos='1 2 3'><geom type='box' size='0.01 0.02 0.03' mass='0.1'/>"
        "<body pos='0 0 0.05' euler='90 0 0'><geom type='cylinder' size='0.005 0.04' mass='0.1'/></body>"
        "</body></worldbody></mujoco>"
    )
    thing = GraspObject("thing", "mjcf", (), float("nan"), file)
    np.testing.assert_allclose(resting_extents(thing)[2], [0.02, 0.08, 0.085], atol=1e-6)


@pytest.mark.parametrize(("wanted", "where"), [("lemon", [-0.1, 0.1]), (None, [0.08, -0.06])])
def test_the_cell_looks_for_what_was_asked_for(
    wanted: str | None, where: list[float], cell: Cell, monkeypatch: pytest.MonkeyPatch
) -> None:
    heard: list[Any] = []
    work = CellActions(cell if wanted else replace(cell, wanted=None))
    work.on_detection = lambda frame, seen: heard.append(seen)
    monkeypatch.setattr(work.selector, "first", lambda seen, frame, alone: None)
    state = cell.arm.reset()
    work.observe(MachineState("Look", 0.0), state)
    work.observe(MachineState("Look", 0.0), replace(state, t=state.t + 0.5))
    np.testing.assert_allclose(place(heard[0]), where, atol=0.005)


def test_a_box_that_lies_askew_in_its_file_has_its_own_edges(tmp_path: Path) -> None:
    corners = np.array([[x, y, z] for x in (0, 0.09) for y in (0, 0.06) for z in (0, 0.04)])
    c, s = np.cos(np.radians(34.0)), np.sin(np.radians(34.0))
    faces = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    triangles = [three for a, b, c_, d in faces for three in ([a, b, c_], [a, c_, d])]
    file = obj(tmp_path / "box.obj", corners @ [[c, s, 0], [-s, c, 0], [0, 0, 1]], triangles, 1.0)
    poses = resting_extents(GraspObject("box", "mesh", (), 0.1, file))
    assert unlikeness((0.04, 0.09, 0.06), poses) < 0.01
    assert unlikeness((0.06, 0.09, 0.06), poses) == pytest.approx(np.log(1.5), abs=0.01)
    assert unlikeness((0.1, 0.1, 0.1), np.empty((0, 3))) == np.inf


def test_another_object_that_is_held_is_a_miss_which_names_both(cell: Cell) -> None:
    held, risen = CellOutcome("held"), {"lemon": 0.0, "sugar_box": 0.15}
    found = other_than_wanted(held, "sugar_box", risen, cell)
    assert str(found) == "missed: another object"
    assert found.sentence.startswith("held sugar_box, not lemon: ")
    assert "\n" not in found.sentence
    fault = CellOutcome("fault", "dropped")
    assert other_than_wanted(held, "lemon", risen, cell) is held
    assert other_than_wanted(held, "sugar_box", {"lemon": 0.14, "sugar_box": 0.01}, cell) is held
    assert other_than_wanted(fault, "sugar_box", risen, cell) is fault
    assert other_than_wanted(held, "sugar_box", risen, replace(cell, wanted=None)) is held
