"""A virtual hand in real time on a terminal: for a driver in another program, ours or somebody else's."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Protocol

from allegro_twin.drivers.base.pacing import Served
from allegro_twin.drivers.base.terminal import Terminal

PAUSE = 0.02
"""s of silence on the line after which half a packet is none."""

GLANCE = 0.0005
"""s between two looks whether a step is over, while the line is listened to."""


class SerialDevice(Protocol):
    """A hand that does not exist, at its end of a line. `step` may run in one thread while `receive`, `clear` and
    `seconds` are asked in another: physics take longer than a driver waits for its answer."""

    @property
    def period(self) -> float:
        """s of a step."""
        ...

    @property
    def seconds(self) -> float:
        """For how long the line was used: bytes, and what they wait for."""
        ...

    def step(self) -> object:
        """Let one period pass."""
        ...

    def receive(self, data: bytes, baud: int) -> bytes:
        """What comes back of what a host sends at this speed."""
        ...

    def clear(self) -> None:
        """A pause on the line: what was not a packet yet never becomes one."""
        ...


def serve(hand: SerialDevice, terminal: Terminal, clock: Callable[[], float] = time.monotonic) -> Iterator[Served]:
    """Be this hand at this terminal; yields after every step, until nobody consumes.

    Answers come when the bytes have had their time on the line, also while a step is computed: qbAPI gives a device up
    after 4 ms. Raises LinkError when the terminal is gone.
    """
    served, line = Served(hand.period, clock, "bytes"), _Line(hand, terminal, clock)
    with ThreadPoolExecutor(1, "physics") as physics:
        while True:
            line.carry(served.due, served)
            served.count()
            step = physics.submit(hand.step)
            line.carry_during(step, served)
            step.result()
            yield served


class _Line:
    """Bytes on their way between the terminal and the hand."""

    def __init__(self, hand: SerialDevice, terminal: Terminal, clock: Callable[[], float]) -> None:
        self._hand, self._terminal, self._clock = hand, terminal, clock
        self._answers = deque[tuple[float, bytes]]()
        self._free = self._last = clock()

    def carry(self, due: float, served: Served) -> None:
        """Until then; on a late step what is there, or a busy computer never hears the host."""
        while True:
            self._say(served)
            until = min(due, self._answers[0][0]) if self._answers else due
            data = self._terminal.read(until - self._clock())
            if data:
                served.heard += len(data)
                self._hear(data)
            elif self._clock() >= due:
                return

    def carry_during(self, step: Future[object], served: Served) -> None:
        """Until a step is over."""
        while not step.done():
            self._say(served)
            if data := self._terminal.read(GLANCE):
                served.heard += len(data)
                self._hear(data)

    def _hear(self, data: bytes) -> None:
        now, hand = self._clock(), self._hand
        if now - self._last > PAUSE:
            hand.clear()
        self._last, before = now, hand.seconds
        answer = hand.receive(data, self._terminal.baud or 1)
        self._free = max(self._free, now) + hand.seconds - before
        if answer:
            self._answers.append((self._free, answer))

    def _say(self, served: Served) -> None:
        while self._answers and self._answers[0][0] <= self._clock():
            answer = self._answers.popleft()[1]
            served.sent += len(answer) if self._terminal.write(answer) else 0
