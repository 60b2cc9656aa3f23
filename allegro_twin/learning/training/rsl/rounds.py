"""Training in rounds, for any learner on tensors: after each a checkpoint, a policy file and the curve.

A checkpoint contains the learner, its environments in the middle of their episodes, and the random number generators of
PyTorch, NumPy and Python.
"""

from __future__ import annotations

import io
import pickle
import random
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch

from allegro_twin.errors import ConfigError
from allegro_twin.files.atomic_write import atomic_file
from allegro_twin.learning.environments.tensors import TensorVectorEnv
from allegro_twin.learning.policy.card import PolicyCard
from allegro_twin.learning.policy.loading import load_policy
from allegro_twin.learning.training.evaluation import evaluate
from allegro_twin.learning.training.logs import NO_TERMS, TrainingLog
from allegro_twin.learning.training.onnx_policy import PolicyNetwork, to_onnx
from allegro_twin.learning.training.progress import (
    EVALUATION,
    Advance,
    Kept,
    TrainingProgress,
    TrainingResult,
    checked_progress,
    checkpoint_content,
    finite_network,
    round_length,
    training_note,
    write_recipe,
)
from allegro_twin.learning.training.settings import Recipe


class Learner(Protocol):
    """A policy in training."""

    @property
    def card(self) -> PolicyCard:
        """Card of the policy."""
        ...

    @property
    def device(self) -> Any:
        """Device of the tensors."""
        ...

    def begin(self, progress: TrainingProgress) -> None:
        """Begin a round."""
        ...

    def update(self) -> dict[str, float]:
        """Collect one rollout of all simulations and learn from it. Returns values for the logs."""
        ...

    def episodes(self) -> tuple[int, float, float, float]:
        """Number of episodes that ended since the last call, their mean return and length, and the success rate; NaN
        where none has."""
        ...

    def layers(self) -> PolicyNetwork:
        """The policy's mean action, for a file."""
        ...

    def weights(self) -> Iterable[Any]:
        """The policy's parameters."""
        ...

    def state_dict(self) -> Any:
        """Content for `load`."""
        ...

    def load(self, content: Any) -> None: ...


def train_in_rounds(learner: Learner, recipe: Recipe, folder: Path, advance: Advance, kept: Kept) -> TrainingResult:
    """Train in `folder`, or continue after the last round there. Raises ConfigError for a folder of another
    training."""
    # No number may depend on the number of threads.
    if torch.device(learner.device).type == "cpu":
        torch.set_num_threads(1)
    progress = _read(learner, folder, recipe)
    kept(progress.steps)
    policy = folder / "policy.onnx"
    with TrainingLog(recipe, folder, progress.steps) as log:
        while progress.steps < recipe.total:
            learner.begin(progress)
            with finite_network(learner.weights, recipe, progress.steps):
                progress = _round(learner, recipe, progress, log, advance)
            _write(learner, folder, recipe, progress)
            kept(progress.steps)
            to_onnx(learner.layers(), policy, learner.card.model_copy(update={"note": training_note(recipe, progress)}))
            write_recipe(folder, recipe)
        settings = recipe.environment.model_copy(update={"device": "cpu"})
        rate = evaluate(load_policy(policy).policy, recipe.task, settings, recipe.trials, seed=EVALUATION).rate
        log.add_evaluation(progress.steps, progress.seconds, rate)
    return TrainingResult(policy, progress, rate)


