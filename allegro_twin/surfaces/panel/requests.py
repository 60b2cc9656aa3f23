"""What a person may wish of a hand, as plain data, and the queue that it waits in."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass
from typing import TypeAlias


@dataclass(frozen=True, slots=True)
class Joints:
    """Head for these positions, (n,), rad."""

    position: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Posture:
    """Go to a posture of the library."""

    name: str


@dataclass(frozen=True, slots=True)
class Grasp:
    """Perform a grasp of the library."""

    name: str


@dataclass(frozen=True, slots=True)
class Control:
    """Another controller, as `Hand.set_controller` takes it."""

    kind: str


@dataclass(frozen=True, slots=True)
class UseGains:
    """Other gains of the library, from the next wish on."""

    name: str


@dataclass(frozen=True, slots=True)
class Gravity:
    """What controllers compensate, palm frame, (3,), m/s²; None: what the hand reports."""

    vector: tuple[float, float, float] | None


@dataclass(frozen=True, slots=True)
class Hold:
    """Stay here."""


@dataclass(frozen=True, slots=True)
class Stop:
    """Limp, at once."""


@dataclass(frozen=True, slots=True)
class Release:
    """Take wishes again after a stop."""


@dataclass(frozen=True, slots=True)
class Teach:
    """Begin to be shown something, or end it."""

    on: bool


@dataclass(frozen=True, slots=True)
class Repeat:
    """The motion that was shown last."""


@dataclass(frozen=True, slots=True)
class Keep:
    """Store what was shown in the user's library: the way the fingers went, or where they were left."""

    name: str
    motion: bool


@dataclass(frozen=True, slots=True)
class Record:
    """Begin to record, or end it."""

    on: bool


@dataclass(frozen=True, slots=True)
class Scene:
    """Open a simulated hand anew, in a scenario, with an object of the catalogue in place of its own; None: as the
    config has it. `perform`: and do what the scenario, or the config, is for."""

    scenario: str | None
    thing: str | None
    perform: bool


@dataclass(frozen=True, slots=True)
class Again:
    """Open the hand again, limp: after a fault, or at the end of a recording."""


@dataclass(frozen=True, slots=True)
class Gone:
    """Nobody drives any more."""


Wish: TypeAlias = (
    Joints
    | Posture
    | Grasp
    | Control
    | UseGains
    | Gravity
    | Hold
    | Stop
    | Release
    | Teach
    | Repeat
    | Keep
    | Record
    | Scene
    | Again
    | Gone
)


class Wishes:
    """They wait here until the hand has time. A slider that is dragged wishes more than a hand can do: of joint
    positions in a row only the newest waits."""

    def __init__(self) -> None:
        self._waiting: deque[Wish] = deque()
        self._news = threading.Condition()

    def put(self, wish: Wish) -> None:
        with self._news:
            if isinstance(wish, Joints) and self._waiting and isinstance(self._waiting[-1], Joints):
                self._waiting.pop()
            self._waiting.append(wish)
            self._news.notify()

    def clear(self) -> None:
        """Forget all that waits: somebody pressed stop."""
        with self._news:
            self._waiting.clear()

    def get(self, timeout: float) -> Wish | None:
        """The oldest, or None if none came for so many seconds."""
        with self._news:
            if not self._waiting:
                self._news.wait(timeout)
            return self._waiting.popleft() if self._waiting else None
