"""How far a training is, and whether it is the same one as another."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from allegro_twin.errors import ConfigError
from allegro_twin.files.schema import parse
from allegro_twin.train.settings import Recipe

VERSION = 2
"""Of the trainer: what a checkpoint must be of to be continued."""


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a training is."""

    rounds: int = 0
    """That are done."""
    steps: int = 0
    """Actions taken, all simulations together."""
    seconds: float = 0.0
    """Spent in training, pauses not counted."""


def same_training(path: Path, was: dict[str, Any], recipe: Recipe) -> None:
    """Raise ConfigError for a checkpoint of another recipe than this one; more steps are a longer training of the same
    kind, and where it simulates a training may change."""
    then, now = (each.model_dump(mode="json") for each in (parse(Recipe, was, str(path)), recipe))
    for each in (then, now):
        each["environment"].pop("device", None)
    changed = [key for key in sorted(now.keys() | then.keys()) if key != "steps" and then.get(key) != now.get(key)]
    if changed:
        key = changed[0]
        raise ConfigError(
            f"{path.parent.parent} is a training with {key} {then.get(key)}, not {now.get(key)}: choose another folder"
        )
