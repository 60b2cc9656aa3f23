"""Driver protocol: the operations of a hand's own protocol that `SerialBackend` needs."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

from allegro_twin.drivers.base.difference_quotient import Exchanged
from allegro_twin.types import Vector


class Answer(NamedTuple):
    """State and health of a hand as it reports them, all of one exchange."""

    actuators: Vector
    """Where they are, shape (m,), rad."""
    position: Vector
    """Positions of the joints, shape (n,), rad; NaN where unknown, as in the following."""
    velocity: Vector | Exchanged
    """rad/s; where the hand does not say, when it was asked for the position, from whose change it follows."""
    torque: Vector
    """N·m."""
    temperature: Vector
    """°C."""


class Driver(Protocol):
    """The host's end of one hand. Raises LinkError, LinkTimeout, ProtocolError, HandFault or ConfigError."""

    on: bool
    """Whether the motors may be on."""

    @property
    def calibration(self) -> dict[str, Any]:
        """What turns this hand's ticks into rad and N·m, for recordings."""
        ...

    @property
    def shutdown_frames(self) -> bytes:
        """The bytes that switch all motors off."""
        ...

    def find(self) -> None:
        """Make sure that this very hand is there. Raises ConfigError for another one, LinkTimeout with the way out."""
        ...

    def wake(self) -> None:
        """Make ready what is there and limp; what was before is forgotten."""
        ...

    def first(self) -> Answer:
        """The first answer. Raises ConfigError for a hand that would be where it cannot be."""
        ...

    def go(self, position: Vector, effort: Vector | None) -> None:
        """Go there, (m,), rad, with no more than this, (m,), N·m; motors that are off are switched on, confirmed."""
        ...

    def again(self, position: Vector) -> None:
        """Go on to there: the way of a timed command, what got lost, and a word for the watchdog."""
        ...

    def stop(self) -> None:
        """All motors off, confirmed. Raises LinkError or ProtocolError where nobody confirms it."""
        ...

    def ask(self) -> Answer:
        """The state. Raises HandFault for what the hand says of itself."""
        ...

    def ask_more(self, tick: int) -> None:
        """What is asked now and then, once this period's state is there. Raises HandFault likewise."""
        ...

    def warnings(self) -> list[str]:
        """What went wrong without ending the session."""
        ...
