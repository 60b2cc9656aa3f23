"""Commands and requests of a polled hand's electronics, in ticks and milliamperes."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from allegro_twin.drivers.base.difference_quotient import Exchanged
from allegro_twin.types import Vector


class MotorState(NamedTuple):
    """State of the motors as the hand reports it."""

    ticks: Vector
    """Ticks of the encoders, shape (m,)."""
    current: Vector
    """mA, shape (m,)."""
    on: bool
    """Whether the motors are switched on."""
    when: Exchanged
    """When it was asked, and answered."""
    why: str = ""
    """What the hand says is wrong with it."""


class Wire(Protocol):
    """The host's end. Raises LinkTimeout, ProtocolError or LinkError for what gets lost, HandFault for a refusal."""

    @property
    def shutdown_frames(self) -> bytes:
        """The bytes that switch all motors off."""
        ...

    def find(self) -> None:
        """Make sure that this very hand is there. Raises ConfigError for another one, LinkTimeout with the way out."""
        ...

    def go(self, ticks: list[int]) -> None:
        """Go there, (m,); motors that are off are switched on, and confirm it."""
        ...

    def stop(self) -> None:
        """All motors off, confirmed, whatever was wrong is forgotten. Raises LinkError where nobody confirms it."""
        ...

    def ask(self) -> MotorState:
        """All of one exchange."""
        ...
