"""What `ArmPick` needs no learning for: nothing, random actions and the script, in the same episodes.

`python -m benchmarks.pick [--episodes 100] [--seed 0]` prints the table of docs/results/environments.md; intervals
are Wilson's, 95 %.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

import numpy as np

from allegro_twin.grasping.statistics import wilson
from allegro_twin.pick.env import ArmPick, Floats
from allegro_twin.pick.scripted_policy import ScriptedPick

KINDS: dict[str, dict[str, Any]] = {
    "the thing is known": {},
    "as a camera would tell it: 5 mm, 0.1 rad, a decision late": {
        "camera_shift": 0.005, "camera_turn": 0.1, "camera_delay": 1,
    },
    "`perception=True`": {"perception": True},
    '`control="grasp", perception=True`': {"control": "grasp", "perception": True},
}  # fmt: skip
POLICIES = ("nothing", "random", "script")


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    print(f"| episodes | {' | '.join(POLICIES)} | return of each |", "|---|---|---|---|---|", sep="\n")
    for kind, settings in KINDS.items():
        # Nothing and random do not look: once is enough.
        policies = POLICIES if not settings else ("script",)
        told = [tried(policy, settings, asked.episodes, asked.seed) for policy in policies]
        told = [("—", "—")] * (len(POLICIES) - len(told)) + told
        print(
            f"| {kind} | {' | '.join(rate for rate, _ in told)} | {', '.join(gain for _, gain in told)} |", flush=True
        )


def tried(name: str, settings: dict[str, Any], episodes: int, seed: int) -> tuple[str, str]:
    """Success with its interval, and the mean return."""
    env, successes, returns = ArmPick(**settings), [], []
    draws = np.random.default_rng(seed)
    for episode in range(episodes):
        held, earned = episode_of(env, 10_000 * seed + episode, lambda: _policy(name, env, draws))
        successes.append(held)
        returns.append(earned)
    env.close()
    low, high = wilson(sum(successes), episodes)
    rate = sum(successes) / episodes
    return f"{rate:.0%} ({low:.0%}–{high:.0%})", f"{np.mean(returns):.1f}"


def episode_of(env: ArmPick, seed: int, policy: Callable[[], Callable[[], Floats]]) -> tuple[bool, float]:
    """Success and return of the episode of a seed; `policy` is made once it has begun."""
    env.reset(seed=seed)
    act, info, over, earned = policy(), dict[str, Any](), False, 0.0
    while not over:
        _, reward, lost, late, info = env.step(act())
        over, earned = lost or late, earned + reward
    return bool(info["is_success"]), earned


def _policy(name: str, env: ArmPick, draws: np.random.Generator) -> Callable[[], Floats]:
    size = env.action_space.shape
    if name == "script":
        return ScriptedPick(env)
    if name == "random":
        return lambda: draws.uniform(-1.0, 1.0, size).astype(np.float32)
    return lambda: np.zeros(size or (), np.float32)


if __name__ == "__main__":
    main()
