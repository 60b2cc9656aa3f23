"""What pictures in observations cost: `python -m benchmarks.pictures` prints actions per second of one processor, by
task and by what is observed, single and in a vector environment of eight. Times are of the process (CPU time), so that
others on the machine count less."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from allegro_twin.learning.environments.env import HandEnv
from allegro_twin.learning.environments.vector import HandVectorEnv

CASES: dict[str, dict[str, Any]] = {
    "numbers": {},
    "`depth` 84 × 84": {"observe": ("depth",)},
    "`rgb` 84 × 84": {"observe": ("rgb",)},
    "`rgb` 224 × 224": {"observe": ("rgb",), "resolution": "224x224"},
    "both, two cameras, 84 × 84": {"observe": ("rgb", "depth"), "cameras": ("side", "top")},
}
ACTIONS, N = 40, 8


def rate(env: HandEnv | HandVectorEnv, n: int) -> float:
    """Actions per second of CPU time, of all simulations together; best of three."""
    env.reset(seed=0)
    action, best = np.zeros((n, 16) if n > 1 else 16, np.float32), 0.0
    for _ in range(3):
        began = time.process_time()
        for _ in range(max(ACTIONS // n, 5)):
            env.step(action)
        best = max(best, n * max(ACTIONS // n, 5) / (time.process_time() - began))
    env.close()
    return best


def main() -> None:
    print("| observed | " + " | ".join(f"`{task}`, single | in {N}" for task in ("Reach", "Rotate")) + " |")
    print("|---|" + "---|" * 4)
    for name, more in CASES.items():
        cells = []
        for task in ("Reach", "Rotate"):
            cells.append(rate(HandEnv(task, timestep=0.003, **more), 1))
            cells.append(rate(HandVectorEnv(task, N, threads=1, timestep=0.003, **more), N))
        print(f"| {name} | " + " | ".join(f"{each:.0f}" for each in cells) + " |", flush=True)


if __name__ == "__main__":
    main()
