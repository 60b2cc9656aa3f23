"""Tendon hands as they are seen: in Rerun, in pictures and in messages joints that follow bend with their motor."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from allegro_twin.hands.description.specs import load_spec
from allegro_twin.recording.messages.frames import LinkFrames
from allegro_twin.sim.model.joints import PostureMap
from allegro_twin.sim.model.scene import Stage, compile_scene
from allegro_twin.viewing.skeleton import Skeleton, bodies_of

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
