"""The other learner: rsl-rl's PPO on tensors, with the same recipes, files and rounds."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from allegro_twin.errors import ConfigError, HandError
from allegro_twin.learning.policy.loading import load_policy
from allegro_twin.learning.training import Recipe, progress, train
from allegro_twin.learning.training.progress import check_same_recipe
from allegro_twin.learning.training.settings import load_recipe

EXTRA = "rsl_rl is not installed: pip install 'allegro-twin[rsl]'"


def recipe(**changes: Any) -> Recipe:
    given: dict[str, Any] = {
        "task": "Reach", "learner": "rsl-rl", "environment": {"timestep": 0.003}, "envs": 4, "rollout": 4, "steps": 48,
        "round": 16, "batch": 8, "epochs": 1, "hidden": [8], "trials": 1,
    }  # fmt: skip
    return Recipe(**given | changes)


def test_a_training_leaves_a_policy_that_any_hand_can_load(tmp_path: Path) -> None:
    pytest.importorskip("rsl_rl", reason=EXTRA)
    told: list[int] = []
    trained = train(recipe(), tmp_path, lambda steps, mean, rate: told.append(steps))
    assert told == [16, 32, 48]
    assert trained.progress.rounds == 3
    loaded = load_policy(trained.policy)
    assert loaded.card.task == "AllegroTwin/Reach-v0"
    seen = {"observation": np.zeros((2, 64), np.float32), "achieved_goal": np.zeros((2, 12), np.float32),
            "desired_goal": np.zeros((2, 12), np.float32)}  # fmt: skip
    assert loaded.policy(seen).shape == (2, 16)


def test_it_goes_on_after_the_last_round_and_elsewhere(tmp_path: Path) -> None:
    pytest.importorskip("rsl_rl", reason=EXTRA)
    train(recipe(steps=16), tmp_path)
    told: list[int] = []
    train(recipe(steps=32), tmp_path, lambda steps, mean, rate: told.append(steps))
    assert told == [32]
    with pytest.raises(ConfigError, match="is a training with batch 8, not 16: choose another folder"):
        train(recipe(batch=16), tmp_path)
    newest = max(tmp_path.glob("checkpoints/*.pt"))
    newest.write_bytes(newest.read_bytes()[:100])
    with pytest.raises(ConfigError, match="not a readable checkpoint"):
        train(recipe(steps=48), tmp_path)


def test_the_exported_policy_acts_as_the_one_that_was_trained(tmp_path: Path) -> None:
    pytest.importorskip("rsl_rl", reason=EXTRA)
    torch = pytest.importorskip("torch")
    from allegro_twin.learning.environments.tensors import TensorVectorEnv
    from allegro_twin.learning.training.onnx_policy import to_onnx
    from allegro_twin.learning.training.rsl.ppo import PpoLearner

    env = TensorVectorEnv("Rotate", 4, timestep=0.003, state=True)
    learner = PpoLearner(recipe(task="Rotate", environment={"timestep": 0.003, "state": True}), env)
    learner.update()
    to_onnx(learner.layers(), tmp_path / "policy.onnx", env.engine.task.card())
    seen = env.reset()
    with torch.inference_mode():
        theirs = learner.ppo.get_policy()(learner._observation_groups(seen)).clamp(-1.0, 1.0).numpy()
    ours = load_policy(tmp_path / "policy.onnx").policy(seen["observation"].numpy())
    np.testing.assert_allclose(ours, theirs, atol=1e-5)


def test_what_only_one_learner_has_is_refused_for_the_other() -> None:
    with pytest.raises(ValueError, match="desired_kl is for learner: rsl-rl"):
        recipe(learner="stable-baselines3", desired_kl=0.01)
    with pytest.raises(ValueError, match="start is for learner: rsl-rl"):
        recipe(learner="stable-baselines3", start="reach_right")
    with pytest.raises(ValueError, match="settle is for a policy to start with"):
        recipe(settle=2)
    with pytest.raises(ValueError, match="device warp needs learner: rsl-rl or dagger; stable-baselines3 has cpu"):
        recipe(learner="stable-baselines3", environment={"device": "warp"})


def test_a_training_may_go_on_where_nothing_but_the_device_differs() -> None:
    there = recipe(environment={"timestep": 0.003, "device": "warp"})
    check_same_recipe(Path("runs/x/00001.pt"), there.model_dump(mode="json"), recipe())
    with pytest.raises(ConfigError, match="is a training with seed 0, not 1"):
        check_same_recipe(Path("runs/x/00001.pt"), there.model_dump(mode="json"), recipe(seed=1))


def test_what_is_lost_at_the_last_moment_is_a_failure_and_not_a_time_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    """A value is put in the place of what a time limit cuts off, never of a loss."""
    pytest.importorskip("rsl_rl", reason=EXTRA)
    torch = pytest.importorskip("torch")
    from allegro_twin.learning.environments.tensors import TensorVectorEnv
    from allegro_twin.learning.training.rsl.ppo import PpoLearner

    env = TensorVectorEnv("Reach", 4, timestep=0.003)
    learner = PpoLearner(recipe(rollout=1, batch=4), env)
    step, told = env.step, []

    def ended(actions: Any) -> Any:
        seen, reward, _, _, info = step(actions)
        return seen, reward, torch.tensor([False, True, False, True]), torch.tensor([False, False, True, True]), info

    def noted(seen: Any, reward: Any, over: Any, more: Any) -> None:
        told.append((over.tolist(), more["time_outs"].tolist()))
        process(seen, reward, over, more)

    process = learner.ppo.process_env_step
    monkeypatch.setattr(env, "step", ended)
    monkeypatch.setattr(learner.ppo, "process_env_step", noted)
    learner.update()
    assert told == [([0.0, 1.0, 1.0, 1.0], [False, False, True, False])]


def test_a_recipe_for_a_gpu_may_be_followed_on_processors() -> None:
    loaded = load_recipe("rotate_on_palm")
    assert (loaded.task, loaded.learner, loaded.environment.device) == ("Rotate", "rsl-rl", "warp")
    assert load_recipe("rotate", device="cpu").environment.device == "cpu"


@pytest.mark.parametrize("learner", ["rsl-rl", "stable-baselines3"])
def test_a_training_that_diverges_is_refused_in_one_line(tmp_path: Path, learner: str) -> None:
    pytest.importorskip("rsl_rl" if learner == "rsl-rl" else "stable_baselines3", reason=EXTRA)
    with pytest.raises(HandError, match=r"the training diverged in the round after 0 actions: .* below 1e\+30"):
        train(recipe(learner=learner, learning_rate=1e30), tmp_path)
    assert not list(tmp_path.glob("checkpoints/*"))


def test_without_rsl_rl_training_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("torch", reason=EXTRA)
    monkeypatch.setitem(__import__("sys").modules, "rsl_rl", None)
    with pytest.raises(ConfigError, match=r"training needs rsl_rl: pip install 'allegro-twin\[rsl\]'"):
        train(recipe(), tmp_path)


def acts(policy: Path, seen: dict[str, Any]) -> Any:
    return load_policy(policy).policy(seen)


def test_a_training_that_starts_from_a_policy_keeps_it_until_its_value_is_known(tmp_path: Path) -> None:
    pytest.importorskip("rsl_rl", reason=EXTRA)
    given = train(recipe(), tmp_path / "given").policy
    draws = np.random.default_rng(0)
    seen = {name: draws.normal(0.0, 0.3, (5, width)).astype(np.float32)
            for name, width in (("observation", 64), ("achieved_goal", 12), ("desired_goal", 12))}  # fmt: skip
    settled = train(recipe(start=str(given), settle=3), tmp_path / "settled").policy
    # The normalisation takes the few observations of this training in as well.
    np.testing.assert_allclose(acts(settled, seen), acts(given, seen), atol=1e-3)
    assert load_policy(settled).card.note.startswith(f"PPO from {given} on, seed 0, 48 actions")
    on = train(recipe(start=str(given), settle=2), tmp_path / "on").policy
    assert np.abs(acts(on, seen) - acts(given, seen)).max() > 2e-3


def test_a_training_begins_with_next_to_no_action() -> None:
    pytest.importorskip("rsl_rl", reason=EXTRA)
    torch = pytest.importorskip("torch")
    from allegro_twin.learning.environments.tensors import TensorVectorEnv
    from allegro_twin.learning.training.rsl.ppo import PpoLearner

    env = TensorVectorEnv("Rotate", 4, timestep=0.003)
    learner = PpoLearner(recipe(task="Rotate", environment={"timestep": 0.003}), env)
    with torch.inference_mode():
        action = learner.ppo.get_policy()(learner._observation_groups(env.reset()))
    assert 0.0 < action.abs().max() < 0.02


@pytest.mark.slow
def test_a_start_may_see_less_and_has_the_recipes_layers(tmp_path: Path) -> None:
    pytest.importorskip("rsl_rl", reason=EXTRA)
    torch = pytest.importorskip("torch")
    from allegro_twin.learning.environments.tensors import TensorVectorEnv
    from allegro_twin.learning.training.rsl.ppo import PpoLearner

    hand: dict[str, Any] = {"timestep": 0.003, "observation": "hand"}
    given = train(recipe(task="Rotate", environment=hand), tmp_path).policy
    env = TensorVectorEnv("Rotate", 4, timestep=0.003)
    seen = env.reset()
    learner = PpoLearner(recipe(task="Rotate", environment={"timestep": 0.003}, start=str(given)), env)
    with torch.inference_mode():
        theirs = learner.ppo.get_policy()(learner._observation_groups(seen)).clamp(-1.0, 1.0).numpy()
    np.testing.assert_allclose(theirs, load_policy(given).policy(seen[:, :64].numpy()), atol=1e-5)
    with pytest.raises(ConfigError, match="its layers are 64-8-16, and this recipe's 77-9-16"):
        PpoLearner(recipe(task="Rotate", environment={"timestep": 0.003}, start=str(given), hidden=[9]), env)
    fingers = TensorVectorEnv("Rotate", 4, **hand)
    full = train(recipe(task="Rotate", environment={"timestep": 0.003}), tmp_path / "full").policy
    with pytest.raises(ConfigError, match="it sees 77 numbers of observation, here are 64"):
        PpoLearner(recipe(task="Rotate", environment=hand, start=str(full)), fingers)


@pytest.mark.slow
def test_a_policy_of_rotate_begins_reorient_with_the_goal_left_out_at_first(tmp_path: Path) -> None:
    pytest.importorskip("rsl_rl", reason=EXTRA)
    torch = pytest.importorskip("torch")
    from allegro_twin.learning.environments.tensors import TensorVectorEnv
    from allegro_twin.learning.training.onnx_policy import NetworkActor, read_onnx_network, to_onnx
    from allegro_twin.learning.training.rsl.ppo import PpoLearner

    given = train(recipe(task="Rotate", environment={"timestep": 0.003}), tmp_path).policy
    env = TensorVectorEnv("Reorient", 4, timestep=0.003, state=True)
    learner = PpoLearner(recipe(task="Reorient", environment={"timestep": 0.003, "state": True}, start=str(given)), env)
    seen = env.reset()
    with torch.inference_mode():
        theirs = learner.ppo.get_policy()(learner._observation_groups(seen)).clamp(-1.0, 1.0).numpy()
    np.testing.assert_allclose(theirs, load_policy(given).policy(seen["observation"].numpy()), atol=1e-5)
    learner.update()
    to_onnx(learner.layers(), tmp_path / "turned.onnx", env.engine.task.card())
    again = read_onnx_network(tmp_path / "turned.onnx")
    assert again.turns
    assert again.widths == {"observation": 77, "achieved_goal": 4, "desired_goal": 4}
    flat = learner._observation_groups(seen)["policy"]
    with torch.inference_mode():
        theirs = learner.ppo.get_policy()(learner._observation_groups(seen)).clamp(-1.0, 1.0).numpy()
        read = NetworkActor(again)(flat).numpy()
    ours = load_policy(tmp_path / "turned.onnx").policy({name: part.numpy() for name, part in seen.items()})
    np.testing.assert_allclose(ours, theirs, atol=1e-5)
    np.testing.assert_allclose(read, theirs, atol=1e-5)


def test_a_file_that_training_did_not_write_is_no_start(tmp_path: Path) -> None:
    onnx = pytest.importorskip("onnx", reason=EXTRA)
    pytest.importorskip("torch", reason=EXTRA)
    from allegro_twin.learning.training.onnx_policy import read_onnx_network

    seen, given = (onnx.helper.make_tensor_value_info(name, 1, ["batch", 16]) for name in ("observation", "action"))
    nodes = [
        onnx.helper.make_node(kind, [a], [b]) for kind, a, b in (("Relu", seen.name, "x"), ("Tanh", "x", "action"))
    ]
    onnx.save(onnx.helper.make_model(onnx.helper.make_graph(nodes, "other", [seen], [given])), tmp_path / "other.onnx")
    with pytest.raises(ConfigError, match=r"other\.onnx: not a policy that `allegro-twin train` wrote"):
        read_onnx_network(tmp_path / "other.onnx")


@pytest.mark.slow
def test_a_training_goes_on_only_with_what_it_began_with(monkeypatch: pytest.MonkeyPatch) -> None:
    path, mine = Path("runs/x/checkpoints/00001.pt"), recipe()
    was = progress.input_fingerprints(mine)
    assert set(was) == {"engine", "code", "hand allegro_right", "gains of allegro", "objects"}
    progress.check_same_inputs(path, was, progress.input_fingerprints(mine))
    for name, said in (("code", "another code: "), ("hand allegro_right", "another hand allegro_right: ")):
        with pytest.raises(ConfigError, match=f"runs/x is a training with {said}choose another folder"):
            progress.check_same_inputs(path, was | {name: "0"}, progress.input_fingerprints(mine))
    with pytest.raises(ConfigError, match="is a training with another engine, code, hand allegro_right"):
        progress.check_same_inputs(path, {}, progress.input_fingerprints(mine))  # Of before that was kept.
    monkeypatch.setattr(progress, "load_gains", lambda name, spec: 1.0)
    with pytest.raises(ConfigError, match="is a training with another gains of allegro"):
        progress.check_same_inputs(path, was, progress.input_fingerprints(mine))
