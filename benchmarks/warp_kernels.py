"""Compile a training's kernels for an NVIDIA GPU that is not there: `python -m benchmarks.warp_kernels RECIPE FOLDER`.

For a lent GPU, whose minutes are dear. It makes the recipe's environments with as many simulations as the recipe has,
on Warp's CPU device, and lets every launch compile its kernel for `--arch` (90: H100, H200) instead of running it. On
the GPU's machine `WARP_CACHE_PATH=FOLDER` finds them, with the same versions of Python, warp-lang and mujoco-warp.
What it misses is compiled there, as ever. It reaches into Warp 1.19.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

MULTIPROCESSORS = 132  # Of an H100; it decides sizes of launches, not kernels.
ON_A_GPU = 256  # Warp's threads per block where none are asked for.


class NotRunError(Exception):
    """A kernel has been compiled, and cannot run here."""


class Pretended:
    """A device that says it is a GPU, to whoever chooses kernels by that."""

    is_cuda, is_cpu, sm_count = True, False, MULTIPROCESSORS

    def __init__(self, device: Any) -> None:
        self._device = device

    def __getattr__(self, name: str) -> Any:
        return getattr(self._device, name)


def pretend(wp: Any, arch: int, seconds: dict[str, float]) -> None:
    """Make Warp compile for `arch` what it is told to launch. `seconds`: of each module, as they come."""
    from warp._src import context

    launch, get_device = context.launch, wp.get_device

    def load(module: Any, device: Any, block_dim: int | None = None, **more: Any) -> None:
        block = module.options["block_dim"] if block_dim is None else block_dim
        module.get_module_hash(block)
        name = module.get_module_identifier(block)
        if name not in seconds:
            began = time.monotonic()
            module._compile(None, None, None, arch, use_ptx=False, options=module.resolved_options[block])
            seconds[name] = time.monotonic() - began
            print(f"{seconds[name]:6.1f} s  {name}", flush=True)
        raise NotRunError

    def launched(*args: Any, **kwargs: Any) -> None:
        try:
            launch(*args, **kwargs)
        except NotRunError:
            pass

    def suggested(kernel: Any, device: Any = None) -> tuple[int, int]:
        try:
            kernel.module.load(device)
        except NotRunError:
            pass
        return ON_A_GPU, MULTIPROCESSORS

    def either(condition: Any, on_true: Any = None, on_false: Any = None, stream: Any = None, **kwargs: Any) -> None:
        for branch in (on_true, on_false):
            if branch is not None:
                branch(**kwargs)

    def once(condition: Any, while_body: Any, stream: Any = None, **kwargs: Any) -> None:
        while_body(**kwargs)

    def device_for(*args: Any, **kwargs: Any) -> Any:
        caller = sys._getframe(1).f_code.co_filename
        found = get_device(*args, **kwargs)
        return Pretended(found) if "mujoco_warp" in caller and not caller.endswith("io.py") else found

    context.Module.load = load
    context._resolve_launch_block_dim = lambda device, asked: ON_A_GPU if asked is None or asked <= 0 else int(asked)
    context.launch = wp.launch = launched
    wp.get_suggested_block_size, wp.get_device = suggested, device_for
    wp.capture_if, wp.capture_while = either, once
    wp.is_conditional_graph_supported = lambda: True
    from mujoco_warp._src import collision_convex

    collision_convex._ccd_grid_size = lambda kernel, most, device: min(suggested(kernel)[0], most)


def main(recipe_name: str, folder: Path, arch: int) -> None:
    import warp as wp

    wp.config.kernel_cache_dir = str(folder.resolve())
    wp.config.log_level = wp.LOG_WARNING
    wp.init()
    seconds: dict[str, float] = {}
    pretend(wp, arch, seconds)
    import torch

    from allegro_twin.learning.environments.settings import env_keywords
    from allegro_twin.learning.environments.tensors import TensorVectorEnv
    from allegro_twin.learning.training.settings import load_recipe

    recipe = load_recipe(recipe_name)
    env = TensorVectorEnv(recipe.task, recipe.envs, **env_keywords(recipe.environment) | {"device": "warp:cpu"})
    env.engine.worlds.check = lambda: None  # type: ignore[method-assign]  # Nothing has been simulated.
    env.reset()
    for _ in range(2):
        env.step(torch.zeros((recipe.envs, env.engine.task.spec.n_joints)))
    print(f"{len(seconds)} modules, {sum(seconds.values()):.0f} s")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recipe")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--arch", type=int, default=90)
    given = parser.parse_args()
    main(given.recipe, given.folder, given.arch)
