"""The contract that every hand fulfils: simulated, on a bus, or replayed."""

from __future__ import annotations

from typing import Protocol

from allegro_twin.errors import CommandError
from allegro_twin.spec import HandSpec
from allegro_twin.types import Command, HandState, TorqueCommand, Vector


class HandBackend(Protocol):
    """Constructing acquires, `close` releases. In between: reset (write? read)*, over and over, from one thread.

    The backend owns the clock: nothing above it sleeps or asks for the time. After any HandError from `read` or
    `write` the hand is limp and stays limp until `reset`.
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
        """Begin a new session: limp, t = 0. The only way out of a fault."""
        ...

    def write(self, command: Command) -> None:
        """Set what the hand does from now on; held until replaced; returns at once. Raises CommandError."""
        ...

    def read(self) -> HandState:
        """Let one period pass; the state at its end."""
        ...

    def close(self) -> None:
        """Leave the hand limp and let go of it. Idempotent; never raises."""
        ...


def torque_of(command: Command, spec: HandSpec) -> Vector:
    """The torques of a command for a hand that takes torques, shape (m,), N·m. Raises CommandError for any other."""
    if not isinstance(command, TorqueCommand):
        raise CommandError(f"{spec.name} takes a TorqueCommand, not a {type(command).__name__}")
    if command.torque.shape[0] != spec.n_actuators:
        raise CommandError(f"{spec.name} has {spec.n_actuators} actuators; the command has {command.torque.shape[0]}")
    return command.torque
