"""How the cell's arm goes: as on a spring that no friction holds."""

from __future__ import annotations

import numpy as np
import pytest

from allegro_twin.cell.arm.faults import DisturbedBackend
from allegro_twin.cell.arm.impedance import Stiffness
from allegro_twin.cell.arm.target import SMOOTH
from allegro_twin.cell.motion.arm_motion import ACCELERATION, ArmGuide, GuidedImpedance, Straight
from allegro_twin.kinematics.arm import rotation_between
from allegro_twin.kinematics.pose import Pose
from allegro_twin.loop import run, until
from allegro_twin.types import Array
from tests.cell.arm.rigs import rig
from tests.cell.arm.test_control import BARE


@pytest.mark.parametrize("name", ["fer", pytest.param("fr3", marks=pytest.mark.slow)])
def test_a_push_moves_the_cells_arm_as_its_spring_says_in_spite_of_friction_and_a_noisy_sensor(name: str) -> None:
    push = np.zeros((2500, 3))
    push[50:, 0] = -10.0
    arm = rig(name, push)
    guide = ArmGuide(arm.model.spec.ready, arm.model)
    guide.let_go()
    law = GuidedImpedance(arm.model, guide, Stiffness(1000.0, 50.0).diagonal(), SMOOTH, BARE)
    noisy = DisturbedBackend(arm.guard, np.array([1.3, 1.3, 1.3, 0.0, 0.0, 0.0]))
    *_, last = until(2.5, run(noisy, law))
    assert arm.moved(last.state)[0] == pytest.approx(-0.01, rel=0.03)


def test_a_straight_way_is_followed_to_a_centimetre_and_ends_without_going_further() -> None:
    arm = rig("fer", np.zeros((1, 3)))
    guide = ArmGuide(arm.model.spec.ready, arm.model)
    begin = guide.target.pose
    end = Pose(begin.position + np.array([0.05, 0.0, -0.15]), begin.rotation @ about_x(0.4))
    law = GuidedImpedance(arm.model, guide, Stiffness(1000.0, 50.0).diagonal(), SMOOTH, BARE)
    guide.straight(0.0, end, 1.2)
    off, turned = [], []
    for sample in until(2.0, run(arm.guard, law)):
        pose, setpoint = arm.model.pose(sample.state.position), guide.line.at(sample.state.t)  # type: ignore[union-attr]
        off.append(pose.position - setpoint.position)
        turned.append(float(np.linalg.norm(rotation_between(pose.rotation, setpoint.rotation))))
    assert np.linalg.norm(off, axis=1).max() < 0.01  # It was 24 mm behind where only the place was told.
    assert max(turned) < 0.03
    assert min(each[2] for each in off) > -0.001  # And then 7 mm too deep.


@pytest.mark.parametrize("far", [0.05, 0.145, 0.4])
def test_a_short_far_way_is_gone_as_gently_as_a_long_one_and_ends_where_it_leads(far: float) -> None:
    """At full speed 0.145 rad would take 0.18 s, at 26 rad/s²: the third joint overshot its limit of 2.17 rad/s."""
    arm = rig("fer", np.zeros((1, 3)))
    begin = arm.model.spec.ready
    guide = ArmGuide(begin, arm.model)
    law = GuidedImpedance(arm.model, guide, Stiffness(1000.0, 50.0).diagonal(), SMOOTH, BARE)
    goal = begin + far * np.array([0.3, 1.0, -1.0, 0.3, -0.7, 0.9, -0.5])
    there = guide.through_joints(0.0, begin, goal, 1.5)
    speeds = [sample.state.velocity for sample in until(there + 0.3, run(arm.guard, law))]
    assert np.abs(speeds).max() < min(1.6, 1.4 * np.sqrt(2.0 * ACCELERATION * far))
    state = arm.guard.read()
    np.testing.assert_allclose(state.position, goal, atol=0.01)


def test_the_motion_of_a_straight_way_is_the_derivative_of_its_poses() -> None:
    line = Straight(Pose(np.zeros(3), np.eye(3)), Pose(np.array([0.1, -0.2, 0.3]), about_x(0.7)), 0.5, 1.3)
    step = 1e-5
    for t in (0.7, 1.0, 1.5):
        before, now, after = (line.at(t + each) for each in (-step, 0.0, step))
        motion = line.motion(t)
        np.testing.assert_allclose((after.position - before.position) / (2.0 * step), motion.twist[:3], rtol=1e-6)
        turn = rotation_between(before.rotation, after.rotation)
        np.testing.assert_allclose(turn / (2.0 * step), motion.twist[3:], rtol=1e-4, atol=1e-9)
        second = (after.position - 2.0 * now.position + before.position) / step**2
        np.testing.assert_allclose(second, motion.acceleration[:3], rtol=1e-3, atol=1e-4)
    for t in (0.0, 2.0):
        np.testing.assert_array_equal(line.motion(t).twist, np.zeros(6))
        np.testing.assert_array_equal(line.motion(t).acceleration, np.zeros(6))


def about_x(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
