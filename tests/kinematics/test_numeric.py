"""Inverse kinematics by iteration: where a closed form is, it says the same."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from allegro_twin import Hand
from allegro_twin.app.config import RunConfig
from allegro_twin.errors import ConfigError
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.kinematics.closed_form.finger import ClosedFormFinger
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.kinematics.numeric import NumericFinger

LEAP = {"hand": {"model": "leap"}, "backend": {"kind": "sim"}, "controller": {"kind": "position"}}
PARTS = st.lists(st.floats(0.1, 0.9), min_size=4, max_size=4)
FINGERS = st.sampled_from(["index", "middle", "ring", "thumb"])


@settings(max_examples=60)
@given(FINGERS, PARTS, PARTS, st.sampled_from(["allegro", "leap"]))
def test_a_point_that_a_posture_reaches_is_reached_from_another_near_it(
    finger: str, parts: list[float], other: list[float], model: str
) -> None:
    spec = load_spec(model)
    solver = NumericFinger(hand_kinematics(spec), finger)
    span = solver.upper - solver.lower
    there = solver.lower + span * np.array(parts)
    near = np.clip(there + 0.15 * (np.array(other) - 0.5) * span, solver.lower, solver.upper)
    target = solver.fk(there).position
    best = solver.ik(target, near=near).best(near)
    assert best.reached
    np.testing.assert_allclose(solver.fk(best.posture).position, target, atol=1e-4)
    assert ((best.posture >= solver.lower) & (best.posture <= solver.upper)).all()


@given(FINGERS, PARTS)
def test_it_has_the_tip_where_the_closed_form_has_it(finger: str, parts: list[float]) -> None:
    spec = load_spec()
    closed = ClosedFormFinger(spec, finger)
    numeric = NumericFinger(hand_kinematics(spec), finger)
    posture = closed.lower + (closed.upper - closed.lower) * np.array(parts)
    np.testing.assert_allclose(numeric.fk(posture).position, closed.fk(posture).position, atol=1e-9)


def test_a_point_out_of_reach_is_not_reached_and_the_nearest_found_is_told() -> None:
    spec = load_spec("leap")
    solver = NumericFinger(hand_kinematics(spec), "index")
    near = (solver.lower + solver.upper) / 2
    best = solver.ik([0.0, 0.0454, 0.5], near=near).best(near)
    assert not best.reached
    assert 0.37 < best.distance < 0.40  # Stretched, it ends at 0.125 m.


def test_a_finger_whose_motor_moves_others_is_not_moved_alone() -> None:
    spec = load_spec("qb_softhand")
    with pytest.raises(ConfigError, match="index cannot be moved alone, its motor moves middle, ring, little, thumb"):
        NumericFinger(hand_kinematics(spec), "index")


def test_a_leap_hand_moves_its_fingertips_straight() -> None:
    with Hand.open(RunConfig.model_validate(LEAP)) as leap:
        leap.move_to("home")
        begin = leap.fingertips()["middle"].position
        goal = begin + np.array([0.005, 0.0, -0.01])
        ways: list[np.ndarray] = []
        leap.listen(lambda sample: ways.append(sample.state.position))
        leap.move_fingertips({"middle": goal})
        np.testing.assert_allclose(leap.fingertips()["middle"].position, goal, atol=2.5e-3)
        with pytest.raises(ConfigError, match="no closed form: leave out euler"):
            leap.move_fingertips({"middle": goal}, euler={"middle": [0, 0, 0]})
        with pytest.raises(ConfigError, match="the nearest point in reach is"):
            leap.move_fingertips({"middle": [0.0, 0.0, 0.5]})


def test_a_leap_hand_grasps_stops_teaches_and_plays() -> None:
    with Hand.open(RunConfig.model_validate(LEAP)) as leap:
        assert leap.grasp("rubiks_cube").name == "leap_rubiks_cube"
        leap.stop()
        assert leap.controller == "position"
        with leap.teach() as shown:
            assert leap.controller == "limp"
            assert leap.sim is not None
            leap.sim.push(np.full(16, 0.1))
            leap.wait(0.6)
            leap.sim.push(np.zeros(16))
        motion = shown.motion()
        leap.play(motion)
        np.testing.assert_allclose(leap.state.position, motion.positions[-1], atol=0.06)
        with pytest.raises(ConfigError, match="a force is for hands that take torques; leap_right takes position"):
            leap.grasp("rubiks_cube", force=2.0)
