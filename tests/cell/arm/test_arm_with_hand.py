"""Arm and hand in one simulation: what the flange feels, who waits for whom, and a hand on another's flange."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from allegro_twin.cell.arm.arm_with_hand import ArmWithHand, make_arm_with_hand
from allegro_twin.cell.arm.impedance import Impedance, Stiffness
from allegro_twin.cell.arm.target import CartesianTarget
from allegro_twin.cell.arm.tool import WrenchCompensation, identify_tool, tool_weight
from allegro_twin.cell.arm.weighing import weigh_tool
from allegro_twin.control.controllers import PD, ConstantTorque, PositionControl
from allegro_twin.control.trajectory import Hold, Moves, Waypoint
from allegro_twin.controller import Controller
from allegro_twin.errors import ConfigError, HandFault
from allegro_twin.files.assets import data_root
from allegro_twin.hands.description.mounts import load_mount
from allegro_twin.hands.description.specs import is_hand_model, load_spec
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.kinematics.arm import rotate
from allegro_twin.kinematics.pose import Pose, compose, relative_to
from allegro_twin.loop import interleave, run
from allegro_twin.sim.model.arm_with_hand import CAMERA
from allegro_twin.sim.objects.catalogue import PlacedObject, load_object
from allegro_twin.spec import HandSpec
from allegro_twin.spec.arm import Load
from allegro_twin.types import frozen
from tests.hands.models import made

HANDS = sorted(path.stem for path in (data_root() / "conf" / "mounts").glob("*.yaml") if is_hand_model(path.stem))
DOWN = np.array([0.0, 0.0, -9.81])
CAN = PlacedObject(load_object("tomato_soup_can"), (0.1, 0.0, 0.0505), (1.0, 0.0, 0.0, 0.0))


def open_hand(spec: HandSpec) -> Controller[Any]:
    return (
        PD(Hold(spec.rest), load_gains("default", spec))
        if "torque" in spec.commands
        else PositionControl(Hold(spec.rest))
    )


def driven(robot: ArmWithHand, seconds: float, hand: Controller[Any] | None = None) -> list[list[Any]]:
    """The samples of arm and hand, while the arm keeps its pose."""
    target = CartesianTarget(robot.model.pose(robot.spec.ready))
    law = Impedance(robot.model, target, Stiffness(400.0, 30.0))
    kept: list[list[Any]] = [[], []]
    runs = (
        (run(robot.arm, law), robot.arm.period),
        (run(robot.hand, hand or open_hand(robot.hand.spec)), robot.hand.period),
    )
    for turn, sample in interleave(*runs):
        if sample.state.t > seconds + 1e-9:
            return kept
        kept[turn].append(sample)
    raise AssertionError


@pytest.mark.parametrize("model", HANDS)
def test_any_hand_hangs_on_the_flange_and_the_arm_stays_where_it_is(model: str) -> None:
    robot = make_arm_with_hand("fer", load_spec(model), objects=[CAN])
    arm, hand = driven(robot, 0.3)
    assert (len(arm), len(hand)) == (301, 101)
    assert (
        np.linalg.norm(robot.model.pose(arm[-1].state.position).position - robot.model.pose(robot.spec.ready).position)
        < 5e-3
    )
    np.testing.assert_allclose(robot.object_pose("tomato_soup_can").position, [0.1, 0.0, 0.0505], atol=2e-3)
    palm = robot.world.data.body("palm_link")
    np.testing.assert_allclose(robot.palm(arm[-1].state).position, palm.xpos, atol=1e-3)
    camera = robot.world.data.site(CAMERA)
    np.testing.assert_allclose(robot.camera(arm[-1].state).rotation, camera.xmat.reshape(3, 3), atol=1e-2)


def test_a_hand_on_the_flange_has_no_more_force_than_its_card_says() -> None:
    spec = load_spec("model_o")
    weak = replace(spec, actuation=replace(spec.actuation, torque_limit=0.1 * spec.actuation.torque_limit))
    model = make_arm_with_hand("fer", weak).world.model
    allowed = [model.actuator(name).forcerange[1] for name in spec.joints]
    np.testing.assert_allclose(allowed, weak.actuation.torque_limit)


def test_neither_arm_nor_hand_misses_a_period_of_the_one_clock() -> None:
    arm, hand = driven(make_arm_with_hand("fr3", load_spec()), 0.3)
    assert [s.state.tick for s in arm] == list(range(301))
    assert [s.state.tick for s in hand] == list(range(101))
    assert hand[-1].state.t == pytest.approx(0.3)


def test_a_cell_repeats_itself_bit_for_bit() -> None:
    robot = make_arm_with_hand("fer", load_spec(), objects=[CAN])
    hand = PD(Moves([Waypoint(load_spec().rest + 0.3, speed=2.0)]), load_gains("default", load_spec()))
    first, again = driven(robot, 0.2, hand), driven(robot, 0.2, hand)
    for before, after in zip(first[0] + first[1], again[0] + again[1], strict=True):
        np.testing.assert_array_equal(before.state.position, after.state.position)
        np.testing.assert_array_equal(before.state.wrench, after.state.wrench)


def test_who_was_not_reset_with_the_scene_is_told() -> None:
    robot = make_arm_with_hand("fer", load_spec())
    robot.arm.reset()
    robot.hand.reset()
    robot.arm.read()
    robot.arm.reset()
    with pytest.raises(HandFault, match="the scene of allegro_right was begun anew by another; reset it, too"):
        robot.hand.read()
    assert robot.hand.reset().tick == 0


def test_periods_that_pass_while_another_reads_count_as_missed() -> None:
    robot = make_arm_with_hand("fer", load_spec())
    robot.arm.reset()
    robot.hand.reset()
    robot.hand.read()
    assert robot.arm.read().tick == 3


def test_a_hand_on_the_flange_moves_as_it_does_alone_while_the_arm_is_held() -> None:
    """The arm gives a little under the fingers' accelerations: what differs is below a milliradian."""
    robot = make_arm_with_hand("fer", load_spec("leap"))
    hand = PositionControl(Moves([Waypoint(load_spec("leap").rest + 0.2, speed=1.0)]))
    _, samples = driven(robot, 0.5, hand)
    np.testing.assert_allclose(samples[-1].state.position, load_spec("leap").rest + 0.2, atol=0.06)


