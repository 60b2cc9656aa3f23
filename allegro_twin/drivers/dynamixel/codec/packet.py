"""DYNAMIXEL protocol 2.0: packets to bytes, and bytes back to packets whatever lies between them.

`FF FF FD 00 | id | length | instruction, parameters | CRC`, little-endian; `length` counts from the instruction to the
CRC. Within instruction and parameters `FF FF FD` is sent as `FF FF FD FD`. ROBOTIS e-Manual, protocol2.
"""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import NamedTuple, TypeAlias

HEADER = b"\xff\xff\xfd\x00"
BROADCAST = 0xFE
LAST_ID = 0xFC
LONGEST = 1024
"""Bytes from the instruction to the CRC; what claims to be longer is noise. The vendor's SDK takes no more either."""
FRAME = 10
"""Bytes of a packet without parameters: header, id, length, instruction, CRC."""
STATUS = 0x55
ALERT = 0x80
"""In a status packet's error: the servo has a hardware error."""
_HEAD = struct.Struct("<4sBH")
_POLYNOMIAL = 0x8005
STUFFS, _STUFFED = b"\xff\xff\xfd", b"\xff\xff\xfd\xfd"
"""What is written otherwise in a body, since a header begins so, and how."""


class Instruction(IntEnum):
    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REG_WRITE = 0x04
    ACTION = 0x05
    FACTORY_RESET = 0x06
    REBOOT = 0x08
    CLEAR = 0x10
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83
    BULK_READ = 0x92
    BULK_WRITE = 0x93


class PacketError(IntEnum):
    """Why a servo did not do what it was told: the error number of a status packet."""

    RESULT = 1
    INSTRUCTION = 2
    CRC = 3
    RANGE = 4
    LENGTH = 5
    LIMIT = 6
    ACCESS = 7


class DynamixelPacket(NamedTuple):
    """An instruction for a servo, or the status that it answers with."""

    id: int
    instruction: int
    parameters: bytes = b""

    def encoded(self) -> bytes:
        """As it stands on the wire. Raises ValueError where the stuffed length exceeds 65535."""
        body = bytes((self.instruction,)) + self.parameters
        if STUFFS in body:
            body = body.replace(STUFFS, _STUFFED)
        head = _HEAD.pack(HEADER, self.id, len(body) + 2) + body
        return head + crc16(head).to_bytes(2, "little")


class Damaged(NamedTuple):
    """A packet whose CRC does not fit, as far as it can be believed."""

    id: int


Heard: TypeAlias = DynamixelPacket | Damaged


def status(identifier: int, error: int, data: bytes = b"") -> DynamixelPacket:
    """What a servo answers."""
    return DynamixelPacket(identifier, STATUS, bytes((error,)) + data)


def crc16(data: bytes) -> int:
    """Polynomial 0x8005, begun with 0, not reflected; e-Manual, crc."""
    table, crc = _TABLE, 0
    for byte in data:
        crc = (crc << 8 & 0xFF00) ^ table[crc >> 8 ^ byte]
    return crc


def _remainder(byte: int) -> int:
    rest = byte << 8
    for _ in range(8):
        rest = rest << 1 ^ (_POLYNOMIAL if rest & 0x8000 else 0)
    return rest & 0xFFFF


_TABLE = tuple(_remainder(byte) for byte in range(256))


class DynamixelParser:
    """Takes bytes as they come, in any pieces, and gives the packets that are in them. Never raises.

    After noise it goes on with the next header: one can stand in no packet, since bodies are stuffed, so that a packet
    which was cut short costs itself alone.
    """

    def __init__(self) -> None:
        self._held = bytearray()

    def clear(self) -> None:
        """Forget what is not a packet yet."""
        self._held.clear()

    def feed(self, data: bytes) -> list[Heard]:
        """The packets that are complete now, in order."""
        held, found = self._held, list[Heard]()
        held += data
        while True:
            begin = held.find(HEADER)
            if begin < 0:
                del held[: max(len(held) - len(HEADER) + 1, 0)]
                return found
            del held[:begin]
            if len(held) < 7:
                return found
            identifier, length = struct.unpack_from("<BH", held, 4)
            if not 3 <= length <= LONGEST or identifier in (0xFD, 0xFF):
                del held[:3]
                continue
            end = 7 + length
            another = held.find(HEADER, 7, end - 2)
            if another >= 0:
                del held[:another]
            elif len(held) < end:
                return found
            elif crc16(bytes(held[: end - 2])) != int.from_bytes(held[end - 2 : end], "little"):
                found.append(Damaged(identifier))
                del held[:3]
            else:
                body = bytes(held[7 : end - 2]).replace(_STUFFED, STUFFS)
                found.append(DynamixelPacket(identifier, body[0], body[1:]))
                del held[:end]
