"""From a recipe to a trained policy in a folder: rounds of PPO, a checkpoint after each, and on after a kill."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger, TensorBoardOutputFormat
from stable_baselines3.common.utils import ConstantSchedule, set_random_seed

from allegro_twin.errors import ConfigError
from allegro_twin.files.atomic_write import atomic_file
from allegro_twin.learning.environments.vector import HandVectorEnv
from allegro_twin.learning.policy.card import Card, write_card
from allegro_twin.learning.training.evaluation import evaluate, keywords
from allegro_twin.learning.training.onnx_policy import to_onnx
from allegro_twin.learning.training.progress import (
    EVALUATION,
    STATE,
    Advance,
    Curve,
    Progress,
    Trained,
    checked_progress,
    checkpoint_content,
    farthest_of,
    note,
    rate_of,
    round_seed,
)
from allegro_twin.learning.training.sb3.env import StableEnv
from allegro_twin.learning.training.sb3.network import Asymmetric, Normalised, layered
from allegro_twin.learning.training.settings import Recipe


def learn(recipe: Recipe, folder: Path, advance: Advance = lambda steps, mean, rate: None) -> Trained:
    """Train in `folder`, or go on with what is there. Raises ConfigError for a folder of another training."""
    path = max(folder.glob("checkpoints/*.zip"), default=None)
    progress = Progress() if path is None else _read(path, recipe)
    env = HandVectorEnv(recipe.task, recipe.envs, autoreset="disabled", **keywords(recipe.environment))
    card = env.engine.task.card().model_copy(update={"note": f"{recipe.task}: seed {recipe.seed}"})
    stable = StableEnv(env, scale=recipe.reward_scale)
    # No number may depend on how many threads shared the work.
    torch.set_num_threads(1)
    set_random_seed(recipe.seed)
    model = _model(recipe, stable) if path is None else PPO.load(str(path), env=stable, device="cpu")
    model.set_logger(Logger(str(folder), [TensorBoardOutputFormat(str(folder / "tensorboard"))]))
    curve = Curve(folder / "curve.csv", progress.steps)
    rate = float("nan")
    while progress.rounds < recipe.rounds:
        watching = Watching(curve, progress.seconds, advance)
        _round(model, stable, recipe, progress, watching)
        policy = _deterministic(model)
        rate = evaluate(policy, recipe.task, recipe.environment, recipe.trials, seed=EVALUATION).rate
        progress = Progress(progress.rounds + 1, int(model.num_timesteps), watching.seconds)
        curve.add(steps=progress.steps, seconds=progress.seconds, evaluated=rate)
        model.logger.record("evaluation/success_rate", rate)
        model.logger.dump(progress.steps)
        _save(model, folder / "checkpoints" / f"{progress.rounds:05d}.zip", recipe, card, progress)
    if rate != rate:  # Nothing was left to do.
        rate = evaluate(_deterministic(model), recipe.task, recipe.environment, recipe.trials, seed=EVALUATION).rate
    to_onnx(layered(model), folder / "policy.onnx", card.model_copy(update={"note": note(recipe, progress)}))
    with atomic_file(folder / "recipe.json") as temporary:
        temporary.write_text(json.dumps(recipe.model_dump(mode="json"), indent=1))
    stable.close()
    return Trained(folder / "policy.onnx", progress, rate)


def _model(recipe: Recipe, env: StableEnv) -> Any:
    layers = list(recipe.hidden)
    parts = getattr(env.observation_space, "spaces", {})
    critic = STATE in parts
    chosen = {
        "features_extractor_class": Normalised,
        "features_extractor_kwargs": {"turns": env.env.engine.task.turns},
        "share_features_extractor": not critic,
        "net_arch": {"pi": layers, "vf": layers},
        "activation_fn": {"tanh": torch.nn.Tanh, "elu": torch.nn.ELU}[recipe.activation],
        "log_std_init": recipe.log_spread,
    }
    return PPO(
        Asymmetric if critic else "MultiInputPolicy" if parts else "MlpPolicy",
        env,
        learning_rate=recipe.learning_rate,
        n_steps=recipe.rollout,
        batch_size=recipe.batch,
        n_epochs=recipe.epochs,
        gamma=recipe.discount,
        gae_lambda=recipe.trace,
        clip_range=recipe.clip,
        ent_coef=recipe.entropy,
        policy_kwargs=chosen,
        seed=recipe.seed,
        device="cpu",
    )


def _round(model: Any, env: StableEnv, recipe: Recipe, progress: Progress, watching: Watching) -> None:
    """One round. Everything random in it follows from the recipe's seed and its number, so that a training that was
    continued cannot be told from one that was not."""
    if (farthest := farthest_of(recipe, progress)) is not None:
        env.env.engine.task.farthest = farthest
    model.lr_schedule = ConstantSchedule(rate_of(recipe, progress))
    seed = round_seed(recipe.seed, progress.rounds)
    set_random_seed(seed)
    env.seed(seed)
    model._last_obs = None  # So that `learn` begins with new episodes.
    model.learn(recipe.round_steps, callback=watching, reset_num_timesteps=False)


def _deterministic(model: Any) -> Any:
    return lambda observation: model.predict(observation, deterministic=True)[0]


class Watching(BaseCallback):  # type: ignore[misc]  # Stable-Baselines3 is untyped here.
    """For one round of learning that begins `seconds` after the training did."""

    def __init__(self, curve: Curve, seconds: float, advance: Advance) -> None:
        super().__init__()
        self._curve, self._advance = curve, advance
        self._began = monotonic() - seconds
        self._episodes: list[tuple[float, int, bool]] = []
        self._seen: Any = None

    @property
    def seconds(self) -> float:
        """Of training so far."""
        return monotonic() - self._began

    def _on_step(self) -> bool:
        infos = self.locals["infos"]
        self._episodes += [(i["episode"]["r"], i["episode"]["l"], i["is_success"]) for i in infos if "episode" in i]
        return True

    def _on_rollout_start(self) -> None:
        """An observation means the same while it is acted on and while it is learned from, hence only now."""
        self._learn()

    def _on_rollout_end(self) -> None:
        self._seen = self.model.rollout_buffer.observations
        if not float(self.model.policy.pi_features_extractor.count):
            self._learn()  # Nothing is known yet; the first update is better with it.
        found = np.array(self._episodes, float).mean(axis=0) if self._episodes else np.full(3, np.nan)
        values = dict(zip(("return", "length", "success"), found.tolist(), strict=True)) if self._episodes else {}
        steps = int(self.num_timesteps)
        self._curve.add(steps=steps, seconds=self.seconds, episodes=len(self._episodes), **values)
        self._advance(steps, float(found[0]), float(found[2]))
        self._episodes.clear()

    def _on_training_end(self) -> None:
        self._learn()

    def _learn(self) -> None:
        if self._seen is not None:
            policy = self.model.policy
            for front in {policy.pi_features_extractor, policy.vf_features_extractor}:
                front.learn(self._seen)
            self._seen = None


MEMBER = "training.json"


def _save(model: Any, path: Path, recipe: Recipe, card: Card, progress: Progress) -> None:
    """A checkpoint is also a policy file for `allegro-twin run --policy`. Raises RecordingError for a full disk."""
    with atomic_file(path) as temporary:
        model.save(str(temporary))
        with zipfile.ZipFile(temporary, "a") as archive:
            archive.writestr(MEMBER, json.dumps(checkpoint_content(recipe, progress)))
        write_card(temporary, card)


def _read(path: Path, recipe: Recipe) -> Progress:
    """How far a checkpoint is. Raises ConfigError for one of another version, of another recipe, or none at all."""
    try:
        with zipfile.ZipFile(path) as archive:
            content = json.loads(archive.read(MEMBER)) if MEMBER in archive.namelist() else None
    except (zipfile.BadZipFile, json.JSONDecodeError) as error:
        raise ConfigError(f"{path}: not a readable checkpoint: {error}") from error
    if content is None:
        raise ConfigError(f"{path}: no training inside: a policy, but not a checkpoint to continue")
    return checked_progress(path, content, recipe)
