"""Checkpoints: the model with its optimiser, the policy's card, and what round it was, in one file that is whole or not
there."""

from __future__ import annotations

import json
import zipfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

from allegro_twin.errors import ConfigError
from allegro_twin.files.atomic_write import whole_file
from allegro_twin.learning.policy.card import Card, write_card
from allegro_twin.learning.training.progress import VERSION, Progress, made_of, same_inputs, same_training
from allegro_twin.learning.training.settings import Recipe

MEMBER = "training.json"


def save(model: Any, path: Path, recipe: Recipe, card: Card, progress: Progress) -> None:
    """A checkpoint is also a policy file for `allegro-twin run --policy`. Raises RecordingError for a full disk."""
    content = {
        "version": VERSION,
        "recipe": recipe.model_dump(mode="json"),
        "made_of": made_of(recipe),
        "progress": asdict(progress),
    }
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
    same_inputs(path, content.get("made_of", {}), recipe)
    return Progress(**content["progress"])
