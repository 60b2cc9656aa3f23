"""Cost terms of plans: joints near their ends, posture, effort, and how firmly an object is held."""

from __future__ import annotations

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.learning.environments.engine import EpisodeEngine
from allegro_twin.learning.mpc.settings import CostSettings
from allegro_twin.learning.tasks.in_hand import InHandTask
from allegro_twin.learning.tasks.vectors import rotate_vectors
from allegro_twin.types import Array

_OBJECT = ("place", "lean", "grip")
_UP = np.array([0.0, 0.0, 1.0])


class PlanCosts:
    """Costs a second of `n` simulations of one episode, besides the task's reward.

    `place`: as of `Rollouts`. Raises ConfigError for a term of an object in a task without one.
    """

    def __init__(self, settings: CostSettings, engine: EpisodeEngine, place: str = "") -> None:
        self.settings, self._engine = settings, engine
        task, spec = engine.task, engine.task.spec
        for name in _OBJECT if task.object_body is None else ():
            if getattr(settings, name) > 0:
                raise ConfigError(f"{place}costs.{name} is for tasks with an object, and {task.name} has none: leave "
                                  "it out")  # fmt: skip
        if settings.grip > 0 and not isinstance(task, InHandTask):
            raise ConfigError(f"{place}costs.grip is for objects in the fingertips, and {task.name} does not tell what "
                              "touches its object: leave it out")  # fmt: skip
        self._lower, self._range = spec.lower, spec.upper - spec.lower
        self._posture = spec.lower
        self._place: Array = np.zeros(3)
        self._axis: Array = _UP

    def begin(self, position: Array, pose: Array | None) -> None:
        """A new episode, from joint positions (joints,), rad, and the object's pose (7,), m."""
        self._posture = np.array(position)
        if pose is not None:
            self._place = np.array(pose[:3])
            self._axis = rotate_vectors(pose[None, 3:] * np.array([1.0, -1.0, -1.0, -1.0]), _UP[None])[0]

    def __call__(self) -> Array:
        """Cost of every simulation after its last step, (n,), 1/s."""
        chosen, task = self.settings, self._engine.task
        worlds = task.worlds
        found: Array = np.zeros(worlds.n)
        if chosen.ends > 0:
            part = (worlds.position - self._lower) / self._range
            near = np.minimum(part, 1.0 - part)
            found += chosen.ends * (np.maximum(1.0 - near / chosen.margin, 0.0) ** 2).sum(axis=-1)
        if chosen.posture > 0:
            away = (worlds.position - self._posture) / self._range
            found += chosen.posture * (away * away).sum(axis=-1)
        if chosen.effort > 0:
            torque = worlds.applied_torque / task.spec.actuation.torque_limit
            found += chosen.effort * (torque * torque).mean(axis=-1)
        if task.object_body is None:
            return found
        if chosen.place > 0:
            gone = (task.object_body.pose[:, :3] - self._place) / chosen.far
            found += chosen.place * (gone * gone).sum(axis=-1)
        if chosen.lean > 0:
            up = rotate_vectors(task.object_body.pose[:, 3:], np.broadcast_to(self._axis, (worlds.n, 3)))
            found += chosen.lean * (1.0 - up[:, 2])
        if chosen.grip > 0:
            assert isinstance(task, InHandTask)
            free = 1.0 - task.contacts.touching("tips") / len(task.spec.fingers)
            found += chosen.grip * free * free
        return found
