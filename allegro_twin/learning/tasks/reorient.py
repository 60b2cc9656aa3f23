"""Reorient task: turn a box in the upturned hand to one goal orientation after another."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from allegro_twin.array_api import array_namespace, as_array, to_numpy
from allegro_twin.kinematics.orientation import angle_between_quaternions, rotate_quaternion
from allegro_twin.learning.environments.random_streams import Draws, jitter
from allegro_twin.learning.environments.settings import NEAREST, EnvSettings, ResetOptions
from allegro_twin.learning.policy.interface import Floats, Observation
from allegro_twin.learning.tasks.base import Flags, StepOutcome, Ticks
from allegro_twin.learning.tasks.in_hand import DROPPED, InHandTask
from allegro_twin.learning.tasks.vectors import twist
from allegro_twin.sim.batch.core import Rows
from allegro_twin.types import Array
from allegro_twin.viewing.overlays import Mark

REACHED = 0.1  # rad, as in MuJoCo Playground's LeapCubeReorient.
FARTHEST = {"any": np.pi, "yaw": np.pi / 2}  # rad, where the settings name no other.
WIDTH = 0.5  # rad of angle at which the reward for being near has fallen to 1/e.
BESIDE = (0.12, 0.0, 0.03)  # m: place of the goal in pictures, from where the object began.
BONUS = 10.0  # For a goal: as much as ten seconds within reach of it, so that staying short of it never pays.


class ReorientTask(InHandTask):
    """A goal is an orientation, a quaternion w, x, y, z in the world; the fingers point along x. When it is reached,
    the next step brings another.

    A goal counts, its bonus is paid, and an episode is a success, only where the hand touched the object in the last
    decision (`held`). Rewards, `reached` and success follow from the true orientation. `achieved_goal` is what a camera
    observes, with the noise and delay of `randomise`, so `compute_reward` of it differs from the reward.
    """

    name = "Reorient"
    purpose = "turn a cube in the hand to one goal orientation after another"
    seconds = 30.0
    count_term, count_unit, count_digits = "reached", "goals", 0
    own_settings: ClassVar[tuple[str, ...]] = ("goals", "farthest", "palm", "starts", "grip")
    in_fingertips = ("cube",)
    goal_is_orientation = True

    def __init__(self, settings: EnvSettings, n: int, threads: int) -> None:
        super().__init__(settings, n, threads)
        self.farthest = settings.farthest or FARTHEST[settings.goals]
        xp = self.worlds.xp
        self._goal: Floats = xp.zeros((n, 4), np.float32)
        self._key = xp.zeros(n, np.uint64)
        self._renewed = xp.zeros(n, bool)
        self.reached = xp.zeros(n, np.int64)
        """Goals reached since the reset."""

    def begin(self, rows: Rows, variant: Rows, draws: Draws, values: dict[str, Array], options: ResetOptions) -> None:
        super().begin(rows, variant, draws, values, options)
        self._key[rows], self.reached[rows], self._renewed[rows] = draws.keys(), 0, False
        self._draw_goals(rows)

    def plan_surroundings(self, tick: Ticks) -> None:
        super().plan_surroundings(tick)
        rows = self.worlds.xp.flatnonzero(self._renewed)
        if len(rows):
            self._draw_goals(rows)
            self._renewed[rows] = False

    def live_arrays(self) -> dict[str, NDArray[Any]]:
        own = {"goal": self._goal, "key": self._key, "renewed": self._renewed, "reached": self.reached}
        return super().live_arrays() | own

    def marks(self, row: int) -> list[Mark]:
        """The object in its goal orientation, beside the hand."""
        assert self.object_body is not None
        size = to_numpy(self.worlds.expand("geom_size")[row, self.object_body.geoms.start])
        pose = np.concatenate([to_numpy(self.place[row]) + BESIDE, to_numpy(self._goal[row])])
        kind = "box" if size.min() > 0 else "sphere"
        return [Mark(kind, np.array(size), pose, material="object_look")]

    def goal(self) -> Floats:
        return self._goal

    def set_goal(self, row: int, goal: Array | None) -> None:
        self._renewed[row] = goal is None
        if goal is not None:
            self._goal[row] = self.worlds.xp.asarray(goal, np.float32)

    def look(self, tick: Ticks) -> None:
        self.shown = self.camera.look(tick)

    def achieved(self, tick: Ticks) -> Array:
        return self.shown.quaternion

    def outcome(self, tick: Ticks, action: Array, observation: Observation) -> StepOutcome:
        assert self.object_body is not None
        # In the precision of observations: without noise `compute_reward` of an observation is the reward to the bit.
        angle = _angle(self.worlds.xp.asarray(self.object_body.pose[:, 3:], np.float32), self._goal)
        lost = self.lost()
        held = self.contacts.in_contact() & ~lost
        there = (angle < REACHED) & held
        self.reached += there
        self._renewed |= there
        xp = self.worlds.xp
        dropped = xp.where(lost, DROPPED, 0.0)
        terms = {
            "near": self._near(angle), "bonus": _bonus(angle, held), "dropped": dropped, "angle": angle,
            "held": xp.where(held, 1.0, 0.0),
        }  # fmt: skip
        reward = terms["near"] + terms["bonus"] + dropped
        reached = xp.asarray(self.reached, np.float64)
        return StepOutcome(
            reward, lost, (self.reached > 0) & held, terms | {"reached": reached} | self.palm_terms(tick)
        )

    def reward(self, achieved: ArrayLike, desired: ArrayLike, dropped: Array, held: ArrayLike = 1.0) -> Array:
        """Reward for orientations (..., 4): nearness, from 0 to 1 per second, the bonus for a goal with the object
        held, and the cost of a loss."""
        angle = _angle(achieved, desired)
        return self._near(angle) + _bonus(angle, as_array(held) > 0.0) + dropped

    def _near(self, angle: Array) -> Array:
        """A second at the goal is worth 1, for any number of decisions per second."""
        found: Array = self.interface.seconds * array_namespace(angle).exp(-angle / WIDTH)
        return found

    def _draw_goals(self, rows: Rows) -> None:
        """New goals, from the present orientations: each simulation's own numbers, the same in every batch."""
        assert self.object_body is not None
        xp = self.worlds.xp
        even = (jitter(self._key[rows], self.reached[rows], 10, 3) + 1.0) / 2.0
        z, around, far = (even[:, k] for k in range(3))
        angle = NEAREST + (self.farthest - NEAREST) * far
        here = self.object_body.pose[rows, 3:]
        if self.settings.goals == "yaw":
            axis = xp.stack([0.0 * z, 0.0 * z, xp.where(z < 0.5, -1.0, 1.0)], axis=-1)
            half = twist(here) / 2.0  # Upright, however the object leans.
            here = xp.stack([xp.cos(half), 0.0 * half, 0.0 * half, xp.sin(half)], axis=-1)
        else:
            height = 2.0 * z - 1.0
            radius = xp.sqrt(xp.maximum(1.0 - height * height, 0.0))
            axis = xp.stack([radius * xp.cos(2 * np.pi * around), radius * xp.sin(2 * np.pi * around), height], axis=-1)
        turned = rotate_quaternion(here, axis * angle[:, None])
        self._goal[rows] = xp.asarray(turned, np.float32)


def _angle(achieved: ArrayLike, desired: ArrayLike) -> Array:
    return angle_between_quaternions(as_array(achieved), as_array(desired))


def _bonus(angle: Array, held: Flags) -> Array:
    found: Array = array_namespace(angle).where((angle < REACHED) & held, BONUS, 0.0)
    return found
