"""Messages to the page: frames of the session, which may be lost, and messages that may not."""

from __future__ import annotations

import pickle
import socket
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector
from allegro_twin.viewing.scenery import Scenery

RATE = 30.0
"""Frames a second of the session's clock."""
_LARGEST = 1 << 16  # Bytes of a frame; one has some 3,000.
_NONE: Vector = np.empty(0)


class StreamFrame(NamedTuple):
    """One moment of a session."""

    session: int
    """Which opening of it; they count up."""
    t: float
    """s, on the session's clock."""
    position: Vector
    """Positions of the hand's joints, (n,), rad."""
    torque: Vector
    """(n,), N·m."""
    temperature: Vector
    """(n,), °C."""
    target: Vector
    """(n,), rad; NaN where the controller wants no position."""
    look: Mapping[str, Array]
    """What is known beside the hand: `rerun.viewer.Look`, and `others`, (k, 7), for every object but the first. With an
    arm: `flange` and `goal`, where the palm is to go, (7,). While the mouse pulls an object: `drag`, its number, the
    picked point (m) and the mouse's (m), and the force (N), all in the world, (10,). In an episode: `episode`, its time
    and its limit (s), the goals reached, those of them that a person set, whether the present one is a person's, and
    plans a second, (6,); where its goal is an orientation `object_goal`, the object as it should be, beside the hand,
    (7,)."""
    kind: str
    """The controller."""
    stopped: bool
    """No request is carried out until somebody releases the stop."""
    lost: int
    """Periods of the hand without a state, so far."""
    link: tuple[str, ...]
    """Warnings of the link."""
    recorded: float
    """s; negative: not recording."""
    teaching: bool
    arm: Vector = _NONE
    """Joint positions of the arm, rad; empty: the hand is alone."""
    goal: Vector = _NONE
    """Where the joints are headed, (n,), rad: `LiveControl.goal`; empty: of a cell."""
    gains: str = ""
    """Those in use."""
    gravity: tuple[float, float, float] | None = None
    """What counts in place of what the hand reports, palm frame, m/s²; None: what it reports."""


@dataclass(frozen=True, slots=True)
class SessionInfo:
    """Description of a session for the page, when it is opened."""

    session: int
    title: str
    spec: HandSpec
    scenery: Scenery
    kinds: tuple[str, ...] = ()
    """Controllers."""
    gains: tuple[str, ...] = ()
    scenarios: tuple[str, ...] = ()
    """Empty: the scene of this hand cannot be changed from here."""
    object_names: tuple[str, ...] = ()
    scenario: str | None = None
    object_name: str | None = None
    no_tips: str = ""
    """Why fingertips cannot be dragged; empty: they can."""
    no_drag: str = ""
    """Why objects cannot be pulled with the mouse; empty: they can."""
    arm: HandSpec | None = None
    """The arm of a cell; None: the hand is alone."""
    episode: str = ""
    """The task whose episode the hand is in; empty: none."""
    plans: bool = False
    """The config's controller plans for it."""
    turns: bool = False
    """Its goal is an orientation of the object, which a person may turn."""


@dataclass(frozen=True, slots=True, eq=False)
class LibraryContents:
    """Entries of the library for this hand."""

    postures: Mapping[str, Vector] = field(default_factory=dict)
    """(n,), rad."""
    grasps: Mapping[str, Vector] = field(default_factory=dict)
    """Closed, (n,), rad."""


@dataclass(frozen=True, slots=True)
class Notice:
    """A sentence for a person."""

    text: str
    bad: bool = False


@dataclass(frozen=True, slots=True)
class SessionEnded:
    """The session has ended; it can be opened again."""

    why: str


PageMessage = SessionInfo | LibraryContents | Notice | SessionEnded


def goals_reached(count: int, by_hand: int) -> str:
    """How many goals were reached, and how many of them a person had set, in words."""
    if not count:
        return "no goal reached"
    return f"{count} goal{'' if count == 1 else 's'} reached" + (f", {by_hand} of them set by hand" if by_hand else "")


class FrameSender:
    """Sends frames and never waits: a page that does not read in time misses some."""

    def __init__(self, pipe: socket.socket) -> None:
        pipe.setblocking(False)
        self._pipe = pipe

    def __call__(self, frame: StreamFrame) -> None:
        try:
            self._pipe.send(pickle.dumps(frame, pickle.HIGHEST_PROTOCOL))
        except OSError:
            pass  # The page is slow or gone; the host looks after it, not the loop.


def receive_frame(pipe: socket.socket) -> StreamFrame | None:
    """The next frame, from this program's own other process; None when it has ended."""
    content = pipe.recv(_LARGEST)
    if not content:
        return None
    frame = pickle.loads(content)
    assert isinstance(frame, StreamFrame)
    return frame
