"""A bus shared by the hands of this program: frames out, frames in with their time, errors as LinkErrors."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeAlias

import can

from allegro_twin.drivers.base.keeper.keeper import LinkAddress
from allegro_twin.drivers.can.codec.frames import LOST, Frame, JointFrames
from allegro_twin.drivers.can.link.load import Load, check_load

Message: TypeAlias = can.Message
"""A frame as python-can hands it over, with its time and its direction."""
QUEUE = 4096
"""Frames kept for a hand that nobody reads."""
TURN = 0.0005
"""s after which a hand looks whether another hand's thread has received something for it."""


class Stamped(NamedTuple):
    """A frame and when it came, s on the link's clock; LOST where some were lost."""

    frame: Frame
    t: float


class StampedJoints(NamedTuple):
    """The reports of all joints, of one moment."""

    frames: JointFrames
    t: float


class Link(ABC):
    """One bus. Raises LinkError for whatever ends it; ports are the hands that listen."""

    lockstep = False
    """Whether time on this bus passes only while somebody waits for a frame."""

    def __init__(self, name: str, bitrate: int) -> None:
        self.name, self.bitrate = name, bitrate
        self._ports: list[BusPort] = []
        self._sending, self._receiving = threading.Lock(), threading.Lock()
        self._listeners: list[Callable[[can.Message], None]] = []
        self.error_frames = 0

    @abstractmethod
    def now(self) -> float:
        """Seconds on a clock that never goes back."""

    @abstractmethod
    def _send(self, frames: Sequence[Frame | JointFrames]) -> bool:
        """Put frames on the bus. False when the transmit queue was full and some were lost."""

    @abstractmethod
    def _receive(self, timeout: float) -> Sequence[Stamped | StampedJoints]:
        """Wait for what comes; empty when nothing did."""

    @abstractmethod
    def _close(self) -> None:
        """Let go of the bus."""

    @property
    def address(self) -> LinkAddress | str:
        """How a process of its own can reach this bus, or why none can."""
        return "this adapter serves one program at a time"

    def port(self, load: Load | None = None) -> BusPort:
        """A listener of its own: every port receives every frame. Raises ConfigError when the bus cannot carry its
        `load` beside the others'."""
        port = BusPort(self, load)
        check_load([*(other.load for other in self._ports), load], self.bitrate, self.name)
        self._ports.append(port)
        return port

    def listen(self, listener: Callable[[can.Message], None]) -> None:
        """Tell of every frame, sent or received: for bus logs."""
        self._listeners.append(listener)

    def send(self, frames: Sequence[Frame | JointFrames]) -> bool:
        """Put frames on the bus. False when the transmit queue was full and some were lost."""
        with self._sending:
            return self._send(frames)

    def pump(self, timeout: float) -> bool:
        """Wait for frames and hand them to all ports. False when none came."""
        if not self._receiving.acquire(blocking=False) and not self._receiving.acquire(timeout=min(timeout, TURN)):
            return False  # Another hand's thread receives, for this one as well.
        try:
            came = self._receive(timeout)
            for port in self._ports:
                port.queue.extend(came)
                if len(port.queue) > QUEUE:
                    port.lose()
        finally:
            self._receiving.release()
        return bool(came)

    def leave(self, port: BusPort) -> None:
        """The last one out closes the bus."""
        if port in self._ports:
            self._ports.remove(port)
            if not self._ports:
                self._close()


class BusPort:
    """One hand's end of a link."""

    def __init__(self, link: Link, load: Load | None) -> None:
        self.link, self.load, self.send = link, load, link.send
        self.queue: deque[Stamped | StampedJoints] = deque()

    def lose(self) -> None:
        """Where nobody reads, what came is lost, and known to be."""
        t = self.queue[-1].t
        self.queue.clear()
        self.queue.append(Stamped(LOST, t))

    def receive(self, timeout: float) -> Stamped | None:
        """The next frame; None after `timeout` seconds without one."""
        deadline = self.link.now() + timeout
        while not self.queue:
            left = deadline - self.link.now()
            if not self.link.pump(max(left, 0.0)) and left <= 0.0:
                return None
        came = self.queue.popleft()
        if isinstance(came, Stamped):
            return came
        first, *others = (Stamped(frame, came.t) for frame in came.frames.frames)
        self.queue.extendleft(reversed(others))
        return first

    def close(self) -> None:
        self.link.leave(self)
