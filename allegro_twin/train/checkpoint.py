"""Checkpoints: the model with its optimiser, the policy's card, and what round it was, in one file that is whole or not
there."""

from __future__ import annotations

import json
import zipfile
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from allegro_twin.errors import ConfigError
from allegro_twin.files.schema import parse
from allegro_twin.files.whole import whole_file
from allegro_twin.policy.card import Card, write_card
from allegro_twin.train.settings import Recipe

VERSION = 1
"""Of the trainer: what a checkpoint must be of to be continued."""
MEMBER = "training.json"


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a training is."""

    rounds: int = 0
    """That are done."""
    steps: int = 0
    """Actions taken, all simulations together."""
    seconds: float = 0.0
    """Spent in training, pauses not counted."""


def save(model: Any, path: Path, recipe: Recipe, card: Card, progress: Progress) -> None:
    """A checkpoint is also a policy file for `allegro-twin run --policy`. Raises RecordingError for a full disk."""
    content = {"version": VERSION, "recipe": recipe.model_dump(mode="json"), "progress": asdict(progress)}
    with whole_file(path) as temporary:
        model.save(str(temporary))
        with zipfile.ZipFile(temporary, "a") as archive:
            archive.writestr(MEMBER, json.dumps(content))
        write_card(temporary, card)


def newest(folder: Path) -> Path | None:
    """The last checkpoint of a training, if there is one."""
    return max(folder.glob("checkpoints/*.zip"), default=None)


def read(path: Path, recipe: Recipe) -> Progress:
    """How far a checkpoint is. Raises ConfigError for one of another version, of another recipe, or none at all."""
    try:
        with zipfile.ZipFile(path) as archive:
            content = json.loads(archive.read(MEMBER)) if MEMBER in archive.namelist() else None
    except (zipfile.BadZipFile, json.JSONDecodeError) as error:
        raise ConfigError(f"{path}: not a readable checkpoint: {error}") from error
    if content is None:
        raise ConfigError(f"{path}: no training inside: a policy, but not a checkpoint to continue")
    if content["version"] != VERSION:
        raise ConfigError(
            f"{path} is a checkpoint of version {content['version']}; this package continues {VERSION}: "
            "train anew in another folder"
        )
    same_training(path, content["recipe"], recipe)
    return Progress(**content["progress"])


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
