"""Changing the controller while the hand is moving, without a jump of torque."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from allegro_twin.types import Command, HandState, PositionCommand, TorqueCommand, Vector

HANDOVER = 0.25  # s. A full reversal of the clip then changes by 2.4 % of it a period.


class Driving(NamedTuple):
    """What a relay remembers."""

    driver: Any
    """The controller that drives now."""
    memory: Any
    since: float
    """When it took over, s."""
    torque: Vector
    """What was sent last, within the clip, (n,), N·m."""
    offset: Vector
    """The difference to the one before at the takeover, (n,), N·m; it fades away."""


@dataclass(slots=True, eq=False)
class Relay:
    """A controller that passes the hand from one controller to the next.

    `switch` may be called from any thread; the new controller begins at the next state. At that moment the torque stays
    what it was; the difference to what the new controller wants fades over `HANDOVER`: τ = τ_new + (1 - s) (τ_before -
    τ_new(t₀)), s the minimum-jerk step from 0 to 1. `cut` is the exception, for a stop: nothing fades. Positions are
    passed on as they are.
    """

    first: Any
    torque_limit: Vector
    """The hand's clip, (n,), N·m: torques beyond it are not what was sent."""
    _waiting: list[Callable[[HandState, Driving], Driving]] = field(default_factory=list)

    def switch(self, controller: Any) -> None:
        """Hand over to another controller at the next state."""
        self._waiting.append(lambda state, memory: self._take_over(controller, controller.start(state), state, memory))

    def cut(self, controller: Any) -> None:
        """Another controller at the next state, and nothing of the torque before it."""
        nothing = np.zeros_like(self.torque_limit)
        self._waiting.append(
            lambda state, memory: Driving(controller, controller.start(state), state.t, nothing, nothing)
        )

    def amend(self, change: Callable[[Any], Any]) -> None:
        """Replace the controller by a changed copy of itself, which goes on with the same memory."""
        self._waiting.append(lambda state, memory: self._take_over(change(memory.driver), memory.memory, state, memory))

    def start(self, state: HandState) -> Driving:
        nothing = np.zeros_like(self.torque_limit)
        return Driving(self.first, self.first.start(state), state.t, nothing, nothing)

    def __call__(self, state: HandState, memory: Driving) -> tuple[Command, Driving]:
        while self._waiting:
            memory = self._waiting.pop(0)(state, memory)
        command, inner = memory.driver(state, memory.memory)
        if isinstance(command, PositionCommand):  # The hand's own loop knows no jump of torque.
            return command, memory._replace(memory=inner)
        wanted = self._clipped(command)
        s = min((state.t - memory.since) / HANDOVER, 1.0)
        torque = wanted + (1.0 - s**3 * (10.0 - 15.0 * s + 6.0 * s**2)) * memory.offset
        torque = np.minimum(np.maximum(torque, -self.torque_limit), self.torque_limit)
        return TorqueCommand(torque), memory._replace(memory=inner, torque=torque)

    def _take_over(self, controller: Any, inner: Any, state: HandState, memory: Driving) -> Driving:
        command, _ = controller(state, inner)
        return Driving(controller, inner, state.t, memory.torque, memory.torque - self._clipped(command))

    def _clipped(self, command: Command) -> Vector:
        if isinstance(command, PositionCommand):
            return np.zeros_like(self.torque_limit)
        clipped: Vector = np.minimum(np.maximum(command.torque, -self.torque_limit), self.torque_limit)
        return clipped
