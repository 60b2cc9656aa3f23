"""The bridge: listens to a hand and publishes, hears wishes and passes them on."""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Callable

from allegro_twin.errors import ConfigError, HandError, LinkError, MotionStalled
from allegro_twin.recording.messages.message_types import RosTypes
from allegro_twin.surfaces.hand import Hand
from allegro_twin.surfaces.ros.control_lock import QUIET, Drivers
from allegro_twin.surfaces.ros.node_api import Received, Wire
from allegro_twin.surfaces.ros.publishers import Reports
from allegro_twin.surfaces.ros.subscribers import Wishes
from allegro_twin.surfaces.ros.topics import HEARD, PUBLISHED, WRENCH
from allegro_twin.types import Sample

log = logging.getLogger(__name__)
_OTHER = f"another program drives the hand, or has switched it off; this one is obeyed after {QUIET:g} s of quiet"
_WAIT = 0.05  # s: how long the end of a hand may go unnoticed.


class Bridge:
    """One hand on one node. The hand turns its own loop; what happens here delays it by a queue's `put`."""

    def __init__(
        self, hand: Hand, node: Wire, words: RosTypes, *, rate: float = 100.0, speed: float = 2.0,
        told: Callable[[str], None] = log.warning,
    ) -> None:  # fmt: skip
        """`rate`: Hz, of what is published; `speed`: rad/s, of what is asked for without a time; `told`: hears every
        refusal. Raises ConfigError for a rate that is not positive."""
        if not 0.0 < rate <= 1000.0:
            raise ConfigError(f"--rate must be above 0 and at most 1000 Hz, not {rate:g}")
        self._hand, self._node, self._told = hand, node, told
        self._reports, self._wishes = Reports(hand, words), Wishes(hand, words, time.time_ns, speed=speed)
        self._drivers, self._interval = Drivers(), 1.0 / rate
        self._samples: queue.Queue[tuple[int, Sample]] = queue.Queue(maxsize=3)
        self._due, self._last, self._over = -1.0, None, threading.Event()
        self._latest: Sample | None = None
        for name, kind, quality, _ in PUBLISHED:
            for topic in [name.format(finger=f.name) for f in hand.spec.fingers] if name == WRENCH else [name]:
                node.advertise(topic, kind, quality)
        for name, kind, quality, _ in HEARD:
            node.subscribe(name, kind, quality)

    def serve(self, until: Callable[[], bool] = lambda: False) -> None:
        """Until that is so, or the hand ends: raises then what ended it."""
        for report in self._reports.at_first(time.time_ns()):
            self._node.publish(*report)
        publisher = threading.Thread(target=self._publish, name="allegro_twin ros", daemon=True)
        with self._hand.listening(self._heard):
            publisher.start()
            try:
                while not until():
                    state = self._hand.state  # Raises what ended the loop.
                    assert state is not None
                    for received in self._node.wait(_WAIT):
                        self._act(received)
            except HandError as error:
                self._last_words(error)
                raise
            finally:
                self._over.set()
                publisher.join(timeout=1.0)

    def _heard(self, sample: Sample) -> None:
        """In the hand's own loop: as little as possible."""
        self._reports.seen(sample)
        self._latest = sample
        if sample.state.t >= self._due:
            self._due = max(self._due + self._interval, sample.state.t)
            try:
                self._samples.put_nowait((time.time_ns(), sample))
            except queue.Full:
                pass  # Who listens sees every sample that this computer is fast enough for.

    def _publish(self) -> None:
        said = 0
        while not self._over.is_set():
            try:
                stamp, sample = self._samples.get(timeout=_WAIT)
                for report in self._reports.of(stamp, sample):
                    self._node.publish(*report)
                if stamp - said >= 10**9:
                    said = stamp
                    self._node.publish(*self._reports.health(stamp, sample))
            except queue.Empty:
                continue
            except HandError as error:
                log.warning("nothing more is published: %s", error)
                return

    def _act(self, received: Received) -> None:
        topic, data, sender = received
        now = time.monotonic()
        try:
            if self._wishes.stops(topic, data):
                self._drivers.stop(sender)
            elif not self._drivers.may(sender, now):
                if self._drivers.first_refusal(sender):
                    self._refuse(topic, f"{topic}: {_OTHER}")
                return
            seconds = self._wishes.carry_out(topic, data, sender)
            if seconds:
                self._drivers.keep(sender, now, seconds)
        except (ConfigError, MotionStalled) as error:
            self._refuse(topic, str(error))

    def _refuse(self, topic: str, why: str) -> None:
        self._told(why)
        self._node.publish(*self._reports.refused(time.time_ns(), topic, why))

    def _last_words(self, error: HandError) -> None:
        if self._latest is None:
            return
        try:
            self._node.publish(*self._reports.health(time.time_ns(), self._latest, str(error)))
        except LinkError:
            pass  # What ended the hand is what is raised.
