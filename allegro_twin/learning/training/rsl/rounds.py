"""A training in rounds, whoever learns: a checkpoint, a policy and the curve after each, and on from the last.

A checkpoint holds the learner, its environments in the middle of their episodes, and the random number generators of
PyTorch, NumPy and Python.
"""

from __future__ import annotations

import json
import pickle
import random
import time
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from torch.utils.tensorboard import SummaryWriter

from allegro_twin.errors import ConfigError
from allegro_twin.files.atomic_write import atomic_file
from allegro_twin.learning.environments.tensors import TensorVectorEnv
from allegro_twin.learning.policy.card import Card
from allegro_twin.learning.policy.loading import load_policy
from allegro_twin.learning.training.evaluation import evaluate
from allegro_twin.learning.training.onnx_policy import Layered, to_onnx
from allegro_twin.learning.training.progress import (
    EVALUATION,
    Advance,
    Curve,
    Progress,
    Trained,
    checked_progress,
    checkpoint_content,
    note,
)
from allegro_twin.learning.training.settings import Recipe


class Learner(Protocol):
    """A policy in training."""

    @property
    def card(self) -> Card:
        """Of the policy."""
        ...

    @property
    def device(self) -> Any:
        """Of its tensors."""
        ...

    def begin(self, progress: Progress) -> None:
        """A round begins."""
        ...

    def update(self) -> dict[str, float]:
        """One rollout of all simulations, and what is learned from it; what TensorBoard should show of that."""
        ...

    def episodes(self) -> tuple[int, float, float, float]:
        """How many have ended since the last call, their mean return and length, and the share of success; NaN where
        none has."""
        ...

    def layers(self) -> Layered:
        """The policy's mean action, as it is written to a file."""
        ...

    def saved(self) -> Any:
        """What `load` takes."""
        ...

    def load(self, content: Any) -> None: ...


def in_rounds(learner: Learner, recipe: Recipe, folder: Path, advance: Advance) -> Trained:
    """Train in `folder`, or go on after the last round that is there. Raises ConfigError for a folder of another
    training."""
    # No number may depend on how many threads shared the work.
    if torch.device(learner.device).type == "cpu":
        torch.set_num_threads(1)
    progress = _read(learner, folder, recipe)
    curve, policy = Curve(folder / "curve.csv", progress.steps), folder / "policy.onnx"
    # What a killed training has written beyond its checkpoint is done again, and hidden.
    with SummaryWriter(str(folder / "tensorboard"), purge_step=progress.steps + 1) as board:
        while progress.rounds < recipe.rounds:
            learner.begin(progress)
            progress = _round(learner, recipe, progress, curve, board, advance)
            _write(learner, folder, recipe, progress)
            to_onnx(learner.layers(), policy, learner.card.model_copy(update={"note": note(recipe, progress)}))
        settings = recipe.environment.model_copy(update={"device": "cpu"})
        rate = evaluate(load_policy(policy).policy, recipe.task, settings, recipe.trials, seed=EVALUATION).rate
        curve.add(steps=progress.steps, seconds=progress.seconds, evaluated=rate)
        board.add_scalar("evaluation/success_rate", rate, progress.steps)
    with atomic_file(folder / "recipe.json") as temporary:
        temporary.write_text(json.dumps(recipe.model_dump(mode="json"), indent=1))
    return Trained(policy, progress, rate)


def _round(
    learner: Learner, recipe: Recipe, progress: Progress, curve: Curve, board: SummaryWriter, advance: Advance
) -> Progress:
    began, steps = time.monotonic() - progress.seconds, progress.steps
    for _ in range(recipe.round_steps // recipe.update):
        shown = learner.update()
        steps += recipe.update
        number, mean, length, share = learner.episodes()
        told = {"return": mean, "length": length, "success": share} if number else {}
        curve.add(steps=steps, seconds=time.monotonic() - began, episodes=number, **told)
        names = {"return": "rollout/ep_rew_mean", "length": "rollout/ep_len_mean", "success": "rollout/success_rate"}
        for name, value in {**shown, **{names[key]: value for key, value in told.items()}}.items():
            board.add_scalar(name, value, steps)
        advance(steps, mean, share)
    return Progress(progress.rounds + 1, steps, time.monotonic() - began)


def _write(learner: Learner, folder: Path, recipe: Recipe, progress: Progress) -> None:
    content = checkpoint_content(recipe, progress) | {"learner": learner.saved(), "random": _generators()}
    with atomic_file(folder / "checkpoints" / f"{progress.rounds:05d}.pt") as temporary:
        torch.save(content, temporary)


def _read(learner: Learner, folder: Path, recipe: Recipe) -> Progress:
    """Take the newest checkpoint over. Raises ConfigError."""
    path = max(folder.glob("checkpoints/*.pt"), default=None)
    if path is None:
        return Progress()
    try:
        content = torch.load(path, map_location=learner.device, weights_only=True)
    except (RuntimeError, pickle.UnpicklingError, EOFError) as error:
        raise ConfigError(f"{path}: not a readable checkpoint: {error}") from error
    progress = checked_progress(path, content, recipe)
    learner.load(content["learner"])
    _seed(content["random"])
    return progress


def _generators() -> dict[str, Any]:
    """The states of all generators that a training can draw from, in what `torch.load` takes without a pickle."""
    kind, keys, place, has_gauss, gauss = np.random.get_state()  # A task of a user's may draw from it.
    version, words, left = random.getstate()
    return {
        "torch": torch.get_rng_state(),
        "cuda": torch.cuda.get_rng_state_all() if torch.cuda.is_available() else [],
        "numpy": (kind, torch.from_numpy(np.asarray(keys, np.int64)), int(place), int(has_gauss), float(gauss)),
        "python": (version, list(words), left),
    }


def _seed(states: dict[str, Any]) -> None:
    """Put the generators where they were; those of GPUs where there are as many."""
    torch.set_rng_state(states["torch"].cpu())
    if torch.cuda.is_available() and len(states["cuda"]) == torch.cuda.device_count():
        torch.cuda.set_rng_state_all([state.cpu() for state in states["cuda"]])
    kind, keys, *rest = states["numpy"]
    np.random.set_state((kind, keys.cpu().numpy().astype(np.uint32), *rest))  # As above.
    version, words, left = states["python"]
    random.setstate((version, tuple(words), left))


class Tally:
    """Sums over episodes, on the device of the simulations."""

    def __init__(self, env: TensorVectorEnv) -> None:
        zeros = env.xp.zeros(env.num_envs)
        self._return, self._length, self._over = zeros, zeros.clone(), zeros.new_zeros(4)

    def add(self, reward: Any, ended: Any, success: Any) -> None:
        """One action of every simulation: (n,) each."""
        self._return += reward
        self._length += 1
        one = ended.float()
        self._over += torch.stack(
            [one.sum(), (one * self._return).sum(), (one * self._length).sum(), (one * success).sum()]
        )
        self._return *= 1.0 - one
        self._length *= 1.0 - one

    def saved(self) -> list[Any]:
        """What `load` takes."""
        return [each.clone() for each in (self._return, self._length, self._over)]

    def load(self, content: list[Any]) -> None:
        for mine, other in zip((self._return, self._length, self._over), content, strict=True):
            mine.copy_(other)

    def told(self) -> tuple[int, float, float, float]:
        """How many have ended since the last call, their mean return and length, and the share of success; NaN where
        none has."""
        number, *sums = self._over.tolist()
        self._over.zero_()
        total, length, good = (each / number if number else float("nan") for each in sums)
        return int(number), total, length, good
