"""The ROS bridge of a session, a hand or a cell: it publishes the session's events and passes commands on."""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import NamedTuple, TypeAlias
from uuid import UUID

from allegro_twin.errors import ConfigError, HandError, MotionInterrupted, MotionStalled
from allegro_twin.recording.events import SessionEvent
from allegro_twin.recording.messages import message_types as v
from allegro_twin.surfaces.ros.node_api import Received, RosNode, RosTopic

log = logging.getLogger(__name__)
QUIET = 1.0
"""s after a program's last command, or after its motion, in which no other is obeyed."""
NODE = "allegro_twin"
_WAIT = 0.05  # s: how long the end of a session may go unnoticed.
_INFO, _WARN = 20, 30  # rcl_interfaces/Log.

Publication: TypeAlias = tuple[str, v.Message]
"""A topic and a message for it."""
Maker: TypeAlias = Callable[[int], Iterator[Publication]]
"""Makes publications for a stamp, ns since 1970, in the thread that publishes them."""


class SessionTopics:
    """The topics of one session: messages for its events, and the commands that it takes."""

    published: Sequence[RosTopic]
    subscribed: Sequence[RosTopic]
    backlog = 3
    """Events that wait to be published; further ones are dropped."""
    occupied = "another program is obeyed"
    """The refusal of a command while another program is obeyed."""

    def __init__(self, types: v.RosTypes, name: str, rate: float) -> None:
        """`name` stands in the log; `rate`: Hz, of samples that are published. Raises ConfigError for a rate that is
        not positive."""
        if not 0.0 < rate <= 1000.0:
            raise ConfigError(f"--rate must be above 0 and at most 1000 Hz, not {rate:g}")
        self._types, self._name, self._interval, self._due = types, name, 1.0 / rate, 0.0

    def attached(self, observer: Callable[[SessionEvent], None]) -> AbstractContextManager[None]:
        """While this lasts, the observer gets the session's events; a cell calls its observers by itself."""
        return nullcontext()

    def check(self) -> None:
        """Raises the HandError that ended the session."""

    def first(self, stamp: int) -> Iterator[Publication]:
        """What is published once, and kept for who comes later."""
        raise NotImplementedError

    def messages(self, event: SessionEvent) -> Maker | None:
        """In the session's own loop: how to publish an event; None where it is not published."""
        raise NotImplementedError

    def last(self, stamp: int, error: HandError) -> Iterator[Publication]:
        """What is published when the session has ended by an error."""
        return iter(())

    def closed(self) -> str:
        """Why no program is obeyed; empty: programs are."""
        return ""

    def is_stop(self, topic: str, data: bytes) -> bool:
        """Whether a message only stops the session, which every program may."""
        return False

    def execute(self, topic: str, data: bytes, sender: UUID) -> float:
        """Carry out a message; how long its motion takes, s, where that is known. Raises ConfigError."""
        raise NotImplementedError

    def log(self, stamp: int, topic: str, text: str, *, bad: bool = True) -> Publication:
        """A line of ROS's log."""
        level, types = _WARN if bad else _INFO, self._types
        return "/rosout", types.make(
            v.LOG, stamp=types.time(stamp), level=level, name=self._name, msg=text, file="", function=topic, line=0
        )

    def _is_due(self, t: float) -> bool:
        """Whether a sample at a time, s, is to be published."""
        if t < self._due - 1e-9:
            return False
        self._due += self._interval
        if self._due <= t:  # After a gap, what was left out is not made up for.
            self._due = t + self._interval
        return True


