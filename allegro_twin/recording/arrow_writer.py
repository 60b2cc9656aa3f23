"""Files that recordings are written to: one stream per file, or several tracks in a shared file.

A signal may interrupt any line. Every message has a number and a place in the file, so a message that was begun is
written again and a message that is complete is not. The state of what is written changes in one step.
"""

from __future__ import annotations

import fcntl
import json
import logging
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from allegro_twin.errors import RecordingError

FORMAT = "allegro_twin.recording"
VERSION = 1
"""Format version of a recording of one device."""
SHARED = 2
"""Format version of a file with several tracks. Each track contains what a file of one device contains."""
END = bytes.fromhex("ffffffff00000000")
"""End-of-stream marker, from Arrow's columnar format, "IPC Streaming Format"."""
TRACKS = pa.schema([("track", pa.string()), ("number", pa.int64()), ("data", pa.large_binary())])
"""One row per message: `data` is what the track's own file would contain."""
_log = logging.getLogger(__name__)


def arrow_column(values: NDArray[Any]) -> pa.Array:
    """Convert rows (k,) to numbers, or (k, width) to lists of fixed size."""
    flat = pa.array(np.ascontiguousarray(values).reshape(-1))
    return flat if values.ndim == 1 else pa.FixedSizeListArray.from_arrays(flat, values.shape[1])


class Sink(Protocol):
    """Takes the messages of one stream in order."""

    def put(self, number: int, message: Any) -> None:
        """Write the message with this number, from 1 on; skip a message that is already written. Raises RecordingError
        when the disk is full, and then takes no more."""
        ...

    def close(self) -> None:
        """End the stream. Idempotent. Raises RecordingError."""
        ...


class _File:
    """Bytes at given places of a file. Raises RecordingError when the file cannot be made."""

    def __init__(self, path: Path) -> None:
        self._path, self._error = path, ""
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = os.fdopen(os.open(path, os.O_RDWR | os.O_CREAT, 0o666), "wb", buffering=0)
        except OSError as error:
            raise RecordingError(f"cannot record to {path}: {error.strerror or error}") from error
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # Before anything of another program is touched.
        except BlockingIOError as error:
            self._file.close()
            raise RecordingError(
                f"cannot record to {path}: another program records to it; wait for it to end, or give another file"
            ) from error
        except OSError:
            _log.debug("%s: its file system has no locks", path)
        self.write(0, b"")

    def write(self, at: int, message: Any, *, keep: bool = True) -> int:
        """Write a message at a place, and cut the file after it. Returns the new end. What an earlier attempt left
        there is gone. After an error the file takes no more, and every further attempt raises the same one; without
        `keep` the file is removed then."""
        if self._error:
            raise RecordingError(self._error)
        rest = memoryview(message)
        end = at + len(rest)
        try:
            self._file.truncate(at)
            self._file.seek(at)
            while rest:
                rest = rest[self._file.write(rest) :]
        except OSError as error:
            if not keep:
                with suppress(OSError):  # What went wrong is said below.
                    self._path.unlink()
            raise self._failed(error) from error
        return end

    def close(self) -> None:
        try:
            self._file.close()
        except OSError as error:
            raise self._failed(error) from error

    def discard(self) -> None:
        """Close the file, of which nothing was written, and remove it. Idempotent."""
        if not self._file.closed:
            with suppress(OSError):  # An empty file is no harm.
                self._path.unlink()
        self.close()

    def _failed(self, error: OSError) -> RecordingError:
        try:
            self._file.close()
        except OSError:
            _log.debug("close failed after an error that was already reported")
        why = error.strerror or error
        self._error = f"cannot go on recording to {self._path}: {why}"
        return RecordingError(self._error)


class _Done(NamedTuple):
    """Rows that are safely in the file."""

    size: int
    """Bytes."""
    counts: Mapping[str, int]
    """Messages of each track."""


class FileSink:
    """A file with one stream, which is gone where nothing was put, or the disk did not take more than its head. Raises
    RecordingError when it cannot be made."""

    def __init__(self, path: Path) -> None:
        self._file, self._done = _File(path), _Done(0, {"": 0})

    def put(self, number: int, message: Any) -> None:
        if number > self._done.counts[""]:
            keep = self._done.counts[""] > 1  # The first message has no row.
            self._done = _Done(self._file.write(self._done.size, message, keep=keep), {"": number})

    def close(self) -> None:
        if self._done.size:
            self._file.close()
        else:
            self._file.discard()


class SharedFile:
    """A file with several streams, one track each. Raises RecordingError when it cannot be made.

    Every message of a track is a whole batch of the file, so a killed process loses nothing that it has put.
    """

    def __init__(self, path: Path, meta: Mapping[str, Any]) -> None:
        content = {"format": FORMAT, "version": SHARED, **meta}
        head = TRACKS.with_metadata({"allegro_twin": json.dumps(content)}).serialize()
        self._file, self._ended = _File(path), False
        self._done = _Done(self._file.write(0, head), {})

    def track(self, name: str) -> Sink:
        """Add a track; returns the sink of its messages."""
        return _Track(self, name)

    def put(self, name: str, number: int, message: Any) -> None:
        """Write a message of a track, as `Sink.put` does."""
        size, counts = self._done
        if number <= counts.get(name, 0):
            return
        row = [pa.array([name]), pa.array([number]), pa.array([memoryview(message).tobytes()], pa.large_binary())]
        batch = pa.record_batch(row, schema=TRACKS).serialize()
        try:
            self._done = _Done(self._file.write(size, batch), {**counts, name: number})
        except RecordingError as error:
            raise self._with_rest(error) from error.__cause__

    def close(self) -> None:
        """Write the end of the file. Idempotent. Raises RecordingError."""
        if self._ended:
            return
        try:
            self._file.write(self._done.size, END)
        except RecordingError as error:
            raise self._with_rest(error) from error.__cause__
        self._ended = True
        self._file.close()

    def _with_rest(self, error: RecordingError) -> RecordingError:
        rows = any(count > 1 for count in self._done.counts.values())  # The first message of a track has no row.
        rest = "the rows before are readable: --partial" if rows else "no row of it is whole"
        return RecordingError(f"{error}; {rest}")


class _Track:
    """One of the streams."""

    def __init__(self, file: SharedFile, name: str) -> None:
        self._file, self._name = file, name

    def put(self, number: int, message: Any) -> None:
        self._file.put(self._name, number, message)

    def close(self) -> None:
        """The file stays open for the other tracks."""
