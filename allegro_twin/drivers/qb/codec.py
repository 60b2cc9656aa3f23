"""Packets of qb devices: `3A 3A | id | length | command, payload … | LRC`, and numbers of 16 bits, the high byte first.

Source: qbAPI (qbmove_communications.cpp) and the firmware's command_processing.c, read for their facts. The length is
that of command, payload and checksum; the LRC is the XOR of command and payload. docs/reference/serial_protocols.md
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from enum import IntEnum
from functools import reduce
from operator import xor
from typing import NamedTuple

HEADER = b"::"
BROADCAST = 0
LAST_ID = 127
"""120 is reserved."""
BAUDS = (2_000_000, 460_800)
CLOSED = 19_000
"""Ticks: the default upper limit of position; open is 0."""
ON, OFF = 3, 0
"""What Activate is told: a bit for each motor."""
_FRAME = len(HEADER) + 2
"""Bytes before the command."""
PER_PERIOD = 32
"""Bytes on the line: a goal, a question and its answer."""


class Command(IntEnum):
    """Commands that are used here."""

    PING = 0
    GET_INFO = 6
    """Payload: a number of 16 bits, which text; the answer is that text, without a packet around it."""
    ACTIVATE = 128
    GET_ACTIVATE = 129
    SET_INPUTS = 130
    GET_INPUTS = 131
    GET_MEASUREMENTS = 132
    GET_CURRENTS = 133
    GET_CURR_AND_MEAS = 134
    SET_WATCHDOG = 143
    """Payload: a byte, in 20 ms; 0: none."""


INFO_ALL, INFO_CYCLES = 0, 1
"""What GET_INFO can be asked for."""
ASK_INFO = b"?"
"""Asks for INFO_ALL without a packet, whoever is there: qbAPI's RS485GetInfo."""


class QbPacket(NamedTuple):
    """Contents of a packet between frame and checksum."""

    id: int
    command: int
    payload: bytes = b""

    def encoded(self) -> bytes:
        body = bytes((self.command,)) + self.payload
        return HEADER + bytes((self.id, len(body) + 1)) + body + bytes((lrc(body),))


def lrc(body: bytes) -> int:
    """Checksum of command and payload: the XOR of all bytes."""
    return reduce(xor, body, 0)


def size(payload: int) -> int:
    """Bytes of a packet with so many of payload."""
    return _FRAME + 1 + payload + 1


def pack_int16(*values: int) -> bytes:
    """Numbers of 16 bits with a sign; what does not fit is cut off at the ends."""
    return struct.pack(f">{len(values)}h", *(min(max(value, -32768), 32767) for value in values))


def unpack_int16(payload: bytes) -> Sequence[int]:
    """The opposite."""
    return struct.unpack(f">{len(payload) // 2}h", payload)


class QbParser:
    """Finds packets in whatever comes. One that is damaged is no packet: the search goes on a byte later."""

    def __init__(self) -> None:
        self._left = b""

    def clear(self) -> None:
        """What was not a packet yet never becomes one."""
        self._left = b""

    def feed(self, data: bytes) -> list[QbPacket]:
        """The packets that are whole now."""
        found, rest = list[QbPacket](), self._left + data
        at = rest.find(HEADER)
        while at >= 0 and len(rest) - at > _FRAME:
            length = rest[at + 3]
            end = at + _FRAME + length
            body = rest[at + _FRAME : end]
            if length < 2 or (len(body) == length and lrc(body)):  # With its checksum a sound body's XOR is 0.
                at = rest.find(HEADER, at + 1)
                continue
            if len(body) < length:
                break
            found.append(QbPacket(rest[at + 2], body[0], body[1:-1]))
            at = rest.find(HEADER, end)
            rest, at = (rest[at:], 0) if at >= 0 else (rest[end:], -1)
        self._left = rest[at:] if at >= 0 else rest[-1:] if rest.endswith(HEADER[:1]) else b""
        return found


def answer(heard: bytes, identifier: int, command: int, payload: int) -> bytes | None:
    """The payload, of so many bytes, of this device's answer to a command, once it is whole in what was heard."""
    for packet in QbParser().feed(heard):
        if packet[:2] == (identifier, command) and len(packet.payload) == payload:
            return packet.payload
    return None
