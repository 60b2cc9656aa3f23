"""PPO of rsl-rl (Schulman et al. 2017, as Rudin et al. 2022 run it for thousands of robots), on the simulations'
device.

On a Warp device only counts and printed values leave it. On processors a continued training equals an uninterrupted
one, to the bit: episodes continue where they were. On a Warp device, and where the device changes, episodes begin anew,
and two runs differ.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from itertools import accumulate
from pathlib import Path
from typing import Any

import torch
from gymnasium import spaces
from rsl_rl.algorithms import PPO
from rsl_rl.models import MLPModel
from rsl_rl.storage import RolloutStorage
from tensordict import TensorDict

from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import find_file
from allegro_twin.learning.environments.settings import env_keywords
from allegro_twin.learning.environments.tensors import TensorVectorEnv
from allegro_twin.learning.policy.card import PolicyCard
from allegro_twin.learning.training.goal_features import goal_difference, goal_difference_width
from allegro_twin.learning.training.onnx_policy import PolicyNetwork, read_onnx_network
from allegro_twin.learning.training.progress import (
    ACHIEVED,
    GOAL,
    STATE,
    Advance,
    Kept,
    TrainingProgress,
    TrainingResult,
    goal_distance,
    learning_rate,
)
from allegro_twin.learning.training.rsl.rounds import EpisodeStatistics, train_in_rounds
from allegro_twin.learning.training.settings import Recipe

STILL = 0.01
"""Factor on a policy's last weights at the beginning (Andrychowicz et al. 2021, "What matters in on-policy RL")."""
KNOWN = 1_000_000
"""Number of observations that the normalisation of a given policy counts as."""
_LEFT = "left"

SEEN, ALL = "policy", "critic"
"""Groups of an observation: inputs of the policy, and of the critic."""


class PpoLearner:
    """A policy and a value function in training on an environment's device."""

    def __init__(self, recipe: Recipe, env: TensorVectorEnv) -> None:
        self.recipe, self.env, self.device = recipe, env, env.xp.device
        torch.manual_seed(recipe.seed)
        self.widths, self._turns = _widths(env.single_observation_space), env.engine.task.goal_is_orientation
        self._seen = self._observation_groups(env.reset())
        groups = {"actor": [SEEN], "critic": [ALL if ALL in self._seen.keys() else SEEN]}  # noqa: SIM118  # TensorDict.
        joints = env.engine.task.spec.n_joints
        shared: dict[str, Any] = {
            "hidden_dims": list(recipe.hidden),
            "activation": recipe.activation,
            "obs_normalization": True,
        }
        spread = {"class_name": "GaussianDistribution", "init_std": math.exp(recipe.log_spread), "std_type": "log"}
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
        self._settling = recipe.settle
        shrink_last_layer(actor)
        if recipe.start is not None:
            start_from_policy(actor, find_file(recipe.start, "policy", "conf/policies", ".onnx"), self.widths)
        env.stagger_episodes()
        self._statistics = EpisodeStatistics(env)

    @property
    def card(self) -> PolicyCard:
        return self.env.engine.task.card()

    def begin(self, progress: TrainingProgress) -> None:
        if (farthest := goal_distance(self.recipe, progress)) is not None:
            self.env.engine.task.farthest = farthest
        if self.recipe.desired_kl is None:
            self._learn_at(learning_rate(self.recipe, progress))

    def state_dict(self) -> Any:
        more = {"settling": self._settling, "seen": self._seen.to_dict(), "episodes": self.env.state_dict()}
        return self.ppo.save() | more | {"tally": self._statistics.state_dict()}

    def load(self, content: Any) -> None:
        self._settling = content["settling"]
        self.ppo.load(content, None, strict=True)
        if self.env.load(content["episodes"]):
            self._seen = TensorDict(content["seen"], batch_size=[self.env.num_envs])
            self._statistics.load(content["tally"])

    def update(self) -> dict[str, float]:
        env, scale = self.env, self.recipe.reward_scale
        with torch.inference_mode():
            for _ in range(self.recipe.rollout):
                actions = self.ppo.act(self._seen)
                seen, reward, failed, truncated, info = env.step(actions)
                self._seen, ended = self._observation_groups(seen), failed | truncated
                more = {"time_outs": truncated & ~failed}
                self.ppo.process_env_step(self._seen, (scale * reward).float(), ended.float(), more)
                self._statistics.add(reward, ended, info)
            self.ppo.compute_returns(self._seen)
        with self._fixed_policy():
            losses = self.ppo.update()
        named = {f"train/{name}_loss" if name != "entropy" else "train/entropy": float(value)
                 for name, value in losses.items()}  # fmt: skip
        return named | {
            "train/learning_rate": self.ppo.learning_rate,
            "train/std": float(self.ppo.get_policy().output_std.detach().mean()),
            "train/kl": self._change(),
            **self._statistics.take_terms(),
        }

    def episodes(self) -> tuple[int, float, float, float]:
        return self._statistics.take_means()

    def layers(self) -> PolicyNetwork:
        """The policy's mean action, for a file."""
        actor = self.ppo.get_policy()
        normal = actor.obs_normalizer
        scale = 1.0 / (normal.std + normal.eps)
        mean, scale = normal.mean.cpu().numpy(), scale.cpu().numpy()
        return PolicyNetwork(self.widths, mean, scale, None, list(actor.mlp), self._turns)

    def weights(self) -> Iterable[Any]:
        found: Iterable[Any] = self.ppo.get_policy().parameters()
        return found

    def _change(self) -> float:
        """KL divergence of the policy before an update from that after it, mean over the update's observations; it has
        drawn no random number."""
        storage, actor = self.ppo.storage, self.ppo.get_policy()
        with torch.inference_mode():
            mean = actor(storage.observations.flatten(0, 1))
            before = tuple(each.flatten(0, 1) for each in storage.distribution_params)
            actor.distribution.update(mean)
            return float(actor.get_kl_divergence(before, actor.output_distribution_params).mean())

    @contextmanager
    def _fixed_policy(self) -> Iterator[None]:
        """Keep the policy fixed while the value function of a given policy is still random: it would spoil the policy
        in a few updates."""
        if not self._settling:
            yield
            return
        ppo, actor = self.ppo, self.ppo.actor
        schedule, ppo.schedule = ppo.schedule, "fixed"
        actor.requires_grad_(False)
        try:
            yield
        finally:
            actor.requires_grad_(True)
            ppo.schedule = schedule
            self._settling -= 1

    def _learn_at(self, rate: float) -> None:
        self.ppo.learning_rate = rate
        for group in self.ppo.optimizer.param_groups:
            group["lr"] = rate

    def _observation_groups(self, seen: Any) -> TensorDict:
        """Concatenate parts in the order of exported policies."""
        parts = seen if isinstance(seen, dict) else {"observation": seen}
        flat = [parts[name] for name in self.widths] if isinstance(seen, dict) else [seen]
        if GOAL in parts:
            flat.append(goal_difference(parts[GOAL], parts[ACHIEVED], self._turns))
        groups = {SEEN: torch.cat(flat, dim=-1)}
        if STATE in parts:
            groups[ALL] = torch.cat([groups[SEEN], parts[STATE]], dim=-1)
        return TensorDict(groups, batch_size=[self.env.num_envs])


