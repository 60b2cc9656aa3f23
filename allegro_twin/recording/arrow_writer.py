"""Where a recording's messages go: a file of its own, or a track of a file that several share.

A signal may interrupt any line: every message has its number and its place, so that one that was begun is written
again and one that is there is not, and what counts as written changes in one step.
"""

from __future__ import annotations

import fcntl
import json
import logging
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from allegro_twin.errors import RecordingError

END = bytes.fromhex("ffffffff00000000")
"""Of a stream: Arrow's columnar format, "IPC Streaming Format"."""
TRACKS = pa.schema([("track", pa.string()), ("number", pa.int64()), ("data", pa.large_binary())])
"""A row a message: `data` is what would stand in the track's own file."""
_log = logging.getLogger(__name__)


def arrow_column(values: NDArray[Any]) -> pa.Array:
    """Rows (k,) as numbers, or (k, width) as lists of fixed size."""
    flat = pa.array(np.ascontiguousarray(values).reshape(-1))
    return flat if values.ndim == 1 else pa.FixedSizeListArray.from_arrays(flat, values.shape[1])


class Sink(Protocol):
    """Takes the messages of one stream in order."""

    def put(self, number: int, message: Any) -> None:
        """The bytes of the message with this number, from 1 on; one that was put before is not written twice. Raises
        RecordingError when the disk is full, and then takes no more."""
        ...

    def close(self) -> None:
        """No more will come. Idempotent. Raises RecordingError."""
        ...


class _File:
    """Bytes at places of a file. Raises RecordingError when it cannot be made."""

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = os.fdopen(os.open(path, os.O_RDWR | os.O_CREAT, 0o666), "wb", buffering=0)
        except OSError as error:
            raise RecordingError(f"cannot record to {path}: {error.strerror or error}") from error
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # Before anything of another's is touched.
        except BlockingIOError as error:
            self._file.close()
            raise RecordingError(
                f"cannot record to {path}: another program records to it; wait for it to end, or give another file"
            ) from error
        except OSError:
            _log.debug("%s: its file system has no locks", path)
        self.write(0, b"")

    def write(self, at: int, message: Any) -> int:
        """From a place on, where the file then ends: that place. What an earlier attempt left there is gone."""
        rest = memoryview(message)
        end = at + len(rest)
        try:
            self._file.truncate(at)
            self._file.seek(at)
            while rest:
                rest = rest[self._file.write(rest) :]
        except OSError as error:
            raise self._failed(error) from error
        return end

    def close(self) -> None:
        try:
            self._file.close()
        except OSError as error:
            raise self._failed(error) from error

    def _failed(self, error: OSError) -> RecordingError:
        try:
            self._file.close()
        except OSError:
            _log.debug("close failed after an error that was already reported")
        return RecordingError(
            f"cannot go on recording to {self._path}: {error.strerror or error}; what was written is readable"
        )


class _Done(NamedTuple):
    """What is in the file for good."""

    size: int
    """Bytes."""
    counts: Mapping[str, int]
    """Messages of each track."""


class FileSink:
    """A file for one stream. Raises RecordingError when it cannot be made."""

    def __init__(self, path: Path) -> None:
        self._file, self._done = _File(path), _Done(0, {"": 0})

    def put(self, number: int, message: Any) -> None:
        if number > self._done.counts[""]:
            self._done = _Done(self._file.write(self._done.size, message), {"": number})

    def close(self) -> None:
        self._file.close()


class SharedFile:
    """A file with several streams, each a track of it. Raises RecordingError when it cannot be made.

    Every message of a track is a whole batch of the file at once: what a killed process has put is there.
    """

    def __init__(self, path: Path, meta: Mapping[str, Any]) -> None:
        content = {"format": FORMAT, "version": SHARED, **meta}
        head = TRACKS.with_metadata({"allegro_twin": json.dumps(content)}).serialize()
        self._file, self._ended = _File(path), False
        self._done = _Done(self._file.write(0, head), {})

    def track(self, name: str) -> Sink:
        """Where the messages of a new track go."""
        return _Track(self, name)

    def put(self, name: str, number: int, message: Any) -> None:
        """A message of a track, as of `Sink.put`."""
        size, counts = self._done
        if number <= counts.get(name, 0):
            return
        row = [pa.array([name]), pa.array([number]), pa.array([memoryview(message).tobytes()], pa.large_binary())]
        batch = pa.record_batch(row, schema=TRACKS).serialize()
        self._done = _Done(self._file.write(size, batch), {**counts, name: number})

    def close(self) -> None:
        """The end of the file. Idempotent. Raises RecordingError."""
        if self._ended:
            return
        self._file.write(self._done.size, END)
        self._ended = True
        self._file.close()


class _Track:
    """One of the streams."""

    def __init__(self, file: SharedFile, name: str) -> None:
        self._file, self._name = file, name

    def put(self, number: int, message: Any) -> None:
        self._file.put(self._name, number, message)

    def close(self) -> None:
        """The file goes on."""


FORMAT = "allegro_twin.recording"
VERSION = 1
"""Of one device."""
SHARED = 2
"""Of several tracks, each of which has what a file of one device has."""
