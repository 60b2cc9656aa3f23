"""Rules of a run config: what contradicts, or would be read by nobody, is an error."""

from __future__ import annotations

from collections.abc import Iterator

from allegro_twin.app.controller_settings import (
    CartesianSettings,
    FollowSettings,
    PlanningSettings,
    PolicySettings,
    PositionSettings,
)
from allegro_twin.hands.settings import TaskSettings
from allegro_twin.plugins import BackendSettings, ControllerSettings
from allegro_twin.sim.settings import SimSettings

_MOVING = (PositionSettings, FollowSettings)


def contradiction(task: TaskSettings, controller: ControllerSettings, backend: BackendSettings) -> str | None:
    """The first thing in a config that contradicts another or is read by nobody, and the way out."""
    parts = (_task(task, controller), _controller(task, controller), _backend(task, backend))
    return next((line for part in parts for line in part), None)


def _task(task: TaskSettings, controller: ControllerSettings) -> Iterator[str]:
    kind = controller.kind
    if task.object is not None and task.scenario is None:
        yield "task.object takes the place of a scenario's first object: name task.scenario, too"
    if task.episode is not None and task.scenario is not None:
        yield "task.scenario and task.episode are two scenes: leave one out"
    if isinstance(controller, PlanningSettings):
        if task.episode is None:
            yield "controller.kind mpc plans for an episode: name its task, task: {episode: {task: Rotate}}"
        if task.grasp is not None:
            yield "task.grasp is not for the mpc controller: use pd, pid or position, or leave it out"
        return
    if isinstance(controller, PolicySettings):
        return
    if isinstance(controller, _MOVING):
        if task.posture is not None and (task.scenario or task.grasp) is not None:
            other = "scenario" if task.scenario is not None else "grasp"
            yield f"task.posture and task.{other} are two motions: leave one out"
        return
    for key in () if controller.takes_posture else ("posture", "grasp"):
        if getattr(task, key) is not None:
            yield f"task.{key} is not for the {kind} controller: use pd, pid or position, or leave it out"


def _controller(task: TaskSettings, controller: ControllerSettings) -> Iterator[str]:
    given = controller.model_fields_set
    if isinstance(controller, CartesianSettings):
        if controller.kind == "impedance" and "iterations" in given:
            yield "controller.iterations are the compliance's: leave them out, or take kind: compliance"
        if task.scenario is not None:
            yield "task.scenario is a hand's: leave it out for an arm"
        return
    if task.scenario is None and task.grasp is None:
        return
    for key in ("speed", "profile"):
        if isinstance(controller, _MOVING) and key in given:
            yield f"controller.{key} is for postures; a grasp brings its own: leave it out"


def _backend(task: TaskSettings, backend: BackendSettings) -> Iterator[str]:
    scene = backend if isinstance(backend, SimSettings) else getattr(backend, "scene", None)
    if task.scenario is not None and scene is not None:
        for key in ("facing", "fingers", "timestep"):
            if key in scene.model_fields_set:
                yield f"{key} of a simulated hand is where it stands alone; task.scenario says it: leave one out"
    if task.episode is not None and scene is not None:
        for key in ("facing", "fingers", "timestep", "start", "truth"):
            if key in scene.model_fields_set:
                yield f"{key} of a simulated hand is where it stands alone; task.episode says it: leave one out"
    yield from backend.contradictions(task)
