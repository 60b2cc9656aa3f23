"""Lift: take an object from a table; the wrist, on a slide, comes down, waits for the fingers and goes up again."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from allegro_twin.learning.environments.objects import Given
from allegro_twin.learning.environments.random_streams import Draws
from allegro_twin.learning.environments.settings import EnvSettings, Options
from allegro_twin.learning.policy.interface import Observation
from allegro_twin.learning.tasks.base import Outcome, Ticks
from allegro_twin.learning.tasks.scenes import Scene, from_above, known, on_table, some
from allegro_twin.learning.tasks.scripted_closing import Closing
from allegro_twin.learning.tasks.vectors import effort_of, length
from allegro_twin.sim.batch.cpu import Rows
from allegro_twin.sim.model.wrist import WristSegment, wrist_load, wrist_set_points
from allegro_twin.types import Array, Vector

DOWN, UP, HOLD = 0.5, 0.8, 0.8  # s: the wrist goes down, up, and stays there.
HEIGHT = 0.10  # m that it lifts.
LIFTED = 0.8  # Part of that height at which an object counts as lifted.
SHOVED = 0.08  # m that an object may be moved along the table before the attempt is over.


class Lift(Closing):
    """The scripted player closes where the object should stand; it is off by the position noise."""

    name = "Lift"
    purpose = "lift an object from a table; the wrist on a slide follows a timeline"
    seconds = 4.5
    after = UP + HOLD
    options = ("object", "size", "friction", "grasp", "posture", "position_noise")

    def __init__(self, settings: EnvSettings, n: int, threads: int) -> None:
        super().__init__(settings, n, threads)
        xp = self.worlds.xp
        self.place = xp.zeros((n, 3))
        """Where the object stood, m, world."""
        self._level = xp.asarray(np.array([1.0, 1.0, 0.0]))
        self._periods = xp.arange(settings.decimation)[:, None]
        self._wish = self.worlds.set_point("wrist_z")

    def things(self) -> tuple[Given, ...]:
        """Those of the demo alone, or all."""
        names, demo = from_above(self.spec.model), known(self.spec.model)
        if self.settings.level == "easy":
            names = tuple(name for name in names if Path(demo[name]).parent.name != "more")
        return self.settings.objects or some(names, self.spec, self.name)

    def scene(self, given: Given, grasp: str | None) -> Scene:
        return on_table(given, self.spec, self.settings, grasp)

    def apart(self, scene: Scene, size: float) -> Vector:
        # As the object stands higher by its greater size, and the palm would come down to it.
        return np.array([0.0, 0.0, scene.retreat[2] + scene.pose[2] * (size - 1.0)])

    def learned(self) -> None:
        period = self.settings.period
        place = self.worlds.xp.asarray
        self._up = place(np.array([self.closed(scene) for scene in self.scenes]))
        self._heights = place(np.array([scene.pose[2] for scene in self.scenes]))
        courses = np.zeros((len(self.scenes), self.periods + 1))
        for row, scene in zip(courses, self.scenes, strict=True):
            waiting = self.closed(scene) * period - DOWN
            moves = [(DOWN, -scene.retreat[2]), (waiting, 0.0), (UP, HEIGHT)]
            stretches = [WristSegment(s, np.array([0, 0, z, 0, 0, 0.0]), np.zeros(6)) for s, z in moves]
            wishes = wrist_set_points(stretches, period, wrist_load(scene.model))[: len(row), 2]
            row[: len(wishes)] = wishes
            row[len(wishes) :] = wishes[-1]
        self._wishes = place(courses)

    def begin(self, rows: Rows, variant: Rows, draws: Draws, values: dict[str, Array], options: Options) -> None:
        super().begin(rows, variant, draws, values, options)
        assert self.thing is not None
        self.offset[rows, 2] = 0.0
        self.thing.pose[rows, :3] += self.offset[rows]
        self.thing.pose[rows, 2] = self._heights[variant] * values.get("size", 1.0)
        self.place[rows] = self.thing.pose[rows, :3]

    def plan(self, tick: Ticks) -> None:
        ticks = self.worlds.xp.minimum(tick + self._periods, self.periods)
        self._course = self._wishes[self.script, ticks]

    def drive(self, k: int) -> None:
        self._wish[:] = self._course[k]

    def outcome(self, tick: Ticks, action: Array, observation: Observation) -> Outcome:
        assert self.thing is not None
        up, period = self._up[self.script], self.settings.period
        moved = self.thing.pose[:, :3] - self.place
        xp = self.worlds.xp
        rise = xp.where(tick > up, xp.minimum(xp.maximum(moved[:, 2] / HEIGHT, 0.0), 1.0), 0.0)
        shoved = length(moved * self._level)
        effort = effort_of(action)
        over = tick >= up + (UP + HOLD) / period
        missed = (tick >= up + UP / period) & (rise < 0.2)
        terms = {"rise": rise, "effort": effort}
        return Outcome(rise + effort, missed | (shoved > SHOVED), over & (rise >= LIFTED), terms)
