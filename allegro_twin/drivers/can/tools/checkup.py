"""A link walked step by step with a limp hand: the first thing that is broken is the one to mend."""

from __future__ import annotations

import logging
import math
from collections import deque
from collections.abc import Callable, Generator
from contextlib import suppress
from dataclasses import replace

import can
import numpy as np

from allegro_twin.drivers.can.codec import messages as m
from allegro_twin.drivers.can.codec.codec import Codec
from allegro_twin.drivers.can.codec.detect import reporting
from allegro_twin.drivers.can.codec.frames import Frame, bits
from allegro_twin.drivers.can.codec.messages import Topic
from allegro_twin.drivers.can.driver.host_settings import CanHostSettings
from allegro_twin.drivers.can.driver.interpreter import OTHERS
from allegro_twin.drivers.can.driver.listener import Listener
from allegro_twin.drivers.can.driver.lost_frames import Whole
from allegro_twin.drivers.can.driver.shutdown import ShutdownSequence
from allegro_twin.drivers.can.driver.startup import ANSWER, TRIES, ask, begin, identify, set_up
from allegro_twin.drivers.can.link.load import share
from allegro_twin.drivers.can.link.shared_bus import BusPort
from allegro_twin.drivers.can.tools import findings
from allegro_twin.drivers.can.tools.findings import Finding
from allegro_twin.errors import HandError, LinkError, ProtocolError
from allegro_twin.spec import HandSpec

log = logging.getLogger(__name__)

LISTEN, WATCH, FIRST = 0.3, 2.0, 0.5
"""s of silence before the first word; of reports that are judged; that a hand may take to its first report."""
_POLL = 1.0  # s between two questions for the status, as in the backend.


