"""The vendor's packet handler, unmodified: what is asked of a hand's servos, and what their answers mean."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

from allegro_twin.drivers.dynamixel.codec.packet import ALERT, BROADCAST, DynamixelPacket, Instruction, PacketError
from allegro_twin.drivers.dynamixel.codec.rows import AROUND, clean
from allegro_twin.drivers.dynamixel.codec.table import ERRORS, Model
from allegro_twin.drivers.dynamixel.driver.line import SdkLine
from allegro_twin.errors import ConfigError, LinkError, LinkTimeout, ProtocolError

_DONE, _OVERDUE, _GARBLED = 0, -3001, -3002
"""COMM_SUCCESS, COMM_RX_TIMEOUT, COMM_RX_CORRUPT of dynamixel_sdk.robotis_def."""
_CODES = {1: "b", 2: "h", 4: "i"}
_REASONS = {
    PacketError.RESULT: "it could not do it",
    PacketError.INSTRUCTION: "it does not know the instruction",
    PacketError.CRC: "it heard it garbled",
    PacketError.RANGE: "the value is out of range, or its bus watchdog has struck",
    PacketError.LENGTH: "the length is wrong",
    PacketError.LIMIT: "the value is beyond its limit",
    PacketError.ACCESS: "the item cannot be accessed, or is locked while torque is on",
}


def packet_handler() -> Any:
    """`dynamixel_sdk`'s, of protocol 2.0. Raises ConfigError where it is not installed."""
    try:
        from dynamixel_sdk import PacketHandler
    except ImportError as error:
        raise ConfigError("a Dynamixel hand needs the vendor's SDK: pip install 'allegro-twin[dynamixel]'") from error
    return PacketHandler(2.0)


def causes(hardware_error: int) -> str:
    """The bits of Hardware Error Status in words."""
    known = [word for bit, word in ERRORS.items() if hardware_error & 1 << bit]
    return " and ".join(known) or f"hardware error 0x{hardware_error:02X}"


