"""Trains a policy for `ArmPick`, once the packages that this needs are known to be there."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path

from allegro_twin.learning.training import check_extra, full_disk_as_error
from allegro_twin.learning.training.progress import TrainingResult
from allegro_twin.pick.recipe import PickRecipe


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
    check_extra("rl", ("torch", "onnx", "onnxruntime"), recipe)
    with full_disk_as_error(folder):
        learn = import_module("allegro_twin.pick.imitation").learn
        trained: TrainingResult = learn(recipe, folder, advance, kept, source)
    return trained
