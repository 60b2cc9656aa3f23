"""Trains a network that imitates the script of `ArmPick` from observations alone: DAgger, in rounds.

A round runs its episodes, led by the script or by the network so far, and asks the script in every state. Then the
network learns from all states. It sees no grasp, no approach and nothing of the script's. After every round the folder
has a checkpoint with its states, `policy.onnx` and a row of `curve.csv`.
"""

from __future__ import annotations

import json
import time
import zipfile
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.files.atomic_write import atomic_file
from allegro_twin.files.fingerprints import fingerprint, source_fingerprint
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.learning.policy.interface import Floats
from allegro_twin.learning.training.logs import TrainingLog
from allegro_twin.learning.training.onnx_policy import to_onnx
from allegro_twin.learning.training.progress import (
    EVALUATION,
    TrainingProgress,
    TrainingResult,
    check_same_inputs,
    write_recipe,
)
from allegro_twin.learning.training.regression import ActionRegression
from allegro_twin.pick.card import PickCard
from allegro_twin.pick.env import ArmPick
from allegro_twin.pick.recipe import PickRecipe
from allegro_twin.pick.rollouts import ALWAYS, EpisodeOrder, PickRollouts, evaluate_pick, roll_out
from allegro_twin.sim.model.fingerprint import hand_fingerprint
from allegro_twin.sim.objects.catalogue import object_catalogue

VERSION = 1
"""Version of the trainer. A checkpoint of another version is not continued."""
_FREE = ("envs", "log", "trials")
"""Keys of a recipe that may change while a training goes on."""


class _Data(NamedTuple):
    """States that were learned from, and the script's actions there."""

    observed: Floats
    taught: Floats

    def plus(self, other: _Data) -> _Data:
        """With other states after these."""
        return _Data(*(np.concatenate(columns) for columns in zip(self, other, strict=True)))


def learn(
    recipe: PickRecipe, folder: Path, advance: Callable[[int], None], kept: Callable[[int], None], source: str
) -> TrainingResult:
    """`train_pick`, where the packages are there."""
    env = ArmPick(**recipe.environment.keywords())
    if recipe.held_out:
        try:
            ArmPick(**recipe.environment.keywords() | {"objects": recipe.held_out}).close()
        except ConfigError as error:
            raise ConfigError(f"{source}: held_out: {error}") from error
    env.close()
    learner = ActionRegression(*env.numbers, recipe.hidden, recipe.learning_rate, recipe.seed)
    progress, data = _read(folder, recipe, learner)
    kept(progress.rounds)
    policy, rate = folder / "policy.onnx", float("nan")
    with TrainingLog(recipe, folder, progress.steps) as log:
        while progress.rounds < recipe.rounds:
            if progress.rounds:
                _write_policy(policy, learner, recipe, progress)  # Where a run ended before it was written.
            began = time.monotonic()
            found = _collect(recipe, progress.rounds, policy, env.episodes.limit, advance)
            new = _Data(found.observed, found.taught)
            data = data.plus(new)
            last = progress.rounds == recipe.rounds - 1
            updates = recipe.last_updates if last else recipe.updates
            wrong = learner.learn(*data, updates, recipe.batch, last=last)
            progress = TrainingProgress(
                progress.rounds + 1, len(data.observed), progress.seconds + time.monotonic() - began
            )
            _write(folder, recipe, progress, learner, new)
            kept(progress.rounds)
            mean, length, share = (float(each.mean()) for each in (found.returns, found.lengths, found.success))
            log.add_update(
                progress.steps, progress.seconds, (recipe.episodes, mean, length, share), {"train/action_error": wrong}
            )
        _write_policy(policy, learner, recipe, progress)
        write_recipe(folder, recipe)
        rate = evaluate_pick(recipe.environment, recipe.trials, policy, seed=EVALUATION, processes=recipe.envs).rate
        log.add_evaluation(progress.steps, progress.seconds, rate)
    return TrainingResult(policy, progress, rate)


