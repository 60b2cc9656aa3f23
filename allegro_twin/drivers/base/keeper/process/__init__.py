"""The process that leaves a hand limp when the program that drives it dies or stalls.

It runs as a package of its own, isolated, and imports nothing but the standard library, so that it starts in 50 ms. It
knows frames and bytes, not hands. Standard input is a socket to the program: one line of JSON (`Orders`), then a byte
whenever a cell has changed; its end is the program's end. The heartbeat is in shared memory, in these cells.
"""

from __future__ import annotations

from typing import Any, NamedTuple

BEAT, PATIENCE, ARMED, VOICE, CUTS, OWED = range(6)
"""Cells of the shared memory: when the program called last and how long it may stay away, ns on the monotonic clock (0:
for ever); whether the motors may be on; what the program wants said; how often the hand was cut off; whether the hand
is being told, and this has not come to its end."""
SPEAK, HUSH = 1, 2
"""VOICE: leave the hand limp now; be silent, for the program speaks to the hand itself."""


class Orders(NamedTuple):
    """The first line that the program sends."""

    program: int
    """Its process id."""
    memory: int
    """Descriptor of the shared memory."""
    address: dict[str, Any]
    """`kind` of the way to the hand (socketcan, slcan, socketcand or bytes), and what it takes."""
    limp: list[tuple[int, str, bool]]
    """Frames that leave the hand limp: identifiers, data in hexadecimal, whether remote. None for `bytes`, a way that
    has its words and knows no answer."""
    reports: list[int]
    """Identifiers of the hand's reports."""
    ask: tuple[int, int, int] | None
    """Identifier that asks whether the motors are on, the byte of the answer and its bit; None: it cannot be asked."""
