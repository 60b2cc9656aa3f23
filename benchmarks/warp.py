"""Steps a second of many environments on an NVIDIA GPU through MuJoCo Warp: `python -m benchmarks.warp`.

Beside each figure is what the bare physics would do: the same number of `mujoco_warp.step`, nothing copied back and no
task around it. Without a GPU it says so and measures nothing.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.gym.vector import HandVectorEnv

SIZES = (1024, 4096, 16384)
TASKS: tuple[tuple[str, dict[str, Any]], ...] = (("Reach", {}), ("Reorient", {}), ("Grasp", {"objects": ("orange",)}))
WARM, STEPS = 3, 20


def main(device: str) -> None:
    print(f"{'task':<10}{'simulations':>12}{'env steps/s':>14}{'physics steps/s':>17}{'bare physics/s':>16}  device")
    for task, kwargs in TASKS:
        for n in SIZES:
            try:
                env = HandVectorEnv(task, n, device=device, **kwargs)
            except ConfigError as error:
                print(f"not measured: {error}")
                return
            row(task, n, env)


def row(task: str, n: int, env: HandVectorEnv) -> None:
    env.reset(seed=0)
    still = np.zeros((n, 16), np.float32)
    worlds: Any = env.engine.worlds
    settings = env.engine.settings
    count = round(settings.period / settings.timestep)
    seconds = timed(lambda: env.step(still))
    with worlds._wp.ScopedDevice(worlds._device):

        def bare() -> None:
            for _ in range(settings.decimation):
                worlds._advance(count)
            worlds._wp.synchronize()

        physics = timed(bare)
    every = n * settings.decimation * count
    print(f"{task:<10}{n:>12,}{n / seconds:>14,.0f}{every / seconds:>17,.0f}{every / physics:>16,.0f}  {worlds.device}")


def timed(act: Callable[[], object]) -> float:
    """Seconds a call, after some that compile and warm up."""
    for _ in range(WARM):
        act()
    start = time.perf_counter()
    for _ in range(STEPS):
        act()
    return (time.perf_counter() - start) / STEPS


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "warp")
