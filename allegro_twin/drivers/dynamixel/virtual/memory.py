"""A servo's control table as bytes, with the manual's reasons to refuse a read or a write."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from allegro_twin.drivers.dynamixel.codec.packet import PacketError
from allegro_twin.drivers.dynamixel.codec.table import EEPROM_END, MODES, POSITION, TRIPPED, Field, Model

_SIZE = 662
"""Bytes of the largest table: to the end of the second block of indirect data."""
_LIMITED = {"goal_pwm": "pwm_limit", "goal_current": "current_limit", "goal_velocity": "velocity_limit"}
_GOALS = {*_LIMITED, "goal_position"}
_TRIPPED = TRIPPED & 0xFF


class Refused(Exception):
    """A servo's answer is this error number. It never leaves the servo."""

    def __init__(self, why: PacketError) -> None:
        super().__init__(why)
        self.why = why


class Memory:
    """The table of one servo. A write is done whole or not at all."""

    def __init__(self, model: Model) -> None:
        self.model, self.bytes = model, bytearray(_SIZE)
        self._pointers = {
            data + k: pointer + 2 * k for pointer, data, count in model.indirect for k in range(count)
        }  # fmt: skip
        self._plain = set[tuple[int, int]]()
        """Rows of bytes, address and length, that are known to belong to items."""
        self.restore(range(_SIZE))

    def restore(self, addresses: range) -> None:
        """Factory values of the items that begin there."""
        for item in self.model.fields:
            if item.address in addresses:
                self.put(item.name, item.default)
        for data, pointer in self._pointers.items():
            if pointer in addresses:
                self.bytes[pointer : pointer + 2] = data.to_bytes(2, "little")

    def get(self, name: str) -> int:
        item = self.model.named[name]
        return item.value_of(bytes(self.bytes[item.address : item.address + item.size]))

    def put(self, name: str, value: int) -> None:
        """What the servo itself does: nothing is checked."""
        item = self.model.named[name]
        self.bytes[item.address : item.address + item.size] = item.bytes_of(value)

    def read(self, address: int, length: int) -> bytes:
        """Raises Refused."""
        if not length:
            raise Refused(PacketError.LENGTH)
        if (address, length) in self._plain:
            return bytes(self.bytes[address : address + length])
        if all(k in self.model.at for k in range(address, address + length)):
            self._plain.add((address, length))
        return bytes(self._byte(k) for k in range(address, address + length))

    def writes(self, address: int, data: bytes) -> Sequence[tuple[Field, int]]:
        """The items that these bytes are for, and their values, checked; pointers of indirect addresses are set at
        once. Raises Refused."""
        if not data:
            raise Refused(PacketError.LENGTH)
        item = self.model.at.get(address)
        if item is not None and item.address == address and item.size == len(data):
            value = int.from_bytes(data, "little", signed=item.signed)
            self._check(item, value)
            return ((item, value),)
        items = list[tuple[Field, int]]()
        for begin, piece in self._runs(address, data):
            if begin in self._pointers.values():
                self._point(begin, piece)
            else:
                items += self._items(begin, piece)
        for item, value in items:
            self._check(item, value)
        return items

    def _byte(self, address: int) -> int:
        pointer = self._pointers.get(address)
        if pointer is not None:
            address = int.from_bytes(self.bytes[pointer : pointer + 2], "little")
        elif address not in self.model.at and address & ~1 not in self._pointers.values():
            raise Refused(PacketError.ACCESS)
        return self.bytes[address] if address < _SIZE else 0

    def _runs(self, address: int, data: bytes) -> Iterator[tuple[int, bytes]]:
        """The bytes where they really go, in pieces that lie together."""
        if address not in self._pointers:
            yield address, data
            return
        run, begin, last = bytearray(), -1, -2
        for k, value in enumerate(data):
            pointer = self._pointers.get(address + k)
            if pointer is None:
                raise Refused(PacketError.ACCESS)
            target = int.from_bytes(self.bytes[pointer : pointer + 2], "little")
            if target in self._pointers:
                raise Refused(PacketError.ACCESS)
            if target != last + 1 and run:
                yield begin, bytes(run)
                run.clear()
            begin = begin if run else target
            run.append(value)
            last = target
        yield begin, bytes(run)

    def _point(self, address: int, data: bytes) -> None:
        if len(data) % 2 or not {*range(address, address + len(data), 2)} <= {*self._pointers.values()}:
            raise Refused(PacketError.LENGTH if len(data) % 2 else PacketError.ACCESS)
        targets = [int.from_bytes(data[k : k + 2], "little") for k in range(0, len(data), 2)]
        if any(not EEPROM_END <= target < _SIZE for target in targets):
            raise Refused(PacketError.RANGE)
        self.bytes[address : address + len(data)] = data

    def _items(self, address: int, data: bytes) -> Iterator[tuple[Field, int]]:
        offset = 0
        while offset < len(data):
            item = self.model.at.get(address + offset)
            if item is None:
                raise Refused(PacketError.ACCESS)
            if item.address != address + offset or item.size > len(data) - offset:
                raise Refused(PacketError.LENGTH)
            yield item, item.value_of(data[offset : offset + item.size])
            offset += item.size

    def _check(self, item: Field, value: int) -> None:
        if not item.writable or (item.address < EEPROM_END and self.bytes[64]):
            raise Refused(PacketError.ACCESS)
        if not item.low <= value <= item.high:
            raise Refused(PacketError.RANGE)
        if item.name in _GOALS:
            self._check_goal(item.name, value)
        elif (item.name == "operating_mode" and value not in MODES) or (item.name == "bus_watchdog" and value < 0):
            raise Refused(PacketError.RANGE)
        elif item.name == "torque_enable" and value and self.bytes[70] & self.bytes[63]:
            raise Refused(PacketError.RESULT)  # "REBOOT is the only method", and no number: e-Manual, Shutdown.

    def _check_goal(self, name: str, value: int) -> None:
        if self.bytes[98] == _TRIPPED:
            raise Refused(PacketError.RANGE)
        if name in _LIMITED:
            if abs(value) > self.get(_LIMITED[name]):
                raise Refused(PacketError.LIMIT)
        elif self.bytes[11] == POSITION:
            lowest, highest = self.get("min_position_limit"), self.get("max_position_limit")
            if not lowest <= value <= highest:
                raise Refused(PacketError.LIMIT)
