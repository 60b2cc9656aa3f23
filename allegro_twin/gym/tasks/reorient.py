"""Reorient: turn a box in the fingertips of the upturned hand to one wanted orientation after another."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from allegro_twin.gym.noise import Draws, jitter
from allegro_twin.gym.settings import EnvSettings, Options
from allegro_twin.gym.tasks.base import Outcome, Ticks
from allegro_twin.gym.tasks.in_hand import DROPPED, InHand
from allegro_twin.kinematics.orientation import angle_between_quaternions, turned_by
from allegro_twin.look.marks import Mark
from allegro_twin.policy.interface import Floats, Observation
from allegro_twin.sim.batch import Rows
from allegro_twin.types import Array

REACHED = 0.1  # rad, as in MuJoCo Playground's LeapCubeReorient.
NEAREST = 0.3  # rad that a new goal is away at least: never reached already.
FARTHEST = {"any": np.pi, "yaw": np.pi / 2}  # rad, where the settings name nothing else.
WIDTH = 0.5  # rad of angle at which the reward for being near has fallen to 1/e.
BESIDE = (-0.07, 0.0, 0.08)  # m, of the goal in pictures from where the object began.
BONUS = 10.0  # For a goal.


class Reorient(InHand):
    """A goal is an orientation, as a quaternion w, x, y, z in the world, whose x is where the fingers point. When it is
    reached, the next step brings another."""

    name = "Reorient"
    purpose = "turn a cube in the fingertips to one goal orientation after another"
    seconds = 30.0
    own: ClassVar[tuple[str, ...]] = ("goals", "farthest")

    def __init__(self, settings: EnvSettings, n: int, threads: int) -> None:
        super().__init__(settings, n, threads)
        self.farthest = settings.farthest or FARTHEST[settings.goals]
        self._goal = np.zeros((n, 4), np.float32)
        self._key = np.zeros(n, np.uint64)
        self._renewed = np.zeros(n, bool)
        self.reached = np.zeros(n, np.int64)
        """Goals since the reset."""

    def begin(self, rows: Rows, variant: Rows, draws: Draws, values: dict[str, Array], options: Options) -> None:
        super().begin(rows, variant, draws, values, options)
        self._key[rows], self.reached[rows], self._renewed[rows] = draws.key(), 0, False
        self._renew(rows)

    def plan(self, tick: Ticks) -> None:
        rows = np.flatnonzero(self._renewed)
        if len(rows):
            self._renew(rows)
            self._renewed[rows] = False

    def marks(self, row: int) -> list[Mark]:
        """The object as it should be turned, beside the hand."""
        assert self.thing is not None
        size = self.worlds.expand("geom_size")[row, self.thing.geoms.start]
        pose = np.concatenate([self.place[row] + BESIDE, self._goal[row]])
        kind = "box" if size.min() > 0 else "sphere"
        return [Mark(kind, np.array(size), pose, material="object_look")]

    def goal(self) -> Floats:
        return self._goal

    def achieved(self, tick: Ticks) -> Array:
        return self.camera.look(tick).quaternion

    def outcome(self, tick: Ticks, action: Array, observation: Observation) -> Outcome:
        assert isinstance(observation, dict)
        angle = _angle(observation["achieved_goal"], observation["desired_goal"])
        lost = self.lost()
        there = (angle < REACHED) & ~lost
        self.reached += there
        self._renewed |= there
        dropped = np.where(lost, DROPPED, 0.0)
        terms = {"near": _near(angle), "bonus": _bonus(angle), "dropped": dropped, "angle": angle}
        reward = terms["near"] + terms["bonus"] + dropped
        return Outcome(reward, lost, (self.reached > 0) & ~lost, terms | {"reached": self.reached.astype(np.float64)})

    def reward(self, achieved: ArrayLike, desired: ArrayLike, dropped: Array) -> Array:
        """How near the orientations (..., 4) are, from 0 to 1, the bonus for a goal, and what a loss costs."""
        angle = _angle(achieved, desired)
        return _near(angle) + _bonus(angle) + dropped

    def _renew(self, rows: Rows) -> None:
        """New goals, from where the objects are: each simulation's own numbers, the same in every batch."""
        assert self.thing is not None
        z, around, far = (jitter(self._key[rows], self.reached[rows], 10, 3).T + 1.0) / 2.0
        angle = NEAREST + (max(self.farthest, NEAREST) - NEAREST) * far
        if self.settings.goals == "yaw":
            axis = np.stack([0.0 * z, 0.0 * z, np.where(z < 0.5, -1.0, 1.0)], axis=-1)
        else:
            height = 2.0 * z - 1.0
            radius = np.sqrt(np.maximum(1.0 - height * height, 0.0))
            axis = np.stack([radius * np.cos(2 * np.pi * around), radius * np.sin(2 * np.pi * around), height], axis=-1)
        self._goal[rows] = turned_by(self.thing.pose[rows, 3:], axis * angle[:, None])


def _angle(achieved: ArrayLike, desired: ArrayLike) -> Array:
    return angle_between_quaternions(np.asarray(achieved, np.float64), np.asarray(desired, np.float64))


def _near(angle: Array) -> Array:
    return np.asarray(np.exp(-angle / WIDTH))


def _bonus(angle: Array) -> Array:
    return np.where(angle < REACHED, BONUS, 0.0)