class Sdk:
    """Items of servos, by their names. Raises LinkTimeout where none answers, ProtocolError where what comes is no
    answer or a refusal, LinkError when the line is gone. `names`: what each id is called in messages."""

    def __init__(self, line: SdkLine, model: Model, names: dict[int, str], tries: int = 3) -> None:
        """`tries`: how often one servo is asked before it counts as silent."""
        self._line, self.port = line, line.port
        self._model, self._names, self._tries = model, names, tries
        self._handler = packet_handler()
        self.alerts = set[int]()
        """Ids whose last answer said that there is a hardware error."""

    def ping(self, identifier: int) -> int | None:
        """The model number; None where nobody answers, or not as a servo does."""
        number, result, error = self._again(lambda: self._handler.ping(self._line, identifier))
        # Of an answer that is nothing but an error the SDK takes the CRC for the model number.
        return int(number) if result == _DONE and not error & ~ALERT else None

    def everybody(self) -> dict[int, int]:
        """Whoever answers to a broadcast: ids and their model numbers. Takes most of a second on a real line."""
        self._free()
        found, _ = self._handler.broadcastPing(self._line)
        return {int(identifier): int(said[0]) for identifier, said in found.items()}

    def read(self, identifier: int, name: str) -> int:
        """An item of one servo."""
        item = self._model.named[name]
        data, result, error = self._again(
            lambda: self._handler.readTxRx(self._line, identifier, item.address, item.size)
        )
        self._check(identifier, result, error, f"read {name} of")
        return item.value_of(self._whole(identifier, data, item.size))

    def write(self, identifier: int, name: str, value: int) -> None:
        """Set an item of one servo, and have it confirmed."""
        item = self._model.named[name]
        data = list(item.bytes_of(value))
        result, error = self._again(
            lambda: self._handler.writeTxRx(self._line, identifier, item.address, item.size, data)
        )
        self._check(identifier, result, error, f"write {name} = {value} to")

    def reboot(self, identifier: int) -> None:
        result, error = self._again(lambda: self._handler.reboot(self._line, identifier))
        self._check(identifier, result, error & ~ALERT, "reboot")

    def tell(self, ids: Sequence[int], name: str, values: Sequence[int]) -> None:
        """Set an item of all of them at once. Nobody confirms it."""
        item, n = self._model.named[name], len(ids)
        row = [number for pair in zip(ids, values, strict=True) for number in pair]
        parameters = struct.pack("<" + f"B{_CODES[item.size]}" * n, *row)
        self._free()
        result = self._handler.syncWriteTxOnly(self._line, item.address, item.size, list(parameters), len(parameters))
        if result != _DONE:
            raise LinkError(f"{self.port.name} did not take {name} for {len(ids)} servos; is it plugged in?")

    def ask(self, ids: Sequence[int], address: int, size: int) -> bytes:
        """So many bytes of each of them, one after the other. What is not as nearly always is left to the SDK, whose
        plain Python takes as long for the sound answers of sixteen servos as a period's physics."""
        self._free()
        self._handler.syncReadTx(self._line, address, size, list(ids), len(ids), False)
        came = self._line.take(len(ids) * (AROUND + size))
        if (sound := clean(came, ids, size)) is not None:
            return sound
        self._line.give_back(came)
        said = bytearray()
        for identifier in ids:
            data, result, error = self._handler.readRx(self._line, identifier, size)
            if result or error or len(data) != size:
                self._check(identifier, result, error, "read")
                self._whole(identifier, data, size)
            said += bytes(data)
        return bytes(said)

    def ask_item(self, ids: Sequence[int], name: str) -> list[int]:
        """An item of each of them."""
        item = self._model.named[name]
        for _ in range(self._tries - 1):
            with suppress(LinkTimeout, ProtocolError):  # Lost on the way: asked again.
                said = self.ask(ids, item.address, item.size)
                break
        else:
            said = self.ask(ids, item.address, item.size)
        return [item.value_of(said[k : k + item.size]) for k in range(0, len(said), item.size)]

    def shutdown_frames(self) -> bytes:
        """The bytes that switch every motor on the line off."""
        item = self._model.named["torque_enable"]
        address = item.address.to_bytes(2, "little")
        return DynamixelPacket(BROADCAST, Instruction.WRITE, address + bytes((0,))).encoded()

    def _again(self, exchange: Callable[[], Any]) -> Any:
        """What the SDK makes of an exchange with one servo: at the last try, or once it is whole."""
        for _ in range(self._tries):
            self._free()
            outcome = exchange()
            heard = outcome[-1] & ~ALERT != PacketError.CRC
            if heard and outcome[-2] not in (_OVERDUE, _GARBLED):
                break
        return outcome

    def _free(self) -> None:
        """Before an exchange: the SDK marks its port as in use, and does not take that back on every way out."""
        self._line.is_using = False

    def _check(self, identifier: int, result: int, error: int, doing: str) -> None:
        if result == _DONE and not error:
            return
        who = f"{self._names.get(identifier, 'servo')} (id {identifier})"
        if result == _OVERDUE:
            raise LinkTimeout(f"no answer from {who} on {self.port.name}; is it powered and plugged in?")
        if result != _DONE:
            raise ProtocolError(f"what {who} answered on {self.port.name} is garbled (SDK result {result})")
        if error & ALERT:
            self.alerts.add(identifier)
        if error & ~ALERT:
            why = (
                _REASONS.get(PacketError(error & ~ALERT), "")
                if error & ~ALERT <= PacketError.ACCESS
                else f"error {error}"
            )
            raise ProtocolError(f"cannot {doing} {who}: {why}")

    def _whole(self, identifier: int, data: Sequence[int], size: int) -> bytes:
        if len(data) != size:
            raise ProtocolError(f"id {identifier} answered with {len(data)} bytes in place of {size}")
        return bytes(data)
