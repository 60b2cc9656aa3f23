"""What a lab's report says of the Schunk SIH, as its simulation has it: order of the joints, springs, hysteresis, what
is coupled, what is sensed, and what it costs."""

from __future__ import annotations

import numpy as np
import pytest

from allegro_twin import Hand
from allegro_twin.backend import HandBackend
from allegro_twin.errors import CommandError, ConfigError, SelfCollision
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.sim.engine.backend import SimBackend
from allegro_twin.types import PositionCommand, TorqueCommand
from tests.conftest import MakeSim
from tests.hands.test_tendon_hands import closed, hold

SPEC = load_spec("sih")
FINGERS = {"index": ("index_0", "index_1"), "middle": ("middle_0", "middle_1"), "thumb_flexion": ("thumb_1", "thumb_2")}
PAIR = {"ring": ("ring_0", "ring_1"), "little": ("little_0", "little_1")}
TRAVEL = 1.571
"""rad, of each hinge."""


@pytest.fixture
def sim(make_sim: MakeSim) -> SimBackend:
    return make_sim(SPEC)


def goal_of(motor: str, position: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    goal = SPEC.lower.copy()
    goal[SPEC.joints.index(motor)] = position
    return goal


def angle(sim: SimBackend, joint: str) -> float:
    return float(sim.data.joint(joint).qpos[0])


def test_five_motors_move_eleven_hinges() -> None:
    assert SPEC.joints == ("thumb_flexion", "index", "middle", "ring_little", "thumb_rotation")
    assert SPEC.joint_labels == SPEC.joints  # A finger and a place would name no motor.
    assert len(SPEC.followers) == 10  # And the rotation, which its motor turns itself.


@pytest.mark.parametrize("motor", FINGERS)
def test_the_first_joint_bends_before_the_second(motor: str, sim: SimBackend) -> None:
    """At 0.8 of the first one's way the second has gone less than 0.15 rad."""
    first, second = FINGERS[motor]
    rows = closed(sim, SPEC, goal_of(motor, 2.67))
    moves = next(k for k, row in enumerate(rows) if row[second] > 0.15)
    assert rows[moves][first] >= 0.8 * TRAVEL
    assert rows[-1][second] > 1.3


def test_so_do_ring_and_little_finger_which_one_motor_pulls(sim: SimBackend) -> None:
    rows = closed(sim, SPEC, goal_of("ring_little", 2.67))
    for first, second in PAIR.values():
        moves = next(k for k, row in enumerate(rows) if row[second] > 0.15)
        assert rows[moves][first] >= 0.8 * TRAVEL
        assert rows[-1][second] > 1.3
    ring, little = (np.array([sum(row[j] for j in PAIR[finger]) for row in rows]) for finger in PAIR)
    assert np.abs(ring - little).max() < 0.5


@pytest.mark.parametrize("motor", FINGERS)
def test_a_finger_that_is_held_at_its_base_closes_at_its_end(motor: str, sim: SimBackend) -> None:
    first, second = FINGERS[motor]
    hold(sim, first, 0.5)
    last = closed(sim, SPEC, goal_of(motor, 1.9))[-1]
    assert last[first] < 0.55
    assert last[second] > 1.3


def test_a_ring_finger_that_is_held_leaves_the_little_finger_what_it_cannot_take(sim: SimBackend) -> None:
    """A pulley between their tendons: assumed. The little finger goes on, and farther than it would."""
    goal = goal_of("ring_little", 0.8)
    free = closed(sim, SPEC, goal)[-1]
    for joint in PAIR["ring"]:
        hold(sim, joint, 0.2)
    held = closed(sim, SPEC, goal)[-1]
    assert sum(held[j] for j in PAIR["ring"]) < 0.5
    assert held["little_0"] > free["little_0"] + 0.2


def test_springs_open_a_finger_that_is_let_go(sim: SimBackend) -> None:
    closed(sim, SPEC, goal_of("index", 2.67))
    sim.write(PositionCommand(SPEC.lower))
    for _ in range(round(2.5 / sim.period)):
        sim.read()
    assert all(angle(sim, joint) < 0.1 for joint in FINGERS["index"])


def test_the_same_command_is_another_place_when_opening_than_when_closing(sim: SimBackend) -> None:
    """The loop: command against the first joint, up and down again. Its width is dry friction over the motor's
    stiffness, and in the middle of the way it is between 0.005 and 0.1 rad; it does not drift from round to round."""
    commands = np.concatenate([np.linspace(0.0, 1.5, 38), np.linspace(1.5, 0.0, 38)])
    rounds = []
    sim.reset()
    for _ in range(2):
        row = []
        for command in commands:
            for _ in range(60):
                sim.write(PositionCommand(goal_of("index", command)))
                sim.read()
            row.append(angle(sim, "index_0"))
        rounds.append(np.array(row))
    closing, opening = rounds[1][:38], rounds[1][38:][::-1]
    width = (opening - closing)[10:28]
    assert (width > 0.005).all()
    assert 0.005 < width.mean() < 0.1
    np.testing.assert_allclose(rounds[1][10:], rounds[0][10:], atol=0.02)


def test_only_motors_are_sensed_and_where_the_joints_are_is_an_estimate(sim: SimBackend) -> None:
    """Free it is right within 0.1 rad, as far as a motor stays behind its command; a finger that is held is elsewhere,
    and nobody says so."""
    goal = goal_of("index", 2.0)
    free = closed(sim, SPEC, goal)[-1]
    state = sim.read()
    assert state.position.shape == (5,)
    names = [each.name for each in SPEC.followers]
    said = dict(zip(names, SPEC.coupled_positions(state.position), strict=True))
    for joint in FINGERS["index"]:
        assert said[joint] == pytest.approx(free[joint], abs=0.1)
    hold(sim, "index_0", 0.4)
    held = closed(sim, SPEC, goal)[-1]
    said = dict(zip(names, SPEC.coupled_positions(sim.read().position), strict=True))
    assert abs(said["index_0"] - held["index_0"]) > 0.3


def test_its_thumb_turns_before_index_and_middle_finger_and_its_tip_can_meet_theirs() -> None:
    """The choice that is ours: which way round its base is. Beside the index finger, and it opposes two."""
    model = hand_kinematics(SPEC)
    aside, before = (model.fingertips(goal_of("thumb_rotation", turn))["thumb"].position for turn in (0.0, 1.571))
    assert aside[1] > 0.10  # To the side of the index finger.
    assert before[0] > 0.10  # Out of the palm.
    tips = model.fingertips(np.array([0.9, 1.2, 1.2, 1.2, 1.571]))
    apart = {name: float(np.linalg.norm(tips[name].position - tips["thumb"].position)) for name in tips}
    assert max(apart["index"], apart["middle"]) < 0.06 < min(apart["ring"], apart["little"]) + 0.02
    assert apart["little"] == max(apart.values())


@pytest.mark.parametrize("command", [TorqueCommand(np.zeros(5)), PositionCommand(np.zeros(5), np.full(5, 0.1))])
def test_it_takes_positions_and_nothing_else(command: TorqueCommand | PositionCommand, sim: HandBackend) -> None:
    assert SPEC.commands == ("position",)
    sim.reset()
    with pytest.raises(CommandError, match="sih_right takes"):
        sim.write(command)


@pytest.mark.parametrize("config", ["sim_sih", "sih_virtual"])
def test_the_facade_moves_it_grasps_with_it_and_plans_no_fist_through_the_thumb(config: str) -> None:
    with Hand.open(config) as hand:
        hand.move_to(0.7 * SPEC.lower + 0.3 * SPEC.upper)
        np.testing.assert_allclose(hand.state.position, 0.7 * SPEC.lower + 0.3 * SPEC.upper, atol=0.03)
        hand.grasp("sih_apple")
        assert hand.state.position[1] > 1.5
        with pytest.raises(SelfCollision, match="thumb would be .* mm inside each other"):
            hand.move_to([2.0, 2.4, 2.4, 2.4, 1.4])


def test_a_card_cannot_say_velocity_and_is_told_what_it_can(tmp_path: object) -> None:
    from allegro_twin.files.schema import parse_settings
    from allegro_twin.hands.description.card import HandCard

    driven = [{"name": "a", "actuator": "a", "lower": 0, "upper": 1, "effort": 1}]
    card = {"mjcf": "x.xml", "root": "palm", "commands": ["velocity"], "driven": driven}
    with pytest.raises(ConfigError, match=r"'torque', 'position', 'limited_position' or 'timed_position', not 'veloc"):
        parse_settings(HandCard, card, "card")
