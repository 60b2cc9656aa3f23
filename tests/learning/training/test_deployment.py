"""A policy is worth as much on a CAN bus as in the batch that it was trained in."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.learning.environments.env import HandEnv
from allegro_twin.learning.environments.episode import EpisodeBackend
from allegro_twin.learning.environments.settings import EnvSettings
from allegro_twin.learning.policy.card import check_card
from allegro_twin.learning.policy.controller import PolicyController, ZeroPolicy
from allegro_twin.learning.training.evaluation import evaluate
from allegro_twin.learning.training.settings import load_recipe
from allegro_twin.loop import run

POLICIES = data_root() / "conf" / "policies"
CLOSE = 0.05
"""Issue: within 5 points."""


@pytest.mark.parametrize("randomise", ["off", "default"])
@pytest.mark.parametrize("task", ["Reach", "Grasp"])
def test_an_episode_driven_as_a_hand_is_the_environments_own(task: str, randomise: str) -> None:
    few: dict[str, Any] = {"objects": ("tennis_ball", "lemon")} if task == "Grasp" else {}
    env, steps = HandEnv(task, randomise=randomise, **few), 70 if task == "Grasp" else 40
    env.reset(seed=11)
    weights = np.random.default_rng(0).normal(size=(64, 16)).astype(np.float32)
    seen: list[Any] = []

    def policy(observation: Any) -> Any:
        joints = observation["observation"] if isinstance(observation, dict) else observation
        seen.append(joints)
        return (0.3 * np.tanh((joints[:64, None] * weights).sum(axis=0))).astype(np.float32)

    episode = EpisodeBackend(task, env.engine.settings, seed=11)
    episode.reset()
    interface = episode.engine.task.interface
    # Gains differ from hand to hand where they are randomised; a controller on a real hand does not know.
    exact = randomise == "off"
    controller = PolicyController(policy, interface, episode.goal, episode.script)
    positions, successes = [], []
    for sample in run(episode, controller):
        if sample.state.tick % interface.decimation == 0:
            positions.append(sample.state.position)
            successes.append(episode.success)
        if len(positions) > steps:
            break
    own, observation = [], env.reset(seed=11)[0]
    np.testing.assert_array_equal(joints_of(observation), seen[0])
    for step in range(steps):
        observation, _, _, _, info = env.step(policy(observation))
        own.append(env.engine.measure(np.array([(step + 1) * interface.decimation]))[0][0].copy())
        assert info["is_success"] == successes[step + 1] or not exact
    if exact:
        np.testing.assert_array_equal(own, positions[1:])
    assert np.ptp(own, axis=0).max() > 0.1


@pytest.mark.parametrize("task", ["Rotate", "Reorient"])
def test_what_no_hand_reports_is_told_beside_it_and_is_the_environments_own(task: str) -> None:
    env, steps = HandEnv(task, decimation=20, timestep=0.003, palm="allowed"), 25
    observation = env.reset(seed=4)[0]
    weights = np.random.default_rng(0).normal(size=(77, 16)).astype(np.float32)
    seen: list[Any] = []

    def policy(observation: Any) -> Any:
        seen.append(observation)
        return (0.3 * np.tanh(joints_of(observation) @ weights)).astype(np.float32)

    episode = EpisodeBackend(task, env.engine.settings, seed=4)
    episode.reset()
    interface = episode.engine.task.interface
    controller = PolicyController(policy, interface, episode.goal, 0, episode.target, episode.complete_observation)
    for sample in run(episode, controller):
        if sample.state.tick == interface.decimation * steps:
            break
    driven, seen = seen, []
    for step in range(steps):
        for name, part in observation.items() if isinstance(observation, dict) else {"all": observation}.items():
            np.testing.assert_array_equal(part, driven[step][name] if name != "all" else driven[step])
        observation, _, _, _, info = env.step(policy(observation))
    assert episode.count == info[episode.engine.task.count_term]


def joints_of(observation: Any) -> Any:
    return observation["observation"] if isinstance(observation, dict) else observation


def test_an_episode_begins_anew_at_every_reset_and_another_with_another_seed() -> None:
    episode = EpisodeBackend("Grasp", EnvSettings(objects=("tennis_ball", "lemon"), position_noise=0.015), seed=1)
    runs = []
    for seed in (1, 1, 2):
        episode.seed = seed
        still = PolicyController(ZeroPolicy(16), episode.engine.task.interface)
        samples = run(episode, still)
        runs.append([next(samples).state.position for _ in range(400)])
    np.testing.assert_array_equal(runs[0], runs[1])
    assert not np.array_equal(runs[0], runs[2])


def test_a_policy_of_another_task_is_refused_with_both_sides() -> None:
    settings = load_recipe("grasp_easy").environment
    ours = HandEnv("Grasp", objects=("lemon",)).engine.task.card()
    with pytest.raises(ConfigError, match="the policy has decimation 13, these environments have 26"):
        check_card(
            ours, EpisodeBackend("Grasp", settings.model_copy(update={"objects": ("lemon",)})).engine.task.card()
        )
    check_card(ours, HandEnv("Grasp", objects=("apple",)).engine.task.card())


@pytest.mark.parametrize(("name", "recipe_name"), [("reach", "reach"), ("grasp", "grasp_easy")])
def test_shipped_policies_are_small_and_for_the_right_hand(name: str, recipe_name: str) -> None:
    pytest.importorskip("onnxruntime", reason="the shipped policies are ONNX files: extra policy")
    from allegro_twin.learning.policy.loading import load_policy

    path = POLICIES / f"{name}_right.onnx"
    assert path.stat().st_size < 1_000_000
    card = load_policy(path).card
    assert card.interface(load_spec()).spec.side == "right"
    assert "PPO, seed 0" in card.note
    recipe = load_recipe(recipe_name)
    check_card(card, EpisodeBackend(recipe.task, recipe.environment).engine.task.card())


@pytest.mark.parametrize("name", ["rotate", "reorient"])
def test_a_policy_that_sees_the_cube_fits_its_task_and_no_real_hand(name: str) -> None:
    pytest.importorskip("onnxruntime", reason="the shipped policies are ONNX files: extra policy")
    from allegro_twin.learning.policy.loading import load_policy
    from allegro_twin.learning.training.report import as_shipped

    path, recipe = POLICIES / f"{name}_right.onnx", load_recipe(f"{name}_on_palm")
    assert path.stat().st_size < 1_000_000
    card = load_policy(path).card
    check_card(card, EpisodeBackend(recipe.task, as_shipped(recipe.environment)).engine.task.card())
    with pytest.raises(ConfigError, match="privileged: 13 of the numbers it sees are not measured by any hand"):
        card.interface(load_spec())


@pytest.mark.long
@pytest.mark.parametrize(("name", "recipe_name"), [("reach", "reach"), ("grasp", "grasp_easy")])
def test_a_policy_on_the_virtual_hand_over_can_is_as_good_as_in_the_batch(name: str, recipe_name: str) -> None:
    pytest.importorskip("onnxruntime", reason="the shipped policies are ONNX files: extra policy")
    from allegro_twin.learning.policy.loading import load_policy
    from allegro_twin.learning.training.deployment import evaluate_on_can
    from allegro_twin.learning.training.report import as_shipped

    recipe, path, episodes = load_recipe(recipe_name), POLICIES / f"{name}_right.onnx", 60
    settings = as_shipped(recipe.environment)
    batch = evaluate(load_policy(path).policy, recipe.task, settings, episodes, seed=77)
    wire = evaluate_on_can(path, recipe.task, settings, episodes, seed=77)
    assert wire.objects == batch.objects
    assert batch.rate > 0.5
    assert abs(wire.rate - batch.rate) <= CLOSE
    assert not np.array_equal(wire.returns, batch.returns), "nothing was encoded"
