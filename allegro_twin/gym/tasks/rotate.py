"""Rotate: turn an object in the upturned hand about the vertical, on and on."""

from __future__ import annotations

import numpy as np

from allegro_twin.gym.noise import Draws
from allegro_twin.gym.settings import EnvSettings, Options
from allegro_twin.gym.tasks.base import Outcome, Ticks
from allegro_twin.gym.tasks.in_hand import InHand
from allegro_twin.gym.tasks.vectors import effort_of
from allegro_twin.kinematics.orientation import turn_about_z
from allegro_twin.policy.interface import Observation
from allegro_twin.sim.batch import Rows
from allegro_twin.types import Array

FASTEST = 1.0  # rad/s. Turning faster than this earns no more.
ENOUGH = np.pi / 2  # rad in an episode. A quarter: from there the cube looks as it did.


class Rotate(InHand):
    """Counter-clockwise seen from above for the right hand; clockwise for the left."""

    name = "Rotate"
    purpose = "rotate an object in the palm about the vertical, continuously"
    seconds = 8.0

    def __init__(self, settings: EnvSettings, n: int, threads: int) -> None:
        super().__init__(settings, n, threads)
        self._sign = 1.0 if settings.side == "right" else -1.0
        self._before = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
        self.turned = np.zeros(n)
        """Since the reset, rad."""

    def begin(self, rows: Rows, variant: Rows, draws: Draws, values: dict[str, Array], options: Options) -> None:
        super().begin(rows, variant, draws, values, options)
        assert self.thing is not None
        self._before[rows], self.turned[rows] = self.thing.pose[rows, 3:], 0.0

    def outcome(self, tick: Ticks, action: Array, observation: Observation) -> Outcome:
        assert self.thing is not None
        now = np.array(self.thing.pose[:, 3:])
        turn = self._sign * turn_about_z(self._before, now)
        self._before, self.turned = now, self.turned + turn
        speed = np.clip(turn / self.interface.seconds / FASTEST, -1.0, 1.0)
        effort = effort_of(action)
        terms = {"speed": speed, "effort": effort}
        return Outcome(speed + effort, self.lost(), self.turned >= ENOUGH, terms)
