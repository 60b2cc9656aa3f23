"""Grasp task: close on a presented object, and hold it when it is let go of and pushed."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from allegro_twin.learning.environments.objects import ObjectChoice
from allegro_twin.learning.environments.random_streams import Draws
from allegro_twin.learning.environments.settings import EnvSettings, ResetOptions
from allegro_twin.learning.policy.interface import Observation
from allegro_twin.learning.tasks.base import StepOutcome, Ticks
from allegro_twin.learning.tasks.scenes import TaskScene, known_scenarios, presented_scene, require_objects
from allegro_twin.learning.tasks.scripted_closing import ScriptedClosingTask
from allegro_twin.learning.tasks.vectors import effort_cost, length
from allegro_twin.sim.batch.core import Rows
from allegro_twin.types import Array, Vector

APPROACH = 0.4  # s in which the object comes from the scenario's retreat to the hand.
GRACE = 0.1  # s between the scripted squeeze and the release of the object.
CALM = 0.3  # s until the push begins,
PUSHED = 1.0  # s of its duration, half of DexGraspBench's 2 s,
PUSH = (0.5, 1.5)  # and its strength, in weights of the object; DexGraspBench: 1 without gravity, here with gravity.
HELD, LOST = 0.03, 0.05  # m from where the object was released: still held, and lost. DexGraspBench: 0.05.
WIDTH = 0.02  # m of displacement at which the reward for holding has fallen to 1/e.


class GraspTask(ScriptedClosingTask):
    """The scripted grasp closes where the object should be; the object is off by the position noise. Success is an
    object that is where it was let go of, and that the hand touches, after the push."""

    name = "Grasp"
    purpose = "close on a presented object and hold it through a push"
    reward_terms: ClassVar[dict[str, float]] = {"hold": 1.0, "effort": 1.0}
    seconds = 4.3
    after = GRACE + CALM + PUSHED
    options: ClassVar[tuple[str, ...]] = ("object", "size", "friction", "grasp", "posture", "position_noise")

    def __init__(self, settings: EnvSettings, n: int, threads: int) -> None:
        super().__init__(settings, n, threads)
        xp = self.worlds.xp
        self.push = xp.zeros((n, 3))
        """N, world."""
        self.place = xp.zeros((n, 3))
        """Position of the object at the first observation after its release, m, world."""
        self._hand, self._way, self._holds = self.worlds.presenter()
        self._periods = xp.arange(settings.decimation)[:, None]

    def object_choices(self) -> tuple[ObjectChoice, ...]:
        return self.settings.objects or require_objects(
            tuple(known_scenarios(self.spec.model))[:12], self.spec, self.name
        )

    def make_scene(self, choice: ObjectChoice, grasp: str | None) -> TaskScene:
        return presented_scene(choice, self.spec, self.settings, grasp)

    def grasp_offset(self, scene: TaskScene, size: float) -> Vector:
        return np.zeros(3)

    def update_tables(self) -> None:
        period = self.settings.period
        part = np.minimum(np.arange(self.periods + 1) * period / APPROACH, 1.0)
        place = self.worlds.xp.asarray
        self._left = place(1.0 - part**3 * (10 + part * (6 * part - 15)))  # Minimum jerk.
        self._arrived = int((part < 1.0).sum())
        self._release = place(np.array([self.closing_period(scene) + round(GRACE / period) for scene in self.scenes]))
        self._retreats = place(np.array([scene.retreat for scene in self.scenes]))
        self._middles = place(np.array([scene.pose[:3] for scene in self.scenes]))

    def begin(self, rows: Rows, variant: Rows, draws: Draws, values: dict[str, Array], options: ResetOptions) -> None:
        super().begin(rows, variant, draws, values, options)
        assert self.object_body is not None
        self.object_body.pose[rows, :3] = self._hand[rows] = self._hand_at(rows, 0 * rows)
        self._way[rows] = self.object_body.pose[rows, 3:]
        mass = self.worlds.expand("body_mass")[rows, self.object_body.id]
        weight = mass * -self.worlds.model.opt.gravity[2]
        self.push[rows] = draws.directions() * draws.uniform(*PUSH) * weight[:, None]
        self.place[rows] = self._middles[variant]
        self._holds[rows] = 1.0

    def plan_surroundings(self, tick: Ticks) -> None:
        """Sets what is the same in every period of the step once."""
        assert self.object_body is not None
        self.contacts.begin_decision()
        release, calm = self._release[self.script], CALM / self.settings.period
        first = tick - release
        going = first + self._periods
        self._path = self._forces = None
        known = self.worlds.xp is np  # On a device a check costs more than doing it all.
        earliest, latest = (first.min(), going[-1].max()) if known else (-1, calm)
        if earliest >= 0:
            self._holds[:] = 0.0
        elif latest < 0 and tick.min() >= self._arrived:
            self._hand[:], self._holds[:] = self._hand_at(slice(None), tick), 1.0
        else:
            self._path, self._holding = self._hand_at(slice(None), going + release), going < 0
        if latest >= calm:
            pushing = (going >= calm) & (going < (CALM + PUSHED) / self.settings.period)
            self._forces = self.worlds.xp.where(pushing[..., None], self.push, 0.0)
        else:
            self.object_body.force[:] = 0.0

    def move_surroundings(self, k: int) -> None:
        assert self.object_body is not None
        if self._path is not None:
            self._hand[:] = self._path[k]
            self._holds[:] = self._holding[k]
        if self._forces is not None:
            self.object_body.force[:] = self._forces[k]

    def outcome(self, tick: Ticks, action: Array, observation: Observation) -> StepOutcome:
        assert self.object_body is not None
        going = tick - self._release[self.script]
        alone = going > 0
        just = alone & (going <= self.settings.decimation)
        xp = self.worlds.xp
        self.place[...] = xp.where(just[:, None], self.object_body.pose[:, :3], self.place)
        drift = xp.where(alone, length(self.object_body.pose[:, :3] - self.place), 0.0)
        hold = xp.where(alone, xp.exp(-((drift / WIDTH) ** 2)), 0.0)
        effort = effort_cost(action)
        failed = drift > LOST
        over = going >= (CALM + PUSHED) / self.settings.period
        terms = {"hold": hold, "effort": effort}
        return StepOutcome(hold + effort, failed, over & (drift < HELD) & self.held(), terms)

    def live_arrays(self) -> dict[str, NDArray[Any]]:
        return super().live_arrays() | {"push": self.push, "place": self.place}

    def _hand_at(self, rows: Rows | slice, tick: Ticks) -> Array:
        """Position of the presenter's hand, (..., 3), m, world."""
        number = self.script[rows]
        left = self._left[self.worlds.xp.minimum(tick, len(self._left) - 1)]
        place: Array = self._middles[number] + self.offset[rows] - left[..., None] * self._retreats[number]
        return place
