"""Training: PPO of Stable-Baselines3 on the vector environments, from a recipe to a policy file with its figures."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from allegro_twin.errors import ConfigError
from allegro_twin.train.settings import Recipe, load_recipe

if TYPE_CHECKING:
    from allegro_twin.train.learning import Trained

__all__ = ["Recipe", "load_recipe", "train"]


def train(
    recipe: Recipe, folder: Path, advance: Callable[[int, float, float], None] = lambda steps, mean, rate: None
) -> Trained:
    """Train in `folder`, or go on with what is there; told after every update: the actions taken, and the mean return
    and success rate since. Raises ConfigError without the extra, or for a folder of another training."""
    for name in ("torch", "stable_baselines3", "onnx", "tensorboard"):
        try:
            import_module(name)
        except ImportError as error:
            raise ConfigError(f"training needs {name}: pip install 'allegro-twin[rl]'") from error
    from allegro_twin.train.learning import learn

    return learn(recipe, folder, advance)
