"""Environments whose arrays are PyTorch's tensors: the same tasks, for learners that stay where the simulations are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from allegro_twin.learning.environments.tensors import TensorVectorEnv

torch = pytest.importorskip("torch", reason="torch is not installed: pip install 'allegro-twin[rsl]'")
N = 3
FAST: dict[str, Any] = {"timestep": 0.003}


def actions(seed: int = 0) -> Any:
    return torch.from_numpy(np.random.default_rng(seed).uniform(-0.5, 0.5, (N, 16)).astype(np.float32))


def test_the_same_seed_is_the_same_run_and_another_is_not() -> None:
    runs = []
    for seed in (0, 0, 1):
        env = TensorVectorEnv("Rotate", N, seed=seed, **FAST)
        env.reset()
        runs.append([env.step(actions(k))[0].clone() for k in range(3)])
    for first, again, other in zip(*runs, strict=True):
        assert torch.equal(first, again)
        assert not torch.equal(first, other)


def test_simulations_and_episodes_all_begin_otherwise() -> None:
    env = TensorVectorEnv("Rotate", N, **FAST)
    first, second = env.reset().clone(), env.reset().clone()
    rows = torch.cat([first, second])
    assert len({tuple(row.tolist()) for row in rows}) == 2 * N


def test_what_ends_begins_anew_in_the_same_step_and_the_rest_goes_on() -> None:
    env = TensorVectorEnv("Rotate", N, max_episode_steps=5, **FAST)
    env.reset()
    env.engine.count[1] = 4
    observation, reward, failed, truncated, info = env.step(actions())
    assert truncated.tolist() == [False, True, False]
    assert not failed.any()
    assert reward.shape == (N,)
    assert not torch.equal(observation[1], info["final_obs"][1])
    assert torch.equal(observation[0], info["final_obs"][0])
    assert env.engine.count.tolist() == [1, 0, 1]
    *_, info = env.step(actions())
    assert "final_obs" not in info


def test_goals_and_state_are_tensors_by_name() -> None:
    env = TensorVectorEnv("Reorient", N, state=True, **FAST)
    seen = env.reset()
    assert {name: len(part) for name, part in seen.items()} == dict.fromkeys(
        ("observation", "achieved_goal", "desired_goal", "state"), N
    )
    assert all(part.dtype == torch.float32 for part in seen.values())


@pytest.mark.long
def test_on_a_device_and_on_processors_the_same_episodes_begin() -> None:
    pytest.importorskip("mujoco_warp", reason="mujoco_warp is not installed: pip install 'allegro-twin[warp]'")
    ours, theirs = (TensorVectorEnv("Rotate", N, seed=3, device=device, **FAST) for device in ("cpu", "warp:cpu"))
    torch.testing.assert_close(ours.reset(), theirs.reset(), atol=2e-5, rtol=0.0)
    for k in range(3):
        (seen, reward, *_), (there, their_reward, *_) = ours.step(0.3 * actions(k)), theirs.step(0.3 * actions(k))
        torch.testing.assert_close(seen, there, atol=2e-3, rtol=0.0)
        torch.testing.assert_close(reward.float(), their_reward, atol=5e-3, rtol=0.0)


def test_what_an_episode_has_come_to_is_in_its_last_info_although_the_next_has_begun() -> None:
    envs = TensorVectorEnv("Rotate", 2, max_episode_steps=3, timestep=0.003)
    envs.reset()
    for _ in range(3):
        *_, info = envs.step(envs.xp.torch.full((2, 16), 0.3))
    assert (info["turned"] != 0.0).all()


def test_a_checkpoint_without_pickle_has_what_a_user_s_task_keeps(tmp_path: Path) -> None:
    task, path = "tests.learning.environments.test_task_memory:Remembering", tmp_path / "state.pt"
    env, new = (TensorVectorEnv(task, N, **FAST) for _ in range(2))
    env.reset()
    for k in range(3):
        env.step(actions(k))
    torch.save(env.state_dict(), path)
    first = env.step(actions(4))[4]
    new.reset()
    assert new.load(torch.load(path, weights_only=True))
    for name, value in new.step(actions(4))[4].items():
        np.testing.assert_array_equal(value, first[name], err_msg=name)
