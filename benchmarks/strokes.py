"""How a policy turns things, 3 s by 3 s: `python -m benchmarks.strokes POLICY … [--episodes 48] [--seed 2000000000]`.

Episodes begin in the policy's own grip. Net speed, the range of headings within the 3 s, and what the task paid for new
angles, as a share of its most; of the episodes that were in the hand to the end of the 3 s. A policy that rocks has a
range and no net speed.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from allegro_twin.learning.environments.vector import HandVectorEnv
from allegro_twin.learning.policy.loading import load_policy
from allegro_twin.learning.training.report import SELECTION

PART = 50  # Decisions: 3 s.
SETTINGS: dict[str, Any] = {"timestep": 0.003, "decimation": 20}


def main(policy: str, episodes: int, seed: int) -> None:
    loaded = load_policy(policy)
    act, grip = loaded.policy, (loaded.card.environment or {}).get("grip", "pinch")
    env = HandVectorEnv("Rotate", episodes, threads=1, autoreset_mode="disabled", grip=grip, **SETTINGS)
    observation, _ = env.reset(seed=seed)
    period, running = env.engine.settings.period * env.engine.settings.decimation, np.ones(episodes, bool)
    turned, paid = [np.zeros(episodes)], [np.zeros(episodes)]
    while running.any():
        observation, _, terminated, truncated, info = env.step(act(observation))
        turned.append(np.where(running, info["turned"], np.nan))
        paid.append(np.where(running, info["speed"], np.nan))
        running &= ~(terminated | truncated)
    env.close()
    heading, pay = np.array(turned), np.array(paid)
    print(f"{policy}\n{'s':>8}{'in hand':>9}{'net, rad/s':>12}{'range, rad':>12}{'paid':>7}")
    for first in range(0, len(heading) - PART, PART):
        last = first + PART
        kept = np.isfinite(heading[last])
        if kept.any():
            part = heading[first : last + 1, kept]
            speed, span = (part[-1] - part[0]).mean() / (PART * period), np.ptp(part, axis=0).mean()
            print(f"{first * period:>5.0f}-{last * period:<2.0f}{kept.sum():>9}{speed:>12.2f}{span:>12.2f}"
                  f"{pay[first + 1 : last + 1, kept].mean():>7.2f}")  # fmt: skip


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("policies", nargs="+", metavar="POLICY")
    parser.add_argument("--episodes", type=int, default=48)
    parser.add_argument("--seed", type=int, default=SELECTION)
    given = parser.parse_args()
    for name in given.policies:
        main(name, given.episodes, given.seed)
