"""Training from a recipe to a policy file: PPO by Stable-Baselines3 on processors or by rsl-rl on the simulations'
device, and imitation (DAgger)."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from allegro_twin.errors import ConfigError
from allegro_twin.learning.training.logs import check_logs
from allegro_twin.learning.training.settings import Recipe, load_recipe

if TYPE_CHECKING:
    from allegro_twin.learning.training.progress import TrainingResult

_STABLE = "rl", ("torch", "stable_baselines3", "onnx")
_RSL = "rsl", ("torch", "rsl_rl", "onnx", "onnxruntime")
_DAGGER = "rl", ("torch", "onnx", "onnxruntime")

__all__ = ["Recipe", "load_recipe", "train"]


def train(
    recipe: Recipe, folder: Path, advance: Callable[[int, float, float], None] = lambda steps, mean, rate: None
) -> TrainingResult:
    """Train in `folder`, or continue what is there. `advance` is called after every update with the actions taken,
    and the mean return and success rate since. Raises ConfigError without the extra, or for a folder of another
    training."""
    check_packages(recipe)
    module = {"rsl-rl": "rsl.ppo", "dagger": "rsl.dagger"}.get(recipe.learner, "sb3.ppo")
    trained: TrainingResult = import_module(f"allegro_twin.learning.training.{module}").learn(recipe, folder, advance)
    return trained


def check_packages(recipe: Recipe) -> None:
    """Raise ConfigError where a package is missing that this training needs."""
    extra, needed = {"rsl-rl": _RSL, "dagger": _DAGGER}.get(recipe.learner, _STABLE)
    for name in needed:
        try:
            import_module(name)
        except ImportError as error:
            raise ConfigError(f"training needs {name}: pip install 'allegro-twin[{extra}]'") from error
    check_logs(recipe, extra)
