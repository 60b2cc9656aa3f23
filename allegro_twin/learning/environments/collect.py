"""Collects whole episodes of a policy in an environment, for data sets."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.learning.environments.vector import HandVectorEnv
from allegro_twin.learning.policy.interface import Floats, Observation
from allegro_twin.recording.exchange.environment_episodes import OBSERVATION, EnvironmentEpisode


def collect_episodes(
    policy: Callable[[Observation], Floats],
    task: str,
    keywords: dict[str, Any],
    episodes: int,
    *,
    seed: int = 0,
    threads: int = 0,
) -> list[EnvironmentEpisode]:
    """Run `episodes` episodes side by side, each to its end. Episode i is that of the single environment with the seed
    `seed + i`. Raises ConfigError."""
    if episodes < 1:
        raise ConfigError(f"a data set needs at least 1 episode, not {episodes}")
    if keywords.get("observe"):
        raise ConfigError("observe: data sets of episodes have no pictures: leave it out")
    env = HandVectorEnv(task, episodes, threads=threads, autoreset_mode="disabled", **keywords)
    observation, report = env.reset(seed=seed)
    observations, rows, running = [_parts(observation)], list[tuple[Any, ...]](), np.ones(episodes, bool)
    length, failed = np.zeros(episodes, np.int64), np.zeros(episodes, bool)
    while running.any():
        action = np.asarray(policy(observation), np.float32)
        observation, reward, terminated, truncated, info = env.step(action)
        observations.append(_parts(observation))
        rows.append((np.clip(action, -1.0, 1.0), reward, info["is_success"]))
        length += running
        failed |= running & terminated
        running &= ~(terminated | truncated)
    env.close()
    objects = report.get("object", [""] * episodes)
    actions, rewards, successes = (np.stack(each) for each in zip(*rows, strict=True))
    arrays = {name: np.stack([each[name] for each in observations]) for name in observations[0]}
    purpose = env.engine.task.purpose
    return [
        EnvironmentEpisode(
            env.engine.task.id,
            f"{purpose} ({objects[row]})" if objects[row] else purpose,
            {name: values[: count + 1, row] for name, values in arrays.items()},
            actions[:count, row],
            rewards[:count, row],
            successes[:count, row],
            bool(failed[row]),
        )
        for row, count in enumerate(length.tolist())
    ]


def _parts(observation: Observation) -> dict[str, Floats]:
    return observation if isinstance(observation, dict) else {OBSERVATION: observation}
