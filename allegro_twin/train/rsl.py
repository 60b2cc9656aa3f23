"""PPO of rsl-rl (Schulman et al. 2017, as Rudin et al. 2022 run it for thousands of robots), where the simulations are.

On a Warp device nothing leaves it but a count and what is printed. Rounds and files are those of the other learner; two
runs on a GPU are not equal.
"""

from __future__ import annotations

import json
import pickle
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from rsl_rl.algorithms import PPO
from rsl_rl.models import MLPModel
from rsl_rl.storage import RolloutStorage
from tensordict import TensorDict

from allegro_twin.errors import ConfigError
from allegro_twin.files.whole import whole_file
from allegro_twin.gym.settings import EnvSettings
from allegro_twin.gym.tensors import TensorVectorEnv
from allegro_twin.policy.loading import load_policy
from allegro_twin.train.checkpoint import VERSION, Progress, same_training
from allegro_twin.train.curve import Curve
from allegro_twin.train.evaluation import evaluate, keywords
from allegro_twin.train.export import Layered, to_onnx
from allegro_twin.train.learned import ACHIEVED, EVALUATION, GOAL, STATE, Advance, Trained, farthest_of, note, rate_of
from allegro_twin.train.settings import Recipe

SEEN, ALL = "policy", "critic"
"""Groups of an observation: what the policy sees, and what the critic sees."""


