"""Cartesian control against its bars: what a spring does, how fast compliance is, and what neither accepts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import linprog  # type: ignore[import-untyped]  # Its types are a package of their own.

from allegro_twin.cell.arm.compliance import Compliance, Pull, VirtualArm, advance_virtual_arm
from allegro_twin.cell.arm.faults import DisturbedBackend
from allegro_twin.cell.arm.impedance import Impedance, Stiffness, hung
from allegro_twin.cell.arm.target import CartesianTarget, Smoothing, approach
from allegro_twin.cell.arm.tool import WrenchCompensation
from allegro_twin.errors import CommandError, ConfigError
from allegro_twin.hands.description.arms import load_arm_spec
from allegro_twin.kinematics.arm import ArmModel, rotate, rotation_between
from allegro_twin.kinematics.orientation import matrix_from_quaternion, quaternion_from_matrix, slerp
from allegro_twin.kinematics.pose import Pose
from allegro_twin.loop import run, until
from allegro_twin.spec.arm import Load
from allegro_twin.types import Array, frozen
from tests.cell.arm.rigs import GAP, WALL, Rig, at_a_wall, rig

STICK = WrenchCompensation(Load(0.001, frozen([0.0, 0.0, 0.06])))
BARE = WrenchCompensation(Load(0.0, frozen([0.0, 0.0, 0.0])))


def below(arm: Rig, depth: float) -> Pose:
    return Pose(arm.home.position - [0.0, 0.0, depth], arm.home.rotation)


def followed(arm: Rig, law: Compliance, goal: Pose, cycles: int, wall: float = np.inf) -> list[float]:
    """Heights of a tool that follows at once, m above the start, after each cycle; `wall`: where it begins, below."""
    virtual, heights = VirtualArm(arm.model.spec.ready, np.zeros(7), np.zeros(6)), [0.0]
    for _ in range(cycles):
        push = np.array([0.0, 0.0, WALL * max(-wall - heights[-1], 0.0), 0.0, 0.0, 0.0])
        virtual = advance_virtual_arm(law, virtual, goal, push)
        heights.append(float(arm.model.pose(virtual.position).position[2] - arm.home.position[2]))
    return heights


@pytest.mark.slow
@pytest.mark.parametrize("name", ["fer", "fr3"])
@pytest.mark.parametrize("stiffness", [150.0, 400.0, 1000.0])
def test_a_push_of_ten_newtons_moves_the_tool_by_ten_over_k(name: str, stiffness: float) -> None:
    push = np.zeros((2200, 3))
    push[50:, 2] = -10.0
    arm = rig(name, push)
    state = arm.after(2.2, Impedance(arm.model, arm.target, Stiffness(stiffness, 10.0)))
    assert arm.moved(state)[2] == pytest.approx(-10.0 / stiffness, rel=0.05)
    assert np.abs(state.velocity).max() < 1e-3  # Stable: it has come to rest.


@pytest.mark.slow
@pytest.mark.parametrize(("name", "axis", "stiffness", "angular"), [
    ("fer", 0, 150.0, 10.0), ("fer", 0, 1000.0, 10.0), ("fr3", 0, 400.0, 10.0), ("fr3", 2, 150.0, 30.0),
])  # fmt: skip
def test_an_arm_that_feels_its_flange_is_moved_by_ten_over_k_whichever_way_it_is_pushed(
    name: str, axis: int, stiffness: float, angular: float
) -> None:
    push = np.zeros((2500, 3))
    push[50:, axis] = -10.0
    arm = rig(name, push)
    state = arm.after(2.5, Impedance(arm.model, arm.target, Stiffness(stiffness, angular), compensation=BARE))
    assert arm.moved(state)[axis] == pytest.approx(-10.0 / stiffness, rel=0.02)
    assert np.abs(state.velocity).max() < 2e-3


@pytest.mark.parametrize("dry", [0.2, *(pytest.param(each, marks=pytest.mark.slow) for each in (0.1, 0.4))])
def test_a_sensor_that_is_noisy_and_a_friction_that_is_not_the_tables_make_no_arm_swing(dry: float) -> None:
    push = np.zeros((2500, 3))
    push[50:, 0] = -10.0
    told = load_arm_spec("fer")
    arm = rig(force=push, spec=replace(told, actuation=replace(told.actuation, frictionloss=frozen(np.full(7, dry)))))
    noisy = DisturbedBackend(arm.guard, np.array([1.3, 1.3, 1.3, 0.0, 0.0, 0.0]))
    *_, last = until(2.5, run(noisy, Impedance(ArmModel(told), arm.target, Stiffness(400.0, 10.0), compensation=BARE)))
    state = last.state
    assert arm.moved(state)[0] == pytest.approx(-10.0 / 400.0, rel=0.06)
    assert np.abs(state.velocity).max() < 0.02


@pytest.mark.parametrize("stiffness", [150.0, pytest.param(1000.0, marks=pytest.mark.slow)])
def test_the_tool_comes_to_rest_near_a_target_that_moved_and_turned(stiffness: float) -> None:
    arm = rig()
    goal = Pose(arm.home.position + np.array([0.1, -0.15, -0.1]), rotate(arm.home.rotation, np.array([0.3, 0.2, -0.5])))
    arm.target.move(goal)
    state = arm.after(3.0, Impedance(arm.model, arm.target, Stiffness(stiffness, 30.0)))
    pose = arm.model.pose(state.position)
    assert np.linalg.norm(pose.position - goal.position) < 2.0 / stiffness  # Dry friction: up to two newtons.
    assert np.linalg.norm(rotation_between(goal.rotation, pose.rotation)) < 0.02
    assert np.abs(state.velocity).max() < 5e-3


def test_what_draws_the_elbow_back_does_not_move_the_tool() -> None:
    arm = rig()
    state, law = arm.sim.reset(), Impedance(arm.model, arm.target)
    rest = state.position + np.array([0.2, -0.1, 0.3, 0.1, 0.0, -0.2, 0.1])
    torque = hung(arm.model, state, arm.home, rest, law.spring, law.null)
    _, _, jacobian = arm.model.motion(state.position)
    np.testing.assert_allclose(jacobian @ torque, 0.0, atol=1e-4)
    assert torque @ (rest - state.position) > 0.01


@pytest.mark.parametrize(("iterations", "seconds"), [(1, 0.54), (10, 0.05)])
def test_compliance_covers_nine_tenths_of_its_way_in_the_tabled_time(iterations: int, seconds: float) -> None:
    arm = rig()
    law = Compliance(arm.model, arm.target, pull=Pull(iterations=iterations), smoothing=None)
    # 1 cm: with ten iterations a longer way would be cut by how fast the real joints can stop.
    heights = np.array(followed(arm, law, below(arm, 0.01), 100)) / -0.01
    after = int(np.argmax(heights > 0.9))
    crossed = after - (heights[after] - 0.9) / (heights[after] - heights[after - 1])
    assert law.cycle * crossed == pytest.approx(seconds, abs=law.cycle)


@pytest.mark.parametrize(("iterations", "share"), [(1, 0.05), (1, 0.1), (10, 0.05)])
def test_at_a_wall_springs_share_the_way_whatever_the_speed(iterations: int, share: float) -> None:
    arm = rig()
    law = Compliance(arm.model, arm.target, pull=Pull(linear=share, iterations=iterations), smoothing=None)
    last = followed(arm, law, below(arm, 0.05), 1500, wall=0.01)[-1]
    assert 500.0 * (0.05 + last) == pytest.approx(WALL * (-last - 0.01), rel=1e-6)  # K e = k δ.


def test_an_arm_presses_on_a_wall_as_its_springs_say() -> None:
    arm = at_a_wall()
    arm.target.move(below(arm, 0.05))
    state = arm.after(3.0, Compliance(arm.model, arm.target, STICK))
    way, plate = -arm.moved(state)[2], -float(arm.sim.data.qpos[-1])
    assert way - plate == pytest.approx(GAP, abs=2e-3)
    assert 500.0 * (0.05 - way) == pytest.approx(WALL * plate, rel=0.01)


@pytest.mark.parametrize(("dry", "near"), [pytest.param(0.0, 0.01, marks=pytest.mark.slow), (0.2, 0.06)])
def test_an_arm_under_impedance_presses_as_hard_as_its_spring_is_drawn_but_for_friction(
    dry: float, near: float
) -> None:
    arm = at_a_wall(frictionloss=dry)
    arm.target.move(below(arm, 0.05))
    state = arm.after(2.5, Impedance(arm.model, arm.target, Stiffness(1000.0, 30.0)))
    way, plate = -arm.moved(state)[2], -float(arm.sim.data.qpos[-1])
    assert 1000.0 * (0.05 - way) == pytest.approx(WALL * plate, rel=near)


@pytest.mark.parametrize("stiffness", [400.0, pytest.param(1000.0, marks=pytest.mark.slow)])
def test_an_arm_that_feels_its_flange_presses_as_hard_as_its_spring_is_drawn_in_spite_of_friction(
    stiffness: float,
) -> None:
    arm = at_a_wall()
    arm.target.move(below(arm, 0.05))
    state = arm.after(2.5, Impedance(arm.model, arm.target, Stiffness(stiffness, 30.0), compensation=STICK))
    way, plate = -arm.moved(state)[2], -float(arm.sim.data.qpos[-1])
    assert stiffness * (0.05 - way) == pytest.approx(WALL * plate, rel=0.01)


def least(arm: Rig, axis: int, depth: float) -> float:
    """The t90 of the fastest way from rest to rest, s: full rates of torque one way, the other and back.

    Of all joint jerks that move the tool along an axis alone the largest that keeps |M q⃛| under the rates."""
    rates, jacobian = arm.model.spec.actuation.torque_rate, arm.model.motion(arm.model.spec.ready)[2]
    assert rates is not None
    inertia = np.hstack([arm.model.inertia(arm.model.spec.ready), np.zeros((7, 1))])
    along = np.hstack([jacobian, -np.eye(6)[:, [axis]]])
    found = linprog([0.0] * 7 + [-1.0], np.vstack([inertia, -inertia]), [*rates, *rates], along, np.zeros(6),
                    bounds=[(None, None)] * 8)  # fmt: skip
    whole = (32.0 * depth / found.x[7]) ** (1.0 / 3.0)
    return float(whole * (1.0 - (0.6 / 32.0) ** (1.0 / 3.0)))  # But for 0.1 % of it: the last quarter begins later.


@pytest.mark.parametrize(
    ("name", "axis", "depth"),
    [("fer", 2, 0.005), ("fer", 2, 0.02), ("fer", 2, 0.05), ("fr3", 2, 0.02), ("fr3", 2, 0.05), ("fr3", 0, 0.05)],
)
def test_ten_iterations_lead_the_arm_down_a_step_and_little_beyond_it(name: str, axis: int, depth: float) -> None:
    arm = rig(name)
    arm.target.move(Pose(arm.home.position - depth * np.eye(3)[axis], arm.home.rotation))
    law = Compliance(arm.model, arm.target, pull=Pull(iterations=10), smoothing=None)
    heights = np.array([arm.moved(sample.state)[axis] for sample in until(0.8, run(arm.guard, law))]) / -depth
    assert 1.0 <= heights.max() < 1.09
    assert heights[-1] == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize(("name", "seconds"), [("fer", 0.089), ("fr3", 0.093)])
def test_no_torque_that_may_change_so_fast_takes_the_arm_down_two_centimetres_in_the_tabled_time(
    name: str, seconds: float
) -> None:
    arm = rig(name)
    assert least(arm, 2, 0.02) == pytest.approx(seconds, abs=0.001)  # And 0.05 s are tabled.
    arm.target.move(below(arm, 0.02))
    law = Compliance(arm.model, arm.target, pull=Pull(iterations=10), smoothing=None)
    heights = np.array([arm.moved(sample.state)[2] for sample in until(0.3, run(arm.guard, law))]) / -0.02
    assert seconds < 0.001 * int(np.argmax(heights > 0.9)) < 1.25 * seconds


def test_compliance_reaches_a_target_in_the_time_of_its_iterations_on_the_arm() -> None:
    arm = rig()
    arm.target.move(below(arm, 0.05))
    law = Compliance(arm.model, arm.target, smoothing=None)
    heights = [arm.moved(sample.state)[2] for sample in until(1.0, run(arm.guard, law))]
    assert 0.001 * int(np.argmax(np.array(heights) < -0.045)) == pytest.approx(0.54, abs=0.02)


def test_compliance_presses_with_what_it_is_asked_to() -> None:
    arm = at_a_wall()
    arm.target.move(below(arm, GAP))
    arm.target.press(np.array([0.0, 0.0, -5.0, 0.0, 0.0, 0.0]))
    arm.after(2.5, Compliance(arm.model, arm.target, STICK, stiffness=Stiffness(1.0, 50.0)))
    assert -WALL * float(arm.sim.data.qpos[-1]) == pytest.approx(5.0, rel=0.02)


def test_a_set_point_goes_straight_and_turns_by_slerp_no_faster_than_it_may() -> None:
    start, goal = (
        Pose(np.zeros(3), np.eye(3)),
        Pose(np.array([1.0, 2.0, 2.0]), rotate(np.eye(3), np.array([0, 0, 2.0]))),
    )
    rule, pose, far = Smoothing(speed=0.3, turning=1.0, share=1.0), start, 0.0
    for step in range(1, 101):
        before, pose = pose, approach(pose, goal, 0.01, rule)
        assert np.linalg.norm(pose.position - before.position) <= 0.003 + 1e-12
        assert np.linalg.norm(rotation_between(before.rotation, pose.rotation)) <= 0.01 + 1e-12
        far = 0.003 * step / 3.0
        np.testing.assert_allclose(pose.position, far * goal.position, atol=1e-12)
    halfway: Array = matrix_from_quaternion(slerp([1, 0, 0, 0], quaternion_from_matrix(goal.rotation), 0.5))
    np.testing.assert_allclose(pose.rotation, halfway, atol=1e-9)
    for _ in range(2000):
        pose = approach(pose, goal, 0.01, rule)
    np.testing.assert_allclose(pose.position, goal.position, atol=1e-12)


@pytest.mark.parametrize(
    ("pose", "words"),
    [
        (Pose(np.array([0.3, np.nan, 0.2]), np.eye(3)), r"target position\[1\] is nan; the arm keeps its last target"),
        (Pose(np.zeros(3), np.ones((3, 3))), "is no rotation matrix; the arm keeps its last target"),
        (Pose(np.zeros(2), np.eye(3)), r"needs a position \(3,\) and axes \(3, 3\)"),
    ],
)
def test_a_target_that_is_none_is_refused_and_the_arm_stands_still(pose: Pose, words: str) -> None:
    arm = rig()
    with pytest.raises(CommandError, match=words):
        arm.target.move(pose)
    state = arm.after(0.3, Impedance(arm.model, arm.target))
    np.testing.assert_allclose(arm.moved(state), 0.0, atol=1e-6)


def test_a_spring_that_friction_would_hold_is_refused_with_the_least_that_is_enough() -> None:
    arm = rig()
    with pytest.raises(ConfigError, match=r"stiffness.linear 20 N/m: dry friction would keep fer up to .* at least"):
        arm.after(0.1, Impedance(arm.model, arm.target, Stiffness(20.0, 30.0)))
    with pytest.raises(ConfigError, match=r"stiffness.angular 0.5 N·m/rad: dry friction .*°"):
        arm.after(0.1, Impedance(arm.model, arm.target, Stiffness(200.0, 0.5)))


def test_a_spring_that_friction_would_hold_is_soft_enough_for_an_arm_that_feels_its_flange() -> None:
    arm = rig()
    arm.after(0.01, Impedance(arm.model, arm.target, Stiffness(20.0, 30.0), compensation=BARE))
    with pytest.raises(ConfigError, match=r"stiffness.linear 5 N/m: dry friction would keep fer up to"):
        arm.after(0.01, Impedance(arm.model, arm.target, Stiffness(5.0, 30.0), compensation=BARE))


def test_a_law_that_feels_says_what_to_do_without_a_sensor() -> None:
    arm = rig()
    unfelt, target = replace(arm.sim.reset(), wrench=np.empty(0)), CartesianTarget(arm.home)
    for law in (Compliance(arm.model, target, STICK), Impedance(arm.model, target, compensation=STICK)):
        with pytest.raises(ConfigError, match="reports no wrench: leave out the compensation"):
            law.start(unfelt)
