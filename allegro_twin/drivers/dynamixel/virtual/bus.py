"""Many servos on one line: bytes in, bytes out."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial

from allegro_twin.drivers.base.serial_line import BITS
from allegro_twin.drivers.dynamixel.codec.budget import DELAY_UNIT
from allegro_twin.drivers.dynamixel.codec.packet import (
    BROADCAST,
    LAST_ID,
    STATUS,
    Damaged,
    DynamixelPacket,
    DynamixelParser,
    Heard,
    Instruction,
    PacketError,
    status,
)
from allegro_twin.drivers.dynamixel.codec.rows import answers
from allegro_twin.drivers.dynamixel.virtual.servo import Servo

_WHERE = struct.Struct("<HH")
_OPTION = 1


class Bus:
    """Servos that hear the same bytes. Those that answer at once speak over each other: a 0 wins over a 1."""

    def __init__(self, servos: Sequence[Servo]) -> None:
        self.servos, self._parser = list(servos), DynamixelParser()
        self.seconds = 0.0
        """For how long the line was used, with the servos' return delays."""

    def clear(self) -> None:
        """A pause on the line: what was not a packet yet never becomes one."""
        self._parser.clear()

    def receive(self, data: bytes, baud: int) -> bytes:
        """What the servos answer to what a host sends at this speed. Never raises."""
        self.seconds += len(data) * BITS / baud
        answer = b"".join(piece for heard in self._parser.feed(data) for piece in self._answers(heard, baud))
        self.seconds += len(answer) * BITS / baud
        return answer

    def _answers(self, heard: Heard, baud: int) -> Iterator[bytes]:
        awake = [servo for servo in self.servos if servo.baud == baud and not servo.mute]
        there = {servo.id: [servo] for servo in awake}
        if len(there) < len(awake):
            there = {identifier: [servo for servo in awake if servo.id == identifier] for identifier in there}
        mine = there.get(heard.id, [])
        if isinstance(heard, Damaged):
            yield self._together([servo for servo in mine if servo.return_level == 2], _damaged)
            return
        for servo in awake if heard.id == BROADCAST else mine:
            servo.heard()
        match heard.instruction:
            case Instruction.SYNC_READ | Instruction.BULK_READ:
                yield from self._in_turn(heard, there)
            case Instruction.SYNC_WRITE | Instruction.BULK_WRITE:
                self._to_each(heard, there)
            case Instruction.PING if heard.id == BROADCAST:
                for identifier in sorted(there):
                    yield self._together(there[identifier], _ping)
            case _ if heard.id == BROADCAST:
                for servo in awake:
                    _obey(servo, heard)
            case _:
                yield self._together(mine, partial(_obey, heard=heard))

    def _in_turn(self, heard: DynamixelPacket, there: Mapping[int, Sequence[Servo]]) -> Iterator[bytes]:
        """Each waits for the one before: after one that is silent nobody speaks (DynamixelSDK issue 364)."""
        asked = _asked(heard)
        if heard.instruction == Instruction.SYNC_READ and (spoken := self._at_once(asked, there)):
            yield spoken
            return
        for identifier, address, length in asked:
            mine = there.get(identifier, ())
            if len(mine) == 1:
                answer = _read(mine[0], address, length)
                self.seconds += mine[0].return_delay * DELAY_UNIT
            else:
                answer = self._together(mine, partial(_read, address=address, length=length))
            if not answer:
                return
            yield answer

    def _at_once(self, asked: Sequence[tuple[int, int, int]], there: Mapping[int, Sequence[Servo]]) -> bytes | None:
        """What nearly always comes: each is there once, and has no more to say than what it was asked for."""
        said, delay = list[bytes](), 0
        for identifier, address, length in asked:
            mine = there.get(identifier, ())
            if len(mine) != 1 or mine[0].alert or mine[0].return_level < 1:
                return None
            error, data = mine[0].read(address, length)
            if error:
                return None
            said.append(data)
            delay += mine[0].return_delay
        spoken = answers([identifier for identifier, _, _ in asked], said) if said else None
        if spoken is not None:
            self.seconds += delay * DELAY_UNIT
        return spoken

    def _to_each(self, heard: DynamixelPacket, there: Mapping[int, Sequence[Servo]]) -> None:
        for identifier, address, data in _told(heard):
            for servo in there.get(identifier, ()):
                servo.write(address, data)

    def _together(self, servos: Sequence[Servo], answered: Callable[[Servo], bytes]) -> bytes:
        spoken = b""
        for servo in servos:
            answer = answered(servo)
            if answer:
                spoken = _over(spoken, answer) if spoken else answer
                self.seconds += servo.return_delay * DELAY_UNIT
        return spoken


