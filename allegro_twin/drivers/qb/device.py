"""A qb device that does not exist: what its firmware does with packets.

Assumed, for no source says it: that a watchdog that strikes switches the motor off.
"""

from __future__ import annotations

import math

from allegro_twin.drivers.base.host_settings import WATCHDOG_UNIT
from allegro_twin.drivers.qb.codec import (
    ASK_INFO,
    BROADCAST,
    CLOSED,
    INFO_ALL,
    INFO_CYCLES,
    OFF,
    ON,
    Command,
    QbPacket,
    QbParser,
    pack_int16,
    unpack_int16,
)
from allegro_twin.types import Array

VERSION = "allegro-twin virtual v1.0.0"
"""In place of the firmware's own."""


class QbDevice:
    """One motor. Fresh: switched off."""

    def __init__(self, identifier: int) -> None:
        self.id, self.active, self.watchdog = identifier, OFF, 0
        self.goal = self.tick = self.current = 0
        self._parser, self._silent, self._seconds = QbParser(), 0.0, 0.0

    @property
    def wants(self) -> list[int] | None:
        return [min(max(self.goal, 0), CLOSED)] if self.active == ON else None

    def receive(self, data: bytes) -> bytes:
        if data.strip() == ASK_INFO:
            return self._info(INFO_ALL)
        return b"".join(self._answer(packet) for packet in self._parser.feed(data))

    def clear(self) -> None:
        self._parser.clear()

    def elapse(self, seconds: float) -> None:
        self._silent += seconds
        self._seconds += seconds
        if self.watchdog and self._silent > self.watchdog * WATCHDOG_UNIT:
            self.active = OFF

    def sense(self, ticks: Array, current: Array) -> None:
        self.tick, self.current = (int(row[0]) if math.isfinite(row[0]) else 0 for row in (ticks, current))

    def _answer(self, packet: QbPacket) -> bytes:
        if packet.id not in (self.id, BROADCAST):
            return b""
        self._silent, given = 0.0, packet.payload
        said: bytes | None = None
        match packet.command:
            case Command.PING:
                said = b""
            case Command.GET_INFO if len(given) == 2:
                return self._info(unpack_int16(given)[0])
            case Command.ACTIVATE if len(given) == 1:
                if given[0] != OFF:
                    self.goal = self.tick  # Firmware: the goal becomes where the motor is.
                self.active = ON if given[0] == ON else OFF
            case Command.GET_ACTIVATE:
                said = bytes((self.active,))
            case Command.SET_INPUTS if len(given) == 4:
                self.goal = unpack_int16(given)[0]
            case Command.GET_INPUTS:
                said = pack_int16(self.goal, 0)
            case Command.GET_MEASUREMENTS:
                said = pack_int16(self.tick, 0, 0)
            case Command.GET_CURRENTS:
                said = pack_int16(self.current, 0)
            case Command.GET_CURR_AND_MEAS:
                said = pack_int16(self.current, 0, self.tick, 0, 0)
            case Command.SET_WATCHDOG if len(given) == 1:
                self.watchdog = min(given[0], 250)
        return b"" if said is None else QbPacket(self.id, packet.command, said).encoded()

    def _info(self, which: int) -> bytes:
        """The firmware's text (prepare_generic_info of its command_processing.c), of what exists here: a program that
        looks for a line by its name finds it, or that it is not there."""
        cycles = [
            "", "USAGE STATISTICS", "",
            f"Total power on time (sec): {int(self._seconds)}", "",
        ]  # fmt: skip
        if which == INFO_CYCLES:
            lines = cycles
        elif which == INFO_ALL:
            lines = [
                "", f"Firmware version: {VERSION}.", "",
                "DEVICE INFO", f"ID: {self.id}", "Hand side: RIGHT", "",
                "MOTOR INFO", f"Motor reference - Position: {self.goal} ", "",
                f"Motor enabled: {'YES' if self.active == ON else 'NO'}", "",
                "MEASUREMENTS INFO", "Sensor value:", f"1 -> {self.tick}", "2 -> 0", "3 -> 0",
                f"Current (mA): {self.current}", "",
                "DEVICE PARAMETERS", "Startup activation: NO", "Input mode: USB", "Control mode: Position",
                "Position limit active: 1", f"Position limit motor: inf -> 0  sup -> {CLOSED}", *cycles,
            ]  # fmt: skip
        else:
            return b""
        return "\r\n".join([*lines, ""]).encode("ascii")
