"""Reads recordings: of one device, or of a cell with all its tracks."""

from __future__ import annotations

import mmap
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from allegro_twin.errors import RecordingError, unknown
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.recording.arrow_writer import END, SHARED
from allegro_twin.recording.journal import FieldKind, unpack_event
from allegro_twin.recording.spec_json import spec_from_json
from allegro_twin.recording.validation import check_recording, stream_metadata
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array


class ArrowStream(NamedTuple):
    """The readable part of an Arrow stream."""

    table: pa.Table
    meta: dict[str, Any]
    cut: bool
    """The stream ends inside a batch."""
    rest: int
    """Bytes after the end of the stream."""
    ended: bool
    """The end-of-stream marker was written."""


def read_stream(path: Path) -> ArrowStream:
    """Read a file. Raises RecordingError for a file that is no recording."""
    if path.is_dir():
        raise RecordingError(f"cannot read {path}: it is a folder; a recording is a .arrow file")
    try:
        with pa.BufferReader(_mapped(path)) as source:
            try:
                reader = pa.ipc.open_stream(source)
            except (pa.ArrowInvalid, pa.ArrowException, OSError) as error:
                raise RecordingError(
                    f"{path} is not a recording: expected an Arrow IPC stream written by allegro-twin, "
                    f"{_file_kind(path)}"
                ) from error
            table, cut = _whole_batches(reader)
            rest = 0 if cut else source.size() - source.tell()
    except FileNotFoundError as error:
        raise RecordingError(f"no recording at {path}") from error
    except RecordingError:
        raise
    except OSError as error:
        raise RecordingError(f"cannot read {path}: {error.strerror or error}") from error
    return ArrowStream(table, stream_metadata(str(path), table.schema), cut, rest, not cut and _ended(path))


def _mapped(path: Path) -> pa.Buffer:
    """The file in memory, read as it is used. Arrow opens only names that are UTF-8; Python opens every one."""
    with path.open("rb") as file:
        if os.fstat(file.fileno()).st_size == 0:
            return pa.py_buffer(b"")
        return pa.py_buffer(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))


def parse_stream(content: bytes, name: str) -> ArrowStream:
    """Read a stream from bytes; `name` stands for it in error messages. Raises RecordingError."""
    try:
        table, cut = _whole_batches(pa.ipc.open_stream(content))
    except (pa.ArrowInvalid, pa.ArrowException, OSError) as error:
        raise RecordingError(f"{name} is damaged: {str(error).splitlines()[0]}") from error
    return ArrowStream(table, stream_metadata(name, table.schema), cut, 0, content.endswith(END))


def numpy_column(column: pa.ChunkedArray) -> Array:
    """Convert a column to an array (k,) or (k, width), read-only. A null, as other programs write NaN, is NaN; in a
    column of something else than numbers, None."""
    if pa.types.is_fixed_size_list(column.type):
        values = np.concatenate([_list_rows(chunk) for chunk in column.chunks])
    else:
        values = column.to_numpy()
    values.setflags(write=False)
    return values


def _list_rows(chunk: Any) -> Array:
    """Rows of lists of one size, (k, width)."""
    width = chunk.type.list_size
    if not chunk.null_count:
        return np.asarray(chunk.flatten().to_numpy(zero_copy_only=False)).reshape(len(chunk), width)
    there = _list_rows(chunk.drop_null())
    rows: Array = np.full((len(chunk), width), np.nan if there.dtype.kind in "biuf" else None)
    rows[chunk.is_valid().to_numpy(zero_copy_only=False)] = there
    return rows


def _whole_batches(reader: Any) -> tuple[pa.Table, bool]:
    """All whole batches, and whether the stream ends inside a batch."""
    batches, cut = [], False
    try:
        for batch in reader:
            batches.append(batch)  # noqa: PERF402 - what was read before an error must be kept.
    except (pa.ArrowInvalid, OSError):
        cut = True
    return pa.Table.from_batches(batches, reader.schema), cut


def _file_kind(path: Path) -> str:
    with path.open("rb") as file:
        head = file.read(8)
    for magic, name in (
        (b"PAR1", "a Parquet file"),
        (b"ARROW1", "an Arrow file, not a stream"),
        (b"RRF2", "a Rerun file"),
    ):
        if head.startswith(magic):
            return f"found {name}"
    return "found an empty file" if not head else f"found bytes {head.hex(' ')}"


def _ended(path: Path) -> bool:
    """Whether the file ends with the end-of-stream marker of Arrow IPC: a continuation and a length of zero."""
    with path.open("rb") as file:
        file.seek(-len(END), 2)
        return file.read() == END


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """A recording of one device in memory."""

    path: Path
    meta: Mapping[str, Any]
    columns: Mapping[str, Array]
    """Arrays by name, one row per period: (k,) or (k, width). The file's schema has the units."""
    complete: bool
    """The end was written: the process that recorded was not killed."""
    notes: tuple[str, ...] = ()
    """What of a bag is left out or was chosen, in sentences; of a bag that has just been read."""

    def __len__(self) -> int:
        return len(self.columns["t"])

    @property
    def period(self) -> float:
        return float(self.meta["period"])

    @property
    def spec(self) -> HandSpec:
        """As it was when it was recorded; the model file of a hand by a card is where the card says now, and unknown
        where the card is gone or has other joints."""
        spec = spec_from_json(self.meta["hand"])
        if not Path(spec.card).is_file():
            return spec
        now = load_spec(spec.card, spec.side)
        return spec if now.joints != spec.joints else replace(spec, foreign=now.foreign)


