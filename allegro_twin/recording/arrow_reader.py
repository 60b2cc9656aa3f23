"""Arrow streams as they are found: every whole batch, and one clear error for whatever is wrong with the file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa

from allegro_twin.errors import RecordingError
from allegro_twin.recording.arrow_writer import END
from allegro_twin.recording.format import FORMAT, SHARED
from allegro_twin.types import Array


class Stream(NamedTuple):
    """What is readable of one."""

    table: pa.Table
    meta: dict[str, Any]
    cut: bool
    """It ends inside a batch."""
    ended: bool
    """Its end was written."""


def stream_in(path: Path) -> Stream:
    """Of a file. Raises RecordingError for a file that is none of ours."""
    if path.is_dir():
        raise RecordingError(f"cannot read {path}: it is a folder; a recording is a .arrow file")
    try:
        with pa.memory_map(str(path)) as source:
            try:
                reader = pa.ipc.open_stream(source)
            except (pa.ArrowInvalid, pa.ArrowException, OSError) as error:
                raise RecordingError(
                    f"{path} is not a recording: expected an Arrow IPC stream written by allegro-twin, {_found(path)}"
                ) from error
            table, cut = _whole(reader)
    except FileNotFoundError as error:
        raise RecordingError(f"no recording at {path}") from error
    except RecordingError:
        raise
    except OSError as error:
        raise RecordingError(f"cannot read {path}: {error.strerror or error}") from error
    return Stream(table, _meta(str(path), table.schema), cut, not cut and _ended(path))


def stream_of(content: bytes, name: str) -> Stream:
    """Of bytes in memory, which `name` stands for in messages. Raises RecordingError."""
    try:
        table, cut = _whole(pa.ipc.open_stream(content))
    except (pa.ArrowInvalid, pa.ArrowException, OSError) as error:
        raise RecordingError(f"{name} is damaged: {str(error).splitlines()[0]}") from error
    return Stream(table, _meta(name, table.schema), cut, content.endswith(END))


def numpy_of(column: pa.ChunkedArray) -> Array:
    """One row a row, (k,) or (k, width), read-only."""
    if pa.types.is_fixed_size_list(column.type):
        flat = np.concatenate([chunk.flatten().to_numpy() for chunk in column.chunks])
        values = flat.reshape(-1, column.type.list_size)
    else:
        values = column.to_numpy()
    values.setflags(write=False)
    return values


def _whole(reader: Any) -> tuple[pa.Table, bool]:
    """Every whole batch, and whether it ends inside one."""
    batches, cut = [], False
    try:
        for batch in reader:
            batches.append(batch)  # noqa: PERF402 - what was read before an error must be kept.
    except (pa.ArrowInvalid, OSError):
        cut = True
    return pa.Table.from_batches(batches, reader.schema), cut


def _meta(name: str, schema: pa.Schema) -> dict[str, Any]:
    text = (schema.metadata or {}).get(b"allegro_twin")
    meta = json.loads(text) if text else {}
    if meta.get("format") != FORMAT:
        raise RecordingError(f"{name} is an Arrow stream of something else: its schema has no {FORMAT!r} metadata")
    if meta["version"] > SHARED:
        raise RecordingError(
            f"{name} has format version {meta['version']}; this program reads up to {SHARED}: upgrade it"
        )
    return dict(meta)


def _found(path: Path) -> str:
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
    """Whether the end-of-stream marker of Arrow IPC is there: a continuation and a length of zero."""
    with path.open("rb") as file:
        file.seek(-len(END), 2)
        return file.read() == END