def test_the_flange_feels_the_hands_weight_and_the_bridge_takes_it_away() -> None:
    robot = make_arm_with_hand("fer", load_spec())
    state = driven(robot, 1.5)[0][-1].state
    assert np.linalg.norm(state.wrench[:3]) == pytest.approx(1.3154 * 9.81, rel=0.01)
    np.testing.assert_allclose(robot.wrench(state), 0.0, atol=0.05)


def test_an_arm_that_knows_its_hand_stays_where_it_is_without_a_torque() -> None:
    robot = make_arm_with_hand("fer", load_spec("leap"))
    runs = (run(robot.arm, ConstantTorque(np.zeros(7))), 0.001), (run(robot.hand, open_hand(load_spec("leap"))), 0.003)
    for turn, sample in interleave(*runs):
        if turn == 0 and sample.state.t >= 0.5:
            np.testing.assert_allclose(sample.state.position, robot.spec.ready, atol=0.02)
            return


def test_a_weight_in_the_hand_is_felt_in_the_world_as_what_it_weighs() -> None:
    robot = make_arm_with_hand("fer", load_spec())
    palm = robot.world.model.body("palm_link").id
    samples = driven(robot, 1.0)[0]
    compensation, pose = robot.compensation, robot.model.pose
    felt = [compensation.flange_wrench(s.state.wrench, pose(s.state.position).rotation, DOWN) for s in samples[-100:]]
    tare = compensation.with_tare(felt)
    robot.world.data.xfrc_applied[palm, 2] = -0.053 * 9.81
    target = CartesianTarget(robot.model.pose(robot.spec.ready))
    robot.arm.write(samples[-1].command)
    law = Impedance(robot.model, target, Stiffness(400.0, 30.0))
    memory = law.start(samples[-1].state)
    felt, state = [], samples[-1].state
    for _ in range(1000):
        command, memory = law(state, memory)
        robot.arm.write(command)
        state = robot.arm.read()
        axes = robot.model.pose(state.position).rotation
        felt.append(tare.base_wrench(state.wrench, axes, state.gravity, np.zeros(3))[2])
    assert np.mean(felt[-100:]) == pytest.approx(-0.053 * 9.81, rel=0.1)


