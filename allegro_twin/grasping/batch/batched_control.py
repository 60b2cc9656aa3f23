"""What controllers of many hands tell the motors: along trajectories as arrays, any other controller one by one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from allegro_twin.backend import position_of, torque_of
from allegro_twin.control import laws
from allegro_twin.control.controllers import PD, Gains, GravityFeedforward, PositionControl
from allegro_twin.control.trajectory import BatchedTrajectories, Trajectory
from allegro_twin.controller import Controller
from allegro_twin.safety import Limits, bounded, clamp
from allegro_twin.sim.batch.cpu import Rows, SimBatch
from allegro_twin.types import Array, HandState


class BatchedControllers:
    """A controller for each simulation, bit for bit as if it were alone behind the guard: of torques, or, where hands
    close their own loop, of positions."""

    def __init__(
        self, controllers: Sequence[Controller[Any]], states: Sequence[HandState], limits: Limits, sims: SimBatch
    ) -> None:
        self._controllers, self._limits, self._sims, self._spec = controllers, limits, sims, sims.spec
        self._memory = [each.start(state) for each, state in zip(controllers, states, strict=True)]
        self._gravity = next((each.gravity for each in controllers if isinstance(each, PD)), None)
        self._place = np.full(len(controllers), -1)
        """Of each controller among those along trajectories."""
        self._effort = np.tile(self._spec.actuation.torque_limit, (len(controllers), 1))
        paths, gains = list[Trajectory](), list[Gains]()
        for row, (each, memory) in enumerate(zip(controllers, self._memory, strict=True)):
            alike = (
                isinstance(each, PositionControl)
                if sims.closes_loop
                else isinstance(each, PD) and each.gravity is self._gravity
            )
            if not alike or not isinstance(memory.path, Trajectory):
                continue
            self._place[row] = len(paths)
            paths.append(memory.path)
            if isinstance(each, PD):
                gains.append(each.gains)
            else:
                self._effort[row] = self._bounded(row, states[row])[1]
        self._paths = BatchedTrajectories(paths) if paths else None
        self._kp, self._kd = (np.array([getattr(each, name) for each in gains]) for name in ("kp", "kd"))

    def __call__(self, rows: Rows, t: float, state_of: Callable[[int], HandState]) -> Array:
        """What the motors of some rows are told at a time, s: (rows, joints), as of `SimBatch.advance`."""
        return (self._positions if self._sims.closes_loop else self._torques)(rows, t, state_of)

    def _torques(self, rows: Rows, t: float, state_of: Callable[[int], HandState]) -> Array:
        torque, sims = np.empty((len(rows), self._spec.n_joints)), self._sims
        along = self._place[rows] >= 0
        if self._paths is not None and along.any():
            places = self._place[rows[along]]
            target, gains = self._paths(places, t), (self._kp[places], self._kd[places])
            torque[along] = pd_torque(sims, rows[along], target.position, target.velocity, gains, self._gravity)
        for place in np.flatnonzero(~along).tolist():
            row = int(rows[place])
            command, self._memory[row] = self._controllers[row](state_of(row), self._memory[row])
            torque[place] = torque_of(command, self._spec)
        return clamp_torques(torque, sims.position[rows], self._limits)

    def _positions(self, rows: Rows, t: float, state_of: Callable[[int], HandState]) -> Array:
        position, duration = np.empty((len(rows), self._spec.n_joints)), np.zeros(len(rows))
        along = self._place[rows] >= 0
        if self._paths is not None and along.any():
            wanted = self._paths(self._place[rows[along]], t).position
            position[along] = np.minimum(np.maximum(wanted, self._limits.lower), self._limits.upper)
        for place in np.flatnonzero(~along).tolist():
            row = int(rows[place])
            position[place], self._effort[row], duration[place] = self._bounded(row, state_of(row))
        return self._sims.servo_control(rows, position, self._effort[rows], duration)

    def _bounded(self, row: int, state: HandState) -> tuple[Array, Array, float]:
        """Position, effort and duration that a controller may ask for; an effort that it does not name is the
        hand's."""
        command, self._memory[row] = self._controllers[row](state, self._memory[row])
        asked = bounded(position_of(command, self._spec), state, self._limits, self._spec)
        effort = self._spec.actuation.torque_limit if asked.effort is None else asked.effort
        return asked.position, effort, asked.duration or 0.0


def pd_torque(
    sims: SimBatch,
    rows: Rows,
    position: Array,
    velocity: Array,
    gains: tuple[Array, Array],
    gravity: GravityFeedforward | None,
) -> Array:
    """PD of some hands towards positions, rad, at speeds, rad/s, with their weight carried, (rows, joints), N·m.
    `gains`: kp and kd, (joints,) or (rows, joints)."""
    now, feed = sims.position[rows], np.zeros(1)
    if gravity is not None:
        down = sims.gravity[rows] if gravity.vector is None else np.tile(gravity.vector, (len(rows), 1))
        feed = gravity.torque_of(now, down)
    return laws.pd(position - now, velocity - sims.velocity[rows], *gains, feed)


def clamp_torques(torque: Array, position: Array, limits: Limits) -> Array:
    """As `safety.clamp`, of many hands whose temperature nobody reports, (n, joints)."""
    seen = _States(position, np.full(position.shape, np.nan))
    return clamp(torque, seen, limits)  # type: ignore[arg-type]  # It reads no more of a state than this.


@dataclass(frozen=True, slots=True, eq=False)
class _States:
    """What the guard reads of many states."""

    position: Array
    temperature: Array
