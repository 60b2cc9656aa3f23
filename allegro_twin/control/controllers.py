"""Controllers: frozen gains and goals, pure functions from state to torque."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np

from allegro_twin.control import laws
from allegro_twin.control.trajectory import Path, Reference
from allegro_twin.errors import ConfigError
from allegro_twin.types import Command, HandState, PositionCommand, TorqueCommand, Vector

GravityTorque: TypeAlias = Callable[[Vector, Vector], Vector]
"""(joint positions (n,) rad, gravity in the palm frame (3,) m/s²) -> torques that hold the hand still (n,), N·m."""


@dataclass(frozen=True, slots=True, eq=False)
class Gravity:
    """Feed-forward that carries the hand's weight, following the palm as it turns."""

    torque_of: GravityTorque
    vector: Vector | None = None
    """Gravity in the palm frame where the hand does not report it or is wrong about it, shape (3,), m/s²."""

    def check(self, state: HandState) -> None:
        """Raise ConfigError when nobody says where down is."""
        if self.vector is None and not np.isfinite(state.gravity).all():
            raise ConfigError("this hand reports no gravity; give the controller a `gravity` vector in the palm frame")

    def __call__(self, state: HandState) -> Vector:
        return self.torque_of(state.position, state.gravity if self.vector is None else self.vector)


@dataclass(frozen=True, slots=True, eq=False)
class Gains:
    """Per joint, shape (n,)."""

    kp: Vector
    """N·m/rad."""
    kd: Vector
    """N·m·s/rad."""
    ki: Vector
    """N·m/(rad·s); only PID uses it."""
    clamp: Vector
    """The largest integral term, N·m; only PID uses it."""


@dataclass(frozen=True, slots=True, eq=False)
class Torque:
    """Set and keep the same torques."""

    torque: Vector
    """Shape (n,), N·m."""

    def start(self, state: HandState) -> None:
        return None

    def __call__(self, state: HandState, memory: None) -> tuple[TorqueCommand, None]:
        return TorqueCommand(self.torque), None


@dataclass(frozen=True, slots=True, eq=False)
class GravityCompensation:
    """Carry the hand's own weight, so that a person can move the fingers."""

    gravity: Gravity

    def start(self, state: HandState) -> None:
        self.gravity.check(state)

    def __call__(self, state: HandState, memory: None) -> tuple[TorqueCommand, None]:
        return TorqueCommand(self.gravity(state)), None


class Following(NamedTuple):
    """What a PD controller remembers: where it is going, and since when."""

    path: Path
    began: float


@dataclass(frozen=True, slots=True, eq=False)
class PD:
    """Follow a reference with stiffness and damping."""

    reference: Reference
    gains: Gains
    gravity: Gravity | None = None

    def start(self, state: HandState) -> Following:
        if self.gravity is not None:
            self.gravity.check(state)
        return Following(self.reference.begin(state.position), state.t)

    def __call__(self, state: HandState, memory: Following) -> tuple[TorqueCommand, Following]:
        target = memory.path(state.t - memory.began)
        torque = laws.pd(
            target.position - state.position,
            laws.known(target.velocity - state.velocity),
            self.gains.kp,
            self.gains.kd,
            0.0 if self.gravity is None else self.gravity(state),
        )
        return TorqueCommand(torque), memory


@dataclass(frozen=True, slots=True, eq=False)
class Follow:
    """Follow a reference with a hand whose firmware closes the loop."""

    reference: Reference
    effort: Vector | None = None
    """The most that each motor may give, (n,), N·m; None: what the hand allows."""

    def start(self, state: HandState) -> Following:
        return Following(self.reference.begin(state.position), state.t)

    def __call__(self, state: HandState, memory: Following) -> tuple[PositionCommand, Following]:
        return PositionCommand(memory.path(state.t - memory.began).position, self.effort), memory


@dataclass(frozen=True, slots=True, eq=False)
class Send:
    """Send the same command on and on: the limp one, for instance."""

    command: Command

    def start(self, state: HandState) -> None:
        return None

    def __call__(self, state: HandState, memory: None) -> tuple[Command, None]:
        return self.command, None


class Integrating(NamedTuple):
    """What a PID controller remembers."""

    path: Path
    began: float
    t: float
    integral: Vector


@dataclass(frozen=True, slots=True, eq=False)
class PID:
    """PD with an integral that removes the steady error, clamped and protected against wind-up."""

    reference: Reference
    gains: Gains
    torque_limit: Vector
    """Beyond it the integral does not grow, shape (n,), N·m."""
    gravity: Gravity | None = None

    def start(self, state: HandState) -> Integrating:
        if self.gravity is not None:
            self.gravity.check(state)
        return Integrating(self.reference.begin(state.position), state.t, state.t, np.zeros_like(state.position))

    def __call__(self, state: HandState, memory: Integrating) -> tuple[TorqueCommand, Integrating]:
        target = memory.path(state.t - memory.began)
        torque, integral = laws.pid(
            target.position - state.position,
            laws.known(target.velocity - state.velocity),
            memory.integral,
            state.t - memory.t,
            self.gains.kp,
            self.gains.ki,
            self.gains.kd,
            self.gains.clamp,
            self.torque_limit,
            0.0 if self.gravity is None else self.gravity(state),
        )
        return TorqueCommand(torque), Integrating(memory.path, memory.began, state.t, integral)
