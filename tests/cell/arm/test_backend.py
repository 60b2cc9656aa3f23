"""A simulated arm as a backend: it carries itself and its load, holds itself while nobody commands it, and replays."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from allegro_twin.cell.arm.compliance import Compliance, Pull
from allegro_twin.cell.arm.faults import DisturbedBackend, SilentBackend
from allegro_twin.cell.arm.impedance import Impedance
from allegro_twin.cell.arm.limits import arm_limits, at_limit
from allegro_twin.control.controllers import ConstantTorque
from allegro_twin.errors import CommandError, HandFault, LinkTimeout
from allegro_twin.hands.description.arms import load_arm_spec
from allegro_twin.kinematics.arm import ArmModel, ToolFrame
from allegro_twin.kinematics.pose import Pose
from allegro_twin.loop import run, to_the_end, until
from allegro_twin.recording.reader import load
from allegro_twin.recording.recorder import record
from allegro_twin.recording.replay import ReplayBackend
from allegro_twin.recording.spec_json import spec_from_json, spec_to_json
from allegro_twin.safety import Guard, violation
from allegro_twin.spec.arm import ArmSpec, Load
from allegro_twin.types import PositionCommand, TorqueCommand, frozen
from tests.cell.arm.rigs import rig


def test_an_arm_carries_its_own_weight() -> None:
    arm = rig()
    state = arm.after(1.0, ConstantTorque(np.zeros(7)))
    np.testing.assert_allclose(state.position, arm.model.spec.ready, atol=1e-6)


def test_an_arm_that_was_told_of_a_load_lifts_with_that_weight() -> None:
    spec = replace(load_arm_spec("fer"), load=Load(1.0, frozen([0.0, 0.0, 0.1])))
    arm = rig(spec=spec)
    state = arm.after(0.2, ConstantTorque(np.zeros(7)))
    assert arm.moved(state)[2] > 0.01  # Nothing hangs there, so the arm rises.


def test_an_arm_carries_its_load_at_its_centre_of_mass() -> None:
    load = Load(1.0, frozen([0.1, 0.05, 0.15]))
    bare, told = rig(), rig(spec=replace(load_arm_spec("fer"), load=load))
    for arm in (bare, told):
        arm.sim.reset()
    more = told.sim.data.qfrc_gravcomp[:7] - bare.sim.data.qfrc_gravcomp[:7]
    at = ArmModel(load_arm_spec("fer"), ToolFrame(load.centre, np.array([1.0, 0.0, 0.0, 0.0])))
    _, _, jacobian = at.motion(told.model.spec.ready)
    np.testing.assert_allclose(more, jacobian[2] * 9.81, atol=0.01)  # The grain of a gram is carried, too.


def test_an_arm_that_nobody_commands_stands_still_under_a_push() -> None:
    arm = rig(force=np.tile([0.0, 0.0, -20.0], (1000, 1)))
    arm.guard.reset()
    for _ in range(500):
        state = arm.guard.read()
    assert np.abs(arm.moved(state)).max() < 0.015
    assert np.abs(state.velocity).max() < 1e-3


def test_an_arm_falls_silent_after_twenty_milliseconds_without_a_command() -> None:
    arm = rig()
    arm.guard.reset()
    arm.guard.write(TorqueCommand(np.array([1.0, 0, 0, 0, 0, 0, 0])))
    torques = [arm.guard.read().torque[0] for _ in range(40)]
    assert torques[:20] == [1.0] * 20
    assert torques[20] != 1.0
    assert abs(arm.guard.read().velocity[0]) < 0.05


def test_torques_change_no_faster_than_the_arm_allows() -> None:
    arm = rig()
    wanted = np.array([50.0, 0, 0, 0, 0, 0, 0])
    sent = [s.command for s in until(0.01, run(arm.guard, ConstantTorque(wanted)))]
    assert arm.guard.applied.torque[0] == pytest.approx(11.0)  # type: ignore[union-attr]  # 1000 N·m/s for 11 ms.
    assert sent[0].torque[0] == 50.0  # type: ignore[union-attr]


def test_a_joint_that_goes_too_fast_stops_the_arm_and_it_stands_still() -> None:
    arm = rig()
    with pytest.raises(HandFault, match=r"fer_joint1 moves at 2.* over its limit of 2.17 rad/s; reset to go on"):
        arm.after(1.0, ConstantTorque(np.array([30.0, 0, 0, 0, 0, 0, 0])))
    for _ in range(500):
        state = arm.sim.read()  # Time passes for others in its world.
    assert np.abs(state.velocity).max() < 1e-2


def test_an_arm_at_the_end_of_a_joint_stands_still_and_says_which() -> None:
    arm = rig()
    limits = arm_limits(arm.model.spec)
    arm.target.move(Pose(np.array([0.15, 0.0, 0.3]), arm.home.rotation))
    state = arm.after(4.0, Impedance(arm.model, arm.target))
    assert at_limit(arm.guard.reset(), arm.model.spec, limits) is None
    line = at_limit(state, arm.model.spec, limits)
    assert line is not None
    assert "the arm stands still there; ask for a pose" in line
    assert np.abs(state.velocity).max() < 0.01


def test_a_silent_arm_is_named_and_holds_itself() -> None:
    arm = rig()
    silent = Guard(SilentBackend(arm.sim, 0.1), arm_limits(arm.model.spec))
    with pytest.raises(LinkTimeout, match=r"no state from fer since 0.099 s: it holds itself; see to its cable"):
        list(until(1.0, run(silent, ConstantTorque(np.zeros(7)))))
    assert silent.reset().tick == 0


def test_a_disturbed_sensor_repeats_with_its_seed() -> None:
    noise, bias = np.repeat([1.3, 0.05], 3), np.array([0.0, 0.0, 2.0, 0.0, 0.0, 0.0])

    def felt(seed: int) -> np.ndarray:
        backend = DisturbedBackend(rig().sim, noise, bias, at=0.5, seed=seed)
        return np.array([s.state.wrench for s in until(1.0, run(backend, ConstantTorque(np.zeros(7))))])

    first, again, other = felt(1), felt(1), felt(2)
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()
    assert first[:400, 2].std() == pytest.approx(1.3, rel=0.15)
    assert first[501:, 2].mean() - first[:499, 2].mean() == pytest.approx(2.0, abs=0.3)


def test_a_recording_of_an_arm_is_that_arm_again_bit_for_bit(tmp_path: Path) -> None:
    arm, path = rig(), tmp_path / "arm.arrow"
    arm.target.move(Pose(arm.home.position + np.array([0.0, 0.1, 0.0]), arm.home.rotation))
    law = Impedance(arm.model, arm.target)
    first = list(record(until(0.3, run(arm.guard, law)), path, arm.model.spec, 0.001))
    backend = ReplayBackend(load(path))
    again = list(to_the_end(run(backend, law)))
    assert backend.spec.name == "fer"
    np.testing.assert_array_equal(backend.spec.rest, arm.model.spec.ready)
    for before, after in zip(first, again, strict=True):
        np.testing.assert_array_equal(before.command.torque, after.command.torque)  # type: ignore[union-attr]
        np.testing.assert_array_equal(before.state.wrench, after.state.wrench)


def test_an_arm_takes_torques_alone() -> None:
    arm = rig()
    arm.guard.reset()
    with pytest.raises(CommandError, match="fer takes a TorqueCommand, not a PositionCommand"):
        arm.guard.write(PositionCommand(np.zeros(7)))


def test_an_fr3_near_the_end_of_a_joint_may_go_no_faster_than_it_could_stop_and_stops_if_it_does() -> None:
    spec = load_arm_spec("fr3")
    limits = arm_limits(spec)
    near = spec.ready.copy()
    near[0] = 2.7
    # libfranka, rate_limiting.h: -0.30 + √(12 (2.7501 - q)) up, 2.62 down from there.
    assert limits.speeds is not None
    down, up = limits.speeds(near)
    assert (up[0], down[0]) == pytest.approx((np.sqrt(12.0 * 0.0501) - 0.3, -2.62))
    down, up = limits.speeds(spec.ready)
    np.testing.assert_allclose(up, [2.62, 2.62, 2.62, 2.62, 5.26, 4.18, 5.26])
    assert arm_limits(load_arm_spec("fer")).speeds is None

    arm = rig("fr3")
    resting = replace(arm.sim.reset(), position=frozen(near))
    slow = "moves at 0.60 rad/s, over its limit of 0.48 rad/s at 2.70 rad"
    fast = "moves at -2.70 rad/s, over its limit of 2.62 rad/s"
    for speed, said in ((0.4, "None"), (0.6, slow), (-2.5, "None"), (-2.7, fast)):
        moving = replace(resting, velocity=frozen([speed, 0, 0, 0, 0, 0, 0]))
        assert str(violation(moving, limits, spec)).removeprefix("fr3_joint1 ") == said


def test_a_recording_of_an_fr3_knows_how_fast_it_may_go() -> None:
    spec = load_arm_spec("fr3")
    again = spec_from_json(json.loads(json.dumps(spec_to_json(spec))))
    assert isinstance(again, ArmSpec)
    assert spec.slowing is not None
    assert again.slowing is not None
    np.testing.assert_array_equal(again.slowing.b, spec.slowing.b)
    assert spec_from_json(spec_to_json(load_arm_spec("fer"))).slowing is None  # type: ignore[attr-defined]  # It is an arm's.


def test_compliance_goes_on_near_the_end_of_an_fr3s_joint_as_slowly_as_it_must() -> None:
    arm = rig("fr3")
    posture = arm.model.spec.ready.copy()
    posture[5] = 4.3
    arm.sim.posture = posture
    goal = posture + np.array([0, 0, 0, 0, 0, 0.17, 0])
    arm.target.move(arm.model.pose(goal))
    state = arm.after(1.5, Compliance(arm.model, arm.target, pull=Pull(iterations=10), smoothing=None))
    assert state.position[5] > 4.4
