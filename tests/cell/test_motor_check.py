"""The motor power check: a joint away from its goal without torque is a fault by name; a healthy one never is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from allegro_twin.cell.checks.motor_check import MotorCheck
from allegro_twin.control.trajectory import SetPoint
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.types import HandState, Vector, frozen

SPEC = load_spec()
LIMIT = SPEC.actuation.torque_limit
KP = np.full(SPEC.n_joints, 12.0)
HERE = np.clip(np.full(SPEC.n_joints, 0.4), SPEC.lower + 0.1, SPEC.upper - 0.1)
STILL = np.zeros(SPEC.n_joints)
PERIODS = 60  # More than 0.15 s.


def state_of(torque: Vector, position: Vector = HERE, velocity: Vector = STILL) -> HandState:
    unknown = frozen(np.full(SPEC.n_joints, np.nan))
    return HandState(0.0, 0, frozen(position), frozen(velocity), frozen(torque), unknown, frozen([0.0, 0.0, -9.81]))


def check() -> MotorCheck:
    return MotorCheck(SPEC, KP, np.stack([-LIMIT, LIMIT]), 0.003)


def away(joint: int, by: float) -> SetPoint:
    return SetPoint(HERE + by * np.eye(SPEC.n_joints)[joint], STILL)


def test_a_joint_away_from_its_goal_without_torque_is_a_fault_by_its_name() -> None:
    motors, target = check(), away(14, 0.05)
    for _ in range(PERIODS):
        motors.update(state_of(STILL), target, STILL)
    fault = motors.fault(state_of(STILL), target)
    assert fault is not None
    assert str(fault) == "fault: hand without torque"
    assert "thumb_2 is 0.050 rad from its goal and gives 0.00 N·m of" in fault.sentence


@pytest.mark.parametrize("share", [0.5, 0.85, 1.0, 1.15])
def test_a_motor_that_gives_what_is_due_is_no_fault(share: float) -> None:
    motors, target = check(), away(14, 0.015)
    state = state_of(share * KP * (target.position - HERE))
    for _ in range(PERIODS):
        motors.update(state, target, STILL)
    assert motors.fault(state, target) is None


def test_a_motor_at_a_fifth_of_its_torque_is_a_fault_and_one_that_pulls_the_wrong_way_too() -> None:
    target = away(14, 0.05)
    for share in (0.2, -1.0):
        motors, state = check(), state_of(share * np.clip(KP * (target.position - HERE), -LIMIT, LIMIT))
        for _ in range(PERIODS):
            motors.update(state, target, STILL)
        assert motors.fault(state, target) is not None


def test_a_joint_that_moves_or_hardly_has_to_or_tells_no_torque_or_lacks_it_for_a_moment_is_no_fault() -> None:
    cases = (
        (state_of(STILL, velocity=np.full(SPEC.n_joints, 0.5)), away(14, 0.3)),
        (state_of(STILL), away(14, 0.001)),
        (state_of(np.full(SPEC.n_joints, np.nan)), away(14, 0.3)),
    )
    for state, target in cases:
        motors = check()
        for _ in range(PERIODS):
            motors.update(state, target, STILL)
        assert motors.fault(state, target) is None
    motors, target = check(), away(14, 0.3)
    for k in range(PERIODS):
        motors.update(state_of(LIMIT if k % 40 == 39 else STILL), target, STILL)
    assert motors.fault(state_of(STILL), target) is None


@pytest.mark.parametrize(("speed", "named"), [(0.07, ""), (0.0, "thumb_2"), (-0.07, "thumb_2"), (0.03, "thumb_2")])
def test_a_joint_that_keeps_up_with_a_slow_goal_is_braked_by_its_loop_and_one_that_does_not_is_a_fault(
    speed: float, named: str
) -> None:
    joint = np.eye(SPEC.n_joints)[14]
    target, state = SetPoint(HERE + 0.05 * joint, 0.08 * joint), state_of(STILL, velocity=speed * joint)
    motors = check()
    for _ in range(PERIODS):
        motors.update(state, target, STILL)
    fault = motors.fault(state, target)
    assert (fault is None) == (not named)
    assert fault is None or named in fault.sentence


def test_a_joint_that_rests_is_a_fault_though_its_reading_trembles_towards_a_goal_that_creeps() -> None:
    joint, motors = np.eye(SPEC.n_joints)[14], check()
    target = SetPoint(HERE + 0.05 * joint, 0.01 * joint)
    for k in range(PERIODS):
        motors.update(state_of(STILL, velocity=0.03 * (-1.0) ** k * joint), target, STILL)
    assert motors.fault(state_of(STILL), target) is not None


def test_a_tendon_that_only_pulls_is_not_asked_to_push() -> None:
    servo = replace(SPEC, commands=("position",))
    motors = MotorCheck(servo, KP, np.stack([STILL, LIMIT]), 0.003)
    for _ in range(PERIODS):
        motors.update(state_of(STILL), away(14, -0.3), STILL)
    assert motors.fault(state_of(STILL), away(14, -0.3)) is None


def test_a_reading_that_does_not_change_while_its_goal_goes_far_is_a_fault() -> None:
    motors, goal = check(), away(5, 0.5).position
    motors.begin(state_of(STILL), goal)
    moved = state_of(STILL, position=HERE + 0.001)
    assert motors.dead(moved) is None
    frozen_reading = moved.position.copy()
    frozen_reading[5] = HERE[5]
    fault = motors.dead(state_of(STILL, position=frozen_reading))
    assert fault is not None
    assert "middle_1 still reads" in fault.sentence


def test_what_is_not_reported_is_taken_as_what_is_due() -> None:
    target = away(14, 0.3)
    given = check().given(state_of(np.full(SPEC.n_joints, np.nan)), target, STILL)
    assert given[14] == LIMIT[14]
    np.testing.assert_array_equal(given[:14], 0.0)
