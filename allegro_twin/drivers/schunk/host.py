"""A hand of our Schunk layout from the program's side. Raises LinkTimeout, ProtocolError, LinkError or ConfigError."""

from __future__ import annotations

import numpy as np

from allegro_twin.drivers.polled.exchange import Exchange
from allegro_twin.drivers.polled.wire import MotorState
from allegro_twin.drivers.schunk import codec
from allegro_twin.drivers.schunk.codec import ACTUATORS, BAUD, LAYOUT, MARK, MILLIAMPERES, SIZE, Bits, Kind, Question
from allegro_twin.errors import ConfigError, HandFault, LinkError

_TRIES = 3
_WRONG = {
    Bits.WATCHDOG: "it heard nobody in time and let go",
    Bits.MODE: "it was asked for a mode that it does not have",
}


class SchunkWire:
    """Every question has a counter, which its answer repeats: an old answer is none. `watchdog`: in 20 ms."""

    def __init__(self, exchange: Exchange, watchdog: int) -> None:
        self._exchange, self._watchdog = exchange, watchdog
        self._counter, self._on, self._targets = 0, False, (0,) * ACTUATORS

    @property
    def shutdown_frames(self) -> bytes:
        return Question(0).encoded()

    def find(self) -> None:
        def knock() -> None:
            count = self._next()
            question = Question(count, kind=Kind.WHO).encoded()
            found.append(self._exchange(question, lambda heard: codec.who(heard, count), SIZE))

        found: list[codec.Who] = []
        self._exchange.find(knock, MARK, (BAUD,))
        said = found[-1]
        if (said.layout, said.actuators) != (LAYOUT, ACTUATORS):
            raise ConfigError(
                f"{self._exchange.who} on {self._exchange.port.name} has {said.actuators} actuators and speaks layout "
                f"{said.layout}; here are {ACTUATORS} and layout {LAYOUT}: docs/reference/serial_protocols.md"
            )

    def go(self, ticks: list[int]) -> None:
        self._on, self._targets = True, tuple(ticks)
        for _ in range(_TRIES):
            bits = self._say().bits
            if bits & Bits.ON:
                return
            if why := _why(bits):
                raise HandFault(f"{self._exchange.who}: {why}; reset to go on")
        raise LinkError(f"the motors on {self._exchange.port.name} do not switch on; is something else driving them?")

    def stop(self) -> None:
        self._on = False
        for _ in range(_TRIES):
            if not self._say(forget=True).bits:
                return
        raise LinkError(f"the motors on {self._exchange.port.name} say that they are on")

    def ask(self) -> MotorState:
        said = self._say()
        current = MILLIAMPERES * np.array(said.currents, dtype=np.float64)
        ticks, when = np.array(said.ticks, dtype=np.float64), self._exchange.when
        return MotorState(ticks, current, bool(said.bits & Bits.ON), when, _why(said.bits))

    def _say(self, *, forget: bool = False) -> codec.State:
        """The whole exchange: targets out, encoders and currents in."""
        count = self._next()
        question = Question(count, self._on, forget, watchdog=self._watchdog, targets=self._targets)
        return self._exchange(question.encoded(), lambda heard: codec.state(heard, count), SIZE)

    def _next(self) -> int:
        self._counter = (self._counter + 1) % 256
        return self._counter


def _why(bits: int) -> str:
    """What the hand says is wrong with it."""
    return next((words for bit, words in _WRONG.items() if bits & bit), "")
