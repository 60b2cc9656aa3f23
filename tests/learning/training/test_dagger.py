"""A policy that sees what a hand reports learns from one that sees more."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.learning.policy.loading import load_policy
from allegro_twin.learning.training import Recipe, train

HAND: dict[str, Any] = {"timestep": 0.003, "decimation": 20, "observation": "hand", "history": 3}


def recipe(**changes: Any) -> Recipe:
    given: dict[str, Any] = {
        "task": "Rotate", "learner": "dagger", "environment": HAND, "envs": 4, "rollout": 4, "steps": 64, "round": 32,
        "batch": 8, "epochs": 1, "hidden": [8], "trials": 1,
    }  # fmt: skip
    return Recipe(**given | changes)


@pytest.fixture(scope="module")
def teacher(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """It says what the middle of the fingers' places and the object's tell it."""
    torch = pytest.importorskip("torch")
    pytest.importorskip("onnx")
    from allegro_twin.learning.environments.settings import EnvSettings
    from allegro_twin.learning.tasks import make_task
    from allegro_twin.learning.training.onnx_policy import PolicyNetwork, to_onnx

    torch.manual_seed(1)
    card = make_task("Rotate", EnvSettings(timestep=0.003, decimation=20), 1, 1).card()
    layer = torch.nn.Linear(card.observation, 16)
    layer.weight.data *= 3.0
    zeros, ones = np.zeros(card.observation, np.float32), np.ones(card.observation, np.float32)
    path = tmp_path_factory.mktemp("teacher") / "teacher.onnx"
    to_onnx(PolicyNetwork({"observation": card.observation}, zeros, ones, None, [layer]), path, card)
    return path


@pytest.mark.slow
def test_it_leaves_a_policy_that_a_real_hand_could_run_and_goes_on(tmp_path: Path, teacher: Path) -> None:
    told: list[int] = []
    trained = train(recipe(teacher=str(teacher)), tmp_path, lambda steps, mean, rate: told.append(steps))
    assert told == [16, 32, 48, 64]
    card = load_policy(trained.policy).card
    assert (card.privileged, card.history) == (0, 3)
    assert card.note.startswith(f"DAgger of {teacher}, seed 0, 64 actions in ")
    assert load_policy(trained.policy).policy(np.zeros((2, card.observation), np.float32)).shape == (2, 16)
    train(recipe(teacher=str(teacher), steps=96), tmp_path, lambda steps, mean, rate: told.append(steps))
    assert told[4:] == [80, 96]


@pytest.mark.slow
def test_it_comes_to_do_what_the_teacher_does_as_far_as_the_hand_shows_it(tmp_path: Path, teacher: Path) -> None:
    torch = pytest.importorskip("torch")
    from allegro_twin.learning.environments.settings import EnvSettings
    from allegro_twin.learning.environments.tensors import TensorVectorEnv
    from allegro_twin.learning.tasks import make_task
    from allegro_twin.learning.training.onnx_policy import NetworkActor, read_onnx_network
    from allegro_twin.learning.training.rsl.dagger import DaggerLearner

    chosen = recipe(
        teacher=str(teacher), envs=32, rollout=8, steps=7680, batch=64, epochs=8, hidden=[64], learning_rate=3e-3
    )
    env = TensorVectorEnv("Rotate", 32, **HAND | {"observation": "full"})
    card = make_task("Rotate", EnvSettings(**HAND), 1, 1).card()
    pupil = DaggerLearner(chosen, env, card, NetworkActor(read_onnx_network(teacher)))

    def apart() -> float:
        with torch.inference_mode():
            mine = pupil._net(pupil._scaled(pupil._inputs(pupil._seen))).clamp(-1, 1)
        return float((mine - pupil._teacher_action(pupil._seen)).pow(2).mean())

    pupil.update()
    before = apart()
    for _ in range(24):
        pupil.update()
    assert len(pupil._states) == 24, "what it keeps has an end"
    assert apart() < 0.7 * before  # Some of what the teacher sees no hand shows.


def test_the_teacher_drives_at_first_and_not_in_the_end(teacher: Path) -> None:
    pytest.importorskip("torch")
    from allegro_twin.learning.environments.settings import EnvSettings
    from allegro_twin.learning.environments.tensors import TensorVectorEnv
    from allegro_twin.learning.tasks import make_task
    from allegro_twin.learning.training.onnx_policy import NetworkActor, read_onnx_network
    from allegro_twin.learning.training.rsl.dagger import DaggerLearner

    env = TensorVectorEnv("Rotate", 4, **HAND | {"observation": "full"})
    card = make_task("Rotate", EnvSettings(**HAND), 1, 1).card()
    pupil = DaggerLearner(recipe(teacher=str(teacher)), env, card, NetworkActor(read_onnx_network(teacher)))
    acted: list[Any] = []
    step = env.step
    env.step = lambda actions: acted.append((actions.clone(), pupil._teacher_action(pupil._seen))) or step(actions)  # type: ignore[method-assign,func-returns-value]
    for _ in range(4):
        pupil.update()
    (first, wish), (last, other) = acted[0], acted[-1]
    assert (first == wish).all()
    assert not (last == other).any(dim=-1).any()


def test_what_cannot_teach_is_refused_in_one_line(tmp_path: Path, teacher: Path) -> None:
    with pytest.raises(ValueError, match="learner dagger and a teacher go together"):
        recipe()
    with pytest.raises(ConfigError, match="the policy has decimation 20, these environments have 10"):
        train(recipe(teacher=str(teacher), environment=HAND | {"decimation": 10}), tmp_path)
    with pytest.raises(ConfigError, match="policies that see what a hand reports: environment.observation: hand"):
        train(recipe(teacher=str(teacher), environment=HAND | {"observation": "full"}), tmp_path)
