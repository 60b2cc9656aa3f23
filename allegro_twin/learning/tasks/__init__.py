"""Tasks by name; each is imported when it is made."""

from __future__ import annotations

from importlib import import_module

from allegro_twin._lazy import entry_points_of, import_user_module
from allegro_twin.errors import ConfigError, unknown
from allegro_twin.learning.environments.settings import EnvSettings
from allegro_twin.learning.tasks.base import Task

TASKS = {
    "Reach": "reach",
    "Grasp": "grasp",
    "Lift": "lift",
    "Pinch": "pinch",
    "HoldDisturbed": "hold_disturbed",
    "Reorient": "reorient",
    "Rotate": "rotate",
}
"""Module of each task."""
GROUP = "allegro_twin.tasks"
"""Entry points of installed packages: a name, and its `module:Class`."""
NO_BATCH = "ArmPick"
"""The environment without a batch (`allegro_twin.pick`)."""


def task_names() -> tuple[str, ...]:
    """The tasks of the package, and those that installed packages add by entry point."""
    return (*TASKS, *(name for name in sorted(entry_points_of(GROUP)) if name not in TASKS))


def task_type(name: str) -> type[Task]:
    """A task of the package or of an installed one, or `module:Class` of your own, of the current folder too. Raises
    ConfigError with the nearest names."""
    if name == NO_BATCH:
        raise ConfigError(explain_no_batch())
    if name in TASKS:
        found: type[Task] = getattr(import_module(f"allegro_twin.learning.tasks.{TASKS[name]}"), f"{name}Task")
        return found
    if ":" not in name and name not in task_names():
        raise ConfigError(unknown("task", name, task_names()))
    return _user_task(name if ":" in name else entry_points_of(GROUP)[name].value)


def explain_no_batch() -> str:
    """Message for the environment without a batch."""
    return (
        f"{NO_BATCH} is a single environment: train and evaluate take it, all else takes the tasks that have a batch; "
        f'any library trains on gymnasium.make("AllegroTwin/{NO_BATCH}-v0")'
    )


def _user_task(name: str) -> type[Task]:
    module, _, attribute = name.partition(":")
    try:
        found = getattr(import_user_module(module), attribute, None)
    except ImportError as error:
        raise ConfigError(f"task {name!r}: no module {module!r} can be imported: {error}") from error
    if not (isinstance(found, type) and issubclass(found, Task)):
        raise ConfigError(f"task {name!r}: {attribute!r} in {module} is no subclass of allegro_twin.gym.Task")
    if found.__abstractmethods__:
        missing = ", ".join(sorted(found.__abstractmethods__))
        raise ConfigError(f"task {name!r}: {attribute} in {module} has no {missing}: write what every task has")
    return found


def make_task(name: str, settings: EnvSettings, n: int, threads: int) -> Task:
    """Make a task for `n` simulations on `threads` threads; 0 for one per processor."""
    return task_type(name)(settings, n, threads)
