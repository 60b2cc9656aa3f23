"""Tendon hands as they are seen: in Rerun, in pictures and in messages joints that follow bend with their motor."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest

from allegro_twin.hands.description.specs import load_spec
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.kinematics.orientation import matrix_from_quaternion
from allegro_twin.recording.messages.frames import LinkFrames, urdf_text
from allegro_twin.recording.messages.message_types import ros_types
from allegro_twin.sim.model.joints import PostureMap
from allegro_twin.sim.model.scene import Stage, compile_scene
from allegro_twin.viewing.skeleton import Skeleton, bodies_of
from tests.hands.models import HANDS as HAND_FILES
from tests.hands.models import SOFT, hand

HANDS = ("model_o", "qb_softhand")


@pytest.mark.parametrize("name", HANDS)
def test_every_link_is_drawn_where_the_simulation_has_it_when_nothing_is_in_its_way(name: str) -> None:
    spec, random = load_spec(name), np.random.default_rng(0)
    model = compile_scene(spec, Stage(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])))
    data, skeleton = mujoco.MjData(model), Skeleton(bodies_of(spec), spec)
    postures = random.uniform(spec.lower, spec.upper, (5, spec.n_joints))
    places = skeleton.places(postures)
    for row, posture in enumerate(postures):
        PostureMap(spec, model)(posture, data.qpos)
        mujoco.mj_kinematics(model, data)
        for body, (place, turn) in zip(skeleton.bodies[1:], places[1:], strict=True):
            np.testing.assert_allclose(place[row], data.body(body.name).xpos, atol=1e-9)
            np.testing.assert_allclose(turn[row], data.body(body.name).xmat.reshape(3, 3), atol=1e-9)


@pytest.mark.parametrize("name", HANDS)
def test_a_view_is_found_by_the_ends_of_tendon_fingers(name: str) -> None:
    spec = load_spec(name)
    straight, bent = Skeleton(bodies_of(spec), spec).tips()
    assert straight.shape == bent.shape == (len(spec.fingers), 3)
    assert np.linalg.norm(bent - straight, axis=1).min() > 0.01


@pytest.mark.parametrize("name", HANDS)
def test_frames_of_a_tendon_hand_are_those_of_all_that_moves(name: str) -> None:
    spec = load_spec(name)
    moving = {spec.all_joints[frame.joint] for frame in LinkFrames(spec).moving}
    assert {each.name for each in spec.followers} <= moving <= set(spec.all_joints)


@pytest.mark.parametrize("name", ["gripper", "soft"])
def test_a_hand_by_its_card_has_a_urdf_and_frames_that_are_where_its_kinematics_have_them(
    name: str, tmp_path: Path
) -> None:
    spec, words = hand(name, tmp_path), ros_types()
    frames, model = LinkFrames(spec), hand_kinematics(spec)
    urdf = ElementTree.fromstring(urdf_text(spec))
    assert {each.get("name") for each in urdf.iter("joint")} >= set(spec.all_joints) - {"cable"} - set(spec.joints)
    fixed = {each.child_frame_id: each for each in frames.static_transforms(words, 0).transforms}
    for posture in np.random.default_rng(0).uniform(spec.lower, spec.upper, (4, spec.n_joints)):
        moving = {each.child_frame_id: each for each in frames.transforms_at(words, 0, posture).transforms}
        for finger, pose in model.fingertips(posture).items():
            np.testing.assert_allclose(_place(fixed | moving, spec.finger(finger).tip), pose.position, atol=1e-9)


def test_a_joint_whose_file_counts_from_elsewhere_stands_in_the_urdf_where_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    turned = SOFT.replace('axis="0 1 0" range="0 86"', 'axis="0 1 0" range="10 86" ref="10" pos="0.001 0 0.002"')
    assert turned != SOFT
    monkeypatch.setitem(HAND_FILES, "soft", turned)
    test_a_hand_by_its_card_has_a_urdf_and_frames_that_are_where_its_kinematics_have_them("soft", tmp_path)


def _place(frames: dict[str, Any], name: str) -> Any:
    """Of a frame in the root's, by the transforms that ROS gets."""
    place = np.zeros(3)
    while name in frames:
        step = frames[name].transform
        q = np.array([step.rotation.w, step.rotation.x, step.rotation.y, step.rotation.z])
        shift = np.array([step.translation.x, step.translation.y, step.translation.z])
        place, name = matrix_from_quaternion(q) @ place + shift, frames[name].header.frame_id
    return place