class RosBridge:
    """One session on one node. The session turns its own loop; `on_event` delays it by a queue's `put`."""

    def __init__(self, topics: SessionTopics, node: RosNode, on_refusal: Callable[[str], None] = log.warning) -> None:
        """`on_refusal` gets the reason of every command that is refused."""
        self._topics, self._node, self._on_refusal = topics, node, on_refusal
        self._lock, self._over = SenderLock(), threading.Event()
        self._waiting: queue.Queue[tuple[int, Maker]] = queue.Queue(maxsize=topics.backlog)
        for name, kind, quality, _ in topics.published:
            node.advertise(name, kind, quality)
        for name, kind, quality, _ in topics.subscribed:
            node.subscribe(name, kind, quality)

    def on_event(self, event: SessionEvent) -> None:
        """Publish an event of the session soon; drop it where this computer is not fast enough."""
        make = self._topics.messages(event)
        if make is not None:
            try:
                self._waiting.put_nowait((time.time_ns(), make))
            except queue.Full:
                pass

    def serve(self, until: Callable[[], bool] = lambda: False) -> None:
        """Publish, and carry out commands, until that is so or the session ends: raises then what ended it."""
        self._publish_all(self._topics.first(time.time_ns()))
        publisher = threading.Thread(target=self._publish, name="allegro_twin ros", daemon=True)
        with self._topics.attached(self.on_event):
            publisher.start()
            try:
                while not until():
                    self._topics.check()
                    for received in self._node.wait(_WAIT):
                        self._act(received)
            except HandError as error:
                self._publish_last(error)
                raise
            finally:
                self._over.set()
                publisher.join(timeout=1.0)

    def _publish(self) -> None:
        while not (self._over.is_set() and self._waiting.empty()):
            try:
                stamp, make = self._waiting.get(timeout=_WAIT)
                self._publish_all(make(stamp))
            except queue.Empty:
                continue
            except HandError as error:
                log.warning("nothing more is published: %s", error)
                return

    def _publish_all(self, publications: Iterator[Publication]) -> None:
        for publication in publications:
            self._node.publish(*publication)

    def _publish_last(self, error: HandError) -> None:
        try:
            self._publish_all(self._topics.last(time.time_ns(), error))
        except HandError:
            pass  # What ended the session is what is raised.

    def _act(self, received: Received) -> None:
        topic, data, sender = received
        now, topics = time.monotonic(), self._topics
        try:
            if topics.is_stop(topic, data):
                self._lock.stop(sender)
            elif reason := topics.closed() or ("" if self._lock.acquire(sender, now) else topics.occupied):
                if self._lock.first_refusal(sender):
                    self._refuse(topic, f"{topic}: {reason}")
                return
            seconds = topics.execute(topic, data, sender)
            if seconds:
                self._lock.extend(sender, now, seconds)
        except (ConfigError, MotionStalled, MotionInterrupted) as error:
            self._refuse(topic, str(error))

    def _refuse(self, topic: str, why: str) -> None:
        self._on_refusal(why)
        self._node.publish(*self._topics.log(time.time_ns(), topic, why))


class _Turn(NamedTuple):
    sender: UUID
    until: float
    """s."""


class SenderLock:
    """Lock of the sender: the program that came first is obeyed, until it has been quiet."""

    def __init__(self) -> None:
        self._turn: _Turn | None = None
        self._stopped: dict[UUID, float] = {}
        self._refused: set[UUID] = set()

    def acquire(self, sender: UUID, now: float) -> bool:
        """Whether a program is obeyed at a time, s."""
        if now < self._stopped.get(sender, 0.0):
            self._stopped[sender] = now + QUIET
            return False
        if self._turn is not None and self._turn.sender != sender and now < self._turn.until:
            return False
        if self._turn is None or self._turn.sender != sender:
            self._refused.clear()
        self._turn = _Turn(sender, now + QUIET)
        return True

    def extend(self, sender: UUID, now: float, seconds: float) -> None:
        """A program's motion lasts so long, s."""
        self._turn = _Turn(sender, now + seconds + QUIET)

    def stop(self, sender: UUID) -> None:
        """A program has stopped the session: whoever was obeyed is so again after it has been quiet, or its stream
        would undo that at once."""
        if self._turn is not None and self._turn.sender != sender:
            self._stopped[self._turn.sender] = self._turn.until
            self._refused.discard(self._turn.sender)
        self._turn = None

    def first_refusal(self, sender: UUID) -> bool:
        """Whether a program is refused for the first time since the lock changed hands."""
        known = sender in self._refused
        self._refused.add(sender)
        return not known
