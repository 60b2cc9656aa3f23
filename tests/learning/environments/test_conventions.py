"""Every environment keeps Gymnasium's promises, and every warning of its checkers is a failure."""

from __future__ import annotations

import pickle
import subprocess
import sys
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env, data_equivalence

import allegro_twin.gym
from allegro_twin.learning.tasks import TASKS
from tests.learning.environments.test_batch import kwargs_of

IDS = allegro_twin.gym.ids()
# One side of every task before each push; the other with the long ones.
NAMES = [pytest.param(name, marks=[pytest.mark.long] if "Left" in name else []) for name in IDS if "Right" not in name]
MODES = [
    pytest.param(task, mode, marks=[] if task in ("Reach", "Grasp") else [pytest.mark.long])
    for task in TASKS
    for mode in ("delta", "absolute", "torque")
]


def make(name: str, **more: Any) -> gymnasium.Env[Any, Any]:
    return gymnasium.make(name, **(kwargs_of(IDS[name][0]) | more))


@pytest.mark.parametrize("name", NAMES)
def test_every_id_passes_the_checker_without_a_warning(name: str) -> None:
    with gymnasium.make(name, render_mode="rgb_array", **kwargs_of(IDS[name][0])) as env:
        check_env(env.unwrapped)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_two_copies_with_the_same_seed_and_actions_agree_exactly(name: str) -> None:
    first, second = make(name, randomise="default"), make(name, randomise="default")
    first.action_space.seed(0)
    ours, theirs = first.reset(seed=4), second.reset(seed=4)
    assert data_equivalence(ours, theirs, exact=True)
    for _ in range(40):
        action = first.action_space.sample()
        ours_next, theirs_next = first.step(action), second.step(action)
        assert data_equivalence(ours_next, theirs_next, exact=True)
        if ours_next[2] or ours_next[3]:
            return


@pytest.mark.parametrize("task", TASKS)
def test_an_environment_goes_through_a_pickle_as_it_was_made(task: str) -> None:
    env = make(f"AllegroTwin/{task}-v0", side="left", decimation=7)
    copy = pickle.loads(pickle.dumps(env.unwrapped))
    assert copy.engine.settings == env.unwrapped.engine.settings  # type: ignore[attr-defined]  # Ours.
    assert data_equivalence(env.unwrapped.reset(seed=1), copy.reset(seed=1), exact=True)


@pytest.mark.slow
def test_an_id_is_found_by_its_module_and_runs_in_spawned_workers() -> None:
    code = """
import gymnasium, numpy as np
if __name__ == "__main__":
    one = gymnasium.make("allegro_twin.gym:AllegroTwin/Reach-v0")
    envs = gymnasium.make_vec("allegro_twin.gym:AllegroTwin/Reach-v0", 2, vectorization_mode="async",
                              vector_kwargs={"context": "spawn"})
    seen, _ = envs.reset(seed=3)
    own, _ = one.reset(seed=3)
    assert (seen["observation"][0] == own["observation"]).all()
    envs.step(np.zeros((2, 16), np.float32))
    envs.close()
    print("done")
"""
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True)
    assert done.stdout.strip() == "done", done.stderr[-2000:]


def test_make_vec_takes_the_batch_and_declares_how_it_resets() -> None:
    envs = gymnasium.make_vec("AllegroTwin/Lift-v0", 3, objects=("lemon",))
    assert type(envs.unwrapped).__name__ == "HandVectorEnv"
    assert envs.metadata["autoreset_mode"] is gymnasium.vector.AutoresetMode.NEXT_STEP
    observations, _ = envs.reset(seed=0)
    assert observations in envs.observation_space
    observations, rewards, terminated, _, _ = envs.step(envs.action_space.sample())
    assert observations in envs.observation_space
    assert rewards.shape == terminated.shape == (3,)


@pytest.mark.parametrize(("task", "control"), MODES)
def test_every_control_mode_keeps_observations_in_their_space(task: str, control: str) -> None:
    env = make(f"AllegroTwin/{task}-v0", control=control)
    env.action_space.seed(1)
    env.reset(seed=0)
    for _ in range(20):
        observation = env.step(env.action_space.sample())[0]
        assert observation in env.observation_space


def test_rewards_of_a_goal_task_can_be_computed_anew_for_one_goal_and_for_many() -> None:
    env = gymnasium.make("AllegroTwin/Reach-v0").unwrapped
    seen, _ = env.reset(seed=0)
    rewards, achieved, desired = [], [], []
    for _ in range(5):
        seen, reward, _, _, info = env.step(env.action_space.sample())
        assert env.compute_reward(seen["achieved_goal"], seen["desired_goal"], info) == reward  # type: ignore[attr-defined]
        rewards.append(reward)
        achieved.append(seen["achieved_goal"])
        desired.append(seen["desired_goal"])
    many = env.compute_reward(np.array(achieved), np.array(desired), {})  # type: ignore[attr-defined]
    np.testing.assert_array_equal(many, rewards)
    assert env.compute_terminated(np.array(achieved), np.array(desired), {}).shape == (5,)  # type: ignore[attr-defined]
    assert env.compute_truncated(achieved[0], desired[0], {}) is False  # type: ignore[attr-defined]


def test_the_frame_rate_is_that_of_the_actions() -> None:
    env = gymnasium.make("AllegroTwin/Reach-v0", decimation=10, render_mode="rgb_array")
    assert env.metadata["render_fps"] == 33
    env.reset(seed=0)
    frame = env.render()
    assert isinstance(frame, np.ndarray)
    assert frame.shape == (480, 480, 3)
    assert frame.dtype == np.uint8
    assert frame.std() > 10, "the picture is empty"


def test_depth_is_in_metres() -> None:
    env = gymnasium.make("AllegroTwin/Lift-v0", render_mode="depth_array", width=64, height=48, objects=("lemon",))
    env.reset(seed=0)
    depth = env.render()
    assert isinstance(depth, np.ndarray)
    assert depth.shape == (48, 64)
    assert 0.1 < depth.min() < 0.6
