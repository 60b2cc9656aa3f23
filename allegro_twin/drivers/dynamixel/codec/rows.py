"""The answers of many servos to one sync read, as one array: all or nothing.

A CRC begun with 0 is the exclusive or of those of the message's bytes, each with as many zeros behind it as bytes
follow: sixteen of them are one look into a table.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from allegro_twin.drivers.dynamixel.codec.packet import HEADER, STATUS, STUFFS, crc16

_FRONT = struct.Struct("<4sBHBB")  # Header, id, length, status, error.
_CRC = 2
AROUND = _FRONT.size + _CRC
"""Bytes of an answer that are not what was asked for."""


def clean(packets: bytes, ids: Sequence[int], size: int) -> bytes | None:
    """Data of the servos' answers, so many bytes each, one after the other; None where anything is not as nearly
    always: an answer of another, an error, an alert, a stuffed or a garbled one."""
    if len(packets) != len(ids) * (AROUND + size):
        return None
    rows = np.frombuffer(packets, np.uint8).reshape(len(ids), AROUND + size)
    body, data = rows[:, :-_CRC], rows[:, _FRONT.size : -_CRC]
    if body[:, : _FRONT.size].tobytes() != _fronts(tuple(ids), size).tobytes():
        return None
    return data.tobytes() if _crc(body).tobytes() == rows[:, -_CRC:].tobytes() else None


def answers(ids: Sequence[int], data: Sequence[bytes]) -> bytes | None:
    """What servos say that read so much and have nothing to complain of; None where an answer has to be stuffed."""
    whole, size = b"".join(data), len(data[0])
    if STUFFS in whole:
        return None
    rows = np.empty((len(ids), AROUND + size), np.uint8)
    rows[:, : _FRONT.size] = _fronts(tuple(ids), size)
    rows[:, _FRONT.size : -_CRC] = np.frombuffer(whole, np.uint8).reshape(len(ids), size)
    rows[:, -_CRC:] = _crc(rows[:, :-_CRC])[:, None].view(np.uint8)
    return rows.tobytes()


def _crc(body: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """CRC of each row, low byte first as on the wire."""
    shares, places = _shares(body.shape[1])
    found: NDArray[np.uint16] = np.bitwise_xor.reduce(shares.take(places + body), axis=1)
    return found


@lru_cache(maxsize=16)
def _fronts(ids: tuple[int, ...], size: int) -> NDArray[np.uint8]:
    rows = b"".join(_FRONT.pack(HEADER, each, size + 4, STATUS, 0) for each in ids)
    return np.frombuffer(rows, np.uint8).reshape(len(ids), _FRONT.size)


@lru_cache(maxsize=16)
def _shares(length: int) -> tuple[NDArray[np.uint16], NDArray[np.int64]]:
    """What a byte at a place of a message of that length has in its CRC, one place after the other, (256 length,), and
    where each place begins."""
    alone = [[crc16(bytes((byte,)) + bytes(length - 1 - place)) for byte in range(256)] for place in range(length)]
    return np.array(alone, "<u2").ravel(), 256 * np.arange(length)