def learn(recipe: Recipe, folder: Path, advance: Advance, kept: Kept) -> TrainingResult:
    """Train in `folder`, or continue after the last round there. Raises ConfigError for a folder of another
    training."""
    env = TensorVectorEnv(recipe.task, recipe.envs, seed=recipe.seed, **env_keywords(recipe.environment))
    return train_in_rounds(PpoLearner(recipe, env), recipe, folder, advance, kept)


def _widths(space: spaces.Space[Any]) -> dict[str, int]:
    """Inputs of a policy and their widths, in order."""
    if not isinstance(space, spaces.Dict):
        return {"observation": spaces.flatdim(space)}
    return {name: spaces.flatdim(part) for name, part in space.items() if name != STATE}


def shrink_last_layer(actor: Any) -> None:
    """Make an actor of rsl-rl start near zero action: the task's own script is a better beginning than chance."""
    with torch.no_grad():
        for each in actor.mlp[-1].parameters():
            each.mul_(STILL)


def start_from_policy(actor: Any, path: Path, widths: dict[str, int]) -> None:
    """Copy a policy into an actor of rsl-rl with inputs of these `widths`: by name, and of each the first numbers.
    Inputs that the policy does not have get zero weights. Raises ConfigError for other layers, or inputs that the actor
    does not have."""
    given = read_onnx_network(path)
    theirs = [layer for layer in given.layers if isinstance(layer, torch.nn.Linear)]
    mine = [layer for layer in actor.mlp if isinstance(layer, torch.nn.Linear)]
    if given.bound is not None or [layer.weight.shape[0] for layer in mine] != [len(layer.weight) for layer in theirs]:
        raise ConfigError(f"start {path}: its layers are {_sizes(theirs)}, and this recipe's {_sizes(mine)}")
    columns = _columns(path, given.widths, given.turns, widths)
    normal = actor.obs_normalizer
    with torch.no_grad():
        for layer, other in zip(mine, theirs, strict=True):
            layer.bias.copy_(other.bias)
            if layer is not mine[0]:
                layer.weight.copy_(other.weight)
        mine[0].weight.zero_()
        mine[0].weight[:, columns] = theirs[0].weight.to(mine[0].weight)
        deviation = 1.0 / torch.as_tensor(given.scale).to(normal._std) - normal.eps
        normal._mean[0, columns] = torch.as_tensor(given.mean).to(normal._mean)
        normal._std[0, columns] = deviation
        normal._var[0, columns] = deviation**2
        normal.count.fill_(KNOWN)


def _columns(path: Path, theirs: dict[str, int], turns: bool, mine: dict[str, int]) -> list[int]:
    """Places of the policy's inputs among the actor's."""
    given, wanted = (dict(widths) for widths in (theirs, mine))
    for widths in (given, wanted):
        if GOAL in widths and ACHIEVED in widths:
            widths[_LEFT] = goal_difference_width(widths[GOAL], turns)
    firsts = dict(zip(wanted, accumulate(wanted.values(), initial=0), strict=False))
    more = [name for name, width in given.items() if width > wanted.get(name, 0)]
    if more:
        raise ConfigError(
            f"start {path}: it sees {given[more[0]]} numbers of {more[0]}, here are {wanted.get(more[0], 0)}"
        )
    return [firsts[name] + k for name, width in given.items() for k in range(width)]


def _sizes(layers: list[torch.nn.Linear]) -> str:
    return "-".join(str(width) for width in (layers[0].in_features, *(layer.out_features for layer in layers)))
