"""Reach task: bring all fingertips to given points."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from allegro_twin.array_api import as_array, to_numpy
from allegro_twin.errors import ConfigError
from allegro_twin.hands.library.library import home_posture, load_posture
from allegro_twin.kinematics.orientation import quaternion_facing
from allegro_twin.learning.environments.random_streams import Draws
from allegro_twin.learning.environments.settings import EnvSettings, ResetOptions
from allegro_twin.learning.policy.interface import Floats, Observation
from allegro_twin.learning.tasks.base import StepOutcome, Task, Ticks
from allegro_twin.learning.tasks.scenes import compile_task_scene, make_worlds
from allegro_twin.learning.tasks.vectors import length
from allegro_twin.sim.batch.core import Rows
from allegro_twin.sim.contact.probe import contact_free_postures
from allegro_twin.sim.model.scene import Stage
from allegro_twin.types import Array
from allegro_twin.viewing.overlays import Mark

GOALS, SEED = (
    1024,
    20260101,
)  # The goals are the fingertips of this many postures without contact, always the same ones.
INSIDE = 0.8  # Share of each joint's range in which these postures lie.
# m, every fingertip. PD control without gravity compensation is off by 1 mm (docs/reference/allegro_model.md#gains).
REACHED = 0.010

MARK, GREEN = 0.006, (0.1, 0.75, 0.3, 1.0)  # m, radius of a goal in pictures; its colour.


class ReachTask(Task):
    """The hand alone, upright. A goal is the fingertip positions of some posture without contact.

    Reward and success follow from the true joint positions. `achieved_goal` is what the hand reports, with the noise
    and delay of `randomise`, so `compute_reward` of it differs from the reward.
    """

    name = "Reach"
    purpose = "bring all fingertips to given points in the palm frame"
    seconds = 2.0
    options = ("posture",)

    def __init__(self, settings: EnvSettings, n: int, threads: int) -> None:
        super().__init__(settings, n, threads)
        if settings.objects is not None:
            raise ConfigError("Reach has no objects to choose")
        model = compile_task_scene(self.spec, Stage(np.zeros(3), quaternion_facing((1, 0, 0), (0, 0, 1))), settings)
        self.worlds = make_worlds(self.spec, model, n, threads, settings)
        self.interface = self._interface(goal="fingertips", step=0.15)
        middle, half = self.interface.middle, self.interface.half
        # The table of the right hand, mirrored: both sides have the same goals.
        wishes = middle + INSIDE * half * np.random.default_rng(SEED).uniform(-1.0, 1.0, (8 * GOALS, len(middle)))
        free, xp = contact_free_postures(model, self.spec, wishes, GOALS), self.worlds.xp
        self._goals = xp.asarray(self.interface.fingertips(xp.asarray(free)), np.float32)
        self._goal: Floats = xp.zeros((n, self.interface.n_goal), np.float32)
        self._drawn: Floats = xp.zeros((n, self.interface.n_goal), np.float32)
        """Goals, and those that the reset has drawn."""
        known = home_posture(self.spec)
        home = self.spec.rest if known is None else known
        self._start = xp.asarray(home)

    def variant(self, rows: Rows, draws: Draws, options: ResetOptions) -> Rows:
        found: Rows = self.worlds.xp.zeros(len(rows), np.int64)
        return found

    def begin(self, rows: Rows, variant: Rows, draws: Draws, values: dict[str, Array], options: ResetOptions) -> None:
        xp = self.worlds.xp
        start = self._start if options.posture is None else xp.asarray(load_posture(options.posture, self.spec))
        self.worlds.place(rows, start)
        self._drawn[rows] = self._goal[rows] = self._goals[draws.integers(len(self._goals))]

    def marks(self, row: int) -> list[Mark]:
        """A ball at each goal. The palm's frame is the world's, except for a randomised tilt of the wrist."""
        size = np.full(3, MARK)
        places = to_numpy(self._goal[row]).astype(np.float64).reshape(-1, 3)
        return [Mark("sphere", size, np.array([*place, 1.0, 0.0, 0.0, 0.0]), GREEN) for place in places]

    def live_arrays(self) -> dict[str, NDArray[Any]]:
        return {"goal": self._goal, "drawn": self._drawn}

    def goal(self) -> Floats:
        return self._goal

    def set_goal(self, row: int, goal: Array | None) -> None:
        """Another goal, (3 * fingers,), m, palm frame, until the next reset; None: that of the reset."""
        self._goal[row] = self._drawn[row] if goal is None else self.worlds.xp.asarray(goal, np.float32)

    def describe_outcome(self, terms: Mapping[str, float], success: bool) -> str:
        distance = f"fingertips {terms['distance'] * 1000.0:.1f} mm from their goals in the mean"
        return f"{distance}, {'reached' if success else f'not reached (every one within {REACHED * 1000.0:g} mm)'}"

    def outcome(self, tick: Ticks, action: Array, observation: Observation) -> StepOutcome:
        xp = self.worlds.xp
        # In the precision of observations: without noise `compute_reward` of an observation is the reward to the bit.
        achieved = xp.asarray(self.interface.fingertips(xp.nan_to_num(self.worlds.position)), np.float32)
        distances = self._distances(achieved, self._goal)
        reward = self._reward(distances)
        return StepOutcome(
            reward, xp.zeros(self.n, bool), xp.max(distances, axis=-1) < REACHED, {"distance": distances.mean(axis=-1)}
        )

    def reward(self, achieved: ArrayLike, desired: ArrayLike, dropped: Array, held: ArrayLike = 1.0) -> Array:
        """Minus the mean distance of the fingertips from their goals, in dm; goals (..., 3 * fingers), m."""
        return self._reward(self._distances(achieved, desired))

    def _reward(self, distances: Array) -> Array:
        reward: Array = distances.sum(axis=-1) * (-10.0 / distances.shape[-1])
        return reward

    def _distances(self, achieved: ArrayLike, desired: ArrayLike) -> Array:
        """Distance of every fingertip, (..., fingers), m."""
        distances = as_array(desired) - as_array(achieved)
        return length(distances.reshape(*distances.shape[:-1], -1, 3))
