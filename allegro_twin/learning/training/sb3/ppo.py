"""PPO of Stable-Baselines3 in rounds, with a checkpoint after each; a killed training continues from the last."""

from __future__ import annotations

import io
import json
import warnings
import zipfile
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.utils import ConstantSchedule, set_random_seed

from allegro_twin.errors import ConfigError
from allegro_twin.files.atomic_write import atomic_file
from allegro_twin.learning.environments.settings import env_keywords
from allegro_twin.learning.environments.vector import HandVectorEnv
from allegro_twin.learning.policy.card import PolicyCard, write_card
from allegro_twin.learning.training.evaluation import evaluate
from allegro_twin.learning.training.logs import TrainingLog
from allegro_twin.learning.training.onnx_policy import to_onnx
from allegro_twin.learning.training.progress import (
    EVALUATION,
    STATE,
    Advance,
    Kept,
    TrainingProgress,
    TrainingResult,
    checked_progress,
    checkpoint_content,
    finite_network,
    goal_distance,
    learning_rate,
    round_length,
    round_seed,
    training_note,
    write_recipe,
)
from allegro_twin.learning.training.sb3.env import Sb3VecEnv
from allegro_twin.learning.training.sb3.network import AsymmetricPolicy, NormalisedFeatures, policy_network
from allegro_twin.learning.training.settings import Recipe


def learn(recipe: Recipe, folder: Path, advance: Advance, kept: Kept) -> TrainingResult:
    """Train in `folder`, or continue what is there. Raises ConfigError for a folder of another training."""
    path = max(folder.glob("checkpoints/*.zip"), default=None)
    progress = TrainingProgress() if path is None else _read(path, recipe)
    kept(progress.steps)
    env = HandVectorEnv(recipe.task, recipe.envs, autoreset_mode="disabled", **env_keywords(recipe.environment))
    card = env.engine.task.card().model_copy(update={"note": f"{recipe.task}: seed {recipe.seed}"})
    stable = Sb3VecEnv(env, scale=recipe.reward_scale)
    # No number may depend on the number of threads.
    torch.set_num_threads(1)
    set_random_seed(recipe.seed)
    model = _model(recipe, stable) if path is None else PPO.load(str(path), env=stable, device="cpu")
    model.set_logger(Logger(None, []))
    rate = float("nan")
    with TrainingLog(recipe, folder, progress.steps) as log:
        while progress.steps < recipe.total:
            watching = TrainingCallback(log, progress.seconds, advance)
            with finite_network(lambda: _weights(model.policy), recipe, progress.steps):
                _round(model, stable, recipe, progress, watching)
            policy = _deterministic(model)
            rate = evaluate(policy, recipe.task, recipe.environment, recipe.trials, seed=EVALUATION).rate
            progress = TrainingProgress(progress.rounds + 1, int(model.num_timesteps), watching.seconds)
            log.add_evaluation(progress.steps, progress.seconds, rate)
            model.logger.dump(progress.steps)  # The next round begins without values of this one.
            _save(model, folder / "checkpoints" / f"{progress.rounds:05d}.zip", recipe, card, progress)
            kept(progress.steps)
    if rate != rate:  # Nothing was left to do.
        rate = evaluate(_deterministic(model), recipe.task, recipe.environment, recipe.trials, seed=EVALUATION).rate
    to_onnx(
        policy_network(model), folder / "policy.onnx", card.model_copy(update={"note": training_note(recipe, progress)})
    )
    write_recipe(folder, recipe)
    stable.close()
    return TrainingResult(folder / "policy.onnx", progress, rate)


def _model(recipe: Recipe, env: Sb3VecEnv) -> Any:
    layers = list(recipe.hidden)
    parts = getattr(env.observation_space, "spaces", {})
    critic = STATE in parts
    chosen = {
        "features_extractor_class": NormalisedFeatures,
        "features_extractor_kwargs": {"turns": env.env.engine.task.goal_is_orientation},
        "share_features_extractor": not critic,
        "net_arch": {"pi": layers, "vf": layers},
        "activation_fn": {"tanh": torch.nn.Tanh, "elu": torch.nn.ELU}[recipe.activation],
        "log_std_init": recipe.log_spread,
    }
    with warnings.catch_warnings():
        # A smaller mini-batch at the end of an update is what the recipe says.
        warnings.filterwarnings("ignore", "You have specified a mini-batch size")
        return PPO(
            AsymmetricPolicy if critic else "MultiInputPolicy" if parts else "MlpPolicy",
            env,
            learning_rate=recipe.learning_rate,
            n_steps=recipe.rollout,
            batch_size=min(recipe.batch, recipe.update),
            n_epochs=recipe.epochs,
            gamma=recipe.discount,
            gae_lambda=recipe.trace,
            clip_range=recipe.clip,
            ent_coef=recipe.entropy,
            policy_kwargs=chosen,
            seed=recipe.seed,
            device="cpu",
        )


