"""Batched motor commands of many hands: trajectories as arrays, any other controller one by one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from allegro_twin.backend import position_of, torque_of
from allegro_twin.control import laws
from allegro_twin.control.controllers import PD, GravityFeedforward, PositionControl
from allegro_twin.control.force_grasp import LatchGrasp, LatchParameters, LatchState, latch_torque
from allegro_twin.control.trajectory import BatchedTrajectories, Trajectory
from allegro_twin.controller import Controller
from allegro_twin.safety import Limits, bounded, clamp
from allegro_twin.sim.batch.core import Rows
from allegro_twin.sim.batch.separate_models import SeparateModelBatch
from allegro_twin.types import Array, HandState


class BatchedControllers:
    """A controller for each simulation, bit for bit as if it were alone behind the guard: of torques, or, where hands
    close their own loop, of positions."""

    def __init__(
        self,
        controllers: Sequence[Controller[Any]],
        states: Sequence[HandState],
        limits: Limits,
        sims: SeparateModelBatch,
    ) -> None:
        self._controllers, self._limits, self._sims, self._spec = controllers, limits, sims, sims.spec
        self._memory = [each.start(state) for each, state in zip(controllers, states, strict=True)]
        self._gravity = next((each.gravity for each in controllers if isinstance(each, PD | LatchGrasp)), None)
        self._place = np.full(len(controllers), -1)
        """Place of each controller among those along trajectories; -1: none."""
        self._effort = np.tile(self._spec.actuation.torque_limit, (len(controllers), 1))
        paths, gains, latching = list[Trajectory](), list[tuple[Array, Array]](), list[LatchParameters]()
        self._latching = np.full(len(controllers), -1)
        """Place of each controller among those that latch; -1: none."""
        for row, (each, memory) in enumerate(zip(controllers, self._memory, strict=True)):
            alike = (
                isinstance(each, PositionControl)
                if sims.closes_loop
                else isinstance(each, PD | LatchGrasp) and each.gravity is self._gravity
            )
            alike = alike and getattr(each, "motion", None) is None
            if not alike or not isinstance(memory.path, Trajectory):
                continue
            self._place[row] = len(paths)
            paths.append(memory.path)
            if isinstance(each, LatchGrasp):
                self._latching[row] = len(latching)
                latching.append(each.parameters)
                gains.append((each.parameters.kp, each.parameters.kd))
            elif isinstance(each, PD):
                gains.append((each.gains.kp, each.gains.kd))
            else:
                self._effort[row] = self._bounded(row, states[row])[1]
        self._paths = BatchedTrajectories(paths) if paths else None
        self._kp, self._kd = (np.array([each[k] for each in gains]) for k in (0, 1))
        self._parameters = (
            LatchParameters(*(np.array(field).reshape(len(latching), -1) for field in zip(*latching, strict=True)))
            if latching
            else None
        )
        unknown = np.full((len(latching), self._spec.n_joints), np.nan)
        self._latch = LatchState(unknown, unknown.copy())

    def __call__(self, rows: Rows, t: float, state_of: Callable[[int], HandState]) -> Array:
        """What the motors of some rows are told at a time, s: (rows, joints), as of `SeparateModelBatch.advance`."""
        return (self._positions if self._sims.closes_loop else self._torques)(rows, t, state_of)

    def copy(self, rows: Rows, of: Rows) -> None:
        """Let some controllers remember what others do, (rows,) each."""
        for row, other in zip(rows.tolist(), of.tolist(), strict=True):
            self._memory[row] = self._memory[other]
        self._effort[rows] = self._effort[of]
        mine, theirs = self._latching[rows], self._latching[of]
        for kept in self._latch:
            kept[mine[mine >= 0]] = kept[theirs[mine >= 0]]

    def _torques(self, rows: Rows, t: float, state_of: Callable[[int], HandState]) -> Array:
        torque, sims = np.empty((len(rows), self._spec.n_joints)), self._sims
        latches = self._latching[rows] >= 0
        if latches.any():
            torque[latches] = self._latched(rows[latches], t)
        along = (self._place[rows] >= 0) & ~latches
        if self._paths is not None and along.any():
            places = self._place[rows[along]]
            target, gains = self._paths(places, t), (self._kp[places], self._kd[places])
            torque[along] = pd_torque(sims, rows[along], target.position, target.velocity, gains, self._gravity)
        for place in np.flatnonzero(~along & ~latches).tolist():
            row = int(rows[place])
            command, self._memory[row] = self._controllers[row](state_of(row), self._memory[row])
            torque[place] = torque_of(command, self._spec)
        return clamp_torques(torque, sims.position[rows], self._limits)

    def _latched(self, rows: Rows, t: float) -> Array:
        """Torques of those that latch, before the guard, (rows, joints), N·m."""
        assert self._paths is not None
        assert self._parameters is not None
        mine, sims = self._latching[rows], self._sims
        parameters = LatchParameters(*(np.asarray(each)[mine] for each in self._parameters))
        torque, latch = latch_torque(
            self._paths(self._place[rows], t), sims.position[rows], sims.velocity[rows], t, parameters,
            LatchState(*(each[mine] for each in self._latch)),
        )  # fmt: skip
        self._latch.rest[mine], self._latch.pressed[mine] = latch
        return torque + weight_torque(sims, rows, self._gravity)

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
    sims: SeparateModelBatch,
    rows: Rows,
    position: Array,
    velocity: Array,
    gains: tuple[Array, Array],
    gravity: GravityFeedforward | None,
) -> Array:
    """PD of some hands towards positions, rad, at speeds, rad/s, with their weight carried, (rows, joints), N·m.
    `gains`: kp and kd, (joints,) or (rows, joints)."""
    now = sims.position[rows]
    return laws.pd(position - now, velocity - sims.velocity[rows], *gains, weight_torque(sims, rows, gravity))


def weight_torque(sims: SeparateModelBatch, rows: Rows, gravity: GravityFeedforward | None) -> Array:
    """What carries the weight of some hands, (rows, joints), N·m; zero, (1,), without `gravity` or weight."""
    if gravity is None:
        return np.zeros(1)
    down = sims.gravity[rows] if gravity.vector is None else np.tile(gravity.vector, (len(rows), 1))
    if not down.any():
        return np.zeros(1)
    return gravity.torque_of(sims.position[rows], down)


def clamp_torques(torque: Array, position: Array, limits: Limits) -> Array:
    """As `safety.clamp`, of many hands whose temperature nobody reports, (n, joints)."""
    seen = _States(position, np.full(position.shape, np.nan))
    return clamp(torque, seen, limits)  # type: ignore[arg-type]  # It reads no more of a state than this.


@dataclass(frozen=True, slots=True, eq=False)
class _States:
    """States of many hands, as the guard reads them."""

    position: Array
    temperature: Array