@pytest.mark.parametrize("model", HANDS)
def test_a_mount_says_what_its_hand_weighs(model: str) -> None:
    robot = make_arm_with_hand("fer", load_spec(model))
    scene = robot.world.model
    hung = sum(scene.body_subtreemass[scene.body(name).id] for name in ("fer_adapter", "palm_link"))
    assert robot.mount.load.mass == pytest.approx(hung, abs=2e-3)


@pytest.mark.slow
def test_weighing_finds_what_hangs_on_the_flange() -> None:
    robot = make_arm_with_hand("fer", load_spec())
    tilts = ((0.0, 0.0, 0.0), (0.6, 0.0, 0.0), (0.0, 0.6, 0.0))
    found = weigh_tool(robot, open_hand(load_spec()), tilts)
    assert found.load.mass == pytest.approx(1.3154, rel=2e-3)
    np.testing.assert_allclose(found.load.centre, robot.mount.load.centre, atol=5e-4)
    assert found.residual < 0.01


def test_a_load_is_told_from_a_bias_by_turning_it_or_not_at_all() -> None:
    load, bias = Load(0.8, frozen([0.01, -0.02, 0.1])), np.array([0.5, -0.3, 0.2, 0.02, 0.01, -0.03])
    axes = [rotate(np.eye(3), np.array(turn)) for turn in ([0, 0, 0], [0.6, 0, 0], [0, 0.6, 0], [0.3, -0.5, 0])]
    found = identify_tool(axes, [tool_weight(load, each, DOWN) + bias for each in axes], DOWN)
    assert found.load.mass == pytest.approx(0.8)
    np.testing.assert_allclose(found.load.centre, load.centre, atol=1e-9)
    np.testing.assert_allclose(found.bias, bias, atol=1e-9)
    with pytest.raises(ConfigError, match="3 poses do not tell the tool's weight from the sensor's bias"):
        identify_tool([np.eye(3)] * 3, [tool_weight(load, np.eye(3), DOWN)] * 3, DOWN)


def test_a_bias_is_gone_after_a_tare_and_only_then() -> None:
    load, bias = Load(0.8, frozen([0.0, 0.0, 0.1])), np.array([0.5, -0.3, 0.2, 0.02, 0.01, -0.03])
    compensation, wrench = WrenchCompensation(load), tool_weight(load, np.eye(3), DOWN) + bias
    np.testing.assert_allclose(compensation.flange_wrench(wrench, np.eye(3), DOWN), bias)
    tared = compensation.with_tare([compensation.flange_wrench(wrench, np.eye(3), DOWN)] * 5)
    np.testing.assert_allclose(tared.flange_wrench(wrench, np.eye(3), DOWN), 0.0, atol=1e-12)
    with pytest.raises(ConfigError, match="a tare needs at least one sample"):
        compensation.with_tare([])


def test_a_force_at_a_point_has_no_torque_about_it() -> None:
    force, at = np.array([1.0, -2.0, 3.0]), np.array([0.01, 0.02, 0.1])
    axes = rotate(np.eye(3), np.array([0.3, 0.2, -0.1]))
    compensation = WrenchCompensation(Load(0.5, frozen([0.0, 0.0, 0.05])))
    wrench = tool_weight(compensation.load, axes, DOWN) + np.concatenate([force, np.cross(at, force)])
    outside = compensation.base_wrench(wrench, axes, DOWN, at)
    np.testing.assert_allclose(outside, [*(axes @ force), 0.0, 0.0, 0.0], atol=1e-12)


