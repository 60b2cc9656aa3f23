"""Reorient: turn a cube in the upturned hand to a wanted orientation."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from allegro_twin.gym.noise import Draws
from allegro_twin.gym.settings import EnvSettings, Options
from allegro_twin.gym.tasks.base import Outcome, Ticks
from allegro_twin.gym.tasks.in_hand import InHand
from allegro_twin.kinematics.orientation import angle_between_quaternions, turned_by
from allegro_twin.policy.interface import Floats, Observation
from allegro_twin.sim.batch import Rows
from allegro_twin.types import Array

REACHED = 0.1  # rad, as in MuJoCo Playground's LeapCubeReorient.
FARTHEST = np.pi  # rad about a random axis, that a goal is from where the object lies.


class Reorient(InHand):
    """A goal is an orientation, as a quaternion w, x, y, z in the world, whose x is where the fingers point."""

    name = "Reorient"
    purpose = "turn a cube in the palm to a goal orientation"
    seconds = 8.0

    def __init__(self, settings: EnvSettings, n: int, threads: int) -> None:
        super().__init__(settings, n, threads)
        self._goal = np.zeros((n, 4), np.float32)

    def begin(self, rows: Rows, variant: Rows, draws: Draws, values: dict[str, Array], options: Options) -> None:
        super().begin(rows, variant, draws, values, options)
        assert self.thing is not None
        turn = draws.direction() * draws.within(0.0, FARTHEST)
        self._goal[rows] = turned_by(self.thing.pose[rows, 3:], turn)

    def goal(self) -> Floats:
        return self._goal

    def achieved(self) -> Array:
        assert self.thing is not None
        return self.thing.pose[:, 3:]

    def outcome(self, tick: Ticks, action: Array, observation: Observation) -> Outcome:
        assert isinstance(observation, dict)
        reward = self.reward(observation["achieved_goal"], observation["desired_goal"])
        return Outcome(reward, self.lost(), -reward < REACHED, {"angle": -reward})

    def reward(self, achieved: ArrayLike, desired: ArrayLike) -> Array:
        """Minus the angle between the orientations (..., 4), rad."""
        return -angle_between_quaternions(np.asarray(achieved, np.float64), np.asarray(desired, np.float64))
