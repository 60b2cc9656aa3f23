"""Rewards, successes and ends follow from what is so, not from what a camera or an encoder makes of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from allegro_twin.kinematics.orientation import angle_between_quaternions, rotate_quaternion
from allegro_twin.learning.environments.engine import EpisodeEngine
from allegro_twin.learning.environments.env import HandEnv
from allegro_twin.learning.environments.randomise import Randomise
from allegro_twin.learning.environments.settings import EnvSettings
from allegro_twin.learning.environments.tensors import TensorVectorEnv
from allegro_twin.learning.environments.vector import HandVectorEnv
from allegro_twin.learning.tasks import TASKS
from allegro_twin.learning.tasks.reorient import REACHED
from allegro_twin.sim.batch.link_contacts import AssumedContacts

N = 6
FEW = {"HoldDisturbed": ("tennis_ball",), "Grasp": ("tennis_ball", "foam_brick"), "Lift": ("foam_brick",)}
NOISY = {"camera_turn": (0.1, 0.1), "camera_shift": (0.02, 0.02), "camera_delay": (2, 2)}
BESIDE = (0.0, 0.0, 0.4)  # m, of the palm: nothing touches an object there while an action lasts.


def engine_of(task: str, seed: int, **more: Any) -> EpisodeEngine:
    engine = EpisodeEngine(task, EnvSettings(timestep=0.003, objects=FEW.get(task), **more), N, 1)
    engine.reset(np.arange(N), [np.random.default_rng(seed + row) for row in range(N)])
    return engine


@pytest.mark.parametrize("task", sorted(TASKS))
def test_no_reward_success_or_end_follows_from_what_a_policy_sees(task: str) -> None:
    noisy = Randomise.default()
    engine, blind = (engine_of(task, 5, randomise=noisy) for _ in range(2))
    rng = np.random.default_rng(0)
    for _ in range(12):
        action = rng.uniform(-0.5, 0.5, (N, 16))
        outcomes = []
        for each in (engine, blind):
            each.step(each.clip_actions(action))
            seen = each.observe()
            if each is blind:
                seen = (
                    {name: 0 * rows + np.nan for name, rows in seen.items()}
                    if isinstance(seen, dict)
                    else seen * np.nan
                )
            outcomes.append(each.outcome(action, seen)[0])
        for one, other in zip(outcomes[0][:3], outcomes[1][:3], strict=True):
            np.testing.assert_array_equal(one, other)
        for name, rows in outcomes[0].terms.items():
            np.testing.assert_array_equal(rows, outcomes[1].terms[name], err_msg=name)


def turned_to(env: Any, off: float) -> None:
    """Let every cube stand beside its goal by so many rad, in the air, at rest; a goal that was reached stays."""
    task = env.engine.task
    task.contacts = AssumedContacts(task.worlds)  # In the air a goal would not count.
    task._renewed[:] = False
    task.object_body.pose[:, :3] = task.place[:] = BESIDE
    task.object_body.pose[:, 3:] = rotate_quaternion(np.asarray(task.goal(), float), (0.0, off, 0.0))
    task.object_body.velocity[:] = task.object_body.spin[:] = 0.0


@pytest.mark.parametrize("kind", ["single", "batch", "tensors"])
@pytest.mark.parametrize(("off", "reached"), [(0.05, True), (0.15, False)])
def test_a_goal_counts_where_the_cube_truly_is(kind: str, off: float, reached: bool) -> None:
    """Noise of 0.1 rad an axis shows a cube that is 0.05 rad off beyond 0.1 rad, and one at 0.15 rad within it."""
    settings: dict[str, Any] = {"timestep": 0.003, "decimation": 1, "randomise": NOISY}
    told, given = [], np.zeros((N, 16), np.float32)
    if kind == "tensors":
        torch = pytest.importorskip("torch", reason="tensors: extra rsl")
        tensors = TensorVectorEnv("Reorient", N, seed=1, **settings)
        tensors.reset()
        for _ in range(20):
            turned_to(tensors, off)
            observation, _, _, _, info = tensors.step(torch.zeros((N, 16)))
            told.append((observation["achieved_goal"], observation["desired_goal"], info["bonus"] > 0))
    elif kind == "batch":
        batch = HandVectorEnv("Reorient", N, autoreset_mode="disabled", **settings)
        batch.reset(seed=1)
        for _ in range(20):
            turned_to(batch, off)
            observation, _, _, _, info = batch.step(given)
            assert isinstance(observation, dict)
            told.append((observation["achieved_goal"], observation["desired_goal"], info["bonus"] > 0))
    else:
        env = HandEnv("Reorient", **settings)
        env.reset(seed=1)
        for _ in range(20):
            turned_to(env, off)
            one, _, _, _, info = env.step(given[0])
            assert isinstance(one, dict)
            told.append((one["achieved_goal"][None], one["desired_goal"][None], np.array([info["bonus"] > 0])))
    shown = np.stack([angle_between_quaternions(np.asarray(a, float), np.asarray(d, float)) for a, d, _ in told])
    assert (shown < REACHED).any(), "a picture never showed it at the goal: nothing is tested"
    assert (shown > REACHED).any(), "a picture never showed it off the goal: nothing is tested"
    assert np.stack([np.asarray(counted) for _, _, counted in told]).all() == reached
    assert np.stack([np.asarray(counted) for _, _, counted in told]).any() == reached


def test_fingertips_reach_where_the_joints_truly_are() -> None:
    env = HandEnv("Reach", timestep=0.003, randomise={"encoder_noise": (0.1, 0.1), "sensor_delay": (3, 3)})
    observation, _ = env.reset(seed=2)
    off = []
    for _ in range(10):
        observation, reward, _, _, info = env.step(np.zeros(16, np.float32))
        task = env.engine.task
        tips = task.interface.fingertips(task.worlds.position)[0].reshape(-1, 3)
        assert isinstance(observation, dict)
        apart = np.linalg.norm(tips - observation["desired_goal"].reshape(-1, 3), axis=-1)
        assert info["distance"] == pytest.approx(apart.mean(), rel=1e-5)
        assert reward == pytest.approx(-10.0 * info["distance"], rel=1e-5)
        seen = float(env.compute_reward(observation["achieved_goal"], observation["desired_goal"], info))
        off.append(abs(seen - reward))
    assert max(off) > 0.02, "the noise does not show"


@pytest.mark.parametrize("task", ["Reach", "Reorient"])
def test_without_noise_what_is_seen_pays_the_same(task: str) -> None:
    env = HandEnv(task, timestep=0.003)
    env.reset(seed=4)
    rng = np.random.default_rng(4)
    for _ in range(10):
        observation, reward, _, _, info = env.step(rng.uniform(-0.3, 0.3, 16).astype(np.float32))
        assert isinstance(observation, dict)
        assert env.compute_reward(observation["achieved_goal"], observation["desired_goal"], info) == reward