def _collect(recipe: PickRecipe, number: int, policy: Path, limit: int, advance: Callable[[int], None]) -> PickRollouts:
    """The episodes of a round; `limit` of the decisions in one."""
    seeds = recipe.training_seeds()[number * recipe.episodes : (number + 1) * recipe.episodes]
    orders = []
    for seed in seeds:
        draws = np.random.default_rng([seed, 0])
        if not number or draws.random() < recipe.led:
            orders.append(EpisodeOrder(seed, ALWAYS, recipe.noise))
        else:
            orders.append(EpisodeOrder(seed, int(draws.integers(limit)) * int(draws.integers(2))))
    before = number * recipe.episodes
    return roll_out(
        recipe.environment, orders, policy if number else None, keep=True, processes=recipe.envs,
        progress=lambda done, of: advance(before + done),
    )  # fmt: skip


def _write_policy(path: Path, learner: ActionRegression, recipe: PickRecipe, progress: TrainingProgress) -> None:
    card = PickCard(
        observation=learner.sizes[0], action=learner.sizes[1],
        environment=recipe.environment.keywords(),
        note=f"DAgger of the script, seed {recipe.seed}, {progress.rounds} rounds of {recipe.episodes} episodes, "
             f"{progress.steps} states in {progress.seconds:.0f} s",
    )  # fmt: skip
    to_onnx(learner.network(), path, card)


def _inputs(recipe: PickRecipe) -> dict[str, str]:
    """Fingerprints of a training's inputs beside its recipe."""
    spec = load_spec(recipe.environment.hand, recipe.environment.side)
    return {
        "engine": f"mujoco {version('mujoco')}",
        "code": fingerprint([source_fingerprint(f"allegro_twin.pick.{name}") for name in ("imitation", "env")]),
        f"hand {spec.name}": hand_fingerprint(spec),
        "objects": fingerprint(object_catalogue()),
    }


def _write(folder: Path, recipe: PickRecipe, progress: TrainingProgress, learner: ActionRegression, new: _Data) -> None:
    content = {
        "version": VERSION, "recipe": recipe.model_dump(mode="json"), "made_of": _inputs(recipe),
        "progress": [progress.rounds, progress.steps, progress.seconds],
    }  # fmt: skip
    with atomic_file(_checkpoint(folder, progress.rounds)) as temporary, temporary.open("wb") as file:
        np.savez_compressed(
            file, content=np.frombuffer(json.dumps(content).encode(), np.uint8),
            learner=np.frombuffer(learner.dump(), np.uint8), observed=new.observed, taught=new.taught,
        )  # fmt: skip


def _checkpoint(folder: Path, rounds: int) -> Path:
    return folder / "checkpoints" / f"{rounds:05d}.npz"


def _read(folder: Path, recipe: PickRecipe, learner: ActionRegression) -> tuple[TrainingProgress, _Data]:
    """Load the newest checkpoint, and the states of all. Raises ConfigError."""
    if others := [path.name for path in sorted(folder.glob("checkpoints/[0-9]*")) if path.suffix != ".npz"]:
        raise ConfigError(f"{folder} is a training of another task ({others[0]}): choose another folder")
    newest = max((int(path.stem) for path in folder.glob("checkpoints/[0-9]*.npz")), default=0)
    data, progress = _Data(*(np.zeros((0, size), np.float32) for size in learner.sizes)), TrainingProgress()
    for number in range(1, newest + 1):
        path = _checkpoint(folder, number)
        try:
            with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
                content: dict[str, Any] = json.loads(file["content"].tobytes())
                new, state = _Data(file["observed"], file["taught"]), file["learner"].tobytes()
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
            raise ConfigError(f"{path}: not a readable checkpoint ({error}): choose another folder") from error
        _check_same(path, content, recipe)
        progress, data = TrainingProgress(*content["progress"]), data.plus(new)
        if number == newest:
            learner.load(state)
    return progress, data


def _check_same(path: Path, content: dict[str, Any], recipe: PickRecipe) -> None:
    if content["version"] != VERSION:
        raise ConfigError(f"{path} is a checkpoint of version {content['version']}; this package continues {VERSION}: "
                          "train anew in another folder")  # fmt: skip
    was, now = content["recipe"], recipe.model_dump(mode="json")
    changed = [key for key in sorted(now.keys() | was.keys()) if key not in _FREE and was.get(key) != now.get(key)]
    if changed:
        key = changed[0]
        raise ConfigError(f"{path.parent.parent} is a training with {key} {was.get(key)}, not {now.get(key)}: choose "
                          "another folder")  # fmt: skip
    check_same_inputs(path, content["made_of"], _inputs(recipe))
