"""What may stand beside what a hand reports: external torque in the observation, and a state for critics."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest

import allegro_twin.gym  # noqa: F401  # Registers the ids.
from allegro_twin.learning.environments.observation_model import FACTORS
from allegro_twin.learning.environments.vector import HandVectorEnv
from allegro_twin.learning.policy.interface import Floats, Observation

N = 16


def of(observation: Observation, name: str) -> Floats:
    assert isinstance(observation, dict)
    return observation[name]


@pytest.mark.parametrize("task", ["Reach", "Grasp", "Rotate", "Reorient"])
def test_a_state_stands_beside_an_observation_that_it_leaves_as_it_is(task: str) -> None:
    plain = HandVectorEnv(task, 2, timestep=0.003, randomise="default")
    env = HandVectorEnv(task, 2, timestep=0.003, randomise="default", state=True)
    action = np.full((2, N), 0.3, np.float32)
    for alone, both in ((plain.reset(seed=3)[0], env.reset(seed=3)[0]), (plain.step(action)[0], env.step(action)[0])):
        parts = alone if isinstance(alone, dict) else {"observation": alone}
        assert isinstance(both, dict)
        assert set(both) == {*parts, "state"}
        for name, value in parts.items():
            np.testing.assert_array_equal(both[name], value)
        assert env.observation_space.contains(both)


def test_the_state_is_exact_where_the_observation_has_noise_and_delay() -> None:
    env = HandVectorEnv("Grasp", 3, timestep=0.003, randomise="default", state=True)
    _, info = env.reset(seed=0)
    observation = env.step(np.zeros((3, N), np.float32))[0]
    state, worlds, spec = of(observation, "state"), env.engine.worlds, env.engine.task.spec
    half, middle = (spec.upper - spec.lower) / 2, (spec.upper + spec.lower) / 2
    np.testing.assert_allclose(state[:, :N] * half + middle, worlds.position, atol=1e-6)
    assert np.abs(of(observation, "observation")[:, :N] - state[:, :N]).max() > 1e-5
    thing = env.engine.task.object_body
    assert thing is not None
    np.testing.assert_allclose(state[:, 4 * N : 4 * N + 3] * 0.1, thing.pose[:, :3], atol=1e-6)
    drawn = np.stack([info["randomised"][name] for name in FACTORS], axis=-1)
    np.testing.assert_allclose(state[:, -len(FACTORS) :], drawn, rtol=1e-6)


def test_external_torque_is_what_stops_a_finger() -> None:
    """A finger that is driven against an object with some torque and rests there feels as much from outside."""
    env = HandVectorEnv("HoldDisturbed", 2, timestep=0.003, touch=True)
    env.reset(seed=1)
    assert env.engine.task.card().privileged == N
    for _ in range(4):
        seen = env.step(np.zeros((2, N), np.float32))[0]
    touch = np.asarray(seen)[:, -N:]
    model, limit = env.engine.worlds.model, env.engine.task.spec.actuation.torque_limit
    worlds, row = env.engine.worlds.snapshot(0), 0
    asked = np.clip(env.engine.worlds.control[row], -limit, limit)
    still = np.abs(env.engine.worlds.velocity[row]) < 0.02
    gravity = worlds.data.qfrc_bias[: model.nv]
    columns = [int(model.joint(name).dofadr[0]) for name in env.engine.task.spec.joints]
    expected = gravity[columns] - asked
    assert still.sum() > 8
    np.testing.assert_allclose((touch[row] * limit)[still], expected[still], atol=0.02)
    assert np.abs(touch[row]).max() > 0.1


def test_an_episode_is_the_same_whether_its_contacts_are_felt_or_not() -> None:
    plain = HandVectorEnv("Grasp", 2, timestep=0.003, randomise="default")
    felt = HandVectorEnv("Grasp", 2, timestep=0.003, randomise="default", touch=True)
    (first, before), (second, after) = plain.reset(seed=4), felt.reset(seed=4)
    np.testing.assert_array_equal(first, np.asarray(second)[:, :-N])
    assert set(after["randomised"]) - set(before["randomised"]) == {"touch_noise", "_touch_noise"}
    assert (after["randomised"]["touch_noise"] <= 0.02).all()
    np.testing.assert_array_equal(before["randomised"]["mass"], after["randomised"]["mass"])


def test_before_the_first_period_nothing_is_felt_whatever_was_before() -> None:
    env = HandVectorEnv("HoldDisturbed", 2, timestep=0.003, touch=True, autoreset_mode="disabled")
    env.reset(seed=1)
    env.step(np.zeros((2, N), np.float32))
    seen = np.asarray(env.reset(options={"reset_mask": np.array([True, False])})[0])[:, -N:]
    assert not seen[0].any()
    assert seen[1].any()


def test_felt_torque_has_the_noise_that_was_drawn_and_is_the_same_alone_and_beside_others() -> None:
    rows = []
    for count in (1, 3):
        env = HandVectorEnv("Grasp", count, timestep=0.003, touch=True, randomise={"touch_noise": (0.01, 0.02)})
        env.reset(seed=5)
        env.step(np.zeros((count, N), np.float32))
        rows.append(np.asarray(env.step(np.zeros((count, N), np.float32))[0])[0])
    np.testing.assert_array_equal(*rows)
    quiet = HandVectorEnv("Grasp", 1, timestep=0.003, touch=True)
    quiet.reset(seed=5)
    quiet.step(np.zeros((1, N), np.float32))
    exact = np.asarray(quiet.step(np.zeros((1, N), np.float32))[0])[0]
    np.testing.assert_array_equal(rows[1][:-N], exact[:-N])
    off = np.abs(rows[1] - exact)[-N:] * quiet.engine.task.spec.actuation.torque_limit
    assert 0.001 < off.max() < 0.0201


def test_a_single_environment_has_them_too() -> None:
    env = gymnasium.make("AllegroTwin/Rotate-v0", state=True, touch=True, timestep=0.003)
    observation, _ = env.reset(seed=0)
    assert env.observation_space.contains(observation)
    assert observation["observation"].shape == (4 * N + 13 + N,)
    assert observation["state"].shape == (4 * N + 13 + len(FACTORS),)


@pytest.mark.long
def test_on_a_warp_device_both_are_what_they_are_on_processors() -> None:
    pytest.importorskip("mujoco_warp", reason="MuJoCo Warp is not installed: pip install 'allegro-twin[warp]'")
    told: list[Any] = []
    for device in ("cpu", "warp:cpu"):
        env = HandVectorEnv("Reach", 2, autoreset_mode="disabled", device=device, state=True, touch=True)
        env.reset(seed=5)
        told.append([env.step(np.full((2, N), 0.2, np.float32))[0] for _ in range(3)][-1])
    here, there = told
    assert here["observation"].shape == (2, 4 * N + N)
    np.testing.assert_allclose(here["observation"], there["observation"], atol=2e-4)
    np.testing.assert_allclose(here["state"], there["state"], atol=2e-4)
