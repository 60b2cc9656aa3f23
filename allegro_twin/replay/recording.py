"""Reading a recording: every whole row, and one clear error for whatever is wrong with the file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from allegro_twin.errors import RecordingError
from allegro_twin.replay.format import FORMAT, VERSION
from allegro_twin.replay.identity import spec_from_json
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """A recording in memory."""

    path: Path
    meta: Mapping[str, Any]
    columns: Mapping[str, Array]
    """By name, one row a period: (k,) or (k, width). Units are in the file's schema."""
    complete: bool
    """Its end was written: the process that made it was not killed."""

    def __len__(self) -> int:
        return len(self.columns["t"])

    @property
    def period(self) -> float:
        return float(self.meta["period"])

    @property
    def spec(self) -> HandSpec:
        return spec_from_json(self.meta["hand"])


def load(path: Path, *, partial: bool = False) -> Recording:
    """Read a recording. Raises RecordingError for a file that is none, or, unless `partial`, for one that was cut in
    the middle of a batch; the error says how many rows can be read."""
    table, cut = _batches(path)
    meta = _meta(path, table.schema)
    if cut and not partial:
        raise RecordingError(
            f"{path} is cut short after {table.num_rows} whole rows; set `partial: true` or pass --partial to use them"
        )
    if table.num_rows == 0:
        raise RecordingError(f"{path} has no rows: nothing was recorded before the process ended")
    columns = {name: _numpy(table.column(name)) for name in table.column_names}
    return Recording(path, meta, columns, complete=not cut and _ended(path))


def _batches(path: Path) -> tuple[pa.Table, bool]:
    """Every whole batch, and whether the file ends inside one."""
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
            batches, cut = [], False
            try:
                for batch in reader:
                    batches.append(batch)  # noqa: PERF402 - what was read before an error must be kept.
            except (pa.ArrowInvalid, OSError):
                cut = True
            return pa.Table.from_batches(batches, reader.schema), cut
    except FileNotFoundError as error:
        raise RecordingError(f"no recording at {path}") from error
    except RecordingError:
        raise
    except OSError as error:
        raise RecordingError(f"cannot read {path}: {error.strerror or error}") from error


def _meta(path: Path, schema: pa.Schema) -> dict[str, Any]:
    text = (schema.metadata or {}).get(b"allegro_twin")
    meta = json.loads(text) if text else {}
    if meta.get("format") != FORMAT:
        raise RecordingError(f"{path} is an Arrow stream of something else: its schema has no {FORMAT!r} metadata")
    if meta["version"] > VERSION:
        raise RecordingError(
            f"{path} has format version {meta['version']}; this program reads up to {VERSION}: upgrade it"
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
        file.seek(-8, 2)
        return file.read() == b"\xff\xff\xff\xff\x00\x00\x00\x00"


def _numpy(column: pa.ChunkedArray) -> Array:
    if pa.types.is_fixed_size_list(column.type):
        flat = np.concatenate([chunk.flatten().to_numpy() for chunk in column.chunks])
        values = flat.reshape(-1, column.type.list_size)
    else:
        values = column.to_numpy()
    values.setflags(write=False)
    return values
