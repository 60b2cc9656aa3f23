"""What the program tells its keeper at first."""

from __future__ import annotations

from typing import Any, NamedTuple


class Orders(NamedTuple):
    """What the program says at first."""

    program: int
    """Its process id."""
    memory: int
    """Descriptor of the shared memory."""
    way: dict[str, Any]
    """`kind` of the way to the bus, and what it takes."""
    limp: list[tuple[int, str, bool]]
    """What leaves the hand limp: identifiers, data in hexadecimal, whether remote."""
    reports: list[int]
    """Identifiers of the hand's reports."""
    ask: tuple[int, int, int] | None
    """Identifier that asks whether the motors are on, the byte of the answer and its bit; None: it cannot be asked."""
