"""Training: PPO, from a recipe to a policy file with its figures. Stable-Baselines3 learns on processors, and rsl-rl
where the simulations are on a GPU."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from allegro_twin.errors import ConfigError
from allegro_twin.train.settings import Recipe, load_recipe

if TYPE_CHECKING:
    from allegro_twin.train.learned import Trained

_STABLE = "rl", ("torch", "stable_baselines3", "onnx", "tensorboard")
_RSL = "rsl", ("torch", "rsl_rl", "onnx", "onnxruntime")

__all__ = ["Recipe", "load_recipe", "train"]


def train(
    recipe: Recipe, folder: Path, advance: Callable[[int, float, float], None] = lambda steps, mean, rate: None
) -> Trained:
    """Train in `folder`, or go on with what is there; told after every update: the actions taken, and the mean return
    and success rate since. Raises ConfigError without the extra, or for a folder of another training."""
    rsl = recipe.learner == "rsl-rl"
    extra, needed = _RSL if rsl else _STABLE
    for name in needed:
        try:
            import_module(name)
        except ImportError as error:
            raise ConfigError(f"training needs {name}: pip install 'allegro-twin[{extra}]'") from error
    if rsl:
        from allegro_twin.train.rsl import learn
    else:
        from allegro_twin.train.learning import learn

    return learn(recipe, folder, advance)
