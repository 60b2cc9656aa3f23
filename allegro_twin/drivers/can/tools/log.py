"""Bus logs: every frame of a link on disk, and from the frames of a log the samples that they were."""

from __future__ import annotations

import copy
import io
import math
import os
import struct
import threading
import time
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import can
from can.io.blf import BLFParseError

from allegro_twin.drivers.can.codec.codec import Codec
from allegro_twin.drivers.can.codec.frames import Frame
from allegro_twin.drivers.can.driver.host_settings import CanHostSettings
from allegro_twin.drivers.can.link.shared_bus import Stamped
from allegro_twin.drivers.can.tools.samples import Found, Samples
from allegro_twin.errors import ConfigError, RecordingError, unknown
from allegro_twin.types import Sample

SUFFIXES = (".blf", ".log", ".asc")
"""Vector's binary logs, those of `candump -l`, and Vector's text logs."""
_FLUSH, _CONTAINER = 128, 6144
"""Frames, and bytes of a .blf's compressed block, after which what was heard goes to the file: a program that is killed
loses 0.1 s of one hand's bus."""
_BLF_OBJECT = 16
"""Bytes of the header of each object in a .blf, in which the object's size stands from byte 8 on."""
_READERS: dict[str, Any] = {".blf": can.BLFReader, ".log": can.CanutilsLogReader, ".asc": can.ASCReader}
_BROKEN = (ValueError, IndexError, KeyError, struct.error, zlib.error, can.CanError, BLFParseError, EOFError)

_CERTAIN, _FEWEST = 200, 32
"""A hand's reports after which it is known whether times count from the frame before, and least reports to say so."""
_BACK, _AS_FAR = 0.2, 0.5
"""Share of steps that go back where times count from the frame before, at least: one of four, where a hand's reports
come in a burst. And how far they go back, as a share of how far the others go forward: as far, but for the ends."""


def check_suffix(path: Path) -> None:
    """Raises ConfigError for a file name that no bus log has."""
    if path.suffix not in SUFFIXES:
        raise ConfigError(f"{path}: a bus log ends in {', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]}")


class WireLog:
    """A bus log in the format of its suffix; a listener for `Link.listen`, from any thread.

    Raises ConfigError for an unknown suffix, RecordingError where the file cannot be made. A disk that fails later
    does not stop the hand: `close` raises RecordingError then, and what was written is readable.
    """

    def __init__(self, path: Path, bus: str = "can0") -> None:
        check_suffix(path)
        self._path = path
        self._failed: OSError | None = None
        self._frames = 0
        self._lock = threading.Lock()  # The deadman sends from its own thread.
        # Only candump's logs name the bus, by one word.
        more: dict[str, Any] = {"channel": "_".join(bus.split())} if path.suffix == ".log" else {}
        if path.suffix == ".blf":
            more["max_container_size"] = _CONTAINER
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._writer: Any = can.Logger(str(path), **more)
        except OSError as error:
            raise RecordingError(f"cannot log the bus to {path}: {error.strerror}") from error

    def __call__(self, message: can.Message) -> None:
        with self._lock:
            if self._writer is None or self._failed is not None:
                return
            own = copy.copy(message)
            own.channel = None  # One bus a log, by one name.
            try:
                self._writer.on_message_received(own)
                self._frames += 1
                if self._frames % _FLUSH == 0:
                    self._writer.file.flush()
            except OSError as error:
                self._failed = error

    def close(self) -> None:
        """Write what is left. Idempotent."""
        with self._lock:
            writer, self._writer = self._writer, None
            if writer is None:
                return
            try:
                writer.stop()
            except OSError as error:
                self._failed = self._failed or error
        if self._failed is not None:
            raise RecordingError(
                f"cannot go on logging the bus to {self._path}: {self._failed.strerror}; what was written is readable"
            ) from self._failed


class LoggedBus(can.BusABC):
    """A bus that tells a log of every frame: for the end of a bus that has no link."""

    def __init__(self, bus: can.BusABC, log: WireLog) -> None:
        self._inner, self._log = bus, log
        self.channel_info = bus.channel_info
        super().__init__(str(bus.channel_info))

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self._inner.send(msg, timeout)
        msg.is_rx = False
        self._tell(msg)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        message = self._inner.recv(timeout)
        if message is not None:
            self._tell(message)
        return message

    def shutdown(self) -> None:
        super().shutdown()
        self._inner.shutdown()

    def _tell(self, message: can.Message) -> None:
        if not message.timestamp:
            message.timestamp = time.time()
        self._log(message)


class _Lines(io.TextIOWrapper):
    """Lines of a text log, up to one without an end: such a line may lack digits and still look whole."""

    number = 0
    """Number of the last line that was read, from 1 on."""
    cut = False

    def __next__(self) -> str:  # type: ignore[override]  # Typeshed says bytes of every file.
        line = super().__next__()
        self.number += 1
        if not line.endswith("\n"):
            self.cut = True
            raise StopIteration
        return line


