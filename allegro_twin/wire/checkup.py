"""A link walked step by step with a limp hand: the first thing that is broken is the one to mend."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator
from dataclasses import replace

import can
import numpy as np

from allegro_twin.errors import HandError, LinkError, ProtocolError
from allegro_twin.spec import HandSpec
from allegro_twin.wire import findings
from allegro_twin.wire import messages as m
from allegro_twin.wire.assembler import Whole
from allegro_twin.wire.codec import Codec
from allegro_twin.wire.findings import Finding
from allegro_twin.wire.frames import Frame, bits
from allegro_twin.wire.handshake import ask, begin, identify
from allegro_twin.wire.link import Port
from allegro_twin.wire.listener import Listener
from allegro_twin.wire.load import share
from allegro_twin.wire.messages import Topic
from allegro_twin.wire.strangers import speakers
from allegro_twin.wire.terms import Terms

LISTEN, WATCH, FIRST = 0.3, 2.0, 0.5
"""s of silence before the first word; of reports that are judged; that a hand may take to its first report."""
_POLL = 1.0  # s between two questions for the status, as in the backend.
_KEPT = 400  # Frames of others that are kept, to say whose they are.


class Checkup:
    """One walk. The hand gets zero torque and nothing else, and is limp and silent afterwards, whatever happens."""

    def __init__(self, spec: HandSpec, codec: Codec, open_port: Callable[[], Port], terms: Terms) -> None:
        self._spec, self._codec, self._open, self._terms = spec, codec, open_port, terms
        self._zero = [codec.encode(m.SetTorque(finger, (0.0, 0.0, 0.0, 0.0))) for finger in range(4)]
        self._limp = [*self._zero, *map(codec.encode, codec.closing())]
        self._ears = Listener(codec, terms.period, terms.gravity)
        self._others: list[Frame] = []
        self._side: str | None = None
        self._frames = self._bits = 0
        self._wholes: list[Whole] = []
        self._measured = 0.0
        self._port: Port

    def walk(self) -> Generator[Finding]:
        """Finding after finding; the last is the first that is broken, or that the hand was left limp."""
        try:
            self._port = self._open()
        except HandError as error:
            yield Finding.of("interface", error)
            return
        try:
            yield Finding("interface", f"{self._port.link.name} is open, {self._port.link.bitrate} bit/s")
            for name, step in self._steps():
                try:
                    finding = step()
                except HandError as error:
                    finding = Finding.of(name, error)
                yield finding
                if not finding.ok:
                    return
            yield findings.side(self._side, self._spec)
        finally:
            self._leave()

    def _steps(self) -> tuple[tuple[str, Callable[[], Finding]], ...]:
        return (
            ("bus", self._listen),
            ("identity", self._identify),
            ("fingers", self._serve),
            ("reports", self._watch),
            ("temperature", lambda: findings.temperature(self._ears.temperature, self._codec.version)),
            ("joints", self._joints),
            ("load", self._load),
        )

    def _listen(self) -> Finding:
        """Say nothing yet."""
        port, link, commands = self._port, self._port.link, ""
        link.listen(self._count)
        began = link.now()
        while (left := began + LISTEN - link.now()) > 0.0:
            if (stamped := port.receive(left)) is None:
                continue
            message = self._decoded(stamped.frame)
            self._others = [*self._others, stamped.frame][:_KEPT]
            if isinstance(message, m.SetTorque | m.ServoOn | m.ServoOff):
                commands = f"{type(message).__name__}, frame {stamped.frame}"
        heard, self._others = speakers(self._others), []
        return findings.bus(self._frames, LISTEN, link.error_frames, link.bitrate, commands, heard)

    def _identify(self) -> Finding:
        port, codec = self._port, self._codec
        if not port.send(self._limp):
            raise LinkError(f"{port.link.name} takes no frames; is the hand powered and on this bus?")
        if not codec.identifies:
            return findings.identity(codec, None, "")
        if self._terms.identify:
            found, self._side = identify(port, codec, self._spec)
        else:
            found = ask(port, codec, Topic.INFORMATION, m.Information)  # type: ignore[assignment]  # Its kind.
            self._side = None if found is None else found.side
        return findings.identity(codec, found, self._serial() if found is not None else "")

    def _serial(self) -> str:
        try:
            serial = ask(self._port, self._codec, Topic.SERIAL, m.Serial)
        except ProtocolError:
            return ""  # This version has none.
        return serial.text if isinstance(serial, m.Serial) else ""

    def _serve(self) -> Finding:
        """Motors on, at zero torque."""
        port, terms = self._port, replace(self._terms, identify=False)
        for stamped in begin(port, self._codec, terms, self._spec, self._limp):
            self._hear(stamped.frame, stamped.t)
        deadline = port.link.now() + FIRST
        while not all(self._heard()) and port.link.now() < deadline:
            self._next(deadline)
        return findings.fingers(self._heard(), speakers(self._others))

    def _watch(self) -> Finding:
        link, self._ears.serving = self._port.link, True
        self._frames = self._bits = 0
        began = link.now()
        end, ask_at = began + WATCH, began if self._codec.identifies else math.inf
        while link.now() < end:
            if (whole := self._next(min(end, ask_at))) is not None:
                self._wholes.append(whole)
                self._port.send(self._zero)
            if link.now() >= ask_at:
                ask_at += _POLL
                self._port.send([self._codec.encode(m.Request(Topic.INFORMATION))])
        self._ears.count(link.error_frames)
        self._measured = self._bits / (link.bitrate * (link.now() - began))
        stamps = [whole.t for whole in self._wholes]
        return findings.timing(stamps, WATCH, self._terms.period, self._ears.health.incomplete, self._terms.timeout)

    def _joints(self) -> Finding:
        positions = np.array([whole.position for whole in self._wholes])
        return findings.joints(positions, self._spec, self._codec.version)

    def _load(self) -> Finding:
        link = self._port.link
        alone = share((self._codec, self._terms.period), link.bitrate)
        others = speakers(self._others)
        return findings.load(alone, self._measured, link.bitrate, self._ears.health.unknown, others)

    def _next(self, deadline: float) -> Whole | None:
        """Hear the next frame; the whole hand that it completes."""
        stamped = self._port.receive(max(deadline - self._port.link.now(), 0.0))
        return None if stamped is None else self._hear(stamped.frame, stamped.t)

    def _hear(self, frame: Frame, t: float) -> Whole | None:
        if self._decoded(frame) is None and len(self._others) < _KEPT:
            self._others.append(frame)
        return self._ears.hear(frame, t)

    def _heard(self) -> list[bool]:
        return [t > -math.inf for t in self._ears.heard]

    def _decoded(self, frame: Frame) -> m.Message | None:
        try:
            return self._codec.decode(frame)
        except ProtocolError:
            return None

    def _count(self, message: can.Message) -> None:
        self._frames += 1
        self._bits += bits(message.dlc if not message.is_remote_frame else 0)

    def _leave(self) -> None:
        try:
            self._port.send(self._limp)
        except LinkError:
            pass  # Nothing left to say it with.
        self._port.close()
