"""A hand of our Schunk layout that does not exist: what its firmware does with frames."""

from __future__ import annotations

import numpy as np

from allegro_twin.drivers.base.host_settings import WATCHDOG_UNIT
from allegro_twin.drivers.schunk.codec import (
    ACTUATORS,
    MILLIAMPERES,
    TICKS,
    Bits,
    Kind,
    Mode,
    State,
    Who,
    frames,
    question,
)
from allegro_twin.types import Array

_INT8 = 127


class SchunkDevice:
    """Five motors. Fresh: off. It switches off by itself when nobody speaks, and for a mode that it does not have."""

    def __init__(self) -> None:
        self.on, self.wrong, self.watchdog = False, 0, 0
        self.targets = self.ticks = self.currents = (0,) * ACTUATORS
        self._left, self._silent = b"", 0.0

    @property
    def wants(self) -> list[int] | None:
        return list(self.targets) if self.on else None

    def receive(self, data: bytes) -> bytes:
        found, self._left = frames(self._left + data)
        return b"".join(self._answer(frame) for frame in found)

    def clear(self) -> None:
        self._left = b""

    def elapse(self, seconds: float) -> None:
        self._silent += seconds
        if self.on and self.watchdog and self._silent > self.watchdog * WATCHDOG_UNIT:
            self.on, self.wrong = False, self.wrong | Bits.WATCHDOG

    def sense(self, ticks: Array, current: Array) -> None:
        self.ticks = tuple(np.clip(np.nan_to_num(ticks), 0, TICKS).astype(int).tolist())
        self.currents = tuple(np.clip(np.rint(current / MILLIAMPERES), -_INT8, _INT8).astype(int).tolist())

    def _answer(self, frame: bytes) -> bytes:
        asked = question(frame)
        if asked is None:
            return b""
        if asked.kind == Kind.WHO:
            return Who(asked.counter).encoded()
        self._silent, self.watchdog = 0.0, asked.watchdog
        if asked.forget:
            self.wrong = 0
        if asked.mode != Mode.POSITION:
            self.wrong |= Bits.MODE
        self.on = asked.on and not self.wrong
        if self.on:
            self.targets = asked.targets
        return State(asked.counter, int(Bits.ON if self.on else 0) | self.wrong, self.currents, self.ticks).encoded()
