"""The contact reflex: what an arm feels without a sensor, when it stops by itself, and how it is led on."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from allegro_twin.cell.arm.arm_with_hand import make_arm_with_hand
from allegro_twin.cell.arm.contact_reflex import CollisionMonitor, CollisionSettings, ContactReflex, ContactState
from allegro_twin.cell.arm.faults import DisturbedBackend
from allegro_twin.cell.arm.impedance import Impedance, Stiffness
from allegro_twin.cell.arm.limits import arm_limits
from allegro_twin.cell.arm.target import CartesianTarget
from allegro_twin.errors import ArmReflex, ConfigError, HandFault
from allegro_twin.files.schema import parse_settings
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.kinematics.pose import Pose
from allegro_twin.loop import run, until
from allegro_twin.safety import Guard
from allegro_twin.types import Array, HandState, TorqueCommand
from tests.cell.arm.rigs import Rig, at_a_wall, rig

PHASES = ("acceleration", "nominal")


def thresholds(torque: float = 1e3, force: float = 1e3, lower: float | None = None, **more: Any) -> CollisionSettings:
    """The same for all joints, axes and phases; `lower`: of all forces, N."""
    values: dict[str, Any] = {}
    for phase in PHASES:
        for side in ("lower", "upper"):
            values[f"{side}_torque_thresholds_{phase}"] = [torque] * 7
            values[f"{side}_force_thresholds_{phase}"] = [force if side == "upper" or lower is None else lower] * 6
    return CollisionSettings.model_validate(values | more)


def watched(arm: Rig, settings: CollisionSettings) -> tuple[ContactReflex, Guard, list[ContactState]]:
    """The arm with a reflex behind its guard, and what it feels at each step."""
    reflex, heard = ContactReflex(arm.sim, arm.model, settings), list[ContactState]()
    reflex.on_step = heard.append
    return reflex, Guard(reflex, arm_limits(arm.model.spec)), heard


def pushed(force: float, axis: int = 2, since: int = 200, periods: int = 600) -> Array:
    push = np.zeros((periods, 3))
    push[since:, axis] = force
    return push


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_push_is_felt_at_the_flange_within_milliseconds_and_by_its_size(axis: int) -> None:
    arm = rig(force=pushed(-12.0, axis))
    _, guard, heard = watched(arm, thresholds())
    list(until(0.5, run(guard, Impedance(arm.model, arm.target, Stiffness(400.0, 30.0)))))
    felt = np.array([each.wrench[axis] for each in heard])
    assert np.abs(felt[:200]).max() < 0.5
    assert felt[200 + 8] < -9.0  # 8 ms: five time constants.
    assert felt[-100:].mean() == pytest.approx(-12.0, abs=1.4)  # Dry friction holds 1.3 N.


def test_an_arm_that_moves_fast_and_freely_feels_nothing() -> None:
    arm = rig()
    _, guard, heard = watched(arm, CollisionSettings())
    far = Pose(arm.home.position + np.array([0.1, 0.3, -0.2]), arm.home.rotation)
    arm.target.move(far)
    *_, last = until(2.5, run(guard, Impedance(arm.model, arm.target, Stiffness(600.0, 30.0))))
    assert np.linalg.norm(arm.model.pose(last.state.position).position - far.position) < 0.01
    assert max(float(np.abs(each.wrench[:3]).max()) for each in heard) < 3.0
    assert not any(each.joint_contact.any() or each.cartesian_contact.any() for each in heard)


def test_beyond_a_lower_threshold_there_is_contact_and_beyond_an_upper_one_the_arm_stops() -> None:
    arm = rig(force=pushed(-15.0))
    _, guard, heard = watched(arm, thresholds(force=30.0, lower=8.0))
    list(until(0.5, run(guard, Impedance(arm.model, arm.target))))
    assert heard[-1].cartesian_contact.tolist() == [0, 0, 1, 0, 0, 0]
    assert not heard[-1].cartesian_collision.any()

    arm = rig(force=pushed(-40.0))
    reflex, guard, heard = watched(arm, thresholds(force=30.0, lower=8.0))
    with pytest.raises(ArmReflex, match=r"cartesian_reflex: the force on the flange of fer along z is -3\d") as stopped:
        list(until(0.5, run(guard, Impedance(arm.model, arm.target))))
    assert stopped.value.name == "cartesian_reflex"
    assert "beyond upper_force_thresholds_" in str(stopped.value)
    assert stopped.value.wrench[2] < -30.0
    assert len(heard) < 220
    assert reflex.monitor.state.cartesian_collision.tolist() == [0, 0, 1, 0, 0, 0]


def test_a_joint_has_thresholds_of_its_own() -> None:
    arm = rig(force=pushed(-40.0))
    _, guard, _ = watched(arm, thresholds(torque=5.0))
    with pytest.raises(
        ArmReflex, match=r"joint_reflex: the torque from outside on fer_joint\d is .* N·m, beyond upper"
    ):
        list(until(0.5, run(guard, Impedance(arm.model, arm.target))))


def test_an_arm_that_has_stopped_holds_itself_until_it_is_recovered_and_its_time_goes_on() -> None:
    push = pushed(-40.0, periods=3000)
    push[400:] = 0.0
    arm = rig(force=push)
    _, guard, heard = watched(arm, thresholds(force=30.0))
    law = Impedance(arm.model, arm.target)
    with pytest.raises(ArmReflex):
        list(until(0.5, run(guard, law)))
    with pytest.raises(ArmReflex, match="cartesian_reflex"):
        guard.write(TorqueCommand(np.zeros(7)))
    arm.sim.world.advance(900)
    assert np.abs(arm.sim.data.qvel[:7]).max() < 1e-3
    assert not heard[-1].cartesian_contact.any()
    assert heard[-1].cartesian_collision[2] == 1.0  # Until it is recovered.
    state = guard.recover()
    assert state.t == pytest.approx(0.9)  # 900 steps: the read then was of the moment that had come.
    for _ in range(20):
        guard.write(TorqueCommand(np.full(7, 5.0)))
        state = guard.read()
    assert np.abs(state.velocity).max() > 1e-3


def test_torques_begin_from_nothing_after_a_recovery() -> None:
    arm = rig(force=pushed(-40.0, since=10))
    _, guard, _ = watched(arm, thresholds(force=30.0))
    guard.reset()
    with pytest.raises(ArmReflex):
        for _ in range(100):
            guard.write(TorqueCommand(np.full(7, 8.0)))
            guard.read()
    guard.recover()
    guard.write(TorqueCommand(np.full(7, 8.0)))
    assert isinstance(guard.applied, TorqueCommand)
    np.testing.assert_allclose(guard.applied.torque, 1.0)  # 1000 N·m/s for a millisecond.


def test_a_reset_leads_out_too_and_a_backend_without_recovery_says_so() -> None:
    arm = rig(force=pushed(-40.0, since=10, periods=50))
    _, guard, _ = watched(arm, thresholds(force=30.0))
    law = Impedance(arm.model, arm.target)
    with pytest.raises(ArmReflex):
        list(until(0.5, run(guard, law)))
    assert guard.reset().t == 0.0
    with pytest.raises(HandFault, match="fer has no recovery from a fault: reset it"):
        DisturbedBackend(Guard(rig().sim, arm_limits(arm.model.spec)), np.zeros(6)).recover()


def test_other_thresholds_count_while_a_joint_accelerates() -> None:
    settings = thresholds(upper_force_thresholds_nominal=[5.0] * 6, lower_force_thresholds_nominal=[5.0] * 6)
    arm = rig()
    monitor, spec = CollisionMonitor(arm.model, settings), arm.model.spec
    rate = np.array([2.0, 0, 0, 0, 0, 0, 0])
    inertia, outside = arm.model.inertia(spec.ready), arm.model.motion(spec.ready)[2].T @ [0, 0, -9.0, 0, 0, 0]
    velocity = np.zeros(7)
    for step in range(300):
        now = rate if step < 200 else 0.0 * rate
        velocity = velocity + now * 0.001
        rubbed = 0.2 * np.tanh(velocity / 0.01) + 0.003 * velocity
        bias = arm.model.momentum(spec.ready, velocity)[1]
        torque = inertia @ now + rubbed - bias - (outside if step > 100 else 0.0)
        monitor.update(spec.ready, velocity, torque, 0.001)
        if step == 199:
            assert monitor.state.accelerating
            assert monitor.state.wrench[2] == pytest.approx(-9.0, abs=0.1)
            assert monitor.reflex is None  # 9 N are allowed while it accelerates.
    for _ in range(200):
        monitor.update(spec.ready, velocity, rubbed - bias - outside, 0.001)
    assert not monitor.state.accelerating
    assert monitor.reflex is not None
    assert "upper_force_thresholds_nominal[2] of 5 N" in str(monitor.reflex)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"lower_force_thresholds_nominal": [1, 1, 11, 1, 1, 1]}, r"thresholds_nominal\[2\] 11 is above upper.* 10"),
        ({"upper_torque_thresholds_acceleration": [30.0] * 6}, "has 7 values and upper.* 6"),
        ({"upper_force_thresholds_nominal": [30.0] * 5}, "upper_force_thresholds_nominal"),
        ({"upper_torque_thresholds_nominal": [0.0] * 7}, "upper_torque_thresholds_nominal"),
    ],
)
def test_thresholds_that_cannot_be_are_refused_by_their_name(values: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        parse_settings(CollisionSettings, values, "lab.yaml")


def test_an_arm_needs_as_many_torque_thresholds_as_it_has_joints() -> None:
    six = {f"{side}_torque_thresholds_{phase}": [20.0] * 6 for side in ("lower", "upper") for phase in PHASES}
    with pytest.raises(ConfigError, match="has 6 values; fer has 7 joints"):
        CollisionMonitor(rig().model, CollisionSettings.model_validate(six))


def pressed(seconds: float, settings: CollisionSettings | None) -> tuple[list[float], str]:
    """How hard an arm presses on a wall of 2 kN/m, its target 0.2 m/s fast and 0.2 m beyond, N each 3 ms."""
    arm, said, forces = at_a_wall(), "", list[float]()
    guard = arm.guard if settings is None else watched(arm, settings)[1]
    law = Impedance(arm.model, arm.target, Stiffness(1000.0, 30.0), smoothing=None)
    samples = run(guard, law)
    try:
        for sample in until(seconds, samples):
            down = min(0.2 * sample.state.t, 0.2)
            arm.target.move(Pose(arm.home.position - [0.0, 0.0, down], arm.home.rotation))
            forces.append(2000.0 * max(-float(arm.sim.data.qpos[-1]), 0.0))
    except ArmReflex as error:
        said = error.name
        for step in range(arm.sim.world.steps, round(1000 * seconds), 3):
            arm.sim.world.advance(step)
            forces.append(2000.0 * max(-float(arm.sim.data.qpos[-1]), 0.0))
    return forces, said


def test_an_arm_that_goes_against_a_wall_stops_there_and_presses_no_more() -> None:
    forces, said = pressed(1.5, CollisionSettings())
    assert said == "cartesian_reflex"
    assert max(forces) < 40.0
    assert forces[-1] < 15.0
    free, quiet = pressed(1.5, None)
    assert quiet == ""
    assert max(free) > 100.0  # 200 N/m of spring at 0.185 m, shared with the wall.


def test_a_hand_on_the_flange_is_carried_and_is_no_contact() -> None:
    robot = make_arm_with_hand("fer", load_spec("model_o"), collision=CollisionSettings())
    assert robot.reflex is not None
    target = CartesianTarget(robot.model.pose(robot.arm.reset().position))
    *_, last = until(1.0, run(robot.arm, Impedance(robot.model, target)))
    assert isinstance(last.state, HandState)
    assert np.abs(robot.reflex.monitor.state.wrench[:3]).max() < 1.0
