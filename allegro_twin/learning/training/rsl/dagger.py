"""Imitation of a policy that sees more by one that sees what a hand reports (DAgger: Ross, Gordon and Bagnell 2011).

Simulations are driven by the pupil, at first some of them by the teacher; at every state the teacher says what it would
do, and the pupil learns that, from all states of the last updates. A checkpoint has none of these states, for they are
gigabytes: a training that was continued gathers them anew, and is not equal to one that was not.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import torch

from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import find_file
from allegro_twin.learning.environments.tensors import TensorVectorEnv
from allegro_twin.learning.policy.card import Card, read_card
from allegro_twin.learning.tasks import make_task
from allegro_twin.learning.training.evaluation import fitting, keywords
from allegro_twin.learning.training.onnx_policy import Acting, Layered, layers_of
from allegro_twin.learning.training.progress import Advance, Progress, Trained, rate_of
from allegro_twin.learning.training.rsl.rounds import Tally, in_rounds
from allegro_twin.learning.training.settings import Recipe

_LED = 0.25
"""Share of a training in which the teacher drives some simulations: all at its beginning, none at its end."""
_KEPT = 24
"""Updates whose states are learned from."""
_EPS = 1e-2
"""Of a standard deviation: what a number that never changes is divided by."""


class Pupil:
    """Of the numbers that the teacher sees the pupil's are the first: what the hand reports, and its history."""

    def __init__(self, recipe: Recipe, env: TensorVectorEnv, card: Card, teacher: Acting) -> None:
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
        env.spread()
        self._tally = Tally(env)

    def begin(self, progress: Progress) -> None:
        self._done = progress.steps
        for group in self._adam.param_groups:
            group["lr"] = rate_of(self.recipe, progress)

    def update(self) -> dict[str, float]:
        seen, wished = [], []
        for _ in range(self.recipe.rollout):
            mine, wish = self._mine(self._seen), self._wish(self._seen)
            self._learn_scale(mine)
            with torch.no_grad():
                action = self._net(self._scaled(mine)).clamp(-1.0, 1.0)
            led = round(self.env.num_envs * max(1.0 - self._done / (_LED * self.recipe.steps), 0.0))
            action[:led] = wish[:led]
            self._seen, reward, failed, truncated, info = self.env.step(action)
            self._tally.add(reward, failed | truncated, info["is_success"])
            seen.append(mine.clone())
            wished.append(wish)
            self._done += self.env.num_envs
        self._states.append((torch.cat(seen), torch.cat(wished)))
        del self._states[:-_KEPT]
        return {"train/loss": self._imitate(), "train/learning_rate": self._adam.param_groups[0]["lr"]}

    def episodes(self) -> tuple[int, float, float, float]:
        return self._tally.told()

    def layers(self) -> Layered:
        widths = {"observation": self.card.observation}
        return Layered(widths, self._mean.cpu().numpy(), self._scale().cpu().numpy(), None, list(self._net))

    def saved(self) -> Any:
        return {
            "net": self._net.state_dict(),
            "adam": self._adam.state_dict(),
            "mean": self._mean,
            "var": self._var,
        }

    def load(self, content: Any) -> None:
        self._net.load_state_dict(content["net"])
        self._adam.load_state_dict(content["adam"])
        self._mean, self._var = content["mean"], content["var"]

    def _imitate(self) -> float:
        """As many states as an update has, `epochs` times, from all that are kept; the last error."""
        seen, wished = (torch.cat(rows) for rows in zip(*self._states, strict=True))
        recipe = self.recipe
        loss = torch.zeros(())
        for _ in range(recipe.epochs * max(recipe.update // recipe.batch, 1)):
            rows = torch.randint(len(seen), (recipe.batch,), device=self.device)
            error = self._net(self._scaled(seen[rows])) - wished[rows]
            loss = (error * error).sum(dim=-1).mean()
            self._adam.zero_grad()
            loss.backward()
            self._adam.step()
        return float(loss.detach())

    def _mine(self, seen: Any) -> Any:
        return seen[:, : self.card.observation]

    def _wish(self, seen: Any) -> Any:
        """What the teacher would do: it sees this decision's numbers, and what no hand reports."""
        frame = self.card.observation // self.card.history
        told = torch.cat([seen[:, :frame], seen[:, self.card.observation :]], dim=-1)
        with torch.no_grad():
            wish: torch.Tensor = self._teacher(told)
        return wish

    def _learn_scale(self, seen: Any) -> None:
        """Mean and variance of what was seen first; a scale that goes on changing would make the targets move."""
        if self._done < self.recipe.update:
            share = self.env.num_envs / (self._done + self.env.num_envs)
            self._mean = self._mean + share * (seen.mean(dim=0) - self._mean)
            self._var = self._var + share * (seen.var(dim=0) - self._var)

    def _scale(self) -> Any:
        return 1.0 / (self._var.sqrt() + _EPS)

    def _scaled(self, seen: Any) -> Any:
        return (seen - self._mean) * self._scale()


def learn(recipe: Recipe, folder: Path, advance: Advance = lambda steps, mean, rate: None) -> Trained:
    """Train in `folder`, or go on after the last round that is there. Raises ConfigError for a folder of another
    training, and for a teacher that does not see what the pupil does not."""
    assert recipe.teacher is not None
    path = find_file(recipe.teacher, "policy", "conf/policies", ".onnx")
    teacher = Acting(layers_of(path))
    settings = recipe.environment
    full = settings.model_copy(update={"observation": "full"})
    fitting(read_card(path), make_task(recipe.task, full.model_copy(update={"history": 1}), 1, 1).card())
    card = make_task(recipe.task, settings, 1, 1).card()
    if card.privileged:
        raise ConfigError("learner dagger is for policies that see what a hand reports: environment.observation: hand")
    env = TensorVectorEnv(recipe.task, recipe.envs, seed=recipe.seed, **keywords(full))
    return in_rounds(Pupil(recipe, env, card, teacher), recipe, folder, advance)


def _network(recipe: Recipe, card: Card) -> Any:
    kind = {"tanh": torch.nn.Tanh, "elu": torch.nn.ELU}[recipe.activation]
    sizes, layers = (card.observation, *recipe.hidden), []
    for before, after in pairwise(sizes):
        layers += [torch.nn.Linear(before, after), kind()]
    return torch.nn.Sequential(*layers, torch.nn.Linear(sizes[-1], card.action))
