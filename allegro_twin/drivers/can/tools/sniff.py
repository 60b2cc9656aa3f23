"""Listening to a bus without a word: every identifier, how often it comes, and what it says."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

import can

from allegro_twin.drivers.can.codec.codec import Codec
from allegro_twin.drivers.can.codec.frames import Frame
from allegro_twin.drivers.can.codec.messages import Message
from allegro_twin.drivers.can.codec.text import Description, describe
from allegro_twin.drivers.can.codec.versions import LAST_DEVICE, make_codec
from allegro_twin.drivers.can.link.adapter import received
from allegro_twin.errors import LinkError, ProtocolError
from allegro_twin.hands.description.calibration import HandCalibration, Version

_ORDER: tuple[Version, ...] = ("v4", "v5", "v5plus", "v2", "v3", "v1")
"""Which version is read first where several would do."""
_TICK = 0.1  # s after which silence is told, so that a display goes on.


@dataclass(slots=True)
class TrafficRow:
    """One identifier."""

    frame: Frame
    """The last one."""
    first: float
    last: float
    """When it came, s."""
    count: int = 1
    extended: bool = False

    @property
    def rate(self) -> float:
        """A second, on average; 0 for a single frame."""
        return (self.count - 1) / (self.last - self.first) if self.last > self.first else 0.0


class Sniffer:
    """Keeps a row an identifier. Without a version it takes that which reads most of the identifiers seen so far."""

    def __init__(self, version: Version | None = None, calibration: HandCalibration | None = None) -> None:
        versions = _ORDER if version is None else (version,)
        self._codecs: dict[Version, list[Codec]] = {
            each: [make_codec(each, calibration, device) for device in range(LAST_DEVICE[each] + 1)]
            for each in versions
        }
        self._known = dict.fromkeys(versions, 0)
        self._guessed = version is None
        self.rows: dict[tuple[bool, int, bool], TrafficRow] = {}
        """By extended, identifier and remote."""
        self.errors = self.frames = 0

    def hear(self, message: can.Message, t: float) -> TrafficRow | None:
        """Take a message in at `t` s; its row, None for an error frame."""
        self.frames += 1
        if message.is_error_frame:
            self.errors += 1
            return None
        data = b"" if message.is_remote_frame else bytes(message.data)
        frame = Frame(message.arbitration_id, data, message.is_remote_frame)
        key = (message.is_extended_id, frame.id, frame.remote)
        row = self.rows.get(key)
        if row is None:
            row = self.rows[key] = TrafficRow(frame, t, t, extended=message.is_extended_id)
            if not row.extended:
                for version in self._known:
                    self._known[version] += self._read(version, frame) is not None
        else:
            row.frame, row.last, row.count = frame, t, row.count + 1
        return row

    @property
    def versions(self) -> tuple[Version, ...]:
        """Those that read most; the first is what is shown. Empty when nothing can be read."""
        most = max(self._known.values())
        return tuple(version for version, count in self._known.items() if count == most and (most or not self._guessed))

    def title(self) -> str:
        """Which version is read."""
        found = self.versions
        if not found:
            return "no hand of any version"
        if not self._guessed:
            return f"{found[0]} hand"
        others = f"; {' and '.join(found[1:])} would do as well: say --version" if found[1:] else ""
        return f"guessed: {found[0]} hand{others}"

    def description(self, row: TrafficRow) -> Description:
        """What the last frame of a row says."""
        if row.extended or not self.versions:
            return Description("", "")
        try:
            message = self._decoded(self.versions[0], row.frame)
        except ProtocolError as error:
            return Description("malformed", str(error))
        if message is None:
            return Description("", "")
        device = row.frame.id & 3 if len(self._codecs[self.versions[0]]) > 1 else 0
        words = describe(message)
        return words._replace(name=f"{words.name} ({device})") if device else words

    def line(self, row: TrafficRow) -> str:
        """A frame in one line: time, identifier, raw data, what it is and what it says."""
        name, text = self.description(row)
        raw = "remote" if row.frame.remote else row.frame.data.hex(" ")
        return f"{row.last:10.4f}  {name_of(row):>8}  {raw:<23}  {name:<20} {text}".rstrip()

    def _decoded(self, version: Version, frame: Frame) -> Message | None:
        for codec in self._codecs[version]:
            if (message := codec.decode(frame)) is not None:
                return message
        return None

    def _read(self, version: Version, frame: Frame) -> Message | None:
        try:
            return self._decoded(version, frame)
        except ProtocolError:
            return None


def name_of(row: TrafficRow) -> str:
    """An identifier as it is written."""
    return f"{row.frame.id:08X}" if row.extended else f"{row.frame.id:03X}"


def listened(bus: can.BusABC, seconds: float | None = None) -> Iterator[tuple[float, can.Message | None]]:
    """Everything on a bus, with the time since the beginning, s; None when nothing came for a while. Never sends.

    Raises LinkError when the bus fails.
    """
    begin = time.monotonic()
    while seconds is None or time.monotonic() - begin < seconds:
        try:
            message = received(bus, _TICK)
        except (can.CanError, OSError, ValueError) as error:
            raise LinkError(f"cannot receive on {bus.channel_info}: {error}; is it up and plugged in?") from error
        yield time.monotonic() - begin, message