class Learner:
    """A policy and a value in training on an environment's device."""

    def __init__(self, recipe: Recipe, env: TensorVectorEnv) -> None:
        self.recipe, self.env, self.device = recipe, env, env.xp.device
        torch.manual_seed(recipe.seed)
        self.widths = _widths(env.single_observation_space)
        self._seen = self._grouped(env.reset())
        groups = {"actor": [SEEN], "critic": [ALL if ALL in self._seen.keys() else SEEN]}  # noqa: SIM118  # TensorDict.
        joints = env.engine.task.spec.n_joints
        shared: dict[str, Any] = {
            "hidden_dims": list(recipe.hidden),
            "activation": recipe.activation,
            "obs_normalization": True,
        }
        spread = {"class_name": "GaussianDistribution", "init_std": float(np.exp(recipe.log_spread)), "std_type": "log"}
        actor = MLPModel(self._seen, groups, "actor", joints, distribution_cfg=spread, **shared)
        critic = MLPModel(self._seen, groups, "critic", 1, **shared)
        storage = RolloutStorage("rl", env.num_envs, recipe.rollout, self._seen, [joints], str(self.device))
        self.ppo = PPO(
            actor.to(self.device),
            critic.to(self.device),
            storage,
            num_learning_epochs=recipe.epochs,
            num_mini_batches=max(recipe.update // recipe.batch, 1),
            clip_param=recipe.clip,
            gamma=recipe.discount,
            lam=recipe.trace,
            entropy_coef=recipe.entropy,
            learning_rate=recipe.learning_rate,
            schedule="fixed" if recipe.desired_kl is None else "adaptive",
            desired_kl=recipe.desired_kl or 0.01,
            device=str(self.device),
        )
        self.ppo.train_mode()
        env.spread()
        zeros = env.xp.zeros(env.num_envs)
        self._return, self._length, self._over = zeros, zeros.clone(), zeros.new_zeros(4)

    def rate(self, value: float) -> None:
        """Learn at this rate from now on."""
        self.ppo.learning_rate = value
        for group in self.ppo.optimizer.param_groups:
            group["lr"] = value

    def update(self) -> None:
        """One rollout of all simulations, and what is learned from it."""
        env, scale = self.env, self.recipe.reward_scale
        with torch.inference_mode():
            for _ in range(self.recipe.rollout):
                actions = self.ppo.act(self._seen)
                seen, reward, failed, truncated, info = env.step(actions)
                self._seen, ended = self._grouped(seen), failed | truncated
                more = {"time_outs": truncated & ~failed}
                self.ppo.process_env_step(self._seen, (scale * reward).float(), ended.float(), more)
                self._count(reward, ended, info["is_success"])
            self.ppo.compute_returns(self._seen)
        self.ppo.update()

    def episodes(self) -> tuple[int, float, float, float]:
        """How many have ended since the last call, their mean return and length, and the share of success; NaN where
        none has."""
        number, *sums = self._over.tolist()
        self._over.zero_()
        total, length, good = (each / number if number else float("nan") for each in sums)
        return int(number), total, length, good

    def layers(self) -> Layered:
        """The policy's mean action, as it is written to a file."""
        actor = self.ppo.get_policy()
        normal = actor.obs_normalizer
        scale = 1.0 / (normal.std + normal.eps)
        return Layered(self.widths, normal.mean.cpu().numpy(), scale.cpu().numpy(), None, list(actor.mlp))

    def _grouped(self, seen: Any) -> TensorDict:
        """Flat, in the order that exported policies have."""
        parts = seen if isinstance(seen, dict) else {"observation": seen}
        flat = [parts[name] for name in self.widths] if isinstance(seen, dict) else [seen]
        if GOAL in parts:
            flat.append(parts[GOAL] - parts[ACHIEVED])
        groups = {SEEN: torch.cat(flat, dim=-1)}
        if STATE in parts:
            groups[ALL] = torch.cat([groups[SEEN], parts[STATE]], dim=-1)
        return TensorDict(groups, batch_size=[self.env.num_envs])

    def _count(self, reward: Any, ended: Any, success: Any) -> None:
        self._return += reward
        self._length += 1
        one = ended.float()
        self._over += torch.stack(
            [one.sum(), (one * self._return).sum(), (one * self._length).sum(), (one * success).sum()]
        )
        self._return *= 1.0 - one
        self._length *= 1.0 - one


def learn(recipe: Recipe, folder: Path, advance: Advance = lambda steps, mean, rate: None) -> Trained:
    """Train in `folder`, or go on after the last round that is there. Raises ConfigError for a folder of another
    training."""
    env = TensorVectorEnv(recipe.task, recipe.envs, seed=recipe.seed, **keywords(recipe.environment))
    card = env.engine.task.card()
    learner = Learner(recipe, env)
    progress = _read(learner, folder, recipe)
    curve, policy = Curve(folder / "curve.csv", progress.steps), folder / "policy.onnx"
    while progress.rounds < recipe.rounds:
        if (farthest := farthest_of(recipe, progress)) is not None:
            env.engine.task.farthest = farthest
        if recipe.desired_kl is None:
            learner.rate(rate_of(recipe, progress))
        progress = _round(learner, recipe, progress, curve, advance)
        _write(learner, folder, recipe, progress)
        to_onnx(learner.layers(), policy, card.model_copy(update={"note": note(recipe, progress)}))
    settings = EnvSettings(**keywords(recipe.environment) | {"device": "cpu"})
    rate = evaluate(load_policy(policy).policy, recipe.task, settings, recipe.trials, seed=EVALUATION).rate
    curve.add(steps=progress.steps, seconds=progress.seconds, evaluated=rate)
    with whole_file(folder / "recipe.json") as temporary:
        temporary.write_text(json.dumps(recipe.model_dump(mode="json"), indent=1))
    return Trained(policy, progress, rate)


def _round(learner: Learner, recipe: Recipe, progress: Progress, curve: Curve, advance: Advance) -> Progress:
    began, steps = time.monotonic() - progress.seconds, progress.steps
    for _ in range(recipe.round_steps // recipe.update):
        learner.update()
        steps += recipe.update
        number, mean, length, share = learner.episodes()
        told = {"return": mean, "length": length, "success": share} if number else {}
        curve.add(steps=steps, seconds=time.monotonic() - began, episodes=number, **told)
        advance(steps, mean, share)
    return Progress(progress.rounds + 1, steps, time.monotonic() - began)


def _write(learner: Learner, folder: Path, recipe: Recipe, progress: Progress) -> None:
    content = {
        "version": VERSION,
        "recipe": recipe.model_dump(mode="json"),
        "progress": asdict(progress),
        "learner": learner.ppo.save(),
    }
    with whole_file(folder / "checkpoints" / f"{progress.rounds:05d}.pt") as temporary:
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
    if content["version"] != VERSION:
        raise ConfigError(f"{path} is of version {content['version']}; this package continues {VERSION}")
    same_training(path, content["recipe"], recipe)
    learner.ppo.load(content["learner"], None, strict=True)
    return Progress(**content["progress"])


def _widths(space: spaces.Space[Any]) -> dict[str, int]:
    """The inputs of a policy, in the order that they have there."""
    if not isinstance(space, spaces.Dict):
        return {"observation": spaces.flatdim(space)}
    return {name: spaces.flatdim(part) for name, part in space.items() if name != STATE}
