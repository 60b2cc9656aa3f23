"""Controllers of joints: constant torque, gravity compensation, PD, PID, and set-points for a hand's own loop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np

from allegro_twin.control import laws
from allegro_twin.control.motion_feedforward import MotionFeedforward
from allegro_twin.control.trajectory import Path, Reference
from allegro_twin.errors import ConfigError
from allegro_twin.types import Command, HandState, PositionCommand, TorqueCommand, Vector

GravityTorque: TypeAlias = Callable[[Vector, Vector], Vector]
"""(joint positions (n,) rad, gravity in the palm frame (3,) m/s²) -> torques that hold the hand still (n,), N·m."""


@dataclass(frozen=True, slots=True, eq=False)
class GravityFeedforward:
    """Torques that carry the hand's own weight, at every orientation of the palm."""

    torque_of: GravityTorque
    vector: Vector | None = None
    """Gravity in the palm frame where the hand does not report it or is wrong about it, shape (3,), m/s²."""

    def check(self, state: HandState) -> None:
        """Raise ConfigError where the direction of gravity is unknown."""
        if self.vector is None and not np.isfinite(state.gravity).all():
            raise ConfigError(
                "this hand reports no gravity: have its IMU tell it (`backend.imu: 0.05`, CAN hands from v4 on), or, "
                "where the palm does not turn, give its backend or the controller `gravity`, palm frame, m/s²; or "
                "leave the weight uncarried, `controller.compensate: false`"
            )

    def __call__(self, state: HandState) -> Vector:
        return self.torque_of(state.position, state.gravity if self.vector is None else self.vector)


@dataclass(frozen=True, slots=True, eq=False)
class Gains:
    """Gains of a PD or PID controller, one value a joint, shape (n,)."""

    kp: Vector
    """N·m/rad."""
    kd: Vector
    """N·m·s/rad."""
    ki: Vector
    """N·m/(rad·s); only PID uses it."""
    clamp: Vector
    """The largest integral term, N·m; only PID uses it."""


@dataclass(frozen=True, slots=True, eq=False)
class ConstantTorque:
    """Constant torques."""

    torque: Vector
    """Shape (n,), N·m."""

    def start(self, state: HandState) -> None:
        return None

    def __call__(self, state: HandState, memory: None) -> tuple[TorqueCommand, None]:
        return TorqueCommand(self.torque), None


@dataclass(frozen=True, slots=True, eq=False)
class GravityCompensation:
    """Torques that carry the hand's own weight alone, so that a person can move the fingers."""

    gravity: GravityFeedforward

    def start(self, state: HandState) -> None:
        self.gravity.check(state)

    def __call__(self, state: HandState, memory: None) -> tuple[TorqueCommand, None]:
        return TorqueCommand(self.gravity(state)), None


class ReferenceMemory(NamedTuple):
    """The path that a controller follows, and since when, s."""

    path: Path
    began: float


@dataclass(frozen=True, slots=True, eq=False)
class PD:
    """Torques that follow a reference with stiffness and damping."""

    reference: Reference
    gains: Gains
    gravity: GravityFeedforward | None = None
    motion: MotionFeedforward | None = None

    def start(self, state: HandState) -> ReferenceMemory:
        if self.gravity is not None:
            self.gravity.check(state)
        return ReferenceMemory(self.reference.begin(state.position), state.t)

    def __call__(self, state: HandState, memory: ReferenceMemory) -> tuple[TorqueCommand, ReferenceMemory]:
        target = memory.path(state.t - memory.began)
        torque = laws.pd(
            target.position - state.position,
            laws.known_rate(target.velocity - state.velocity),
            self.gains.kp,
            self.gains.kd,
            _feedforward(self, state, memory),
        )
        return TorqueCommand(torque), memory


@dataclass(frozen=True, slots=True, eq=False)
class PositionControl:
    """Set-points of a reference for a hand whose firmware closes the loop."""

    reference: Reference
    effort: Vector | None = None
    """The most that each motor may give, (n,), N·m; None: what the hand allows."""

    def start(self, state: HandState) -> ReferenceMemory:
        return ReferenceMemory(self.reference.begin(state.position), state.t)

    def __call__(self, state: HandState, memory: ReferenceMemory) -> tuple[PositionCommand, ReferenceMemory]:
        return PositionCommand(memory.path(state.t - memory.began).position, self.effort), memory


@dataclass(frozen=True, slots=True, eq=False)
class ConstantCommand:
    """Controller that repeats one command, such as the one that lets the hand go limp."""

    command: Command

    def start(self, state: HandState) -> None:
        return None

    def __call__(self, state: HandState, memory: None) -> tuple[Command, None]:
        return self.command, None


class PidMemory(NamedTuple):
    """Memory of a PID controller."""

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
    gravity: GravityFeedforward | None = None
    motion: MotionFeedforward | None = None

    def start(self, state: HandState) -> PidMemory:
        if self.gravity is not None:
            self.gravity.check(state)
        return PidMemory(self.reference.begin(state.position), state.t, state.t, np.zeros_like(state.position))

    def __call__(self, state: HandState, memory: PidMemory) -> tuple[TorqueCommand, PidMemory]:
        target = memory.path(state.t - memory.began)
        torque, integral = laws.pid(
            target.position - state.position,
            laws.known_rate(target.velocity - state.velocity),
            memory.integral,
            state.t - memory.t,
            self.gains.kp,
            self.gains.ki,
            self.gains.kd,
            self.gains.clamp,
            self.torque_limit,
            _feedforward(self, state, memory),
        )
        return TorqueCommand(torque), PidMemory(memory.path, memory.began, state.t, integral)


def _feedforward(own: PD | PID, state: HandState, memory: ReferenceMemory | PidMemory) -> Vector | float:
    """What a controller adds to its feedback, (n,), N·m."""
    weight: Vector | float = 0.0 if own.gravity is None else own.gravity(state)
    return weight if own.motion is None else weight + own.motion(memory.path, state.t - memory.began)