class RecordingTrack(NamedTuple):
    """One track of a file with several."""

    content: bytes
    journal: bool
    """The track contains events; otherwise samples of a device."""
    rows: int


@dataclass(frozen=True, slots=True, eq=False)
class CellRecording:
    """A recording of a cell: devices, and journals of events."""

    path: Path
    meta: Mapping[str, Any]
    tracks: Mapping[str, RecordingTrack]
    complete: bool
    partial: bool = False
    """Rows of a device are read up to the first that is wrong."""

    @property
    def devices(self) -> tuple[str, ...]:
        """Names of the tracks that `device` reads. A device that was killed before its first batch has none."""
        return tuple(name for name, track in self.tracks.items() if not track.journal and track.rows)

    def device(self, name: str) -> Recording:
        """The samples of a device, as a recording of its own. Raises RecordingError."""
        if name not in self.devices:
            raise RecordingError(f"{self.path}: {unknown('track of a device', name, self.devices)}")
        said = f"{self.path}, track {name},"
        return _recording(self.path, self._stream(name), self.complete, said, partial=self.partial)

    def events(self, name: str) -> list[dict[str, Any]]:
        """The events of a journal, oldest first; none where the file has no such journal. Raises RecordingError."""
        if name not in self.tracks:
            return []
        stream = self._stream(name)
        fields = cast(Mapping[str, FieldKind], stream.meta["fields"])
        return [unpack_event(row, fields) for row in stream.table.to_pylist()]

    def _stream(self, name: str) -> ArrowStream:
        return parse_stream(self.tracks[name].content, f"{self.path}, track {name},")


def load(path: str | Path, *, partial: bool = False, track: str | None = None) -> Recording:
    """Read a recording, or one track of a recording with several. Raises RecordingError for a file that is no recording
    and, unless `partial`, for a file that was cut inside a batch or has a row that no hand reports; the message says
    how many rows are readable, and `partial` reads those before it."""
    path = Path(path)
    stream = read_stream(path)
    if stream.meta["version"] == SHARED:
        found = _tracks(path, stream, partial=partial)
        if track is None:
            raise RecordingError(f"{path} is of a whole cell: say which track of it, {' or '.join(found.devices)}")
        return found.device(track)
    if track is not None:
        raise RecordingError(f"{path} is of one device and has no track {track!r}: leave it out")
    if not partial:
        _check_whole(path, stream, "whole rows")
    return _recording(path, stream, stream.ended, str(path), partial=partial)


def load_cell(path: str | Path, *, partial: bool = False) -> CellRecording:
    """Read a recording of a cell. Raises RecordingError, as `load`."""
    path = Path(path)
    stream = read_stream(path)
    if stream.meta["version"] != SHARED:
        raise RecordingError(f"{path} is of one device, not of a cell")
    return _tracks(path, stream, partial=partial)


def is_cell_recording(path: Path) -> bool:
    """Whether a file is the recording of a cell. Raises RecordingError for a file that is no recording."""
    return bool(read_stream(path).meta["version"] == SHARED)


def _tracks(path: Path, stream: ArrowStream, *, partial: bool) -> CellRecording:
    if not partial:
        _check_whole(path, stream, "whole batches")
    found: dict[str, RecordingTrack] = {}
    for name in pc.unique(stream.table.column("track")).to_pylist():
        rows = stream.table.filter(pc.equal(stream.table.column("track"), name))
        content = b"".join(rows.column("data").to_pylist())
        inner = parse_stream(content, f"{path}, track {name},")
        found[name] = RecordingTrack(content, "fields" in inner.meta, inner.table.num_rows)
    return CellRecording(path, stream.meta, found, stream.ended, partial)


def _recording(path: Path, stream: ArrowStream, complete: bool, name: str, *, partial: bool) -> Recording:
    if stream.table.num_rows == 0:
        raise RecordingError(f"{name} has no rows: nothing was recorded before the process ended")
    columns = {each: numpy_column(stream.table.column(each)) for each in stream.table.column_names}
    found = check_recording(name.removesuffix(","), stream.meta, columns, partial=partial)
    return Recording(path, stream.meta, found, complete=complete and len(found["t"]) == len(columns["t"]))


def _check_whole(path: Path, stream: ArrowStream, what: str) -> None:
    rows = stream.table.num_rows
    if stream.cut:
        said = f"{path} is cut short after {rows} {what}"
    elif stream.rest:
        said = f"{path} goes on after its end: {stream.rest} bytes, as of a second file, after {rows} {what}"
    else:
        return
    raise RecordingError(
        f"{said}; with `run`, `view`, `mirror` and `export` pass --partial to use them; a config says `partial: true`"
    )
