"""Recipes of trainings: task, environments, and hyperparameters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, TypeVar

from pydantic import Field, field_validator, model_validator

from allegro_twin.errors import ConfigError, unknown
from allegro_twin.files.assets import data_root, find_file, read_yaml
from allegro_twin.files.schema import Positive, Settings, parse_settings
from allegro_twin.learning.environments.objects import ObjectChoice
from allegro_twin.learning.environments.settings import EnvSettings, GoalDistance
from allegro_twin.learning.tasks import NO_BATCH, explain_no_batch, task_names, task_type
from allegro_twin.sim.engine.backend import substeps

Count = Annotated[int, Field(ge=1)]
Share = Annotated[float, Field(ge=0, le=1)]


class Recipe(Settings):
    """Everything that decides what is learned. The same recipe on the same machine gives the same policy, bit for bit,
    however often it was killed and continued."""

    task: str
    environment: EnvSettings = EnvSettings()
    """Keywords of the training's environments."""
    held_out: tuple[ObjectChoice, ...] = ()
    """Objects that are kept from training and from every choice about it, for the evaluation. One that the training or
    `looked_at` has is refused, as is one that the hand cannot take."""
    looked_at: tuple[ObjectChoice, ...] = ()
    """Objects that no simulation of the training has, but by which its recipe and length were chosen. They are no more
    independent than those of the training."""
    learner: Literal["stable-baselines3", "rsl-rl", "dagger"] = "stable-baselines3"
    """Learner: `stable-baselines3` runs PPO on processors, reproducible to the bit; `rsl-rl` runs PPO, also on a Warp
    device; `dagger` imitates a `teacher`."""
    teacher: str | None = None
    """For `dagger`: a policy, by path or name, of the same task with `observation: full`."""
    start: str | None = None
    """With rsl-rl: a policy to start from, by path or name, instead of a random one, with the recipe's hidden layers.
    Inputs that it does not have (a goal) get zero weights."""
    log: tuple[Literal["tensorboard", "csv", "wandb"], ...] = ("tensorboard", "csv")
    """Logs of losses, rates, returns and the task's terms after every update: `tensorboard`, a folder; `csv`,
    curve.csv; `wandb`, Weights & Biases (an extra; `WANDB_MODE=offline` stays on this machine)."""
    settle: Annotated[int, Field(ge=0)] = 0
    """With `start`: updates at the beginning in which only the value function is learned, which no policy file
    contains."""
    envs: Count = 256
    """Number of simulations."""
    steps: Count = 1_000_000
    """Actions in all; whole rounds are trained."""
    round: Count = 100_000
    """Actions between two checkpoints, rounded up to whole updates. A round begins with new episodes."""
    rollout: Count = 16
    """Actions of each simulation between two updates."""
    batch: Count = 1024
    """Actions in a mini-batch; all of an update that has fewer. With stable-baselines3 2 or more."""
    epochs: Count = 5
    learning_rate: Positive = 5e-4
    """At the beginning; it falls in a straight line to a tenth."""
    desired_kl: Positive | None = None
    """With rsl-rl: the learning rate is adapted so that an update changes the policy by this much (Schulman et al.
    2017). None: it falls as described."""
    discount: Share = 0.98
    trace: Share = 0.95
    """λ of the advantage estimate."""
    clip: Positive = 0.2
    entropy: Annotated[float, Field(ge=0)] = 0.0
    hidden: tuple[Count, ...] = (128, 128)
    """Units of each layer, of policy and value alike."""
    activation: Literal["tanh", "elu"] = "elu"
    log_spread: Annotated[float, Field(ge=-20, le=20)] = -1.0
    """Logarithm of the standard deviation of actions at the beginning."""
    reward_scale: Positive = 1.0
    farthest: tuple[GoalDistance, GoalDistance] | None = None
    """For Reorient: distance of goals in the first round and in the last, rad, from 0.3 to π; between them in
    a straight line."""
    seed: Annotated[int, Field(ge=0, le=2**32 - 1)] = 0
    trials: Count = 100
    """Episodes of the evaluation after every round, without noise on the actions."""

    @field_validator("task")
    @classmethod
    def _check_task(cls, value: str) -> str:
        if value not in task_names() and ":" not in value:
            raise ValueError(unknown("task", value, task_names()))
        return value

    @model_validator(mode="after")
    def _check_learner(self) -> Recipe:
        if (self.learner == "dagger") != (self.teacher is not None):
            raise ValueError("learner dagger and a teacher go together: give both, or neither")
        if self.settle and self.start is None:
            raise ValueError("settle is for a policy to start with: give start, or leave it out")
        for name in ("desired_kl", "start"):
            if getattr(self, name) is not None and self.learner != "rsl-rl":
                raise ValueError(f"{name} is for learner: rsl-rl")
        if self.farthest is not None:
            self._check_farthest()
        self._check_steps()
        if self.learner == "stable-baselines3" and self.batch == 1:
            raise ValueError("batch 1 has no other advantage to compare with: 2 or more, or learner: rsl-rl")
        if self.learner != "dagger" and self.update == 1:
            raise ValueError(
                "an update of envs times rollout is 1 action, with no other to compare with: give more envs"
            )
        if self.environment.observe:
            raise ValueError(
                "environment.observe: no learner here has a network for pictures: train with a library of your own on "
                "gymnasium.make, such as MultiInputPolicy of Stable-Baselines3"
            )
        if self.environment.device != "cpu" and self.learner == "stable-baselines3":
            raise ValueError(
                f"device {self.environment.device} needs learner: rsl-rl or dagger; {self.learner} has cpu"
            )
        return self

    def _check_steps(self) -> None:
        environment, shipped = self.environment, EnvSettings()
        try:
            substeps(environment.period, environment.timestep)
        except ConfigError as error:
            raise ValueError(f"environment: {error}") from error
        try:
            substeps(environment.period, shipped.timestep)
        except ConfigError as error:
            raise ValueError(f"environment: {error}, which evaluations have whatever the training has") from error

    def _check_farthest(self) -> None:
        if "farthest" not in task_type(self.task).own_settings:
            raise ValueError(f"farthest: {self.task} has no distance of goals (Reorient has): leave it out")
        if self.learner == "dagger":
            raise ValueError("farthest is for PPO: learner dagger has the goals of its environment")

    @property
    def update(self) -> int:
        """Actions between two updates of the network."""
        return self.envs * self.rollout

    @property
    def rounds(self) -> int:
        """Number of rounds."""
        return max(round(self.steps / self.round_steps), 1)

    @property
    def total(self) -> int:
        """Actions that are trained in all: whole rounds."""
        return self.rounds * self.round_steps

    @property
    def round_steps(self) -> int:
        """Actions in a round: whole updates."""
        return -(-min(self.round, self.steps) // self.update) * self.update


def load_recipe(name: str, **changes: Any) -> Recipe:
    """A recipe by path or by its name in conf/training (`lift`), or the name of a task (`Lift`): the task as
    `gymnasium.make` has it, with the default values of a recipe. `changes` that are None are left out. Raises
    ConfigError with the nearest names."""
    shipped, arm = (
        {path.stem: path for path in sorted((data_root() / "conf" / folder).glob("*.yaml"))}
        for folder in ("training", "pick")
    )
    if name == NO_BATCH or name in arm:
        raise ConfigError(explain_no_batch())
    if ":" in name or name in task_names():
        return changed_recipe(Recipe, {"task": name}, "recipe", changes)
    if "." not in name and "/" not in name and name not in shipped:
        raise ConfigError(unknown("task or recipe", name, {*task_names(), NO_BATCH, *shipped, *arm}))
    path = shipped.get(name) or find_file(name, "recipe", "conf/training")
    content = read_yaml(path)
    if content.get("task") == NO_BATCH:
        raise ConfigError(f"{path}: {explain_no_batch()}")
    return changed_recipe(Recipe, content, str(path), changes)


Kind = TypeVar("Kind", bound=Settings)


def changed_recipe(kind: type[Kind], content: Mapping[str, Any], where: str, changes: Mapping[str, Any]) -> Kind:
    """A recipe with `changes`, of which `hand`, `side` and `device` are its environment's, and those that are None are
    left out. Raises ConfigError with the option that is wrong, or else with `where` the recipe comes from."""
    given = {key: value for key, value in changes.items() if value is not None}
    own = {key: given.pop(key) for key in ("hand", "side", "device") if key in given}

    def source(place: tuple[int | str, ...]) -> str:
        key = next((part for part in place if part != "environment"), "")
        return f"--{key}" if key in (own if place[:1] == ("environment",) else given) else where

    environment = content.get("environment") or {}
    if own and isinstance(environment, Mapping):
        given["environment"] = {**environment, **own}
    return parse_settings(kind, {**content, **given}, source)
