"""Which ways the arm reaches: with room in its joints at every posture, and no joint racing on a straight way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from allegro_twin.cell.assembly import Cell
from allegro_twin.cell.planning.reachability import reachable_grasps, reaches_straight
from allegro_twin.cell.planning.stored_grasps import stored_grasps
from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.arm import rotate
from allegro_twin.kinematics.pose import Pose
from tests.cell.test_run import cell_of


@pytest.fixture(scope="module")
def cell() -> Cell:
    return cell_of()


def test_every_posture_of_a_plan_has_room_in_every_joint_also_those_above_the_object(cell: Cell) -> None:
    """Straight above the first place the arm gets to within 0.03 rad of a joint's end."""
    spec, above = cell.robot.spec, 0
    body = next(card.body for card in stored_grasps("allegro") if card.name == "sugar_box")
    drawn = np.random.default_rng(5).uniform([-0.1, -0.3, -np.pi], [0.14, 0.3, np.pi], (3, 3))
    for x, y, yaw in ((0.1398, 0.0914, -1.6681), *drawn):
        there = replace(body, yaw=float(yaw), position=np.array([x, y, body.position[2]]))
        try:
            plans = reachable_grasps(there, cell.robot, cell.posture, cell.settings.lift)
        except ConfigError:
            continue  # Out of reach.
        for plan in plans:
            above += len(plan.through) - 1
            for posture in (*plan.through, *plan.there):
                assert np.minimum(posture - spec.lower, spec.upper - posture).min() >= 0.08
    assert above


def test_a_straight_way_on_which_the_elbow_swings_far_is_none_and_a_short_one_from_there_is(cell: Cell) -> None:
    """With the second joint near 0 the first and the third turn about nearly the same axis, against each other."""
    begin = np.array([0.801, -0.49, -0.89, -2.907, -0.468, 2.864, 0.227])
    end = np.array([2.015, -0.234, -2.0, -2.823, -0.221, 3.239, 0.074])
    between = np.linalg.norm(cell.robot.model.pose(end).position - cell.robot.model.pose(begin).position)
    assert between < 0.15
    assert not reaches_straight(begin, end, cell.robot)
    there = cell.robot.model.pose(begin)
    higher = Pose(there.position + np.array([0.0, 0.0, 0.03]), there.rotation)
    assert reaches_straight(begin, cell.robot.model.reach(higher, begin), cell.robot)


def test_a_straight_way_that_comes_near_a_joint_s_end_or_leaves_the_arm_s_reach_in_the_middle_is_none(
    cell: Cell,
) -> None:
    posture, model = cell.posture, cell.robot.model
    here = model.pose(posture)
    end = model.reach(Pose(here.position, rotate(here.rotation, np.array([0.0, 0.0, 0.3]))), posture)
    spec = cell.robot.spec
    room = float(np.minimum(posture - spec.lower, spec.upper - posture).min())
    assert reaches_straight(posture, end, cell.robot)
    assert not reaches_straight(posture, end, cell.robot, room + 0.3)
