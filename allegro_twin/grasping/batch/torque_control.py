"""Controllers of torques side by side: PD along trajectories as arrays, any other one by one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from allegro_twin.backend import torque_of
from allegro_twin.control import laws
from allegro_twin.control.controllers import PD, GravityFeedforward
from allegro_twin.control.trajectory import BatchedTrajectories, Trajectory
from allegro_twin.controller import Controller
from allegro_twin.safety import Limits, clamp
from allegro_twin.sim.batch.simulations import Rows, Simulations
from allegro_twin.types import Array, HandState


class Torques:
    """What each of many controllers may ask for, bit for bit as if it were alone behind the guard."""

    def __init__(self, controllers: Sequence[Controller[Any]], states: Sequence[HandState], limits: Limits) -> None:
        self._controllers, self._limits = controllers, limits
        self._memory = [each.start(state) for each, state in zip(controllers, states, strict=True)]
        self._gravity: GravityFeedforward | None = next(
            (each.gravity for each in controllers if isinstance(each, PD)), None
        )
        self._place = np.full(len(controllers), -1)
        alike, paths = list[PD](), list[Trajectory]()
        for row, (each, memory) in enumerate(zip(controllers, self._memory, strict=True)):
            if isinstance(each, PD) and each.gravity is self._gravity and isinstance(memory.path, Trajectory):
                self._place[row] = len(alike)
                alike.append(each)
                paths.append(memory.path)
        if paths:
            self._paths = BatchedTrajectories(paths)
            self._kp, self._kd = np.array([(each.gains.kp, each.gains.kd) for each in alike]).swapaxes(0, 1)

    def __call__(self, rows: Rows, t: float, sims: Simulations, state_of: Callable[[int], HandState]) -> Array:
        """Of some rows at a time, s: (rows, joints), N·m."""
        torque = np.empty((len(rows), sims.spec.n_joints))
        along = self._place[rows] >= 0
        if along.any():
            torque[along] = self._pd(rows[along], t, sims)
        for place in np.flatnonzero(~along).tolist():
            row = int(rows[place])
            command, self._memory[row] = self._controllers[row](state_of(row), self._memory[row])
            torque[place] = torque_of(command, sims.spec)
        seen = _States(sims.position[rows], np.full((len(rows), sims.spec.n_joints), np.nan))
        return clamp(torque, seen, self._limits)  # type: ignore[arg-type]  # It reads no more of a state than this.

    def _pd(self, rows: Rows, t: float, sims: Simulations) -> Array:
        places, position, feed = self._place[rows], sims.position[rows], np.zeros(1)
        target = self._paths(places, t)
        if self._gravity is not None:
            down = sims.gravity[rows] if self._gravity.vector is None else np.tile(self._gravity.vector, (len(rows), 1))
            feed = self._gravity.torque_of(position, down)
        rate = target.velocity - sims.velocity[rows]
        return laws.pd(target.position - position, rate, self._kp[places], self._kd[places], feed)


@dataclass(frozen=True, slots=True, eq=False)
class _States:
    """What the guard reads of many states."""

    position: Array
    temperature: Array
