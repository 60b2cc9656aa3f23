"""A cell on ROS 2: an onlooker that publishes, and, where the cell is led from outside, the one who leads it."""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from allegro_twin.cell.assembly import Room
from allegro_twin.cell.remote.remote_control import Fingers, Led, Palm, Stay
from allegro_twin.errors import ConfigError, LinkError
from allegro_twin.kinematics.pose import Pose, compose
from allegro_twin.recording.events import DeviceSample, JournalEntry, SessionEvent
from allegro_twin.recording.messages import build
from allegro_twin.recording.messages import message_types as v
from allegro_twin.surfaces.ros import cell_topics as topics
from allegro_twin.surfaces.ros.cell_reports import CellReports
from allegro_twin.surfaces.ros.control_lock import QUIET, Drivers
from allegro_twin.surfaces.ros.node_api import Received, Wire
from allegro_twin.surfaces.ros.publishers import Report
from allegro_twin.surfaces.ros.timing import timing
from allegro_twin.surfaces.ros.topics import NODE

log = logging.getLogger(__name__)
_WAIT = 0.05  # s: how long an end may go unnoticed.
_HELD = 20  # Messages that wait to be published; who comes too late is left out.
_OTHER = f"another program leads the cell; this one is obeyed after {QUIET:g} s of quiet"
_DECIDES = "the state machine leads the cell; begin it with --follow to lead it from here"


class CellBridge:
    """One cell on one node. The loop turns elsewhere; what happens here delays it by a queue's `put`."""

    def __init__(self, room: Room, node: Wire, words: v.RosTypes, *, rate: float = 100.0) -> None:
        """`rate`: Hz, of what is published. Raises ConfigError for one that is not positive."""
        if not 0.0 < rate <= 1000.0:
            raise ConfigError(f"the rate must be above 0 and at most 1000 Hz, not {rate:g}")
        self._room, self._node, self._words, self._interval = room, node, words, 1.0 / rate
        self._reports, self._drivers = CellReports(room, words), Drivers()
        self._hand: DeviceSample | None = None
        self._led: Led | None = None
        self._due, self._over = 0.0, threading.Event()
        self._waiting: queue.Queue[Callable[[], Iterator[Report]]] = queue.Queue(maxsize=_HELD)
        for name, kind, quality, _ in topics.PUBLISHED:
            node.advertise(name, kind, quality)
        for name, kind, quality, _ in topics.HEARD:
            node.subscribe(name, kind, quality)
        self._threads = [
            threading.Thread(target=work, name=f"allegro_twin ros {work.__name__}", daemon=True)
            for work in (self._publish, self._hear)
        ]

    def obeyed_by(self, led: Led) -> None:
        """From now on what is heard leads the cell."""
        self._led = led

    def start(self) -> None:
        """Begin to publish and to hear."""
        for report in self._reports.at_first(time.time_ns()):
            self._node.publish(*report)
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """End both."""
        self._over.set()
        for thread in self._threads:
            thread.join(timeout=2.0)

    def on_event(self, event: SessionEvent) -> None:
        """In the cell's loop: as little as possible."""
        stamp = time.time_ns()
        if isinstance(event, JournalEntry):
            self._see_event(stamp, event)
        elif event.device == "hand":
            self._hand = event
        elif self._hand is not None and event.sample.state.t >= self._due - 1e-9:
            self._due = event.sample.state.t + self._interval
            arm, hand = event, self._hand
            self._put(lambda: self._reports.of(stamp, arm, hand))

    def refuse(self, topic: str, why: str) -> None:
        """Say that something that was asked for is not done."""
        stamp = time.time_ns()
        self._put(lambda: iter([self._reports.said(stamp, topic, why, bad=True)]))

    def _see_event(self, stamp: int, told: JournalEntry) -> None:
        row = told.row
        if told.track == "pictures":
            self._put(lambda: self._reports.picture(stamp, row))
        elif told.track == "states":
            end, reason, sentence = (row.get(name) or "" for name in ("end", "reason", "sentence"))
            words = [end, reason, sentence] if end else [sentence or str(row["state"])]
            text, bad = ": ".join(word for word in words if word), bool(sentence)
            self._put(lambda: iter([self._reports.said(stamp, "states", text, bad=bad)]))

    def _put(self, made: Callable[[], Iterator[Report]]) -> None:
        try:
            self._waiting.put_nowait(made)
        except queue.Full:
            pass  # Who listens sees as much as this computer is fast enough for.

    def _publish(self) -> None:
        while not (self._over.is_set() and self._waiting.empty()):
            try:
                for report in self._waiting.get(timeout=_WAIT)():
                    self._node.publish(*report)
            except queue.Empty:
                continue
            except LinkError as error:
                log.warning("nothing more is published: %s", error)
                return

    def _hear(self) -> None:
        while not self._over.is_set():
            for received in self._node.wait(_WAIT):
                self._act(received)

    def _act(self, received: Received) -> None:
        topic, data, sender = received
        now, led = time.monotonic(), self._led
        if led is None:
            if self._drivers.first_refusal(sender):
                self.refuse(topic, f"{topic}: {_DECIDES}")
            return
        if not self._drivers.may(sender, now):
            if self._drivers.first_refusal(sender):
                self.refuse(topic, f"{topic}: {_OTHER}")
            return
        try:
            if topic == topics.TARGET:
                led.wish(Palm(self._pose(data)))
                return
            message = self._words.decode(data, v.TRAJECTORY)
            if not message.points:
                led.wish(Stay())
                return
            times, postures, rates, late = timing(message, self._room.hand.spec, time.time_ns)
            self._drivers.keep(sender, now, float(times[-1]) + late)
            led.wish(Fingers(times + late, postures, rates))
        except ConfigError as error:
            self.refuse(topic, str(error))

    def _pose(self, data: bytes) -> Pose:
        message = self._words.decode(data, v.POSE)
        pose, frame, base = build.pose_in(message, "target_frame"), message.header.frame_id, self._reports.base
        if frame == base:
            return compose(self._room.cell.base, pose)
        if frame not in ("", build.WORLD):
            raise ConfigError(f"target_frame is in {frame!r}; this cell knows {build.WORLD!r} and {base!r}")
        return pose


@contextmanager
def open_cell(
    room: Room,
    *,
    namespace: str = topics.NAMESPACE,
    domain: int = 0,
    distro: str = "jazzy",
    rate: float = 100.0,
) -> Iterator[CellBridge]:
    """Put a cell on ROS 2, on this machine alone. Raises ConfigError, LinkError."""
    from allegro_twin.surfaces.ros.node import Node

    words = v.ros_types_by_name(distro)
    node = Node(words, NODE, namespace, domain)
    try:
        bridge = CellBridge(room, node, words, rate=rate)
        node.announce()
        bridge.start()
        try:
            yield bridge
        finally:
            bridge.close()
    finally:
        node.close()
