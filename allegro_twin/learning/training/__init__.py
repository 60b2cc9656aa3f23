"""Training from a recipe to a policy file: PPO by Stable-Baselines3 on processors or by rsl-rl on the simulations'
device, and imitation (DAgger)."""

from __future__ import annotations

import errno
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from allegro_twin.errors import ConfigError, RecordingError
from allegro_twin.learning.training.logs import LoggedRecipe, check_logs
from allegro_twin.learning.training.settings import Recipe, load_recipe

if TYPE_CHECKING:
    from allegro_twin.learning.training.progress import TrainingResult

_STABLE = "rl", ("torch", "stable_baselines3", "onnx")
_RSL = "rsl", ("torch", "rsl_rl", "onnx", "onnxruntime")
_DAGGER = "rl", ("torch", "onnx", "onnxruntime")

__all__ = ["Recipe", "load_recipe", "train"]


def train(
    recipe: Recipe,
    folder: Path,
    advance: Callable[[int, float, float], None] = lambda steps, mean, rate: None,
    kept: Callable[[int], None] = lambda steps: None,
    source: str = "recipe",
) -> TrainingResult:
    """Train in `folder`, or continue what is there. `advance` is called after every update with the actions taken,
    and the mean return and success rate since; `kept` with the actions of the newest checkpoint, at the beginning (0:
    there is none) and whenever one was written. `source`: where
    the recipe comes from, for errors. Raises ConfigError without the extra, for a folder of another training, and for
    objects or episodes of the evaluation that the training has, or the hand cannot take; HandError where the training
    diverges; RecordingError where the disk is full."""
    from allegro_twin.learning.training.report import check_objects, check_seeds

    check_packages(recipe)
    check_seeds(recipe, source=source)
    check_objects(recipe, source)
    module = {"rsl-rl": "rsl.ppo", "dagger": "rsl.dagger"}.get(recipe.learner, "sb3.ppo")
    learn = import_module(f"allegro_twin.learning.training.{module}").learn
    with full_disk_as_error(folder):
        trained: TrainingResult = learn(recipe, folder, advance, kept)
    return trained


@contextmanager
def full_disk_as_error(folder: Path) -> Iterator[None]:
    """Raise RecordingError where a training in `folder` finds its disk full, with what the same command does then."""
    try:
        with _errors_of_threads():
            yield
    except OSError as error:
        if not _is_full(error):
            raise
        rounds = [int(path.stem) for path in folder.glob("checkpoints/[0-9]*.*")]
        where = f"goes on from checkpoint {max(rounds)}" if rounds else "begins anew"
        raise RecordingError(f"the disk of {folder} is full: make room there, and the same command {where}") from error


@contextmanager
def _errors_of_threads() -> Iterator[None]:
    """Let what TensorBoard's thread cannot write be an error of whoever writes next, and not a traceback, too."""
    before = threading.excepthook

    def hook(found: threading.ExceptHookArgs) -> None:
        if not (isinstance(found.exc_value, OSError) and type(found.thread).__module__.startswith("tensorboard.")):
            before(found)

    threading.excepthook = hook
    try:
        yield
    finally:
        threading.excepthook = before


def _is_full(error: BaseException | None) -> bool:
    """Whether a full disk is behind an error."""
    if error is None:
        return False
    full = isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT)
    return full or _is_full(error.__cause__ or error.__context__)


def check_packages(recipe: Recipe) -> None:
    """Raise ConfigError where a package is missing that this training needs."""
    check_extra(*{"rsl-rl": _RSL, "dagger": _DAGGER}.get(recipe.learner, _STABLE), recipe)


def check_extra(extra: str, needed: Sequence[str], recipe: LoggedRecipe) -> None:
    """Raise ConfigError where one of the packages that `extra` brings is missing, or one of the recipe's logs."""
    for name in needed:
        try:
            import_module(name)
        except ImportError as error:
            raise ConfigError(f"training needs {name}: pip install 'allegro-twin[{extra}]'") from error
    check_logs(recipe, extra)