class Checkup:
    """One walk. The hand gets zero torque and nothing else, and is limp and silent afterwards, whatever happens."""

    def __init__(
        self, spec: HandSpec, codec: Codec, open_port: Callable[[], BusPort], settings: CanHostSettings
    ) -> None:
        self._spec, self._codec, self._open, self._settings = spec, codec, open_port, settings
        self._zero = codec.torques.zero
        self._shutdown = ShutdownSequence(codec, asks=codec.identifies and settings.identify, period=settings.period)
        self._listener = Listener(codec, settings)
        self._side: str | None = None
        self._frames = self._bits = 0
        self._wholes: list[Whole] = []
        self._measured = 0.0
        self._served = False
        self._port: BusPort

    def walk(self) -> Generator[Finding]:
        """Finding after finding, until one is broken; a hand that was not left limp is one more that is."""
        try:
            self._port = self._open()
        except HandError as error:
            yield Finding.of("interface", error)
            return
        try:
            ok = yield from self._walk()
        except BaseException:  # Nobody waits for the row.
            if why := self._leave():
                log.error("%s: cut its power", findings.limp(why).text)
            raise
        why = self._leave()
        if ok or why:
            yield findings.limp(why)
        if ok and not why:
            yield findings.side(self._side, self._spec)

    def _walk(self) -> Generator[Finding, None, bool]:
        """The steps on an open link; whether all of them are in order."""
        yield Finding("interface", f"{self._port.link.name} is open, {self._port.link.bitrate} bit/s")
        for name, step in self._steps():
            try:
                finding = step()
            except HandError as error:
                finding = Finding.of(name, error)
            yield finding
            if not finding.ok:
                return False
        return True

    def _steps(self) -> tuple[tuple[str, Callable[[], Finding]], ...]:
        return (
            ("bus", self._listen),
            ("identity", self._identify),
            ("fingers", self._serve),
            ("reports", self._watch),
            ("motors", lambda: findings.motors(self._listener.motors, self._codec.version)),
            ("temperature", lambda: findings.temperature(self._listener.temperature, self._codec.version)),
            ("joints", self._joints),
            ("load", self._load),
        )

    def _listen(self) -> Finding:
        """Say nothing yet."""
        port, link, commands = self._port, self._port.link, ""
        seen: deque[Frame] = deque(maxlen=OTHERS)
        link.listen(self._count)
        began = link.now()
        while (left := began + LISTEN - link.now()) > 0.0:
            if (stamped := port.receive(left)) is None:
                continue
            message = self._decoded(stamped.frame)
            seen.append(stamped.frame)
            if isinstance(message, m.COMMANDS):
                commands = f"{type(message).__name__}, frame {stamped.frame}"
        return findings.bus(self._frames, LISTEN, link.error_frames, link.bitrate, commands, reporting(seen))

    def _identify(self) -> Finding:
        port, codec = self._port, self._codec
        if not port.send(self._shutdown.frames):
            raise LinkError(f"{port.link.name} takes no frames; is the hand powered and on this bus?")
        if not codec.identifies:
            return findings.identity(codec, None, "")
        if self._settings.identify:
            found, self._side = identify(port, codec, self._spec, self._settings.timeout)
        else:
            found = ask(port, codec, Topic.INFORMATION, m.Information, self._settings.timeout)  # type: ignore[assignment]  # Its kind.
            self._side = None if found is None else found.side
        return findings.identity(codec, found, self._serial() if found is not None else "")

    def _serial(self) -> str:
        try:
            serial = ask(self._port, self._codec, Topic.SERIAL, m.Serial, self._settings.timeout)
        except ProtocolError:
            return ""  # This version has none.
        return serial.text if isinstance(serial, m.Serial) else ""

    def _serve(self) -> Finding:
        """Motors on, at zero torque."""
        port, settings = self._port, replace(self._settings, identify=False)
        self._served = True
        for stamped in begin(port, self._codec, settings, self._spec, self._shutdown.frames):
            self._hear(stamped.frame, stamped.t)
        for tries_left in reversed(range(TRIES)):
            deadline = port.link.now() + FIRST
            while not all(self._heard()) and port.link.now() < deadline:
                self._next(deadline)
            if any(self._heard()) or not tries_left:
                break
            for stamped in set_up(port, self._codec, settings):  # A frame of it may have been lost.
                self._hear(stamped.frame, stamped.t)
        if not any(self._heard()) and self._codec.identifies:
            self._ask_motors()
        return findings.fingers(self._heard(), reporting(self._listener.others), self._listener.motors)

    def _ask_motors(self) -> None:
        """A hand that does not report may answer all the same."""
        self._listener.motors = None
        for _ in range(TRIES):
            self._port.send([self._codec.encode(m.Request(Topic.INFORMATION))])
            deadline = self._port.link.now() + max(self._settings.timeout, ANSWER)
            while self._listener.motors is None and self._port.link.now() < deadline:
                self._next(deadline)

    def _watch(self) -> Finding:
        link, self._listener.serving = self._port.link, True
        self._frames = self._bits = 0
        began = link.now()
        end, ask_at = began + WATCH, began if self._codec.identifies else math.inf
        tries = 1
        while link.now() < end:
            if (whole := self._next(min(end, ask_at))) is not None:
                self._wholes.append(whole)
                self._port.send([self._zero])
            if self._listener.motors is False and tries < TRIES:  # That frame may have been lost.
                tries += 1
                self._port.send([self._codec.encode(m.ServoOn()), self._codec.encode(m.Request(Topic.INFORMATION))])
                self._listener.motors = None
            if link.now() >= ask_at:
                ask_at += _POLL
                self._port.send([self._codec.encode(m.Request(Topic.INFORMATION))])
        self._measured = self._bits / (link.bitrate * (link.now() - began))
        stamps = [whole.t for whole in self._wholes]
        return findings.timing(stamps, WATCH, self._settings.period, self._listener.incomplete, self._settings.timeout)

    def _joints(self) -> Finding:
        positions = np.array([self._listener.position(whole) for whole in self._wholes])
        return findings.joints(positions, self._spec, self._codec.version)

    def _load(self) -> Finding:
        link = self._port.link
        alone = share((self._codec, self._settings.period), link.bitrate)
        others = reporting(self._listener.others)
        return findings.load(alone, self._measured, link.bitrate, self._listener.health.unknown, others)

    def _next(self, deadline: float) -> Whole | None:
        """Hear the next frame; the whole hand that it completes."""
        stamped = self._port.receive(max(deadline - self._port.link.now(), 0.0))
        return None if stamped is None else self._hear(stamped.frame, stamped.t)

    def _hear(self, frame: Frame, t: float) -> Whole | None:
        self._listener.hear(frame, t)
        whole, self._listener.whole = self._listener.whole, None
        return whole

    def _heard(self) -> list[bool]:
        return [t > -math.inf for t in self._listener.heard]

    def _decoded(self, frame: Frame) -> m.Message | None:
        try:
            return self._codec.decode(frame)
        except ProtocolError:
            return None

    def _count(self, message: can.Message) -> None:
        self._frames += 1
        self._bits += bits(message.dlc if not message.is_remote_frame else 0)

    def _leave(self) -> str:
        """Limp, whatever was found; why that was not confirmed. A hand that has said nothing since its motors were
        switched on, and cannot be asked, is not waited for."""
        why = ""
        if self._listener.reports or (self._served and self._shutdown.answer is not None):
            why = self._shutdown.run(self._port, reported=bool(self._listener.reports))
        else:
            with suppress(LinkError):  # Nothing left to say it with.
                self._port.send(self._shutdown.frames)
        self._port.close()
        return why
