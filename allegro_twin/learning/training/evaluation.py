"""Evaluates policies: whole episodes side by side, the same ones for every policy."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from allegro_twin.errors import ConfigError
from allegro_twin.learning.environments.settings import EnvSettings, env_keywords
from allegro_twin.learning.environments.vector import HandVectorEnv
from allegro_twin.learning.policy.controller import Policy


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation:
    """Results of an evaluation, one row per episode."""

    success: NDArray[np.bool_]
    returns: NDArray[np.float64]
    """Sum of the rewards."""
    objects: tuple[str, ...]
    """The object of each episode; empty where a task has none."""
    counts: NDArray[np.float64] | None = None
    """Final values of the task's `count_term`, where its outcomes have one: rad turned, goals reached."""
    shares: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    """Shares of each episode's time, by name, where the task's outcomes have such terms: `on_palm`."""

    @property
    def rate(self) -> float:
        return float(self.success.mean())

    @property
    def error(self) -> float:
        """Standard error of the rate."""
        return math.sqrt(self.rate * (1.0 - self.rate) / len(self.success))

    def by_object(self) -> dict[str, tuple[int, int]]:
        """Successes and episodes of every object."""
        names = np.array(self.objects)
        found = {name: self.success[names == name] for name in sorted({*self.objects})}
        return {name: (int(success.sum()), len(success)) for name, success in found.items()}


def evaluate(
    policy: Policy, task: str, settings: EnvSettings, episodes: int, *, seed: int = 0, threads: int = 0
) -> Evaluation:
    """Run `episodes` episodes of a task. Episode i is that of the single environment with the seed `seed + i`. Raises
    ConfigError."""
    if episodes < 1:
        raise ConfigError(f"an evaluation needs at least 1 episode, not {episodes}")
    env = HandVectorEnv(task, episodes, threads=threads, autoreset_mode="disabled", **env_keywords(settings))
    observation, report = env.reset(seed=seed)
    running = np.ones(episodes, bool)
    success, returned = np.zeros(episodes, bool), np.zeros(episodes)
    name, shares = env.engine.task.count_term, env.engine.task.share_terms
    counted: dict[str, NDArray[np.float64]] = {}
    while running.any():
        observation, reward, terminated, truncated, info = env.step(policy(observation))
        returned += np.where(running, reward, 0.0)
        for each in {name, *shares} & info.keys():
            counted.setdefault(each, np.zeros(episodes))[running] = info[each][running]
        ended = running & (terminated | truncated)
        success[ended] = info["is_success"][ended]
        running &= ~ended
    env.close()
    parts = {each: counted[each] for each in shares if each in counted}
    return Evaluation(success, returned, tuple(report.get("object", ())), counted.get(name), parts)
