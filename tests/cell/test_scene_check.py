"""A cell that cannot be as its config says is refused in a line when it is made, before anything moves."""

from __future__ import annotations

import re
from typing import Any

import pytest

from allegro_twin.cell.assembly import make_cell
from allegro_twin.cell.planning.release import check_tray
from allegro_twin.cell.settings import LabSettings, TraySettings
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root
from allegro_twin.files.schema import load_settings
from tests.cell.test_run import SETTINGS, cell_of

APPLE = {"name": "apple", "at": [0.0, 0.03]}
CAMERA = SETTINGS.model_dump()["camera"]


@pytest.mark.parametrize(("changes", "said"), [
    ({"objects": [APPLE, {"name": "orange", "at": [0.01, 0.03]}]},
     "objects apple and orange stand 6. mm in each other where the scene begins: move one of them by its `at`"),
    ({"objects": [APPLE | {"at": [0.6, 0.0]}]},
     r"apple at \(0.60, 0.00\) stands beside the table, which reaches from \(-0.45, -0.45\) to \(0.45, 0.45\)"),
    ({"objects": [APPLE | {"at": [0.0, 0.0, -0.1]}]},
     r"apple at \(0.00, 0.00, -0.10\) is below the table, whose top is at 0 m: leave out the third number"),
    ({"objects": [APPLE | {"at": [0.0, 0.0, 0.02]}]}, "apple stands 1[67] mm deep in the table where the cell begins"),
    ({"objects": [APPLE, {"name": "lemon", "at": [-0.32, 0.32]}], "tray": {}},
     "lemon stands .* mm deep in the tray where the cell begins: move it by its `at`"),
    ({"tray": {"at": [0.0, 0.2]}},
     r"tray.at \(0.00, 0.20\): the tray .* stands in perception's `workspace`, .* where it would hide objects"),
    ({"objects": [APPLE], "tray": {"size": [0.005, 0.3]}},
     r"tray.size 0.005 x 0.3 m: walls of 6 mm leave no room between them; make it larger"),
    ({"security": {"position": [-0.1, 0.0, 0.01], "facing": [0.0, 0.0, -1.0], "fingers": [1.0, 0.0, 0.0]}},
     r"security.position \(-0.10, 0.00, 0.01\): \S+ would wait \d+ mm deep in the table; take a place with more room"),
    ({"camera": CAMERA | {"mount": {"position": [0.36, 0.0, -0.46], "towards": [0.0, 0.0, 0.05]}}},
     r"camera.mount.position \(0.36, 0.00, -0.46\): the camera is below the table, whose top is at 0 m: raise it"),
    ({"objects": [APPLE | {"name": "world", "shape": "box", "size": [0.05, 0.05, 0.05], "mass": 0.1}]},
     "object world: another part of the scene has this name"),
    ({"objects": [APPLE | {"name": "fer_link3", "shape": "box", "size": [0.05, 0.05, 0.05], "mass": 0.1}]},
     "object fer_link3: another part of the scene has this name"),
    ({"objects": [APPLE | {"name": "table", "shape": "box", "size": [0.05, 0.05, 0.05], "mass": 0.1}]},
     "object table: another part of the scene has this name"),
])  # fmt: skip
def test_a_cell_that_cannot_stand_so_is_refused_when_it_is_made(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError, match=said) as refused:
        cell_of(**changes)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(("changes", "said"), [
    ({"tray": {"at": [-0.5, 0.15]}},
     r"tray.at: the tray stands 40 mm deep in fer_link1, and the arm stands at \(-0.55, 0.00\) .*; move the tray away"),
    ({"objects": [{"name": "post", "shape": "box", "size": [0.16, 0.1, 0.3], "mass": 0.1, "at": [-0.44, 0.0]}]},
     r"the `at` of post: post stands \d+ mm deep in fer_link\d, and the arm stands at .*; move post away"),
])  # fmt: skip
def test_what_stands_in_the_foot_of_the_arm_is_moved_and_not_the_waiting_pose(
    changes: dict[str, Any], said: str
) -> None:
    with pytest.raises(ConfigError, match=said):
        cell_of(**changes)


@pytest.mark.parametrize(("at", "way"), [
    ((-0.75, 0.0), r"0.20 m from its base .*; put the tray farther away, such as at"),
    ((0.6, 0.5), r"1.25 m from its base .*; put the tray nearer, such as at"),
])  # fmt: skip
def test_a_tray_out_of_reach_is_refused_with_the_way_to_where_the_arm_reaches(
    at: tuple[float, float], way: str
) -> None:
    cell = cell_of(tray={"at": at})
    with pytest.raises(ConfigError, match=way) as refused:
        check_tray(TraySettings(at=at), cell)
    place = re.search(r"such as at \((\S+), (\S+)\)", str(refused.value))
    assert place is not None
    check_tray(TraySettings(at=(float(place[1]), float(place[2]))), cell)


def test_objects_that_touch_each_other_are_no_overlap() -> None:
    box = {"shape": "box", "size": [0.06, 0.05, 0.05], "mass": 0.1}
    cell_of(objects=[box | {"name": "one", "at": [0.0, 0.0]}, box | {"name": "two", "at": [0.06, 0.0]},
                     box | {"name": "top", "at": [0.0, 0.0, 0.0751]}]).close()  # fmt: skip


def test_a_seed_below_zero_is_refused_by_its_name() -> None:
    with pytest.raises(ValueError, match="seed"):
        LabSettings.model_validate(SETTINGS.model_dump() | {"seed": -1})


def test_the_check_comes_after_the_forces_of_position_servos_are_read_for_it_leaves_these_limp() -> None:
    cell = make_cell(load_settings(LabSettings, data_root() / "conf" / "lab_leap.yaml"))
    lower, upper = cell.forces
    assert (lower < -0.1).all()
    assert (upper > 0.1).all()
