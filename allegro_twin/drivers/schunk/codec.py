"""Frames of 24 bytes with a Fletcher-16 over bytes 1 to 21. THE LAYOUT IS OURS: Schunk has not published its own.

Known (a lab's report): RS-485, 1 MBaud, 8N1; frames of a fixed length, cyclic ones with targets out and encoder
positions and motor currents in, acyclic ones for diagnosis, padded to the same length; the checksum, and that the
firmware drops a frame in which it is wrong. Everything else is this project's, version 1, and changes here alone:

    byte  question                                answer
    0     5A                                      5A
    1     10 | kind: 1 cyclic, 2 who are you      the same, with bit 3
    2     counter                                 the question's
    3     bit 0: motors on; bit 1: forget faults  bit 0: motors on; bits 1…3: what is wrong
    4     mode: 1 position                        mode
    5     watchdog, 20 ms; 0: none                5 currents, 10 mA each, with sign: bytes 5 … 9
    6…15  5 targets, 16 bits, low byte first      5 encoders: bytes 10 … 19; who: actuators in byte 5
    …21   0                                       0
    22…23 Fletcher-16                             Fletcher-16
"""

from __future__ import annotations

import struct
from enum import IntEnum, IntFlag
from typing import NamedTuple

BAUD = 1_000_000
SIZE, SUMMED = 24, slice(1, 22)
START, LAYOUT = 0x5A, 1
PER_PERIOD = 4 * SIZE
"""Bytes on the line: a goal and a question, and their answers."""
ACTUATORS, TICKS = 5, 65_535
MILLIAMPERES = 10
"""A count of current."""
_ANSWER = 8
MARK = bytes((START, LAYOUT << 4 | _ANSWER | 1))
"""What cyclic answers begin with."""
_QUESTION, _STATE, _WHO = struct.Struct("<BBBBBB5H6x"), struct.Struct("<BBBBB5b5H2x"), struct.Struct("<BBBBBB16x")


class Kind(IntEnum):
    """Kind of a frame."""

    CYCLIC = 1
    WHO = 2


class Mode(IntEnum):
    """Control mode of the hand. There is no other: one that was driven by velocity locked two fingers and broke."""

    POSITION = 1


class Bits(IntFlag):
    """Flags in byte 3 of a frame."""

    ON = 1
    FORGET = 2
    """In a question."""
    WATCHDOG = 2
    """In an answer: nobody spoke in time."""
    MODE = 4
    """A mode was asked for that the hand does not have."""


class Question(NamedTuple):
    """Frame of the host."""

    counter: int
    on: bool = False
    forget: bool = False
    mode: int = Mode.POSITION
    watchdog: int = 0
    targets: tuple[int, ...] = (0,) * ACTUATORS
    kind: Kind = Kind.CYCLIC

    def encoded(self) -> bytes:
        bits = (Bits.ON if self.on else 0) | (Bits.FORGET if self.forget else 0)
        head = START, LAYOUT << 4 | self.kind, self.counter, bits, self.mode, self.watchdog
        return _summed(_QUESTION.pack(*head, *self.targets))


class State(NamedTuple):
    """Answer of the hand to a cyclic frame."""

    counter: int
    bits: int
    currents: tuple[int, ...]
    """10 mA each."""
    ticks: tuple[int, ...]
    mode: int = Mode.POSITION

    def encoded(self) -> bytes:
        head = START, LAYOUT << 4 | _ANSWER | Kind.CYCLIC, self.counter, self.bits, self.mode
        return _summed(_STATE.pack(*head, *self.currents, *self.ticks))


class Who(NamedTuple):
    """Answer of the hand to an identity request."""

    counter: int
    layout: int = LAYOUT
    actuators: int = ACTUATORS

    def encoded(self) -> bytes:
        return _summed(_WHO.pack(START, self.layout << 4 | _ANSWER | Kind.WHO, self.counter, 0, 0, self.actuators))


def fletcher16(data: bytes) -> tuple[int, int]:
    """Both sums, modulo 255: it cannot tell 00 from FF."""
    first = second = 0
    for byte in data:
        first = (first + byte) % 255
        second = (second + first) % 255
    return first, second


def frames(data: bytes) -> tuple[list[bytes], bytes]:
    """The sound frames in what came, and what may become one. After a damaged one the search goes on a byte later."""
    found, at = list[bytes](), data.find(START)
    while at >= 0 and len(data) - at >= SIZE:
        frame = data[at : at + SIZE]
        if sound := tuple(frame[22:]) == fletcher16(frame[SUMMED]):
            found.append(frame)
        at = data.find(START, at + (SIZE if sound else 1))
    return found, data[at:] if at >= 0 else b""


def question(frame: bytes) -> Question | None:
    """Parse a sound frame as a question; None for one that this layout does not have."""
    _, head, counter, bits, mode, watchdog, *targets = _QUESTION.unpack(frame[:22])
    if head not in (LAYOUT << 4 | Kind.CYCLIC, LAYOUT << 4 | Kind.WHO):
        return None
    on, forget = bool(bits & Bits.ON), bool(bits & Bits.FORGET)
    return Question(counter, on, forget, mode, watchdog, tuple(targets), Kind(head & 0x0F))


def state(heard: bytes, counter: int) -> State | None:
    """The answer to a cyclic frame with that counter, once it is whole in what was heard."""
    for frame in frames(heard)[0]:
        _, head, count, bits, mode, *rest = _STATE.unpack(frame[:22])
        if (head, count) == (LAYOUT << 4 | _ANSWER | Kind.CYCLIC, counter):
            return State(count, bits, tuple(rest[:ACTUATORS]), tuple(rest[ACTUATORS:]), mode)
    return None


def who(heard: bytes, counter: int) -> Who | None:
    """The answer to "who are you" with that counter, of whatever layout."""
    for frame in frames(heard)[0]:
        _, head, count, _, _, actuators = _WHO.unpack(frame[:22])
        if (head & 0x0F, count) == (_ANSWER | Kind.WHO, counter):
            return Who(count, head >> 4, actuators)
    return None


def _summed(body: bytes) -> bytes:
    return body + bytes(fletcher16(body[SUMMED]))
