"""The contract that every hand fulfils: simulated, on a bus, or replayed."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np

from allegro_twin.errors import CommandError, HandFault
from allegro_twin.spec import HandSpec
from allegro_twin.types import Command, HandState, PositionCommand, TorqueCommand, Vector


class HandBackend(Protocol):
    """Constructing acquires, `close` releases. In between: reset (write? read)*, over and over, from one thread.

    The backend owns the clock: nothing above it sleeps or asks for the time. After a HandError from `read` or `write`
    the hand stays limp, or an arm holds itself, until `reset`, or `recover` where it is `Recoverable`. A CommandError
    is the exception: the command is refused, nothing changes, and the last one is held, so that a mistake drops no
    grasp. A guard in front of a backend takes it for a controller that went wrong, and leaves the hand limp.
    """

    @property
    def spec(self) -> HandSpec:
        """Which hand this is."""
        ...

    @property
    def period(self) -> float:
        """Nominal seconds between two states."""
        ...

    def reset(self) -> HandState:
        """Begin a new session: limp, t = 0. Leads out of a fault."""
        ...

    def write(self, command: Command) -> None:
        """Set what the hand does from now on; held until replaced; returns at once. Raises CommandError, which
        changes nothing."""
        ...

    def read(self) -> HandState:
        """Let one period pass; the state at its end."""
        ...

    def close(self) -> None:
        """Leave the hand limp and let go of it. Idempotent; never raises."""
        ...


@runtime_checkable
class Recoverable(Protocol):
    """A backend whose session a fault need not end: `recover` leads out of it, as `reset` does."""

    def recover(self) -> HandState:
        """Take commands again after a fault, in the same session; the state then."""
        ...


def recover(backend: HandBackend) -> HandState:
    """Lead a backend out of a fault without a new session. Raises HandFault where it has no other way than `reset`."""
    if not isinstance(backend, Recoverable):
        raise HandFault(f"{backend.spec.name} has no recovery from a fault: reset it")
    return backend.recover()


def torque_of(command: Command, spec: HandSpec) -> Vector:
    """The torques of a command for a hand that takes torques, shape (m,), N·m. Raises CommandError for any other."""
    if not isinstance(command, TorqueCommand):
        raise CommandError(f"{spec.name} takes a TorqueCommand, not a {type(command).__name__}")
    _as_many(command.torque, spec)
    return command.torque


def position_of(command: Command, spec: HandSpec) -> PositionCommand:
    """A command for a hand that takes positions. Raises CommandError for any other, and for a part that this hand does
    not take."""
    if not isinstance(command, PositionCommand):
        raise CommandError(f"{spec.name} takes a PositionCommand, not a {type(command).__name__}")
    _as_many(command.position, spec)
    parts = {"limited_position": command.effort is not None and not command.limp,
             "timed_position": command.duration is not None}  # fmt: skip
    for kind, asked in parts.items():
        if asked and kind not in spec.commands:
            raise CommandError(f"{spec.name} takes {', '.join(spec.commands)}, and this command is a {kind}")
    return command


def limp_of(spec: HandSpec) -> Command:
    """The command that lets go of every joint."""
    nothing = np.zeros(spec.n_actuators)
    return TorqueCommand(nothing) if "torque" in spec.commands else PositionCommand(nothing, effort=nothing)


def _as_many(values: Vector, spec: HandSpec) -> None:
    if values.shape[0] != spec.n_actuators:
        raise CommandError(f"{spec.name} has {spec.n_actuators} actuators; the command has {values.shape[0]}")


class PassThroughBackend:
    """A backend in front of another, which passes everything on; what it changes, a subclass says."""

    def __init__(self, inner: HandBackend) -> None:
        self._inner = inner

    @property
    def in_front_of(self) -> HandBackend:
        """The backend behind this one."""
        return self._inner

    @property
    def spec(self) -> HandSpec:
        return self._inner.spec

    @property
    def period(self) -> float:
        return self._inner.period

    def reset(self) -> HandState:
        return self._inner.reset()

    def write(self, command: Command) -> None:
        self._inner.write(command)

    def read(self) -> HandState:
        return self._inner.read()

    def recover(self) -> HandState:
        """As of the backend behind. Raises HandFault where only a reset leads out of a fault."""
        return recover(self._inner)

    def close(self) -> None:
        self._inner.close()
