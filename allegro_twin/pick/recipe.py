"""Recipes of trainings for `ArmPick`: everything that decides what is learned from the script."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from allegro_twin.errors import unknown
from allegro_twin.files.assets import data_root, find_file, read_yaml
from allegro_twin.files.schema import Positive, Settings
from allegro_twin.learning.tasks import NO_BATCH
from allegro_twin.learning.training.settings import changed_recipe
from allegro_twin.pick.settings import PickSettings
from allegro_twin.sim.objects.catalogue import object_catalogue

Count = Annotated[int, Field(ge=1)]
Share = Annotated[float, Field(ge=0, le=1)]
FOLDER = "conf/pick"
_FIRST, _SEEDS = 100_000, 90_000
"""First seed of all trainings, and how many episodes a training can have."""


class PickRecipe(Settings):
    """A training by DAgger (Ross, Gordon and Bagnell 2011): in every state the script says what it would do, and the
    network learns that from all states so far. The same recipe on the same machine gives the same policy, bit for bit,
    however often it was killed and continued."""

    task: Literal["ArmPick"]
    environment: PickSettings = PickSettings()
    """Keywords of the environments."""
    held_out: tuple[str, ...] = ()
    """Objects of the catalogue that are kept from the training, for the evaluation."""
    rounds: Count = 5
    episodes: Count = 60
    """Episodes of a round. The script leads those of the first."""
    noise: Annotated[float, Field(ge=0, le=1)] = 0.1
    """Spread of what is added to the actions of a script that leads a whole episode."""
    led: Share = 0.15
    """Share of the episodes of later rounds that the script leads. Of the others the network leads half from their
    beginning, and half from some instant on."""
    updates: Count = 2500
    """Steps of Adam after a round."""
    last_updates: Count = 12_000
    """Steps of Adam after the last round, with a learning rate that falls to a hundredth."""
    batch: Count = 512
    """States in a mini-batch."""
    learning_rate: Positive = 1e-3
    hidden: tuple[Count, ...] = (256, 256)
    """Units of each layer."""
    log: tuple[Literal["tensorboard", "csv", "wandb"], ...] = ("tensorboard", "csv")
    """Logs of errors, returns and success after every round: as in other recipes."""
    envs: Count | None = None
    """Episodes at once, each in a process; None: one for each core. No result depends on it."""
    seed: Annotated[int, Field(ge=0, le=9999)] = 0
    trials: Count = 100
    """Episodes of the evaluation at the end."""

    @model_validator(mode="after")
    def _check_held_out(self) -> Self:
        for name in self.held_out:
            if name not in object_catalogue():
                raise ValueError(f"held_out: {unknown('object', name, object_catalogue())}")
            if name in self.environment.objects:
                raise ValueError(f"held_out: {name} is among the objects of the training: leave it out of one of them")
        return self

    def training_seeds(self) -> range:
        """Seeds of the training's episodes."""
        first = _FIRST + self.seed * _SEEDS
        return range(first, first + self.rounds * self.episodes)

    @model_validator(mode="after")
    def _check_seeds(self) -> Self:
        if self.rounds * self.episodes > _SEEDS:
            raise ValueError(f"{self.rounds} rounds of {self.episodes} episodes are more than {_SEEDS:,} episodes")
        return self


def load_pick_recipe(name: str, **changes: Any) -> PickRecipe | None:
    """The recipe of `ArmPick` that `name` is: its path, its name in conf/pick, or `ArmPick` for the default values.
    None where it is of another task, or there is none. `changes` that are None are left out; `hand` and `side` are the
    environment's. Raises ConfigError."""
    if name == NO_BATCH:
        return changed_recipe(PickRecipe, {"task": NO_BATCH}, "recipe", changes)
    ships = (data_root() / FOLDER / f"{name}.yaml").is_file()
    if ":" in name or not (ships or "/" in name or "." in name):
        return None
    path = find_file(name, "recipe", FOLDER)
    content = read_yaml(path)
    return changed_recipe(PickRecipe, content, str(path), changes) if content.get("task") == NO_BATCH else None
