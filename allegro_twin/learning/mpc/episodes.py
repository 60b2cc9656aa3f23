"""Whole episodes under model predictive control, in lockstep: simulated time stops while it thinks."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from allegro_twin.learning.environments.env import HandEnv
from allegro_twin.learning.environments.settings import EnvSettings, env_keywords
from allegro_twin.learning.mpc.sampling import SamplingMpc
from allegro_twin.learning.mpc.settings import MpcSettings


@dataclass(frozen=True, slots=True)
class MpcEpisode:
    """Outcome of an episode."""

    object: str
    """Empty where a task has none."""
    seconds: float
    """Simulated, s."""
    kept: bool
    """It went on to its end."""
    success: bool
    total: float
    """Sum of the rewards."""
    count: float
    """The task's own: rad turned, goals reached; NaN without one."""
    by_tips: float
    """Share of the contact force by fingertips; NaN where a task does not tell."""
    thinking: float
    """Wall time of a decision, mean, s."""
    computing: float
    """Processor time of a decision, mean, s."""


def run_episodes(
    task: str,
    environment: EnvSettings,
    settings: MpcSettings,
    episodes: int,
    *,
    seed: int = 0,
    seconds: float | None = None,
    threads: int = 0,
    place: str = "",
    shown: Callable[[Any], None] | None = None,
    advance: Callable[[int, int], None] = lambda done, of: None,
    ended: Callable[[MpcEpisode], None] = lambda episode: None,
) -> list[MpcEpisode]:
    """Run episodes of a task; number i is that of the environment with the seed `seed + i`. `seconds`: of each at most,
    in place of the task's own; `shown` gets a picture of every decision; `advance` the decisions of an episode that are
    done; `ended` each episode when it has ended. `place`: where the settings are written, before a key in an error.
    Raises ConfigError."""
    env = HandEnv(task, render_mode=None if shown is None else "rgb_array", **env_keywords(environment))
    mpc, found = SamplingMpc(task, environment, settings, threads, place), []
    own, step = env.engine.task, env.engine.task.interface.seconds
    limit = env.engine.limit if seconds is None else max(round(seconds / step), 1)
    for number in range(episodes):
        _, report = env.reset(seed=seed + number)
        mpc.begin()
        total, spent, used, failed, info, done = 0.0, 0.0, 0.0, False, dict[str, Any](), 0
        while not failed and done < limit:
            began, cpu = time.perf_counter(), time.process_time()
            action = mpc.plan(env.save_state())
            spent, used = spent + time.perf_counter() - began, used + time.process_time() - cpu
            _, reward, failed, _, info = env.step(action)
            total, done = total + reward, done + 1
            if shown is not None:
                shown(env.render())
            advance(done, limit)
        count = float(info.get(own.count_term, np.nan))
        kind = str(report.get("object", ""))
        tips = float(info.get("by_tips", np.nan))
        kept, good = not failed, bool(info["is_success"])
        found.append(MpcEpisode(kind, done * step, kept, good, total, count, tips, spent / done, used / done))
        ended(found[-1])
    env.close()
    return found
