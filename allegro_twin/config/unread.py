"""What a config says that nobody would read: an error, for its author believes that it does something."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from allegro_twin.config.backends import VIRTUAL, CanSettings, SimSettings
from allegro_twin.config.controllers import PolicySettings, PositionSettings

if TYPE_CHECKING:
    from allegro_twin.config.run import RunConfig


def unread(config: RunConfig) -> str | None:
    """The first thing in a config that contradicts another or is read by nobody, and the way out."""
    return next((line for part in (_task, _controller, _backend) for line in part(config)), None)


def _task(config: RunConfig) -> Iterator[str]:
    task, kind = config.task, config.controller.kind
    if task.object is not None and task.scenario is None:
        yield "task.object takes the place of a scenario's first object: name task.scenario, too"
    if isinstance(config.controller, PolicySettings):
        return
    if isinstance(config.controller, PositionSettings):
        if task.posture is not None and (task.scenario or task.grasp) is not None:
            other = "scenario" if task.scenario is not None else "grasp"
            yield f"task.posture and task.{other} are two motions: leave one out"
        return
    for key in ("posture", "grasp"):
        if getattr(task, key) is not None:
            yield f"task.{key} is not for the {kind} controller: use pd or pid, or leave it out"


def _controller(config: RunConfig) -> Iterator[str]:
    given = config.controller.model_fields_set
    if config.task.scenario is None and config.task.grasp is None:
        return
    for key in ("speed", "profile"):
        if isinstance(config.controller, PositionSettings) and key in given:
            yield f"controller.{key} is for postures; a grasp brings its own: leave it out"


def _backend(config: RunConfig) -> Iterator[str]:
    backend = config.backend
    scene = backend if isinstance(backend, SimSettings) else getattr(backend, "scene", None)
    if config.task.scenario is not None and scene is not None:
        for key in ("facing", "fingers"):
            if key in scene.model_fields_set:
                yield f"{key} of a simulated hand is where it stands alone; task.scenario says it: leave one out"
    if isinstance(backend, CanSettings) and backend.interface == VIRTUAL:
        for key in ("channel", "options"):
            if key in backend.model_fields_set:
                yield f"backend.{key}: {VIRTUAL} is a bus inside this program and has none: leave it out"
