"""Stable-Baselines3 sees every episode of our vector environment as it was, from its first step to its last."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from allegro_twin.learning.environments.env import HandEnv
from allegro_twin.learning.environments.vector import HandVectorEnv
from allegro_twin.learning.tasks import TASKS
from tests.learning.environments.test_batch import kwargs_of

pytest.importorskip("stable_baselines3", reason="the adapter is for Stable-Baselines3: extra rl")
from allegro_twin.learning.training.sb3.env import Sb3VecEnv

N = 6
FEW: dict[str, Any] = {"objects": ("tennis_ball", "lemon")}


def adapted(task: str = "Grasp", **kwargs: Any) -> Sb3VecEnv:
    given = FEW | kwargs if task == "Grasp" else kwargs
    return Sb3VecEnv(HandVectorEnv(task, N, autoreset_mode="disabled", threads=1, **given))


def uncut(env: Sb3VecEnv) -> Sb3VecEnv:
    """With whole episodes from the beginning."""
    env._cut[:] = env.env.limit
    return env


def test_every_step_is_the_one_of_the_single_environment_until_the_first_episode_ends() -> None:
    env = adapted(position_noise=0.03)
    env.seed(3)
    seen: Any = env.reset()
    uncut(env)
    singles = [HandEnv("Grasp", position_noise=0.03, **FEW) for _ in range(N)]
    for row, single in enumerate(singles):
        np.testing.assert_array_equal(single.reset(seed=3 + row)[0], seen[row])
    actions = np.random.default_rng(0).uniform(-1, 1, (N, 16)).astype(np.float32)
    returned, going = np.zeros(N), np.ones(N, bool)
    ended = 0
    for _ in range(env.env.limit):
        seen, reward, done, infos = env.step(actions)
        for row in np.flatnonzero(going).tolist():
            own: Any
            own, its, failed, over, told = singles[row].step(actions[row])
            returned[row] += its
            assert reward[row] == np.float32(its)
            assert done[row] == (failed or over)
            last = infos[row].get("terminal_observation", seen[row])
            np.testing.assert_array_equal(last, own)
            if done[row]:
                ended += 1
                assert infos[row]["TimeLimit.truncated"] is not failed
                assert infos[row]["is_success"] is told["is_success"]
                assert infos[row]["episode"]["r"] == pytest.approx(returned[row], rel=1e-12)
                assert infos[row]["episode"]["l"] == single_count(singles[row])
                assert not np.array_equal(seen[row], own), "the next episode has not begun"
                assert env.env.engine.count[row] == 0
            else:
                assert infos[row] == {}
        going &= ~done
    assert ended == N


def single_count(env: HandEnv) -> int:
    return int(env.engine.count[0])


def test_first_episodes_are_cut_at_different_moments_and_left_out_of_the_statistics() -> None:
    env = adapted("Reach")
    env.seed(0)
    env.reset()
    ends: dict[int, list[tuple[int, dict[str, Any]]]] = {row: [] for row in range(N)}
    for step in range(2 * env.env.limit):
        _, _, done, infos = env.step(np.zeros((N, 16), np.float32))
        for row in np.flatnonzero(done).tolist():
            ends[row].append((step + 1, infos[row]))
    first = [found[0][0] for found in ends.values()]
    assert len(set(first)) > N // 2
    for found in ends.values():
        (cut, early), (whole, late) = found[:2]
        assert early["TimeLimit.truncated"] is True
        assert ("episode" in early) == (cut == env.env.limit)
        assert whole - cut == env.env.limit == late["episode"]["l"]


def test_the_same_seed_gives_the_same_episodes_again() -> None:
    env = adapted("Reach")
    runs = []
    for _ in range(2):
        env.seed(5)
        first: Any = env.reset()
        seen = [first["desired_goal"]]
        for _ in range(60):
            after: Any = env.step(np.full((N, 16), 0.1, np.float32))[0]
            seen.append(after["achieved_goal"])
        runs.append(np.array(seen))
    np.testing.assert_array_equal(runs[0], runs[1])
    assert np.ptp(runs[0][1:], axis=0).max() > 0.01


def test_rewards_are_scaled_and_returns_are_not() -> None:
    whole, scaled = adapted("Reach"), adapted("Reach")
    scaled._scale = 0.5
    told = []
    for env in (whole, scaled):
        env.seed(1)
        env.reset()
        uncut(env)
        rewards = [env.step(np.zeros((N, 16), np.float32)) for _ in range(env.env.limit)]
        told.append((np.array([r[1] for r in rewards]), rewards[-1][3][0]["episode"]["r"]))
    np.testing.assert_array_equal(told[1][0], told[0][0] / 2)
    assert told[0][1] == told[1][1] < 0


def test_the_terms_of_the_logs_are_those_of_the_task() -> None:
    env = adapted("Reach")
    env.reset()
    *_, info = env.env.step(np.zeros((N, 16), np.float32))
    env.step(np.zeros((N, 16), np.float32))
    own = {name for name in info if not name.startswith("_")} - {"is_success"}
    assert env.take_terms().keys() == {f"terms/{name}" for name in own | {"diverged"}}


def test_stable_baselines3_finds_nothing_wrong_with_it() -> None:
    from stable_baselines3.common.vec_env import VecEnv

    env = adapted("Reach")
    assert isinstance(env, VecEnv)
    assert env.get_attr("limit") == [env.env.limit] * N
    assert env.env_is_wrapped(object, 2) == [False]
    with pytest.raises(AttributeError, match="all simulations are one environment"):
        env.set_attr("limit", 3)
    env.close()


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.filterwarnings("ignore:We detected your env to be a GoalEnv")
def test_every_task_passes_the_checker_of_stable_baselines3(task: str) -> None:
    from stable_baselines3.common.env_checker import check_env

    check_env(HandEnv(task, **kwargs_of(task)), warn=True)
