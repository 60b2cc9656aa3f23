"""Lift task: take an object from a table. The wrist, on a slide, comes down, waits for the fingers and goes up
again."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from allegro_twin.learning.environments.objects import ObjectChoice
from allegro_twin.learning.environments.random_streams import Draws
from allegro_twin.learning.environments.settings import EnvSettings, ResetOptions
from allegro_twin.learning.policy.interface import Observation
from allegro_twin.learning.tasks.base import StepOutcome, Ticks
from allegro_twin.learning.tasks.scenes import (
    TaskScene,
    grasped_from_above,
    known_scenarios,
    require_objects,
    table_scene,
)
from allegro_twin.learning.tasks.scripted_closing import ScriptedClosingTask
from allegro_twin.learning.tasks.vectors import effort_cost, length
from allegro_twin.sim.batch.core import Rows
from allegro_twin.sim.model import wrist
from allegro_twin.types import Array, Vector

DOWN, UP, HOLD = 0.5, 0.8, 0.8  # s: the wrist goes down, up, and stays there.
HEIGHT = 0.10  # m that the wrist lifts.
LIFTED = 0.8  # Share of that height at which an object counts as lifted.
SHOVED = 0.08  # m that an object may be moved along the table before the attempt ends.


class LiftTask(ScriptedClosingTask):
    """The scripted grasp closes where the object should stand; the object is off by the position noise. Success is an
    object that is up at the end, and that the hand touches."""

    name = "Lift"
    purpose = "lift an object from a table; the wrist on a slide follows a timeline"
    reward_terms: ClassVar[dict[str, float]] = {"rise": 1.0, "effort": 1.0}
    seconds = 4.5
    after = UP + HOLD
    options = ("object", "size", "friction", "grasp", "posture", "position_noise")

    def __init__(self, settings: EnvSettings, n: int, threads: int) -> None:
        super().__init__(settings, n, threads)
        xp = self.worlds.xp
        self.place = xp.zeros((n, 3))
        """Position of the object on the table, m, world."""
        self._level = xp.asarray(np.array([1.0, 1.0, 0.0]))
        self._periods = xp.arange(settings.decimation)[:, None]
        self._wish = self.worlds.set_point("wrist_z")

    def object_choices(self) -> tuple[ObjectChoice, ...]:
        """The demo's objects alone, or all."""
        names, demo = grasped_from_above(self.spec.model), known_scenarios(self.spec.model)
        if self.settings.level == "easy":
            names = tuple(name for name in names if Path(demo[name]).parent.name != "more")
        return self.settings.objects or require_objects(names, self.spec, self.name)

    def make_scene(self, choice: ObjectChoice, grasp: str | None) -> TaskScene:
        return table_scene(choice, self.spec, self.settings, grasp)

    def grasp_offset(self, scene: TaskScene, size: float) -> Vector:
        # A larger object stands higher, and the palm would come down to it.
        return np.array([0.0, 0.0, scene.retreat[2] + scene.pose[2] * (size - 1.0)])

    def update_tables(self) -> None:
        period = self.settings.period
        place = self.worlds.xp.asarray
        self._up = place(np.array([self.closing_period(scene) for scene in self.scenes]))
        self._heights = place(np.array([scene.pose[2] for scene in self.scenes]))
        courses = np.zeros((len(self.scenes), self.periods + 1))
        for row, scene in zip(courses, self.scenes, strict=True):
            waiting = self.closing_period(scene) * period - DOWN
            moves = [(DOWN, -scene.retreat[2]), (waiting, 0.0), (UP, HEIGHT)]
            segments = [wrist.WristSegment(s, np.array([0, 0, z, 0, 0, 0.0]), np.zeros(6)) for s, z in moves]
            heights = wrist.wrist_set_points(segments, period, wrist.wrist_load(scene.model))[: len(row), 2]
            row[: len(heights)] = heights
            row[len(heights) :] = heights[-1]
        self._wishes = place(courses)

    def begin(self, rows: Rows, variant: Rows, draws: Draws, values: dict[str, Array], options: ResetOptions) -> None:
        super().begin(rows, variant, draws, values, options)
        assert self.object_body is not None
        self.offset[rows, 2] = 0.0
        self.object_body.pose[rows, :3] += self.offset[rows]
        self.object_body.pose[rows, 2] = self._heights[variant] * values.get("size", 1.0)
        self.place[rows] = self.object_body.pose[rows, :3]

    def plan_surroundings(self, tick: Ticks) -> None:
        self.contacts.begin_decision()
        ticks = self.worlds.xp.minimum(tick + self._periods, self.periods)
        self._course = self._wishes[self.script, ticks]

    def move_surroundings(self, k: int) -> None:
        self._wish[:] = self._course[k]

    def live_arrays(self) -> dict[str, NDArray[Any]]:
        return super().live_arrays() | {"place": self.place}

    def outcome(self, tick: Ticks, action: Array, observation: Observation) -> StepOutcome:
        assert self.object_body is not None
        up, period = self._up[self.script], self.settings.period
        moved = self.object_body.pose[:, :3] - self.place
        xp = self.worlds.xp
        rise = xp.where(tick > up, xp.minimum(xp.maximum(moved[:, 2] / HEIGHT, 0.0), 1.0), 0.0)
        shoved = length(moved * self._level)
        effort = effort_cost(action)
        over = tick >= up + (UP + HOLD) / period
        missed = (tick >= up + UP / period) & (rise < 0.2)
        terms = {"rise": rise, "effort": effort}
        return StepOutcome(rise + effort, missed | (shoved > SHOVED), over & (rise >= LIFTED) & self.held(), terms)