def _over(one: bytes, other: bytes) -> bytes:
    length = max(len(one), len(other))
    return bytes(a & b for a, b in zip(one.ljust(length, b"\xff"), other.ljust(length, b"\xff"), strict=True))


def _status(servo: Servo, error: int, data: bytes = b"") -> bytes:
    return DynamixelPacket(servo.id, STATUS, bytes((error | servo.alert,)) + data).encoded()


def _damaged(servo: Servo) -> bytes:
    return _status(servo, PacketError.CRC)


def _read(servo: Servo, address: int, length: int) -> bytes:
    if servo.memory.bytes[68] < 1:
        return b""
    error, data = servo.read(address, length)
    return _status(servo, error, data)


def _ping(servo: Servo) -> bytes:
    return _status(servo, 0, servo.memory.read(0, 2) + servo.memory.read(6, 1))


def _obey(servo: Servo, heard: DynamixelPacket) -> bytes:
    """Do it; what the servo answers, as far as its Status Return Level lets it."""
    given, level = heard.parameters, servo.return_level
    match heard.instruction:
        case Instruction.PING:
            return _ping(servo)
        case Instruction.READ:
            if heard.id == BROADCAST:
                return b""
            if len(given) == _WHERE.size:
                return _read(servo, *_WHERE.unpack(given))
            return _status(servo, PacketError.LENGTH) if level >= 1 else b""
        case Instruction.WRITE if len(given) >= 2:
            error = servo.write(int.from_bytes(given[:2], "little"), given[2:])
        case Instruction.REG_WRITE if len(given) >= 2:
            error = servo.register(int.from_bytes(given[:2], "little"), given[2:])
        case Instruction.ACTION:
            error = servo.act()
        case Instruction.FACTORY_RESET if len(given) == _OPTION and not (heard.id == BROADCAST and given == b"\xff"):
            before = servo.id
            error = servo.factory_reset(given[0])
            return status(before, error).encoded() if level == 2 else b""
        case Instruction.REBOOT:
            servo.reboot()
            error = 0
        case Instruction.CLEAR:
            error = servo.clear(given)
        case _:
            error = PacketError.INSTRUCTION
    return _status(servo, error) if level == 2 else b""


def _asked(heard: DynamixelPacket) -> list[tuple[int, int, int]]:
    """Who shall read what: id, address, length."""
    given = heard.parameters
    if heard.instruction == Instruction.SYNC_READ:
        if len(given) < _WHERE.size:
            return []
        address, length = _WHERE.unpack_from(given)
        return [(identifier, address, length) for identifier in given[_WHERE.size :] if identifier <= LAST_ID]
    rows = [given[k : k + 5] for k in range(0, len(given) - 4, 5)]
    return [(row[0], *_WHERE.unpack_from(row, 1)) for row in rows]


def _told(heard: DynamixelPacket) -> Iterator[tuple[int, int, bytes]]:
    """Who shall write what: id, address, bytes. What is cut short at the end is left out."""
    given = heard.parameters
    if heard.instruction == Instruction.SYNC_WRITE:
        if len(given) < _WHERE.size:
            return
        address, length = _WHERE.unpack_from(given)
        for k in range(_WHERE.size, len(given) - length, length + 1):
            yield given[k], address, given[k + 1 : k + 1 + length]
        return
    k = 0
    while k + 5 <= len(given):
        address, length = _WHERE.unpack_from(given, k + 1)
        if k + 5 + length <= len(given):
            yield given[k], address, given[k + 5 : k + 5 + length]
        k += 5 + length
