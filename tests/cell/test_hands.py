"""Every hand that has a mount takes things in the cell, by its own config and by one set of rules."""

from __future__ import annotations

import numpy as np
import pytest

from allegro_twin.cell.assembly import make_cell, with_objects
from allegro_twin.cell.planning.reachability import plain_grasps, reachable_grasps
from allegro_twin.cell.planning.stored_grasps import stored_grasps
from allegro_twin.cell.run import LabReport, perform
from allegro_twin.cell.settings import LabSettings, TableObjectSettings
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root
from allegro_twin.files.schema import load_settings
from allegro_twin.sim.contact.obstacle_clearance import TableObject
from tests.cell.test_run import cell_of

OTHERS = ("leap", "model_o", "qb_softhand", "sih")


def shipped(hand: str) -> LabSettings:
    return load_settings(LabSettings, data_root() / "conf" / f"lab_{hand}.yaml")


def taken(settings: LabSettings) -> LabReport:
    cell = make_cell(settings)
    try:
        return perform(cell)
    finally:
        cell.close()


@pytest.mark.parametrize(
    "hand", [pytest.param(hand, marks=pytest.mark.slow if hand == "leap" else pytest.mark.long) for hand in OTHERS]
)
def test_what_stands_in_a_hands_own_config_is_held_and_said_to_be(hand: str) -> None:
    report = taken(shipped(hand))
    assert str(report.end) == "held"
    assert report.is_lifted
    assert report.checked is not None
    assert report.checked.by_fingers


@pytest.mark.slow
def test_an_apple_in_the_hand_is_held_at_the_first_try_where_the_fingers_that_tell_hardly_press() -> None:
    """Two fingers of the LEAP Hand touch each other beside it, and the one that is left presses with 0.09 N·m."""
    report = taken(shipped("leap").model_copy(update={"seed": 102}))
    assert (str(report.end), report.tries, report.is_lifted) == ("held", 1, True)
    assert report.checked is not None
    assert report.checked.by_fingers is None


@pytest.mark.long
@pytest.mark.parametrize("hand", OTHERS)
def test_a_hand_holds_most_things_of_the_demo_wherever_they_stand_and_says_nothing_false(hand: str) -> None:
    settings, draws = shipped(hand), np.random.default_rng(11)
    held = 0
    names = sorted(card.name for card in stored_grasps(hand))
    for seed, name in enumerate(names):
        x, y, yaw = (float(draw) for draw in draws.uniform((-0.08, -0.08, -180.0), (0.08, 0.08, 180.0)))
        report = taken(with_objects(settings, [TableObjectSettings(name=name, at=(x, y), yaw=yaw)], seed))
        held += report.is_lifted
        assert report.is_lifted or report.end.kind != "held", name
    assert held >= 10  # Of 12: docs/results/cell.md names those that are not.


def test_fingers_that_point_at_the_arm_are_reached_with_the_elbow_out() -> None:
    cell = cell_of()
    box = next(card.body for card in stored_grasps("allegro") if card.name == "pudding_box")
    across = TableObject(box.kind, box.extents, np.radians(90.0), np.array([-0.01, -0.01, box.extents[2] / 2.0]))
    best = reachable_grasps(across, cell.robot, cell.posture, 0.15)[0]
    assert abs(best.through[-1][0]) > 1.0


def test_a_lemon_that_points_at_the_arm_is_taken_a_little_askew() -> None:
    cell = cell_of()
    egg = next(card.body for card in stored_grasps("allegro") if card.name == "lemon")
    there = TableObject(egg.kind, egg.extents, np.radians(-95.0), np.array([0.0, 0.0, egg.extents[2] / 2.0]))
    with pytest.raises(ConfigError, match="does not reach the lemon grasp"):
        plain_grasps(there, cell.robot, cell.posture, 0.15)
    assert reachable_grasps(there, cell.robot, cell.posture, 0.15)
