"""Changing the controller while the hand is moving, without a jump of torque."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from allegro_twin.types import Command, HandState, PositionCommand, TorqueCommand, Vector

HANDOVER = 0.25  # s. A full reversal of the clip then changes by 2.4 % of it a period.


class SwitchMemory(NamedTuple):
    """Memory of a bumpless switch."""

    driver: Any
    """The controller that is active."""
    memory: Any
    since: float
    """When it became active, s."""
    torque: Vector
    """The torque sent last, within the clip, (n,), N·m."""
    offset: Vector
    """The difference of torques at the switch, (n,), N·m, which fades."""


@dataclass(slots=True, eq=False)
class BumplessSwitch:
    """A controller that switches between controllers.

    `switch` may be called from any thread; the new controller begins at the next state. At that moment the torque does
    not change; the difference to the new controller's torque fades over `HANDOVER`: τ = τ_new + (1 - s) (τ_before -
    τ_new(t₀)), s the minimum-jerk step from 0 to 1. `cut` is for a stop: nothing fades. Position commands are passed on
    unchanged.
    """

    first: Any
    torque_limit: Vector
    """The hand's clip, (n,), N·m: torques beyond it are not what was sent."""
    _waiting: list[Callable[[HandState, SwitchMemory], SwitchMemory]] = field(default_factory=list)

    def switch(self, controller: Any) -> None:
        """Switch to another controller at the next state."""
        self._waiting.append(lambda state, memory: self._take_over(controller, controller.start(state), state, memory))

    def cut(self, controller: Any) -> None:
        """Switch to another controller at the next state, without its predecessor's torque."""
        nothing = np.zeros_like(self.torque_limit)
        self._waiting.append(
            lambda state, memory: SwitchMemory(controller, controller.start(state), state.t, nothing, nothing)
        )

    def amend(self, change: Callable[[Any], Any]) -> None:
        """Replace the controller by a changed copy of itself, which goes on with the same memory."""
        self._waiting.append(lambda state, memory: self._take_over(change(memory.driver), memory.memory, state, memory))

    def start(self, state: HandState) -> SwitchMemory:
        nothing = np.zeros_like(self.torque_limit)
        return SwitchMemory(self.first, self.first.start(state), state.t, nothing, nothing)

    def __call__(self, state: HandState, memory: SwitchMemory) -> tuple[Command, SwitchMemory]:
        while self._waiting:
            memory = self._waiting.pop(0)(state, memory)
        command, inner = memory.driver(state, memory.memory)
        if isinstance(command, PositionCommand):  # The hand's own loop has no jump of torque.
            return command, memory._replace(memory=inner)
        wanted = self._clipped(command)
        s = min((state.t - memory.since) / HANDOVER, 1.0)
        torque = wanted + (1.0 - s**3 * (10.0 - 15.0 * s + 6.0 * s**2)) * memory.offset
        torque = np.minimum(np.maximum(torque, -self.torque_limit), self.torque_limit)
        return TorqueCommand(torque), memory._replace(memory=inner, torque=torque)

    def _take_over(self, controller: Any, inner: Any, state: HandState, memory: SwitchMemory) -> SwitchMemory:
        command, _ = controller(state, inner)
        return SwitchMemory(controller, inner, state.t, memory.torque, memory.torque - self._clipped(command))

    def _clipped(self, command: Command) -> Vector:
        if isinstance(command, PositionCommand):
            return np.zeros_like(self.torque_limit)
        clipped: Vector = np.minimum(np.maximum(command.torque, -self.torque_limit), self.torque_limit)
        return clipped
