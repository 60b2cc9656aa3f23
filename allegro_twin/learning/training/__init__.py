"""Training, from a recipe to a policy file with its figures: PPO by Stable-Baselines3 on processors or by rsl-rl where
the simulations are, and imitation of a policy that sees more."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from allegro_twin.errors import ConfigError
from allegro_twin.learning.training.settings import Recipe, load_recipe

if TYPE_CHECKING:
    from allegro_twin.learning.training.progress import Trained

_STABLE = "rl", ("torch", "stable_baselines3", "onnx", "tensorboard")
_RSL = "rsl", ("torch", "rsl_rl", "onnx", "onnxruntime", "tensorboard")
_DAGGER = "rl", ("torch", "onnx", "onnxruntime", "tensorboard")

__all__ = ["Recipe", "load_recipe", "train"]


def train(
    recipe: Recipe, folder: Path, advance: Callable[[int, float, float], None] = lambda steps, mean, rate: None
) -> Trained:
    """Train in `folder`, or go on with what is there; told after every update: the actions taken, and the mean return
    and success rate since. Raises ConfigError without the extra, or for a folder of another training."""
    extra, needed = {"rsl-rl": _RSL, "dagger": _DAGGER}.get(recipe.learner, _STABLE)
    for name in needed:
        try:
            import_module(name)
        except ImportError as error:
            raise ConfigError(f"training needs {name}: pip install 'allegro-twin[{extra}]'") from error
    module = {"rsl-rl": "rsl.ppo", "dagger": "rsl.dagger"}.get(recipe.learner, "sb3.ppo")
    trained: Trained = import_module(f"allegro_twin.learning.training.{module}").learn(recipe, folder, advance)
    return trained
