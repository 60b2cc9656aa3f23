"""Controllers of hands that close their own loop, side by side: along trajectories as arrays, any other one by one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from allegro_twin.backend import position_of
from allegro_twin.control.controllers import PositionControl
from allegro_twin.control.trajectory import BatchedTrajectories, Trajectory
from allegro_twin.controller import Controller
from allegro_twin.safety import Limits, bounded
from allegro_twin.sim.batch.simulations import Rows, Simulations
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, HandState


class Goals:
    """Where each of many controllers sends its hand, bit for bit as if it were alone behind the guard."""

    def __init__(
        self, controllers: Sequence[Controller[Any]], states: Sequence[HandState], limits: Limits, spec: HandSpec
    ) -> None:
        self._controllers, self._limits, self._spec = controllers, limits, spec
        self._memory = [each.start(state) for each, state in zip(controllers, states, strict=True)]
        self._place = np.full(len(controllers), -1)
        self._effort = np.tile(spec.actuation.torque_limit, (len(controllers), 1))
        paths = list[Trajectory]()
        for row, (each, memory) in enumerate(zip(controllers, self._memory, strict=True)):
            if isinstance(each, PositionControl) and isinstance(memory.path, Trajectory):
                self._place[row] = len(paths)
                paths.append(memory.path)
                self._effort[row] = self._bounded(row, states[row])[1]
        self._paths = BatchedTrajectories(paths) if paths else None

    def __call__(self, rows: Rows, t: float, sims: Simulations, state_of: Callable[[int], HandState]) -> Array:
        """What the motors of some rows are told at a time, s: (rows, joints)."""
        position, duration, along = np.empty((len(rows), self._spec.n_joints)), np.zeros(len(rows)), self._place[rows]
        if self._paths is not None and (along >= 0).any():
            wanted = self._paths(along[along >= 0], t).position
            position[along >= 0] = np.minimum(np.maximum(wanted, self._limits.lower), self._limits.upper)
        for place in np.flatnonzero(along < 0).tolist():
            row = int(rows[place])
            position[place], self._effort[row], duration[place] = self._bounded(row, state_of(row))
        return sims.command(rows, position, self._effort[rows], duration)

    def _bounded(self, row: int, state: HandState) -> tuple[Array, Array, float]:
        """Position, effort and duration that a controller may ask for; an effort that it does not name is the
        hand's."""
        command, self._memory[row] = self._controllers[row](state, self._memory[row])
        asked = bounded(position_of(command, self._spec), state, self._limits, self._spec)
        effort = self._spec.actuation.torque_limit if asked.effort is None else asked.effort
        return asked.position, effort, asked.duration or 0.0
