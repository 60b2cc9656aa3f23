"""Sampling finds actions that a task's reward asks for, from any moment of an episode, and for any hand."""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np
import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.learning.environments.env import HandEnv
from allegro_twin.learning.environments.settings import EnvSettings
from allegro_twin.learning.environments.snapshot import spread_snapshot
from allegro_twin.learning.environments.vector import HandVectorEnv
from allegro_twin.learning.mpc.episodes import run_episodes
from allegro_twin.learning.mpc.sampling import MpcSettings, SamplingMpc

QUICK = MpcSettings(samples=12, horizon=0.3, hold=0.0, knots=2, iterations=1)


@pytest.mark.parametrize("task", ["Reach", "Grasp", "Rotate"])
def test_every_simulation_of_a_batch_goes_on_from_one_episode_to_the_bit(task: str) -> None:
    keywords: dict[str, Any] = {"timestep": 0.003, "randomise": "default"}
    single, batch = HandEnv(task, **keywords), HandVectorEnv(task, 3, autoreset_mode="disabled", **keywords)
    single.reset(seed=4)
    batch.reset(seed=99)
    rng = np.random.default_rng(0)
    for _ in range(3):
        single.step(rng.uniform(-0.5, 0.5, 16).astype(np.float32))
    state = single.save_state()
    spread_snapshot(batch, state.parts)
    for _ in range(6):
        action = rng.uniform(-0.5, 0.5, 16).astype(np.float32)
        observation, reward, failed, _, _ = single.step(action)
        seen, rewards, lost, _, _ = batch.step(np.stack([action] * 3))
        rows = np.concatenate([np.reshape(part, (3, -1)) for part in _parts(seen)], axis=-1)
        one = np.concatenate([np.ravel(part) for part in _parts(observation)])
        for row in range(3):
            np.testing.assert_array_equal(rows[row], one)
        assert rewards.tolist() == [reward] * 3
        assert lost.tolist() == [failed] * 3


def _parts(observation: Any) -> list[Any]:
    return list(observation.values()) if isinstance(observation, dict) else [observation]


@pytest.mark.parametrize(
    ("hand", "method"),
    [
        ("allegro", "cem"),
        pytest.param("leap", "mppi", marks=pytest.mark.slow),
        pytest.param("allegro", "predictive", marks=pytest.mark.slow),
        pytest.param("leap", "cem", marks=pytest.mark.slow),
    ],
)
def test_fingertips_come_nearer_to_their_goals(hand: str, method: Literal["cem", "mppi", "predictive"]) -> None:
    environment = EnvSettings(timestep=0.003, hand=hand)
    chosen = QUICK.model_copy(update={"method": method, "iterations": 2})
    still = HandEnv("Reach", timestep=0.003, hand=hand)
    still.reset(seed=3)
    nothing = sum(still.step(np.zeros(16, np.float32))[1] for _ in range(15))
    (found,) = run_episodes("Reach", environment, chosen, 1, seed=3, seconds=15 * 0.039, threads=1)
    assert found.seconds == pytest.approx(15 * 0.039)
    assert found.total > 0.8 * nothing  # Both are below 0.


def test_the_same_seed_plans_the_same_and_planning_leaves_the_episode_alone() -> None:
    environment = EnvSettings(timestep=0.003)
    env = HandEnv("Reach", timestep=0.003)
    env.reset(seed=3)
    state = env.save_state()
    plans = [SamplingMpc("Reach", environment, QUICK, threads=1).plan(state) for _ in range(2)]
    np.testing.assert_array_equal(plans[0], plans[1])
    again = env.save_state()
    assert all(np.array_equal(state.parts[name], again.parts[name], equal_nan=False) for name in state.parts)


def test_a_spline_goes_through_its_knots_and_moves_on_by_a_decision() -> None:
    mpc = SamplingMpc("Reach", EnvSettings(timestep=0.003), MpcSettings(samples=2, horizon=0.39, knots=4), threads=1)
    assert mpc.decisions == 10
    knots = np.arange(4.0)[None, :, None] * np.ones((1, 1, 16))
    actions = mpc._spline(knots)[:, 0]
    np.testing.assert_allclose(actions[:, 0], np.linspace(0.0, 3.0, 10))
    mpc._move_on(actions)
    np.testing.assert_allclose(mpc._mean[0], actions[1])
    np.testing.assert_allclose(mpc._mean[-1], 0.0)


def test_a_plan_is_the_last_one_moved_on_where_nothing_else_is_tried() -> None:
    settings = MpcSettings(samples=2, horizon=0.39, knots=10, iterations=1, method="predictive", spread=1e-12)
    mpc = SamplingMpc("Reach", EnvSettings(timestep=0.003), settings.model_copy(update={"narrowest": 1e-12}), threads=1)
    env = HandEnv("Reach", timestep=0.003)
    env.reset(seed=3)
    mpc._mean = np.linspace(0.0, 0.9, 10)[:, None] * np.ones((1, 16))
    for action in (0.0, 0.1, 0.2):
        np.testing.assert_allclose(mpc.plan(env.save_state()), action, atol=1e-6)


def test_what_comes_after_a_failure_counts_for_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    mpc = SamplingMpc("Reach", EnvSettings(timestep=0.003), QUICK.model_copy(update={"samples": 2}), threads=1)
    env = HandEnv("Reach", timestep=0.003)
    env.reset(seed=3)
    steps = iter(range(100))

    def step(actions: Any) -> Any:
        return None, np.array([1.0, 1.0]), np.array([next(steps) == 2, False]), None, None

    monkeypatch.setattr(mpc._sims, "step", step)
    returns = mpc._returns(env.save_state(), np.zeros((2, 2, 16)))
    assert returns.tolist() == [3.0, float(mpc.decisions)]


def test_an_episode_reports_what_became_of_it() -> None:
    seen: list[Any] = []
    (found,) = run_episodes(
        "Rotate", EnvSettings(timestep=0.003, decimation=20, objects=("cube",)), QUICK, 1, seconds=0.3, threads=1,
        advance=lambda done, of: seen.append((done, of)),
    )  # fmt: skip
    assert seen == [(k, 5) for k in range(1, 6)]
    assert found.object == "cube"
    assert found.kept
    assert not found.success
    assert 0.5 < found.by_tips <= 1.0
    assert found.thinking > 0.0
    (reached,) = run_episodes("Reach", EnvSettings(timestep=0.003), QUICK, 1, seconds=0.1, threads=1)
    assert math.isnan(reached.count)
    assert math.isnan(reached.by_tips)


def test_a_device_has_no_states_to_plan_from() -> None:
    pytest.importorskip("mujoco_warp", reason="mujoco_warp is not installed: pip install 'allegro-twin[warp]'")
    with pytest.raises(ConfigError, match="states are not saved there"):
        HandEnv("Reach", device="warp:cpu").save_state()
