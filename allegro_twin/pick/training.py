"""Trains a policy for `ArmPick`, once the packages that this needs are known to be there."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path

from allegro_twin.errors import ConfigError
from allegro_twin.learning.training.logs import check_logs
from allegro_twin.learning.training.progress import TrainingResult
from allegro_twin.pick.recipe import PickRecipe

_EXTRA, _NEEDED = "rl", ("torch", "onnx", "onnxruntime")


def train_pick(
    recipe: PickRecipe,
    folder: Path,
    advance: Callable[[int], None] = lambda episodes: None,
    kept: Callable[[int], None] = lambda rounds: None,
    source: str = "recipe",
) -> TrainingResult:
    """Train in `folder`, or continue what is there. `advance` is told the episodes that are done in all, `kept` the
    rounds whose checkpoint is there, at the beginning and after each. Steps of the result are states. Raises
    ConfigError, which names `source`, for objects that cannot be, without the extra, and for a folder of another
    training; HandError where the training diverges; RecordingError where the disk is full."""
    for name in _NEEDED:
        try:
            import_module(name)
        except ImportError as error:
            raise ConfigError(f"training needs {name}: pip install 'allegro-twin[{_EXTRA}]'") from error
    check_logs(recipe, _EXTRA)
    trained: TrainingResult = import_module("allegro_twin.pick.imitation").learn(recipe, folder, advance, kept, source)
    return trained
