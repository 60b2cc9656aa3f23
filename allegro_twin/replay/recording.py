"""Recordings: an Arrow IPC stream, a row a period, that survives the process that writes it."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from allegro_twin.errors import RecordingError
from allegro_twin.replay.identity import spec_from_json, spec_to_json
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Sample, TorqueCommand

FORMAT = "allegro_twin.recording"
VERSION = 1
BATCH = 100  # Rows: what a killed process can lose, 0.3 s at 333 Hz.
_UNITS = {
    "t": "s", "tick": "1", "position": "rad", "velocity": "rad/s", "torque": "N·m", "temperature": "°C",
    "gravity": "m/s²", "command_torque": "N·m", "command_position": "rad",
}  # fmt: skip
_VECTORS = ("position", "velocity", "torque", "temperature", "gravity")
Extras = Callable[[], Mapping[str, Array]]
_log = logging.getLogger(__name__)


class Recorder:
    """Writes samples to a file, a batch at a time. `extras` adds columns of one axis each, by name.

    Raises RecordingError when the file cannot be made or the disk is full; what was written stays readable.
    """

    def __init__(self, path: Path, spec: HandSpec, period: float, meta: Mapping[str, Any] | None = None) -> None:
        self._path, self._rows = path, 0
        self._meta = {
            "format": FORMAT,
            "version": VERSION,
            "hand": spec_to_json(spec),
            "period": period,
            **(meta or {}),
        }
        self._buffers: dict[str, Array] = {}
        self._writer: pa.RecordBatchStreamWriter | None = None
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("wb")
        except OSError as error:
            raise RecordingError(f"cannot record to {path}: {error.strerror}") from error

    def add(self, sample: Sample, extras: Mapping[str, Array] | None = None) -> None:
        """One row. The first one fixes the columns."""
        state, command = sample
        name = "command_torque" if isinstance(command, TorqueCommand) else "command_position"
        goal = command.torque if isinstance(command, TorqueCommand) else command.position
        if self._writer is None:
            self._begin(sample, {name: goal, **(extras or {})})
        row, buffers = self._rows, self._buffers
        buffers["t"][row] = state.t
        buffers["tick"][row] = state.tick
        buffers["position"][row] = state.position
        buffers["velocity"][row] = state.velocity
        buffers["torque"][row] = state.torque
        buffers["temperature"][row] = state.temperature
        buffers["gravity"][row] = state.gravity
        buffers[name][row] = goal
        if extras:
            for key, value in extras.items():
                buffers[key][row] = value
        self._rows += 1
        if self._rows == BATCH:
            self._flush()

    def close(self) -> None:
        """Write what is left and the end of the stream. Raises RecordingError when the disk is full."""
        if self._file.closed:
            return
        try:
            self._flush()
            if self._writer is not None:
                self._writer.close()
            self._file.close()
        except OSError as error:
            raise self._failed(error) from error
        finally:
            _quietly_close(self._file)

    def _begin(self, sample: Sample, extra: Mapping[str, Array]) -> None:
        fields = [pa.field("t", pa.float64()), pa.field("tick", pa.int64())]
        self._buffers = {"t": np.empty(BATCH), "tick": np.empty(BATCH, dtype=np.int64)}
        vectors = {name: getattr(sample.state, name) for name in _VECTORS} | dict(extra)
        for name, value in vectors.items():
            fields.append(pa.field(name, pa.list_(pa.float64(), len(value))))
            self._buffers[name] = np.empty((BATCH, len(value)))
        fields = [field.with_metadata({"unit": _UNITS.get(field.name, "")}) for field in fields]
        schema = pa.schema(fields, metadata={"allegro_twin": json.dumps(self._meta)})
        try:
            self._writer = pa.ipc.new_stream(self._file, schema)
            self._file.flush()
        except OSError as error:
            raise self._failed(error) from error

    def _flush(self) -> None:
        if self._writer is None or not self._rows:
            return
        columns = []
        for buffer in self._buffers.values():
            rows = buffer[: self._rows]
            flat = pa.array(rows.reshape(-1))
            columns.append(flat if rows.ndim == 1 else pa.FixedSizeListArray.from_arrays(flat, rows.shape[1]))
        self._rows = 0
        try:
            self._writer.write_batch(pa.record_batch(columns, names=list(self._buffers)))
            self._file.flush()
        except OSError as error:
            raise self._failed(error) from error

    def _failed(self, error: OSError) -> RecordingError:
        self._writer, self._rows = None, 0
        _quietly_close(self._file)
        return RecordingError(f"cannot go on recording to {self._path}: {error.strerror}; what was written is readable")


def recorded(
    samples: Iterable[Sample],
    path: Path,
    spec: HandSpec,
    period: float,
    *,
    meta: Mapping[str, Any] | None = None,
    extras: Extras | None = None,
) -> Iterator[Sample]:
    """A stage that writes every sample before it passes it on."""
    with closing(Recorder(path, spec, period, meta)) as recorder:
        for sample in samples:
            recorder.add(sample, extras() if extras is not None else None)
            yield sample


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
    except (PermissionError, IsADirectoryError) as error:
        raise RecordingError(f"cannot read {path}: {error.strerror}") from error


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
    head = path.open("rb").read(8)
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


def _quietly_close(file: Any) -> None:
    try:
        file.close()
    except OSError:
        _log.debug("close failed after an error that was already reported")
