"""A virtual hand in real time on a terminal: for a driver in another program, ours or somebody else's."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Protocol

from allegro_twin.drivers.base.terminal import Terminal

BEHIND = 1.0
"""s of lateness at which the hand gives up catching up: a real hand's clock does not wait either."""
PAUSE = 0.02
"""s of silence on the line after which half a packet is none."""

GLANCE = 0.0005
"""s between two looks whether a step is over, while the line is listened to."""


class Device(Protocol):
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


@dataclass(slots=True)
class Served:
    """What has happened so far."""

    steps: int = 0
    heard: int = 0
    """Bytes from the host."""
    said: int = 0
    """Bytes to the host."""
    late: int = 0
    """Steps that ended more than a step late."""
    lost: int = 0
    """Steps that were left out to catch up."""

    def summary(self) -> str:
        """All of it in one line."""
        steps = f"{self.steps} steps, {self.late} late, {self.lost} left out"
        return f"{steps}; {self.heard} bytes heard, {self.said} said"


def serve(hand: Device, terminal: Terminal, clock: Callable[[], float] = time.monotonic) -> Iterator[Served]:
    """Be this hand at this terminal; yields after every step, until nobody consumes. Deadlines are absolute.

    Answers come when the bytes have had their time on the line, also while a step is computed: qbAPI gives a device up
    after 4 ms. Raises LinkError when the terminal is gone.
    """
    served, begin, skipped, line = Served(), clock(), 0, _Line(hand, terminal, clock)
    with ThreadPoolExecutor(1, "physics") as physics:
        while True:
            due = begin + (served.steps + skipped + 1) * hand.period
            line.carry(due, served)
            late = clock() - due
            if late > BEHIND:
                lost = int(late / hand.period)
                skipped += lost
                served.lost += lost
            served.late += late > hand.period
            served.steps += 1
            step = physics.submit(hand.step)
            line.carry_during(step, served)
            step.result()
            yield served


class _Line:
    """What is on its way between the terminal and the hand."""

    def __init__(self, hand: Device, terminal: Terminal, clock: Callable[[], float]) -> None:
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
            served.said += len(answer) if self._terminal.write(answer) else 0
