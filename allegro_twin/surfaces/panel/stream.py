"""What goes to the page: moments of the hand, which may be lost, and news, which may not."""

from __future__ import annotations

import pickle
import socket
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from allegro_twin.spec import HandSpec
from allegro_twin.surfaces.panel.cell import CellFrame
from allegro_twin.types import Array, Vector
from allegro_twin.viewing.scenery import Scenery

_LARGEST = 1 << 16  # Bytes of a frame; one has some 3,000.


class Frame(NamedTuple):
    """One moment."""

    hand: int
    """Which opening of the hand it is of; they count up."""
    t: float
    """s, on the hand's clock."""
    position: Vector
    """(n,), rad."""
    torque: Vector
    """(n,), N·m."""
    temperature: Vector
    """(n,), °C."""
    target: Vector
    """(n,), rad; NaN where the controller wants no position."""
    look: Mapping[str, Array]
    """What is known beside the hand: `look.viewer.Look`, and `others`, (k, 7), for every object but the first."""
    kind: str
    """The controller."""
    stopped: bool
    """Limp until somebody releases the stop."""
    lost: int
    """Periods of the hand without a state, so far."""
    link: tuple[str, ...]
    """What the link went through, in words."""
    recorded: float
    """s; negative: not recording."""
    teaching: bool


@dataclass(frozen=True, slots=True)
class Opened:
    """A hand was opened."""

    hand: int
    title: str
    spec: HandSpec
    scenery: Scenery
    period: float
    """s."""
    kinds: tuple[str, ...]
    gains: tuple[str, ...]
    used: str
    """Those in use."""
    scenarios: tuple[str, ...] = ()
    """Empty: the scene of this hand cannot be changed from here."""
    things: tuple[str, ...] = ()
    scenario: str | None = None
    thing: str | None = None
    no_tips: str = ""
    """Why fingertips cannot be dragged; empty: they can."""


@dataclass(frozen=True, slots=True, eq=False)
class Shelf:
    """What the library has for this hand."""

    postures: Mapping[str, Vector] = field(default_factory=dict)
    """(n,), rad."""
    grasps: Mapping[str, Vector] = field(default_factory=dict)
    """Closed, (n,), rad."""


@dataclass(frozen=True, slots=True)
class Notice:
    """Something that a person should read."""

    text: str
    bad: bool = False


@dataclass(frozen=True, slots=True)
class Ended:
    """The hand is gone: why. It can be opened again."""

    why: str


News = Opened | Shelf | Notice | Ended


class Sender:
    """Sends frames and never waits: who does not read in time misses some."""

    def __init__(self, pipe: socket.socket) -> None:
        pipe.setblocking(False)
        self._pipe = pipe

    def __call__(self, frame: Frame | CellFrame) -> None:
        try:
            self._pipe.send(pickle.dumps(frame, pickle.HIGHEST_PROTOCOL))
        except OSError:
            pass  # The page is slow or gone; that is for whoever looks after it, not for the loop.


def received(pipe: socket.socket) -> Frame | CellFrame | None:
    """The next frame, from this program's own other process; None when it has ended."""
    content = pipe.recv(_LARGEST)
    if not content:
        return None
    frame = pickle.loads(content)
    assert isinstance(frame, Frame | CellFrame)
    return frame
