"""Actions a second of many environments on an NVIDIA GPU through MuJoCo Warp: `python -m benchmarks.warp`.

Beside each figure is what the bare physics would do: the same steps with nothing around them. Without a GPU it says so
and measures nothing.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

from allegro_twin.errors import ConfigError
from allegro_twin.learning.environments.tensors import TensorVectorEnv

ROWS: tuple[tuple[int, dict[str, Any]], ...] = ((1024, {"coarse": True}), (4096, {"coarse": True}),
                                                (16384, {"coarse": True}), (4096, {}))  # fmt: skip
KEYWORDS: dict[str, Any] = {"timestep": 0.003, "decimation": 20, "palm": "allowed"}
WARM, ACTIONS, STEPS = 4, 10, 100


def main(device: str) -> None:
    print(f"{'simulations':>12}{'actions/s':>12}{'physics steps/s, bare':>24}{'share':>8}")
    for n, kwargs in ROWS:
        try:
            env = TensorVectorEnv("Rotate", n, device=device, **KEYWORDS, **kwargs)
        except ConfigError as error:
            print(f"not measured: {error}")
            return
        env.reset()
        row(n, env)


def row(n: int, env: TensorVectorEnv) -> None:
    torch, device = env.xp.torch, env.xp.device
    wait = torch.cuda.synchronize if device.type == "cuda" else lambda: None
    act = timed(lambda: env.step(torch.rand((n, 16), device=device) - 0.5), ACTIONS, wait)
    step = timed(lambda: env.engine.worlds.step(None, 1), STEPS, wait)
    share = env.engine.settings.decimation * step / act
    print(f"{n:>12,}{n / act:>12,.0f}{n / step:>24,.0f}{share:>8.2f}")


def timed(act: Callable[[], object], count: int, wait: Callable[[], None]) -> float:
    """Seconds a call, after some that compile and warm up."""
    for _ in range(WARM):
        act()
    wait()
    start = time.perf_counter()
    for _ in range(count):
        act()
    wait()
    return (time.perf_counter() - start) / count


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "warp")
