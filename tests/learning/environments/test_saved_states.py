"""An episode can be saved, and goes on from there to the bit: in the same environment, in another, in a batch."""

from __future__ import annotations

import pickle
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import allegro_twin.gym  # noqa: F401  # Registers the ids.
from allegro_twin.errors import ConfigError
from allegro_twin.learning.environments.env import HandEnv
from allegro_twin.learning.environments.vector import HandVectorEnv

RANDOM: dict[str, Any] = {"timestep": 0.003, "randomise": "default"}
N = 3


def flat(observation: Any) -> np.ndarray[Any, Any]:
    parts = observation.values() if isinstance(observation, dict) else (observation,)
    return np.concatenate([np.asarray(part, np.float64).reshape(-1) for part in parts])


def played(env: Any, seed: int, steps: int) -> list[np.ndarray[Any, Any]]:
    rng, found = np.random.default_rng(seed), []
    shape = env.action_space.shape
    for _ in range(steps):
        observation, reward, terminated, truncated, info = env.step(rng.uniform(-0.5, 0.5, shape).astype(np.float32))
        found.append(np.concatenate([flat(observation), np.ravel(reward), np.ravel(terminated), np.ravel(truncated)]))
        found[-1] = np.append(found[-1], np.ravel(info["is_success"]))
        if np.ndim(terminated) == 0 and (terminated or truncated):
            found.append(flat(env.reset()[0]))  # The next episode is drawn from the same numbers.
    return found


@pytest.mark.parametrize("task", ["Reach", "Grasp", "Lift", "HoldDisturbed", "Rotate", "Reorient"])
def test_an_episode_goes_on_from_a_saved_state_to_the_bit(task: str) -> None:
    env, other = (HandEnv(task, **RANDOM) for _ in range(2))
    env.reset(seed=4)
    played(env, 0, 4)
    state = env.save_state()
    first = played(env, 1, 12)
    before = env.restore_state(state)
    again = played(env, 1, 12)
    np.testing.assert_array_equal(np.concatenate(first), np.concatenate(again))
    other.reset(seed=99)
    seen = other.restore_state(pickle.loads(pickle.dumps(state)))
    np.testing.assert_array_equal(flat(seen), flat(before))
    np.testing.assert_array_equal(np.concatenate(first), np.concatenate(played(other, 1, 12)))


def test_the_observation_of_a_restored_state_is_the_one_before_it_was_saved() -> None:
    env = HandEnv("Rotate", **RANDOM, history=3)
    env.reset(seed=4)
    action = np.full(16, 0.2, np.float32)
    seen = [env.step(action)[0] for _ in range(4)][-1]
    state = env.save_state()
    played(env, 1, 5)
    np.testing.assert_array_equal(flat(env.restore_state(state)), flat(seen))


def test_a_batch_goes_on_through_its_resets() -> None:
    env = HandVectorEnv("Rotate", N, max_episode_steps=6, **RANDOM)
    env.reset(seed=4)
    played(env, 0, 4)
    state = env.save_state()
    first = played(env, 1, 12)  # Two resets of everyone.
    env.restore_state(state)
    np.testing.assert_array_equal(np.concatenate(first), np.concatenate(played(env, 1, 12)))
    fresh = HandVectorEnv("Rotate", N, max_episode_steps=6, **RANDOM)
    fresh.reset(seed=1)
    fresh.restore_state(state)
    np.testing.assert_array_equal(np.concatenate(first), np.concatenate(played(fresh, 1, 12)))


def test_a_saved_state_does_not_change_while_its_episode_goes_on() -> None:
    env = HandEnv("Grasp", timestep=0.003)
    env.reset(seed=4)
    state = env.save_state()
    kept = pickle.dumps(state)
    played(env, 1, 5)
    assert pickle.dumps(state) == kept


@pytest.mark.parametrize("task", ["Reach", "Rotate"])
def test_what_a_step_has_given_out_stays_as_it_was_when_a_state_is_restored(task: str) -> None:
    single, batch = HandEnv(task, timestep=0.003), HandVectorEnv(task, N, timestep=0.003)
    for env in (single, batch):
        env.reset(seed=4)
        state = env.save_state()
        out = env.step(np.full(env.action_space.shape or (), 0.3, np.float32))
        kept = pickle.dumps(out)
        env.restore_state(state)
        assert pickle.dumps(out) == kept


def test_a_state_of_other_settings_is_refused() -> None:
    env, other = HandEnv("Grasp", timestep=0.003), HandEnv("Grasp", timestep=0.003, randomise="default")
    for each in (env, other):
        each.reset(seed=0)
    with pytest.raises(ConfigError, match="differ in|does not fit"):
        env.restore_state(other.save_state())
    pair = HandVectorEnv("Grasp", 2, timestep=0.003)
    pair.reset(seed=0)
    with pytest.raises((ConfigError, ValueError)):
        env.restore_state(pair.save_state())


def test_what_an_option_changed_since_is_as_it_was() -> None:
    env = HandEnv("Lift", timestep=0.003, level="easy")
    env.reset(seed=4)
    state = env.save_state()
    first = played(env, 1, 6)
    env.reset(seed=5, options={"friction": 0.3, "size": 1.05})
    played(env, 2, 3)
    friction = env.engine.worlds.expand("geom_friction")
    assert friction[0, :, 0].max() == 0.3
    env.restore_state(state)
    np.testing.assert_array_equal(friction[0], env.engine.worlds.model.geom_friction)
    np.testing.assert_array_equal(np.concatenate(first), np.concatenate(played(env, 1, 6)))


def test_the_length_of_an_episode_is_in_gymnasiums_specification() -> None:
    for decimation, steps in ((13, 51), (26, 26)):
        env = gymnasium.make("AllegroTwin/Reach-v0", decimation=decimation)
        assert env.spec is not None
        assert env.spec.max_episode_steps == steps
        env.reset(seed=0)
        taken = 0
        truncated = False
        while not truncated:
            _, _, _, truncated, _ = env.step(np.zeros(16, np.float32))
            taken += 1
        assert taken == steps
    short = gymnasium.make("AllegroTwin/Reach-v0", max_episode_steps=5)
    assert short.spec is not None
    assert short.spec.max_episode_steps == 5
    envs = gymnasium.make_vec("AllegroTwin/Reach-v0", 2, autoreset_mode=AutoresetMode.SAME_STEP)
    assert envs.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert envs.spec is not None
    assert envs.spec.max_episode_steps == 51
