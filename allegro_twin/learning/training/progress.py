"""Progress of a training: checkpoints' content, learning curve, schedules, and whether a checkpoint belongs to it."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from allegro_twin.errors import ConfigError, HandError
from allegro_twin.files.assets import find_file, read_yaml
from allegro_twin.files.atomic_write import atomic_file
from allegro_twin.files.fingerprints import fingerprint, source_fingerprint
from allegro_twin.files.schema import Settings, parse_settings
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.gains import gains_names, load_gains
from allegro_twin.learning.training.settings import Recipe
from allegro_twin.sim.model.fingerprint import hand_fingerprint
from allegro_twin.sim.objects.catalogue import object_catalogue

GOAL, ACHIEVED = "desired_goal", "achieved_goal"  # Names of Gymnasium.
STATE = "state"
Advance = Callable[[int, float, float], None]
"""Called after every update: the actions taken in all, and the mean return and success rate of the episodes that ended
since, NaN where none did."""
Kept = Callable[[int], None]
"""Told the actions of the newest checkpoint: when a training begins or goes on (0: there is none), and whenever one was
written."""
FINAL_RATE = 0.1  # Share of the learning rate at the end.
EVALUATION = 1_000_000_000  # First seed of the evaluations: never one of training.
ROUND_SEEDS = 100_003  # Distance of seeds: more than there are simulations, so that no two rounds share a seed.

VERSION = 2
"""Version of the trainer. A checkpoint of another version is not continued."""

_MODULES = (
    "allegro_twin.learning.training.rsl.ppo",
    "allegro_twin.learning.training.rsl.dagger",
    "allegro_twin.learning.training.sb3.ppo",
    "allegro_twin.learning.tasks",
)


@dataclass(frozen=True, slots=True)
class TrainingProgress:
    """Progress of a training."""

    rounds: int = 0
    """Completed rounds."""
    steps: int = 0
    """Actions taken, all simulations together."""
    seconds: float = 0.0
    """Training time, without pauses."""


def input_fingerprints(recipe: Recipe) -> dict[str, str]:
    """Fingerprints of a training's inputs beside its recipe: the engine, the code that trains and simulates, the hand
    with its gains, and the catalogue of objects. Files of a user's own, such as meshes, are not included."""
    environment = recipe.environment
    spec, twin = load_spec(environment.hand, environment.side), environment.randomise.twin
    own = {} if twin is None else {"twin": fingerprint(read_yaml(find_file(twin, "hand", "conf/hands")))}
    return own | {
        "engine": f"mujoco {version('mujoco')}",
        "code": fingerprint([source_fingerprint(module) for module in _MODULES]),
        f"hand {spec.name}": hand_fingerprint(spec),
        f"gains of {spec.model}": fingerprint({name: load_gains(name, spec) for name in gains_names(spec)}),
        "objects": fingerprint(object_catalogue()),
    }


def checkpoint_content(recipe: Recipe, progress: TrainingProgress) -> dict[str, Any]:
    """The common part of every checkpoint, for `checked_progress`."""
    return {
        "version": VERSION,
        "recipe": recipe.model_dump(mode="json"),
        "made_of": input_fingerprints(recipe),
        "progress": asdict(progress),
    }


def checked_progress(path: Path, content: Mapping[str, Any], recipe: Recipe) -> TrainingProgress:
    """Progress of a checkpoint. Raises ConfigError for one of another version, another recipe or other inputs."""
    if content["version"] != VERSION:
        raise ConfigError(
            f"{path} is a checkpoint of version {content['version']}; this package continues {VERSION}: "
            "train anew in another folder"
        )
    check_same_recipe(path, content["recipe"], recipe)
    check_same_inputs(path, content.get("made_of", {}), input_fingerprints(recipe))
    progress = TrainingProgress(**content["progress"])
    if progress.steps > recipe.total:
        raise ConfigError(
            f"{path.parent.parent} is a training of {progress.steps} actions already, and steps are {recipe.steps}: "
            "give more steps, or choose another folder"
        )
    return progress