def _round(model: Any, env: Sb3VecEnv, recipe: Recipe, progress: TrainingProgress, watching: TrainingCallback) -> None:
    """One round. All its random numbers follow from the recipe's seed and its own number, so a continued training
    equals an uninterrupted one."""
    if (farthest := goal_distance(recipe, progress)) is not None:
        env.env.engine.task.farthest = farthest
    model.lr_schedule = ConstantSchedule(learning_rate(recipe, progress))
    seed = round_seed(recipe.seed, progress.rounds)
    set_random_seed(seed)
    env.seed(seed)
    model._last_obs = None  # So that `learn` begins with new episodes.
    model.learn(round_length(recipe, progress), callback=watching, reset_num_timesteps=False)


_NAMES = {"train/approx_kl": "train/kl", "train/policy_gradient_loss": "train/surrogate_loss"}
_OF_THE_RECIPE = ("train/n_updates", "train/clip_range")


def _losses(model: Any) -> dict[str, float]:
    """What the model has logged of its last update, by the names that all learners have."""
    found = {_NAMES.get(name, name): float(value) for name, value in model.logger.name_to_value.items()
             if name.startswith("train/") and name not in _OF_THE_RECIPE}  # fmt: skip
    if "train/entropy_loss" in found:
        found["train/entropy"] = -found.pop("train/entropy_loss")
    return found


def _weights(policy: Any) -> list[Any]:
    """The policy's parameters, and the spread of its actions with its inverse."""
    return [*policy.parameters(), policy.log_std.exp(), (-policy.log_std).exp()]


def _deterministic(model: Any) -> Any:
    return lambda observation: model.predict(observation, deterministic=True)[0]


class TrainingCallback(BaseCallback):  # type: ignore[misc]  # Stable-Baselines3 is untyped here.
    """Updates the normalisation and writes the curve during one round, which begins `seconds` after the training
    did."""

    def __init__(self, log: TrainingLog, seconds: float, advance: Advance) -> None:
        super().__init__()
        self._log, self._advance = log, advance
        self._began = monotonic() - seconds
        self._episodes: list[tuple[float, int, bool]] = []
        self._seen: Any = None
        self._collected: tuple[int, float, float, float] | None = None
        """Episodes of the rollout that is being learned from."""

    @property
    def seconds(self) -> float:
        """Training time so far, s."""
        return monotonic() - self._began

    def _on_step(self) -> bool:
        infos = self.locals["infos"]
        self._episodes += [(i["episode"]["r"], i["episode"]["l"], i["is_success"]) for i in infos if "episode" in i]
        return True

    def _on_rollout_start(self) -> None:
        """Update the normalisation here only: an observation must mean the same while it is acted on and learned
        from."""
        self._log_update()
        self._learn()

    def _on_rollout_end(self) -> None:
        self._seen = self.model.rollout_buffer.observations
        if not float(self.model.policy.pi_features_extractor.count):
            self._learn()  # Nothing is known yet; the first update is better with it.
        found = np.array(self._episodes, float).mean(axis=0) if self._episodes else np.full(3, np.nan)
        mean, length, share = found.tolist()
        self._collected = (len(self._episodes), mean, length, share)
        self._advance(int(self.num_timesteps), mean, share)
        self._episodes.clear()

    def _on_training_end(self) -> None:
        self._log_update()
        self._learn()

    def _log_update(self) -> None:
        """Write the row of an update, with its own losses, after it."""
        if self._collected is not None:
            values = _losses(self.model) | self.training_env.take_terms()
            self._log.add_update(int(self.num_timesteps), self.seconds, self._collected, values)
            self._collected = None

    def _learn(self) -> None:
        if self._seen is not None:
            policy = self.model.policy
            for front in {policy.pi_features_extractor, policy.vf_features_extractor}:
                front.learn(self._seen)
            self._seen = None


MEMBER = "training.json"


def _save(model: Any, path: Path, recipe: Recipe, card: PolicyCard, progress: TrainingProgress) -> None:
    """Write a checkpoint: the model with its optimiser, the policy's card and the progress, in one file that is whole
    or not there. It is also a policy file for `allegro-twin run --policy`. Raises RecordingError for a full disk."""
    whole = io.BytesIO()  # What PyTorch cannot write, it does not say why.
    model.save(whole)
    with zipfile.ZipFile(whole, "a") as archive:
        archive.writestr(MEMBER, json.dumps(checkpoint_content(recipe, progress)))
    with atomic_file(path) as temporary:
        temporary.write_bytes(whole.getbuffer())
        write_card(temporary, card)


def _read(path: Path, recipe: Recipe) -> TrainingProgress:
    """Read the progress of a checkpoint. Raises ConfigError for one of another version, of another recipe, or none at
    all."""
    try:
        with zipfile.ZipFile(path) as archive:
            content = json.loads(archive.read(MEMBER)) if MEMBER in archive.namelist() else None
    except (zipfile.BadZipFile, json.JSONDecodeError) as error:
        raise ConfigError(f"{path}: not a readable checkpoint: {error}") from error
    if content is None:
        raise ConfigError(f"{path}: no training inside: a policy, but not a checkpoint to continue")
    return checked_progress(path, content, recipe)
