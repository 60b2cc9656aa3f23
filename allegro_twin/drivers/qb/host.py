"""A qb device from the program's side. Raises LinkTimeout, ProtocolError or LinkError."""

from __future__ import annotations

from collections.abc import Callable
from operator import eq

import numpy as np

from allegro_twin.drivers.polled.exchange import Exchange
from allegro_twin.drivers.polled.wire import MotorState
from allegro_twin.drivers.qb.codec import (
    BAUDS,
    BROADCAST,
    HEADER,
    LAST_ID,
    OFF,
    ON,
    Command,
    QbPacket,
    QbParser,
    answer,
    pack_int16,
    size,
    unpack_int16,
)
from allegro_twin.errors import LinkError, LinkTimeout, ProtocolError

_TRIES = 3
_MOVES = 100
"""Ticks that a motor goes between two questions at most: half a percent of its way."""
_AGAIN = 10
"""Periods after which it is asked whether its motor is on: a question costs as much as a state."""


def _near(one: bytes, other: bytes) -> bool:
    """Whether two answers to GET_CURR_AND_MEAS are of one motion."""
    return abs(unpack_int16(one)[2] - unpack_int16(other)[2]) <= _MOVES


class QbWire:
    """One device with one motor. `watchdog`: in 20 ms."""

    def __init__(self, exchange: Exchange, identifier: int, watchdog: int) -> None:
        self._exchange, self._id, self._watchdog = exchange, identifier, watchdog
        self._on, self._asked = False, 0

    @property
    def shutdown_frames(self) -> bytes:
        return QbPacket(self._id, Command.ACTIVATE, bytes((OFF,))).encoded()

    def find(self) -> None:
        def knock() -> None:
            self._ask(Command.PING, 0)

        self._exchange.find(knock, HEADER, BAUDS, self._other)

    def go(self, ticks: list[int]) -> None:
        goal = pack_int16(ticks[0], 0)
        if self._on:
            self._tell(Command.SET_INPUTS, goal)
            return
        for _ in range(_TRIES):
            self._tell(Command.SET_WATCHDOG, bytes((self._watchdog,)))
            self._tell(Command.ACTIVATE, bytes((ON,)))
            self._tell(Command.SET_INPUTS, goal)  # Activating sets the goal to where the motor is.
            if self._active():
                self._on, self._asked = True, 0
                return
        raise LinkError(f"the motor on {self._exchange.port.name} does not switch on; is something else driving it?")

    def stop(self) -> None:
        for _ in range(_TRIES):
            self._tell(Command.ACTIVATE, bytes((OFF,)))
            if not self._active():
                self._on = False
                return
        raise LinkError(f"the motor on {self._exchange.port.name} says that it is on")

    def ask(self) -> MotorState:
        current, _, tick, *_ = unpack_int16(self._ask(Command.GET_CURR_AND_MEAS, 10, _near))
        ticks, currents, when = np.array([float(tick)]), np.array([float(current)]), self._exchange.when
        self._asked += 1
        if self._on and self._asked >= _AGAIN:
            self._asked, self._on = 0, self._active()
            if not self._on:
                why = "its motor was switched off, by its watchdog or somebody else"
                return MotorState(ticks, currents, on=False, when=when, why=why)
        return MotorState(ticks, currents, on=self._on, when=when)

    def _active(self) -> bool:
        return bool(self._ask(Command.GET_ACTIVATE, 1)[0])

    def _tell(self, command: Command, payload: bytes) -> None:
        """Nobody confirms it."""
        self._exchange.port.send(QbPacket(self._id, command, payload).encoded())

    def _ask(self, command: Command, payload: int, same: Callable[[bytes, bytes], bool] = eq) -> bytes:
        """One answer of 256 that is garbled passes for sound, for the checksum is an XOR. So where anything else was on
        the line two answers must say the same."""
        question, exchange, before = QbPacket(self._id, command).encoded(), self._exchange, b""
        for _ in range(_TRIES):
            said = exchange(question, lambda heard: answer(heard, self._id, command, payload), size(payload))
            if len(exchange.heard) == size(payload) or (before and same(before, said)):
                return said
            before = said
        raise ProtocolError(
            f"{exchange.who} on {exchange.port.name} answers, and not twice the same: is the line noisy?"
        )

    def _other(self) -> str:
        """Who answers to a broadcast."""
        question = QbPacket(BROADCAST, Command.PING).encoded()

        def read(heard: bytes) -> list[int] | None:
            return (
                sorted({p.id for p in QbParser().feed(heard) if p.command == Command.PING and p.id <= LAST_ID}) or None
            )

        try:
            ids = self._exchange(question, read, size(0))
        except (LinkTimeout, ProtocolError):
            return ""
        return f"a qb device answers as {', '.join(map(str, ids))}: set backend.id so"