def check_same_inputs(path: Path, was: Mapping[str, str], now: Mapping[str, str]) -> None:
    """Raise ConfigError for a checkpoint with other inputs: to continue it would mix two trainings."""
    changed = [name for name in {**now, **was} if was.get(name) != now.get(name)]
    if changed:
        raise ConfigError(
            f"{path.parent.parent} is a training with another {', '.join(changed)}: choose another folder, or put back "
            "what it began with"
        )


def check_same_recipe(path: Path, was: dict[str, Any], recipe: Recipe) -> None:
    """Raise ConfigError for a checkpoint of another recipe. Other steps are a shorter or longer training of the same
    kind, and device and logs may change."""
    then, now = (each.model_dump(mode="json") for each in (parse_settings(Recipe, was, str(path)), recipe))
    for each in (then, now):
        each["environment"].pop("device", None)
        each.pop("log")
    changed = [key for key in sorted(now.keys() | then.keys()) if key != "steps" and then.get(key) != now.get(key)]
    if changed:
        key = changed[0]
        raise ConfigError(
            f"{path.parent.parent} is a training with {key} {then.get(key)}, not {now.get(key)}: choose another folder"
        )


@dataclass(frozen=True, slots=True)
class TrainingResult:
    """Result of a training."""

    policy: Path
    """The .onnx file."""
    progress: TrainingProgress
    rate: float
    """Success rate of the last evaluation, on the training's objects."""


@contextmanager
def finite_network(network: Callable[[], Iterable[Any]], recipe: Recipe, steps: int) -> Iterator[None]:
    """Raise HandError where the tensors of `network`, a policy's weights and spread, are not finite after a round that
    began after `steps` actions, or when an error ends it: each learner has another error for them."""
    try:
        yield
    except (ValueError, RuntimeError) as error:
        if not _is_finite(network()):
            raise _diverged(recipe, steps) from error
        raise
    if not _is_finite(network()):
        raise _diverged(recipe, steps)


def _is_finite(tensors: Iterable[Any]) -> bool:
    return all(bool(each.isfinite().all()) for each in tensors)


def _diverged(recipe: Recipe, steps: int) -> HandError:
    return HandError(
        f"the training diverged in the round after {steps:,} actions: its policy's weights or spread are not finite: "
        f"choose a learning_rate below {recipe.learning_rate:g} or a reward_scale below {recipe.reward_scale:g}, and "
        "another folder"
    )


def training_note(recipe: Recipe, progress: TrainingProgress) -> str:
    """How a policy was trained, for its card."""
    how = "PPO" if recipe.teacher is None else f"DAgger of {recipe.teacher}"
    how += "" if recipe.start is None else f" from {recipe.start} on"
    return f"{how}, seed {recipe.seed}, {progress.steps} actions in {progress.seconds:.0f} s"


def round_length(recipe: Recipe, progress: TrainingProgress) -> int:
    """Actions of the next round. The last is shorter where a training goes on that has begun with fewer steps."""
    return min(recipe.round_steps, recipe.total - progress.steps)


def write_recipe(folder: Path, recipe: Settings) -> None:
    """Write the recipe of the policy in a folder."""
    with atomic_file(folder / "recipe.json") as temporary:
        temporary.write_text(json.dumps(recipe.model_dump(mode="json"), indent=1))


def learning_rate(recipe: Recipe, progress: TrainingProgress) -> float:
    """Learning rate of the next round: it falls in a straight line to a tenth."""
    return recipe.learning_rate * (1.0 - (1.0 - FINAL_RATE) * progress.steps / recipe.total)


def round_seed(seed: int, rounds: int) -> int:
    """Seed of the first simulation in a round, with Stable-Baselines3; the others' follow it."""
    return (seed + rounds * ROUND_SEEDS) % 2**31


def goal_distance(recipe: Recipe, progress: TrainingProgress) -> float | None:
    """Distance of goals in the next round, rad, where the recipe has a range."""
    if recipe.farthest is None:
        return None
    near, far = recipe.farthest
    return near + (far - near) * min(progress.steps / max(recipe.total - recipe.round_steps, 1), 1.0)
