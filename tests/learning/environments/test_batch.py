"""The batch and the single environment are the same simulation: to the bit, whatever else runs beside it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from gymnasium.vector import SyncVectorEnv

from allegro_twin.learning.environments.env import HandEnv
from allegro_twin.learning.environments.vector import HandVectorEnv
from allegro_twin.learning.tasks import TASKS

EASY: dict[str, dict[str, Any]] = {
    "Grasp": {"objects": ("tennis_ball", "mug")},
    "Lift": {"objects": ("lemon", "apple")},
    "Pinch": {"objects": ("ball_30", "golf_ball")},
    "HoldDisturbed": {"objects": ("lemon", "apple"), "level": "easy"},
}


def marks(task: str, short: bool) -> list[pytest.MarkDecorator]:
    """Every task once before each push, but the one that takes seconds; two with both of the engine's ways through a
    period."""
    if short and task == "HoldDisturbed":
        return [pytest.mark.slow]
    return [] if task in ("Reach", "Grasp") or short else [pytest.mark.long]


CASES = [
    pytest.param(task, randomise, marks=marks(task, short))
    for task in TASKS
    for randomise, short in (("off", False), ("default", True))
]


def kwargs_of(task: str) -> dict[str, Any]:
    """Few objects, so that a test does not compile them all."""
    return EASY.get(task, {})


def rows_of(observation: Any, row: int) -> Any:
    return {k: v[row] for k, v in observation.items()} if isinstance(observation, dict) else observation[row]


def same(first: Any, second: Any) -> None:
    if isinstance(first, dict):
        assert first.keys() == second.keys()
        for key, value in first.items():
            np.testing.assert_array_equal(value, second[key], err_msg=key)
    else:
        np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize(("task", "randomise"), CASES)
def test_a_simulation_in_a_batch_is_the_single_environment_with_its_seed(task: str, randomise: str) -> None:
    n, steps = (5, 45) if task == "HoldDisturbed" else (3, 25)  # Pushes end most of its episodes soon.
    batch = HandVectorEnv(task, n, threads=2, randomise=randomise, **kwargs_of(task))
    singles = [HandEnv(task, randomise=randomise, **kwargs_of(task)) for _ in range(n)]
    observations, info = batch.reset(seed=7)
    actions = np.random.default_rng(3).uniform(-0.3, 0.3, (steps, n, 16)).astype(np.float32)
    for row, env in enumerate(singles):
        own, own_info = env.reset(seed=7 + row)
        same(rows_of(observations, row), own)
        for name, value in own_info["randomised"].items():
            np.testing.assert_array_equal(info["randomised"][name][row], value)
    over = np.zeros(n, bool)
    for action in actions:
        observations, rewards, terminated, truncated, infos = batch.step(action)
        for row, env in enumerate(singles):
            if over[row]:
                continue
            own, reward, ended, cut, own_info = env.step(action[row])
            same(rows_of(observations, row), own)
            assert (rewards[row], terminated[row], truncated[row]) == (reward, ended, cut)
            assert infos["is_success"][row] == own_info["is_success"]
        over |= terminated | truncated
    assert not over.all(), "the comparison ended before it began"


def test_a_partial_reset_leaves_the_others_alone() -> None:
    n = 4
    first, second = (HandVectorEnv("Lift", n, autoreset_mode="disabled", **kwargs_of("Lift")) for _ in range(2))
    zero = np.zeros((n, 16), np.float32)
    for env in (first, second):
        env.reset(seed=1)
        env.step(zero)
    _, info = first.reset(options={"reset_mask": np.array([False, True, False, False])})
    assert info["_object"].tolist() == [False, True, False, False]
    assert first.engine.count.tolist() == [1, 0, 1, 1]
    second_next, first_next = second.step(zero)[0], first.step(zero)[0]
    others = [0, 2, 3]
    np.testing.assert_array_equal(first_next[others], second_next[others])  # type: ignore[index]  # An array here.
    assert not np.array_equal(first_next[1], second_next[1])  # type: ignore[index]  # An array here.


def test_the_next_step_after_an_end_is_the_first_observation_of_a_new_episode() -> None:
    env = HandVectorEnv("Reach", 3, max_episode_steps=4)
    env.reset(seed=0)
    env.engine.count[1] = 2  # So that the second is over two steps before the others.
    zero = np.zeros((3, 16), np.float32)
    ends = []
    for _ in range(6):
        _, reward, _, truncated, info = env.step(zero)
        ends.append(truncated.tolist())
        if "_randomised" in info or "randomised" in info:
            assert (reward[truncated] == 0).all()
    assert ends[1] == [False, True, False]
    assert ends[3] == [True, False, True]
    assert env.engine.count.tolist() == [1, 3, 1]


def test_in_the_mode_same_step_the_last_observation_comes_with_the_first_of_the_next_episode() -> None:
    env = HandVectorEnv("Lift", 2, max_episode_steps=3, autoreset_mode="same_step", **kwargs_of("Lift"))
    env.reset(seed=0)
    zero = np.zeros((2, 16), np.float32)
    for _ in range(2):
        env.step(zero)
    observation, _, _, truncated, info = env.step(zero)
    assert truncated.all()
    assert info["_final_obs"].all()
    assert isinstance(observation, np.ndarray)
    assert not np.array_equal(info["final_obs"], observation)
    assert env.engine.count.tolist() == [0, 0]


@pytest.mark.parametrize("mode", ["next_step", "same_step"])
def test_info_has_the_masks_and_values_that_gymnasium_s_own_vector_environments_have(mode: str) -> None:
    ours = HandVectorEnv("Rotate", 2, autoreset_mode=mode, timestep=0.003)
    kinds: Any = [lambda: HandEnv("Rotate", timestep=0.003)] * 2
    theirs: Any = SyncVectorEnv(kinds, autoreset_mode=ours.metadata["autoreset_mode"])
    for env in (ours, theirs):
        env.reset(seed=0)
    lose: list[Any] = [each.engine.task for each in (ours, *(env.unwrapped for env in theirs.envs))]
    action = np.random.default_rng(0).uniform(-1.0, 1.0, (2, 16)).astype(np.float32)
    ends = 0
    for step in range(5):
        if step == 2:
            lose[0].object_body.pose[0, 2] = lose[1].object_body.pose[0, 2] = 1.0
        found, wanted = (env.step(action) for env in (ours, theirs))
        ends += int(found[2].sum())
        _assert_same_info(found[4], wanted[4])
    assert ends == 1


def _assert_same_info(found: dict[str, Any], wanted: dict[str, Any]) -> None:
    assert found.keys() == wanted.keys()
    for name in found.keys() - {"final_obs"}:
        if isinstance(wanted[name], dict):
            _assert_same_info(found[name], wanted[name])
        elif wanted[name].dtype != object:
            np.testing.assert_array_equal(found[name], wanted[name], err_msg=name)


def test_what_an_episode_has_come_to_is_in_its_last_info_although_the_next_has_begun() -> None:
    envs = HandVectorEnv("Rotate", 2, max_episode_steps=3, autoreset_mode="same_step", timestep=0.003)
    envs.reset(seed=0)
    for _ in range(3):
        *_, info = envs.step(np.full((2, 16), 0.3, np.float32))
    assert (info["final_info"]["turned"] != 0.0).all()
    assert not info["turned"].any()


def test_an_episode_that_is_repeated_in_the_same_environment_is_the_same_to_the_bit() -> None:
    env = HandEnv("Lift", randomise="default", **kwargs_of("Lift"))
    actions = np.random.default_rng(0).uniform(-1, 1, (30, 16)).astype(np.float32)

    def episode() -> list[Any]:
        return [env.reset(seed=5)[0], *(env.step(action)[0] for action in actions)]

    first = episode()
    env.reset(seed=6, options={"size": 1.1, "friction": 0.5})
    for action in actions:
        env.step(action)
    for before, after in zip(first, episode(), strict=True):
        np.testing.assert_array_equal(before, after)
