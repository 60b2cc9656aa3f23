"""How far a training is, and whether it is the same one as another."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from allegro_twin.errors import ConfigError
from allegro_twin.files.fingerprint import fingerprint, source_fingerprint
from allegro_twin.files.schema import parse
from allegro_twin.hands.description.hands import load_spec
from allegro_twin.hands.library.gains import gains_names, load_gains
from allegro_twin.learning.training.settings import Recipe
from allegro_twin.sim.model.fingerprint import hand_fingerprint
from allegro_twin.sim.objects.catalogue import object_catalogue

VERSION = 2
"""Of the trainer: what a checkpoint must be of to be continued."""

_MODULES = (
    "allegro_twin.learning.training.rsl.ppo",
    "allegro_twin.learning.training.rsl.dagger",
    "allegro_twin.learning.training.sb3.ppo",
    "allegro_twin.learning.tasks",
)


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a training is."""

    rounds: int = 0
    """That are done."""
    steps: int = 0
    """Actions taken, all simulations together."""
    seconds: float = 0.0
    """Spent in training, pauses not counted."""


def made_of(recipe: Recipe) -> dict[str, str]:
    """What a training is made of beside its recipe, by fingerprint: the engine, the code that trains and simulates, the
    hand with its gains, and the catalogue of objects. Files of a user's own, such as meshes, are not in it."""
    spec = load_spec(recipe.environment.hand, recipe.environment.side)
    return {
        "engine": f"mujoco {version('mujoco')}",
        "code": fingerprint([source_fingerprint(module) for module in _MODULES]),
        f"hand {spec.name}": hand_fingerprint(spec),
        f"gains of {spec.model}": fingerprint({name: load_gains(name, spec) for name in gains_names(spec)}),
        "objects": fingerprint(object_catalogue()),
    }


def same_inputs(path: Path, was: Mapping[str, str], recipe: Recipe) -> None:
    """Raise ConfigError for a checkpoint that was made of something else: to go on from it would mix two trainings."""
    now = made_of(recipe)
    changed = [name for name in {**now, **was} if was.get(name) != now.get(name)]
    if changed:
        raise ConfigError(
            f"{path.parent.parent} is a training with another {', '.join(changed)}: choose another folder, or put back "
            "what it began with"
        )


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