def _round(
    learner: Learner,
    recipe: Recipe,
    progress: TrainingProgress,
    log: TrainingLog,
    advance: Advance,
) -> TrainingProgress:
    began, steps = time.monotonic() - progress.seconds, progress.steps
    for _ in range(round_length(recipe, progress) // recipe.update):
        values = learner.update()
        steps += recipe.update
        episodes = learner.episodes()
        log.add_update(steps, time.monotonic() - began, episodes, values)
        _, mean, _, share = episodes
        advance(steps, mean, share)
    return TrainingProgress(progress.rounds + 1, steps, time.monotonic() - began)


def _write(learner: Learner, folder: Path, recipe: Recipe, progress: TrainingProgress) -> None:
    content = checkpoint_content(recipe, progress) | {"learner": learner.state_dict(), "random": _generators()}
    whole = io.BytesIO()  # What PyTorch cannot write, it does not say why.
    torch.save(content, whole)
    with atomic_file(folder / "checkpoints" / f"{progress.rounds:05d}.pt") as temporary:
        temporary.write_bytes(whole.getbuffer())


def _read(learner: Learner, folder: Path, recipe: Recipe) -> TrainingProgress:
    """Load the newest checkpoint. Raises ConfigError."""
    path = max(folder.glob("checkpoints/*.pt"), default=None)
    if path is None:
        return TrainingProgress()
    try:
        content = torch.load(path, map_location=learner.device, weights_only=True)
    except (RuntimeError, pickle.UnpicklingError, EOFError) as error:
        raise ConfigError(f"{path}: not a readable checkpoint: {error}") from error
    progress = checked_progress(path, content, recipe)
    learner.load(content["learner"])
    _seed(content["random"])
    return progress


def _generators() -> dict[str, Any]:
    """States of all generators that a training can draw from, in a form that `torch.load` reads without pickle."""
    kind, keys, place, has_gauss, gauss = np.random.get_state()  # A user's task may draw from it.
    version, numbers, left = random.getstate()
    return {
        "torch": torch.get_rng_state(),
        "cuda": torch.cuda.get_rng_state_all() if torch.cuda.is_available() else [],
        "numpy": (kind, torch.from_numpy(np.asarray(keys, np.int64)), int(place), int(has_gauss), float(gauss)),
        "python": (version, list(numbers), left),
    }


def _seed(states: dict[str, Any]) -> None:
    """Restore the generators; those of GPUs where there are as many."""
    torch.set_rng_state(states["torch"].cpu())
    if torch.cuda.is_available() and len(states["cuda"]) == torch.cuda.device_count():
        torch.cuda.set_rng_state_all([state.cpu() for state in states["cuda"]])
    kind, keys, *rest = states["numpy"]
    np.random.set_state((kind, keys.cpu().numpy().astype(np.uint32), *rest))  # As above.
    version, numbers, left = states["python"]
    random.setstate((version, tuple(numbers), left))


class EpisodeStatistics:
    """Sums over episodes and of the task's terms, on the device of the simulations."""

    def __init__(self, env: TensorVectorEnv) -> None:
        self._terms: dict[str, Any] = {}
        self._actions = 0
        zeros = env.xp.zeros(env.num_envs)
        self._return, self._length, self._over = zeros, zeros.clone(), zeros.new_zeros(4)

    def add(self, reward: Any, ended: Any, info: dict[str, Any]) -> None:
        """Add one action of every simulation: (n,) each. `info`: of the step, with `is_success` and the terms."""
        success = info["is_success"]
        for name, value in info.items():
            if name not in NO_TERMS:
                mean = value.float().mean()
                self._terms[name] = self._terms[name] + mean if name in self._terms else mean
        self._actions += 1
        self._return += reward
        self._length += 1
        one = ended.float()
        self._over += torch.stack(
            [one.sum(), (one * self._return).sum(), (one * self._length).sum(), (one * success).sum()]
        )
        self._return *= 1.0 - one
        self._length *= 1.0 - one

    def take_terms(self) -> dict[str, float]:
        """Means over the actions since the last call of the task's terms, by their names in the logs."""
        found = {f"terms/{name}": float(total) / self._actions for name, total in self._terms.items()}
        self._terms.clear()
        self._actions = 0
        return found

    def state_dict(self) -> list[Any]:
        """Content for `load`."""
        return [each.clone() for each in (self._return, self._length, self._over)]

    def load(self, content: list[Any]) -> None:
        for mine, other in zip((self._return, self._length, self._over), content, strict=True):
            mine.copy_(other)

    def take_means(self) -> tuple[int, float, float, float]:
        """Number of episodes that ended since the last call, their mean return and length, and the success rate; NaN
        where none has."""
        number, *sums = self._over.tolist()
        self._over.zero_()
        total, length, good = (each / number if number else float("nan") for each in sums)
        return int(number), total, length, good
