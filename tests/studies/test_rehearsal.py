"""The rehearsal: hidden hands are unlike each other and unlike our drives, and what they are judged by is the truth."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import yaml

from allegro_twin.files import read_yaml
from allegro_twin.grasping import Perturbation
from allegro_twin.twin.identify import find_pose
from studies.rehearsal.__main__ import PROTOCOL, REGISTRATION, contents
from studies.rehearsal.hidden_hand import STEP, VERSIONS, HiddenHand, draw_hand
from studies.rehearsal.motor_laws import HandPhysics, MotorLaws
from studies.rehearsal.report import table
from studies.rehearsal.sessions import alone, grasp_trial, offsets_by_ends, posture_errors, session

SEED = 5  # Not that of the protocol.


def plain(offset: float = 0.0, **more: Any) -> HandPhysics:
    """As our own nominal drive, with an encoder offset."""
    constant, armature, damping, friction = (np.full(16, value) for value in (1.0, 0.003, 0.07, 0.005))
    return HandPhysics(constant, armature, damping, friction, offset=np.full(16, offset), delay=STEP, **more)


def hand(physics: HandPhysics, version: str = "v4", side: Any = "right") -> HiddenHand:
    return HiddenHand(0, side, version, physics, np.zeros(3), 0.005, 1.0, 0.01, 100.0, ())


def test_hands_are_drawn_by_number_and_no_two_are_alike() -> None:
    drawn = [draw_hand(k, SEED) for k in range(20)]
    np.testing.assert_array_equal(drawn[3].physics.constant, draw_hand(3, SEED).physics.constant)
    assert len({each.physics.delay for each in drawn}) == 20
    assert {each.version for each in drawn} == {*VERSIONS}
    assert {each.side for each in drawn} == {"left", "right"}
    traits = {trait for each in drawn for trait in each.traits}
    assert len(traits) == 9
    assert all(each.physics.constant.min() > 0.5 for each in drawn)


@pytest.mark.slow
def test_an_encoder_that_is_off_puts_every_posture_off_until_the_ends_of_the_joints_tell(tmp_path: Path) -> None:
    own = hand(plain(0.02), side="left")
    off = posture_errors(own, "", "ok", "palm-up", "pd")
    np.testing.assert_allclose(off, -0.02, atol=0.003)
    counts, seconds = offsets_by_ends(own, "up")
    assert seconds < 100.0
    file = tmp_path / "mine.yaml"
    file.write_text(yaml.safe_dump({"wire": {"version": "v4", "side": "left", "encoder_offset": counts}}))
    assert np.abs(posture_errors(own, str(file), "ok", "palm-up", "pd")).max() < 0.002


def test_a_host_that_knows_the_torque_constants_asks_for_that_much_less_of_full_pwm(tmp_path: Path) -> None:
    file = tmp_path / "strong.yaml"
    file.write_text("wire: {version: v4, torque_constant: 2.0}\n")
    pose, duties = find_pose("palm-up", "right"), []
    for serial in ("", str(file)):
        own = hand(plain())
        task = {"kind": "torque", "torque": 0.1}
        with session(own, serial, alone(own, pose), task, {}, pose.gravity) as host:
            state = host.rig.backend.reset()
            for _ in range(5):
                host.rig.backend.write(host.rig.controller(state, host.rig.controller.start(state))[0])
                state = host.rig.backend.read()
            duties.append(host.hidden._duty.copy())
    np.testing.assert_allclose(duties[0], 0.1, rtol=0.02)
    np.testing.assert_allclose(duties[1], duties[0] / 2.0, rtol=0.02)


def test_a_mount_that_leans_turns_the_palm_and_nothing_that_it_says() -> None:
    own = replace(hand(plain()), lean=np.array([0.0, 0.03, 0.0]))
    pose = find_pose("palm-up", "right")
    bodies = []
    for each in (hand(plain()), own):
        with session(each, "", alone(each, pose), {"kind": "torque"}, {}, pose.gravity) as host:
            state = host.rig.backend.reset()
            bodies.append(host.hidden.data.body("palm_link").xquat.copy())
            np.testing.assert_allclose(state.gravity, pose.gravity)
    between = np.zeros(3)
    mujoco.mju_subQuat(between, bodies[1], bodies[0])
    np.testing.assert_allclose(between, [0.0, 0.03, 0.0], atol=1e-9)


def test_bristles_hold_a_joint_until_it_breaks_away_and_let_it_slide_with_less() -> None:
    laws = MotorLaws(plain(ratio=np.full(16, 1.5), bristle=8e-4), 1e-4)
    position, speed = np.zeros(16), np.zeros(16)
    for pull, moves in ((0.0065, False), (0.009, True)):
        laws.reset(np.zeros(16))
        position, speed = np.zeros(16), np.zeros(16)
        for k in range(4000):
            torque, _ = laws.step(np.full(16, pull), position, speed, 1e-4 * k)
            speed = speed + 1e-4 * torque / 0.003
            position = position + 1e-4 * speed
        assert (np.abs(position) > 0.004).all() == moves, pull


def test_teeth_leave_a_link_free_within_their_play_and_carry_it_beyond() -> None:
    laws = MotorLaws(plain(play=np.full(16, 0.006), spring=30.0), 1e-4)
    laws.reset(np.zeros(16))
    for apart, passed in ((0.0, 0.0), (0.002, 0.0), (0.0031, -30.0 * 0.0001), (-0.005, 30.0 * 0.002)):
        laws.reset(np.zeros(16))
        torque, _ = laws.step(np.zeros(16), np.full(16, apart), np.zeros(16), 0.0)
        np.testing.assert_allclose(torque, passed, atol=1e-9)


@pytest.mark.slow
def test_a_grasp_of_a_strong_hand_holds_and_one_of_a_hand_without_motors_does_not() -> None:
    assert grasp_trial(hand(plain()), "", "foam_brick", Perturbation()).held
    weak = plain()
    weak.constant *= 0.05
    assert not grasp_trial(hand(weak), "", "foam_brick", Perturbation()).held


def test_the_table_counts_hands_and_grasps() -> None:
    def twin(error: float, held: bool) -> dict[str, Any]:
        postures = [{"controller": kind, "error": [error] * 16} for kind in ("pd", "pid")]
        return {"postures": postures, "grasps": [{"held": held}, {"held": True}]}

    about = {"side": "right", "version": "v4", "traits": [], "learnt": {"bus_s": 98.0, "cpu_s": 200.0}}
    rows = [about | {"number": k, "nominal": twin(0.006, False), "identified": twin(0.001, True)} for k in range(3)]
    told = table(json.loads(json.dumps(rows)))
    assert "| nominal | 6.0 (6.0) | 6.0 (6.0) | 0 of 3, 0 of 3 | 3 of 6: 50 % (19–81 %) |" in told
    assert "| identified | 1.0 (1.0) | 1.0 (1.0) | 3 of 3, 3 of 3 | 6 of 6: 100 % (61–100 %) |" in told
    assert "| 0 | right v4: as our drives | 6.0, 6.0; 1 of 2 | 1.0, 1.0; 2 of 2 | 98 s, 200 CPU s |" in told


def test_the_registration_is_of_the_protocol_that_is_there() -> None:
    registered, now = json.loads(REGISTRATION.read_text()), contents()
    assert registered.keys() == now.keys()
    assert registered["protocol"] == now["protocol"]
    assert read_yaml(PROTOCOL)["hands"] == 20
