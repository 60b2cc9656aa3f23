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
from allegro_twin.kinematics.orientation import euler_from_matrix, matrix_from_euler

LEAP = {"hand": {"model": "leap"}, "backend": {"kind": "sim"}, "controller": {"kind": "position"}}
PARTS = st.lists(st.floats(0.1, 0.9), min_size=4, max_size=4)
FINGERS = st.sampled_from(["index", "middle", "ring", "thumb"])


@settings(max_examples=60)
@given(FINGERS, PARTS, PARTS, st.sampled_from(["allegro", "leap"]))
def test_a_point_that_a_posture_reaches_is_reached_from_another_near_it(
    finger: str, parts: list[float], other: list[float], model: str
) -> None:
    spec = load_spec(model)
    solver = hand_kinematics(spec).numeric(finger)
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
    numeric = hand_kinematics(spec).numeric(finger)
    posture = closed.lower + (closed.upper - closed.lower) * np.array(parts)
    np.testing.assert_allclose(numeric.fk(posture).position, closed.fk(posture).position, atol=1e-9)


def test_a_point_out_of_reach_is_not_reached_and_the_nearest_found_is_told() -> None:
    spec = load_spec("leap")
    solver = hand_kinematics(spec).numeric("index")
    near = (solver.lower + solver.upper) / 2
    best = solver.ik([0.0, 0.0454, 0.5], near=near).best(near)
    assert not best.reached
    assert 0.37 < best.distance < 0.40  # Stretched, it ends at 0.125 m.


def test_a_finger_says_which_others_its_motor_moves_as_well() -> None:
    assert hand_kinematics(load_spec("qb_softhand")).numeric("index").shared == ("middle", "ring", "little", "thumb")
    assert hand_kinematics(load_spec("leap")).numeric("index").shared == ()


@pytest.mark.parametrize(
    ("model", "finger"),
    [("allegro", "index"), ("allegro", "thumb"), ("leap", "middle"), ("leap", "thumb"), ("sih", "index"),
     ("sih", "thumb"), ("model_o", "thumb"), ("model_o", "reverse"), ("qb_softhand", "middle")],
)  # fmt: skip
def test_whatever_a_posture_reaches_is_reached_by_one_call_and_by_many(model: str, finger: str) -> None:
    """To 10 µm, without a posture near by, of hands of chains, of couplings and of tendons."""
    spec = load_spec(model)
    finger = finger if finger in [each.name for each in spec.fingers] else spec.fingers[0].name
    solver = hand_kinematics(spec).numeric(finger)
    postures = np.random.default_rng(7).uniform(solver.lower, solver.upper, (400, len(solver.lower)))
    targets = solver.fk(postures).position
    found = solver.ik(targets)
    assert found.reachable.all()
    apart = np.linalg.norm(solver.fk(found.position[:, 0]).position - targets, axis=1)
    assert apart.max() < 1e-5
    for target in targets[:40]:
        alone = solver.ik(target)
        assert alone.reachable
        assert np.linalg.norm(solver.fk(alone.position[0]).position - target) < 1e-5


@pytest.mark.parametrize(("model", "finger"), [("allegro", "index"), ("leap", "thumb"), ("sih", "thumb")])
def test_one_posture_in_plain_floats_is_what_many_in_arrays_are(model: str, finger: str) -> None:
    spec = load_spec(model)
    solver = hand_kinematics(spec).numeric(finger)
    chain = solver._chain
    postures = np.random.default_rng(3).uniform(solver.lower, solver.upper, (20, len(solver.lower)))
    tips, _, moves, _ = chain.many(postures.T)
    for k, posture in enumerate(postures):
        tip, columns = chain.one(posture.tolist())
        np.testing.assert_allclose(tip, tips[:, k], atol=1e-14)
        np.testing.assert_allclose(columns, moves[:, :, k], atol=1e-14)
        for joint, step in enumerate(1e-6 * np.eye(len(posture))):
            slope = (np.array(chain.one((posture + step).tolist())[0]) - chain.one((posture - step).tolist())[0]) / 2e-6
            np.testing.assert_allclose(columns[joint], slope, atol=1e-6)


def test_an_orientation_is_met_where_the_position_allows_it_and_missed_by_what_is_said() -> None:
    solver = hand_kinematics(load_spec("leap")).numeric("index")
    postures = np.random.default_rng(5).uniform(solver.lower * 0.8, solver.upper * 0.8, (40, 4))
    wanted = solver.fk(postures)
    found = solver.ik(wanted.position, rotation=wanted.rotation)
    assert found.reachable.all()
    assert np.median(found.angle) < 1e-3
    best = found.position[:, 0]
    cosine = (np.einsum("nij,nij->n", solver.fk(best).rotation, wanted.rotation) - 1.0) / 2.0
    np.testing.assert_allclose(found.angle[:, 0], np.arccos(np.clip(cosine, -1, 1)), atol=1e-6)
    loose = solver.fk(solver.ik(wanted.position).position[:, 0]).rotation
    free = (np.einsum("nij,nij->n", loose, wanted.rotation) - 1.0) / 2.0
    assert np.mean(found.angle) < 0.5 * np.mean(np.arccos(np.clip(free, -1, 1)))


def test_a_leap_hand_moves_its_fingertips_straight() -> None:
    with Hand.open(RunConfig.model_validate(LEAP)) as leap:
        leap.move_to("home")
        begin = leap.fingertips()["middle"].position
        goal = begin + np.array([0.005, 0.0, -0.01])
        ways: list[np.ndarray] = []
        leap.listen(lambda sample: ways.append(sample.state.position))
        leap.move_fingertips({"middle": goal})
        np.testing.assert_allclose(leap.fingertips()["middle"].position, goal, atol=2.5e-3)
        with pytest.raises(ConfigError, match="the tip cannot have euler .* the nearest that it can have there is"):
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


def test_a_finger_that_shares_a_motor_is_not_moved_alone_by_a_person() -> None:
    soft = {"hand": {"model": "qb_softhand"}, "backend": {"kind": "sim"}, "controller": {"kind": "position"}}
    with (
        Hand.open(RunConfig.model_validate(soft)) as hand,
        pytest.raises(ConfigError, match="index cannot be moved alone, its motor moves middle, ring, little, thumb"),
    ):
        hand.move_fingertips({"index": [0.0, 0.0, 0.1]})


def test_a_leap_hands_fingertip_is_turned_as_well_as_moved() -> None:
    with Hand.open(RunConfig.model_validate(LEAP)) as leap:
        finger = hand_kinematics(leap.spec).finger("middle")
        joints = list(leap.spec.finger("middle").joints)
        goal = finger.fk(leap.state.position[joints] + [0.15, 0.0, 0.2, 0.1])
        leap.move_fingertips({"middle": goal.position}, euler={"middle": euler_from_matrix(goal.rotation)})
        tip = leap.fingertips()["middle"]
        np.testing.assert_allclose(tip.position, goal.position, atol=3e-3)
        assert np.arccos(np.clip((np.trace(tip.rotation.T @ goal.rotation) - 1) / 2, -1, 1)) < 0.06


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-6, 1.0])
def test_the_angle_by_which_an_orientation_is_missed_is_exact_however_small(angle: float) -> None:
    solver = hand_kinematics(load_spec("leap")).numeric("index")
    posture = solver.lower + 0.4 * (solver.upper - solver.lower)
    turned = solver.fk(posture).rotation @ matrix_from_euler([angle, 0.0, 0.0])
    assert solver._missed(posture[None], turned[None])[0] == pytest.approx(angle, abs=1e-14)