def _cut_block(file: BinaryIO) -> bool:
    """Whether the last object of a .blf is cut. Leaves the file at its beginning."""

    def number(place: int) -> int:
        file.seek(place)
        return int.from_bytes(file.read(4), "little")

    end, at = os.fstat(file.fileno()).st_size, number(4)
    while at + _BLF_OBJECT <= end and (size := number(at + 8)) >= _BLF_OBJECT:
        at += size
        if at < end:
            at += size % 4  # Padding, which the last object may lack.
    file.seek(0)
    return at > end or 0 < end - at < _BLF_OBJECT


def _count_from_before(path: Path) -> RecordingError:
    return RecordingError(
        f"{path}: its times count from the frame before, of which a reader does not see every one: save it with "
        "absolute times (candump: -t a)"
    )


class _LogTimes:
    """Tells times of a hand's reports that count from the frame before from those of clocks, which may be set, begin
    anew in each of several sessions, or stamp frames a little out of order."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._last, self._reports, self._backs = math.nan, 0, 0
        self._forward, self._back = 0.0, 0.0

    def add(self, t: float) -> None:
        """The next report's time, s; 0: none. Raises RecordingError once it is certain."""
        if t == 0.0:
            return
        self._reports += 1
        if t < self._last:
            self._backs += 1
            self._back += self._last - t
        elif t > self._last:
            self._forward += t - self._last
        self._last = t
        if self._reports == _CERTAIN:
            self.check()

    def check(self) -> None:
        """Raise RecordingError for a log, so far, whose times count from the frame before."""
        often = self._reports >= _FEWEST and self._backs >= _BACK * (self._reports - 1)
        if often and self._back >= _AS_FAR * self._forward:
            raise _count_from_before(self._path)


def frames_of_log(path: Path, bus: str | None = None, found: Found | None = None) -> Iterator[tuple[Stamped, str]]:
    """Every classic frame of a log with its time, s, and the bus it was on; of one bus alone, if `bus` names it.

    A line or block at the end that is cut ends the log; `found` has it, and the buses. Raises ConfigError or
    RecordingError.
    """
    check_suffix(path)
    found = found if found is not None else Found()
    lines: _Lines | None = None
    heard = 0
    try:
        # Opened here, for a reader that does not like what it finds leaves its file open.
        with path.open("rb") as file:
            if path.suffix == ".blf":
                found.cut = "block" if _cut_block(file) else ""
            else:
                lines = _Lines(file)
            reader = _READERS[path.suffix](lines or file)
            for message in reader:
                heard += 1
                if getattr(reader, "timestamps_format", "") == "relative":  # Vector's text logs say so.
                    raise _count_from_before(path)
                where = str(message.channel)
                if message.channel is not None:  # As of candump's error frames.
                    found.buses.add(where)
                if message.is_error_frame or message.is_extended_id or message.is_fd or bus not in (None, where):
                    continue
                data = b"" if message.is_remote_frame else bytes(message.data)
                frame = Frame(message.arbitration_id, data, message.is_remote_frame)
                yield Stamped(frame, message.timestamp), where
            if lines is not None and lines.cut:
                found.cut = "line"
    except RecordingError:
        raise
    except _BROKEN as error:
        if heard and found.cut and isinstance(error, struct.error):
            return  # The head of the last block is cut.
        if heard and lines is not None:
            raise RecordingError(f"{path}, line {lines.number}: no frame that python-can can read: {error}") from error
        hint = "; make it with `candump -l` or -L" if path.suffix == ".log" else ""
        raise RecordingError(f"{path} is no bus log that python-can can read: {error}{hint}") from error
    except FileNotFoundError as error:
        raise RecordingError(f"no bus log at {path}") from error
    except OSError as error:
        raise RecordingError(f"cannot read {path}: {error.strerror}") from error


def samples_of_log(
    path: Path,
    codec: Codec,
    settings: CanHostSettings,
    found: Found | None = None,
    bus: str | None = None,
    side: str | None = None,
) -> Iterator[Sample]:
    """What a hand's session was, from a log of its bus: every whole hand with the torques that were sent next.

    Time is the log's, from the first whole hand. What was sent is known by its identifier, so a log without directions
    will do. `found` counts what there was. `side`: of the config's hand, where one that says another is to be refused.
    Raises RecordingError or ConfigError.
    """
    found = found if found is not None else Found()
    heard, times = Samples(codec, settings, found, side), _LogTimes(path)
    for (frame, t), where in frames_of_log(path, bus, found):
        if frame.id in codec.positions.fingers and not frame.remote:
            times.add(t)
        sample = heard.hear(frame, t, where)
        if sample is not None:
            yield sample
    times.check()
    last = heard.end()
    if last is None and bus is not None and bus not in found.buses:
        raise ConfigError(f"{path}: {unknown('bus', bus, sorted(found.buses))}")
    if last is None:
        but = f"; but {heard.instead} reports: correct `backend.version` or `device`" if heard.instead else ""
        but += f": {heard.disorder}" if heard.disorder else ""
        raise RecordingError(f"{path} holds no whole {codec.version} hand in {found.frames} frames{but}")
    yield last