def test_a_palm_goes_where_the_flange_is_told_to_bring_it() -> None:
    robot = make_arm_with_hand("fer", load_spec())
    state = robot.arm.reset()
    palm = robot.palm(state)
    asked = Pose(palm.position + np.array([0.05, 0.1, -0.1]), rotate(palm.rotation, np.array([0.0, 0.0, 0.3])))
    flange = robot.flange_for(asked)
    at = robot.model.reach(flange, state.position)
    robot.world.data.qpos[: robot.spec.n_joints] = at
    import mujoco

    mujoco.mj_kinematics(robot.world.model, robot.world.data)
    np.testing.assert_allclose(robot.world.data.body("palm_link").xpos, asked.position, atol=2e-4)
    np.testing.assert_allclose(compose(palm, relative_to(palm, asked)).position, asked.position, atol=1e-12)


def test_a_hand_on_another_hands_flange_is_one_line_with_the_way_out() -> None:
    with pytest.raises(ConfigError, match=r"qb_softhand.yaml is the flange of a qb_softhand, and the hand is a "
                                          r"allegro_right: take conf/mounts/allegro.yaml"):  # fmt: skip
        make_arm_with_hand("fer", load_spec(), mount="qb_softhand")
    with pytest.raises(ConfigError, match="no mount named 'alegro'; did you mean 'allegro'"):
        make_arm_with_hand("fer", load_spec(), mount="alegro")


def test_a_hand_of_a_card_is_no_hand_for_the_cell(tmp_path: Path) -> None:
    spec = load_spec(str(made("gripper", tmp_path)))
    with pytest.raises(
        ConfigError, match=r"gripper.yaml has no mount .* take one of allegro, leap, .* plan and run pick"
    ):
        load_mount(spec)


def test_a_left_hands_load_is_the_mirror_image() -> None:
    right, left = load_mount(load_spec()), load_mount(load_spec(side="left"))
    assert left.load.mass == right.load.mass
    robot = make_arm_with_hand("fer", load_spec(side="left"))
    state = driven(robot, 1.5)[0][-1].state
    np.testing.assert_allclose(robot.wrench(state), 0.0, atol=0.05)


def test_an_arm_may_stand_beside_a_hand_that_does_nothing() -> None:
    robot = make_arm_with_hand("fer", load_spec())
    _, hand = driven(robot, 0.1, ConstantTorque(np.zeros(16)))
    assert len(hand) == 34


def test_an_arm_picks_up_a_can_and_feels_what_it_weighs() -> None:
    spec, can = (
        load_spec("model_o"),
        PlacedObject(load_object("tomato_soup_can"), (0.05, 0.0, 0.0505), (1.0, 0.0, 0.0, 0.0)),
    )
    above = Pose(np.array([0.05, 0.0, 0.19]), np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]))
    plan = make_arm_with_hand("fer", spec)
    robot = make_arm_with_hand(
        "fer", spec, objects=[can], posture=plan.model.reach(plan.flange_for(above), plan.spec.ready)
    )
    target = CartesianTarget(robot.model.pose(robot.arm_sim.posture))
    closing = PositionControl(Moves([Waypoint(np.array([0.0, 2.6, 2.6, 2.6]), speed=3.0)]))
    law = Impedance(robot.model, target, Stiffness(800.0, 50.0))
    for turn, sample in interleave((run(robot.arm, law), 0.001), (run(robot.hand, closing), 0.003)):
        if turn == 0 and sample.state.tick == 1500:
            target.move(robot.flange_for(Pose(above.position + np.array([0.0, 0.0, 0.1]), above.rotation)))
        if turn == 0 and sample.state.tick == 3500:
            break
    assert robot.object_pose("tomato_soup_can").position[2] > 0.13
    assert robot.wrench(sample.state)[2] == pytest.approx(-0.349 * 9.81, rel=0.03)
