"""DAgger (Ross, Gordon and Bagnell 2011): a policy that sees what a hand reports imitates one that sees more.

The learner drives the simulations; at first the teacher drives some of them. In every state the teacher gives its
action, and the learner learns these from all states of the last updates. A checkpoint does not contain the states,
which are gigabytes: a continued training collects them anew, and differs from an uninterrupted one.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path
from typing import Any

import torch

from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import find_file
from allegro_twin.learning.environments.settings import env_keywords
from allegro_twin.learning.environments.tensors import TensorVectorEnv
from allegro_twin.learning.policy.card import PolicyCard, check_card, read_card
from allegro_twin.learning.tasks import make_task
from allegro_twin.learning.training.onnx_policy import NetworkActor, PolicyNetwork, read_onnx_network
from allegro_twin.learning.training.progress import Advance, Kept, TrainingProgress, TrainingResult, learning_rate
from allegro_twin.learning.training.rsl.rounds import EpisodeStatistics, train_in_rounds
from allegro_twin.learning.training.settings import Recipe

_LED = 0.25
"""Share of a training in which the teacher drives simulations: all at its beginning, none at its end."""
_KEPT = 24
"""Updates whose states are used."""
_EPS = 1e-2
"""Added to a standard deviation, for numbers that never change."""


class DaggerLearner:
    """The learner's numbers are the first of the teacher's: what the hand reports, and its history."""

    def __init__(self, recipe: Recipe, env: TensorVectorEnv, card: PolicyCard, teacher: NetworkActor) -> None:
        self.recipe, self.env, self.card = recipe, env, card
        self.device = env.xp.device
        self._teacher = teacher.to(self.device)
        torch.manual_seed(recipe.seed)
        self._net = _network(recipe, card)
        self._net.to(self.device)
        self._mean = torch.zeros(card.observation, device=self.device)
        self._var = torch.ones(card.observation, device=self.device)
        self._adam = torch.optim.Adam(self._net.parameters(), lr=recipe.learning_rate)
        self._states: list[tuple[Any, Any]] = []
        self._led, self._done = 1.0, 0
        self._seen = env.reset()
        env.stagger_episodes()
        self._statistics = EpisodeStatistics(env)

    def begin(self, progress: TrainingProgress) -> None:
        self._done = progress.steps
        for group in self._adam.param_groups:
            group["lr"] = learning_rate(self.recipe, progress)

    def update(self) -> dict[str, float]:
        observations, actions = [], []
        for _ in range(self.recipe.rollout):
            own, teachers = self._inputs(self._seen), self._teacher_action(self._seen)
            self._learn_scale(own)
            with torch.no_grad():
                action = self._net(self._scaled(own)).clamp(-1.0, 1.0)
            teacher_rows = round(self.env.num_envs * max(1.0 - self._done / (_LED * self.recipe.steps), 0.0))
            action[:teacher_rows] = teachers[:teacher_rows]
            self._seen, reward, failed, truncated, info = self.env.step(action)
            self._statistics.add(reward, failed | truncated, info)
            observations.append(own.clone())
            actions.append(teachers)
            self._done += self.env.num_envs
        self._states.append((torch.cat(observations), torch.cat(actions)))
        del self._states[:-_KEPT]
        values = {"train/loss": self._imitate(), "train/learning_rate": self._adam.param_groups[0]["lr"]}
        return values | self._statistics.take_terms()

    def episodes(self) -> tuple[int, float, float, float]:
        return self._statistics.take_means()

    def layers(self) -> PolicyNetwork:
        widths = {"observation": self.card.observation}
        return PolicyNetwork(widths, self._mean.cpu().numpy(), self._scale().cpu().numpy(), None, list(self._net))

    def weights(self) -> Iterable[Any]:
        found: Iterable[Any] = self._net.parameters()
        return found

    def state_dict(self) -> Any:
        return {"net": self._net.state_dict(), "adam": self._adam.state_dict(), "mean": self._mean, "var": self._var}

    def load(self, content: Any) -> None:
        self._net.load_state_dict(content["net"])
        self._adam.load_state_dict(content["adam"])
        self._mean, self._var = content["mean"], content["var"]

    def _imitate(self) -> float:
        """Learn from as many states as an update has, `epochs` times, drawn from all that are kept. Returns the last
        error."""
        observations, actions = (torch.cat(rows) for rows in zip(*self._states, strict=True))
        recipe = self.recipe
        loss = torch.zeros(())
        for _ in range(recipe.epochs * max(recipe.update // recipe.batch, 1)):
            rows = torch.randint(len(observations), (recipe.batch,), device=self.device)
            error = self._net(self._scaled(observations[rows])) - actions[rows]
            loss = (error * error).sum(dim=-1).mean()
            self._adam.zero_grad()
            loss.backward()
            self._adam.step()
        return float(loss.detach())

    def _inputs(self, seen: Any) -> Any:
        return seen[:, : self.card.observation]

    def _teacher_action(self, seen: Any) -> Any:
        """The teacher's action, from this decision's numbers and what no hand reports."""
        frame = self.card.observation // self.card.history
        inputs = torch.cat([seen[:, :frame], seen[:, self.card.observation :]], dim=-1)
        with torch.no_grad():
            action: torch.Tensor = self._teacher(inputs)
        return action

    def _learn_scale(self, seen: Any) -> None:
        """Mean and variance of the first observations; a scale that keeps changing would make the targets move."""
        if self._done < self.recipe.update:
            share = self.env.num_envs / (self._done + self.env.num_envs)
            self._mean = self._mean + share * (seen.mean(dim=0) - self._mean)
            self._var = self._var + share * (seen.var(dim=0) - self._var)

    def _scale(self) -> Any:
        return 1.0 / (self._var.sqrt() + _EPS)

    def _scaled(self, seen: Any) -> Any:
        return (seen - self._mean) * self._scale()


def learn(recipe: Recipe, folder: Path, advance: Advance, kept: Kept) -> TrainingResult:
    """Train in `folder`, or continue after the last round there. Raises ConfigError for a folder of another training,
    and for a teacher that sees no more than the learner."""
    assert recipe.teacher is not None
    path = find_file(recipe.teacher, "policy", "conf/policies", ".onnx")
    teacher = NetworkActor(read_onnx_network(path))
    settings = recipe.environment
    full = settings.model_copy(update={"observation": "full"})
    check_card(read_card(path), make_task(recipe.task, full.model_copy(update={"history": 1}), 1, 1).card())
    card = make_task(recipe.task, settings, 1, 1).card()
    if card.privileged:
        raise ConfigError("learner dagger is for policies that see what a hand reports: environment.observation: hand")
    env = TensorVectorEnv(recipe.task, recipe.envs, seed=recipe.seed, **env_keywords(full))
    return train_in_rounds(DaggerLearner(recipe, env, card, teacher), recipe, folder, advance, kept)


def _network(recipe: Recipe, card: PolicyCard) -> Any:
    kind = {"tanh": torch.nn.Tanh, "elu": torch.nn.ELU}[recipe.activation]
    sizes, layers = (card.observation, *recipe.hidden), []
    for before, after in pairwise(sizes):
        layers += [torch.nn.Linear(before, after), kind()]
    return torch.nn.Sequential(*layers, torch.nn.Linear(sizes[-1], card.action))
