"""Writes a recording: an Arrow IPC stream, one row per period, that survives a killed process."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa

from allegro_twin.errors import ConfigError, RecordingError
from allegro_twin.files.first_error import closing_noted
from allegro_twin.recording.arrow_writer import END, FORMAT, VERSION, FileSink, Sink, arrow_column
from allegro_twin.recording.spec_json import spec_to_json
from allegro_twin.recording.validation import STRONGEST, bad_row
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Command, HandState, PositionCommand, Sample, TorqueCommand

BATCH = 100  # Rows: what a killed process can lose, 0.3 s at 333 Hz.
UNITS = {
    "t": "s", "tick": "1", "position": "rad", "velocity": "rad/s", "torque": "N·m", "temperature": "°C",
    "gravity": "m/s²", "wrench": "N, N·m", "command_torque": "N·m", "command_position": "rad", "command_effort": "N·m",
    "command_duration": "s", "mouse_force": "N",
}  # fmt: skip
_VECTORS = ("position", "velocity", "torque", "temperature", "gravity")
_ALWAYS = {"t", "tick", *_VECTORS}
_COMMANDS = {"command_torque", "command_position", "command_effort", "command_duration"}
ExtraColumns = Callable[[], Mapping[str, Array]]


class _Written(NamedTuple):
    """Rows that are safely in the file."""

    rows: int
    messages: int


class Recorder:
    """Writes samples to a file or a track, one batch at a time. `extras` adds columns of one axis each, by name. A
    signal may interrupt any line (`recording.arrow_writer`).

    Raises RecordingError when the file cannot be made or the disk is full; the message says how many rows are readable
    then: those of whole batches. Likewise for a row with other columns than the first, and for one that no reader takes
    (`validation.bad_row`): `close` keeps those before it.
    """

    def __init__(
        self, place: str | Path | Sink, spec: HandSpec, period: float, meta: Mapping[str, Any] | None = None
    ) -> None:
        self._rows, self._done, self._ended = 0, _Written(0, 0), False
        self._meta = {
            "format": FORMAT,
            "version": VERSION,
            "hand": spec_to_json(spec),
            "period": period,
            **(meta or {}),
        }
        pa.array(np.zeros(1))  # The first call imports a part of NumPy: not during a motion.
        self._buffers: dict[str, Array] = {}
        self._schema: pa.Schema | None = None
        self._own = isinstance(place, str | Path)
        self._where = f"{place}: " if self._own else ""
        self._sink: Sink = FileSink(Path(place)) if isinstance(place, str | Path) else place

    def add(self, sample: Sample, extras: Mapping[str, Array] | None = None) -> None:
        """Add one row. The first row fixes the columns."""
        state, command = sample
        further = command_columns(command)
        if state.wrench.size:
            further["wrench"] = state.wrench
        if extras:
            if self._schema is None:
                self._check_extras(extras, further)
            further |= extras
        if self._schema is None:
            self._begin(sample, further)
        self._check(further)
        row, buffers = self._rows - self._done.rows, self._buffers
        # The row before the first of a batch is the last of the batch before, which is still in the buffer.
        before = (buffers["t"][row - 1], buffers["tick"][row - 1]) if self._rows else (-math.inf, -math.inf)
        if not _readable(state, before):
            one = {name: np.array([getattr(state, name)]) for name in _ALWAYS} | {
                name: np.array([value]) for name, value in further.items()
            }
            if (bad := bad_row(one, before)) is not None:
                raise RecordingError(
                    f"{self._where}row {self._rows}: {bad.why}; no reader takes such a row, so it is left out and "
                    "the rows before it are kept: see to what the hand's backend reports"
                )
        buffers["t"][row] = state.t
        buffers["tick"][row] = state.tick
        buffers["position"][row] = state.position
        buffers["velocity"][row] = state.velocity
        buffers["torque"][row] = state.torque
        buffers["temperature"][row] = state.temperature
        buffers["gravity"][row] = state.gravity
        for key, value in further.items():
            buffers[key][row] = value
        self._rows += 1
        if row + 1 == BATCH:
            self._flush()

    def close(self) -> None:
        """Write the remaining rows and the end of the stream. Raises RecordingError when the disk is full."""
        if self._ended:
            return
        self._flush()
        if self._schema is not None:
            self._put(END)
        self._ended = True
        self._sink.close()

    def _check(self, further: Mapping[str, Array]) -> None:
        """Raises RecordingError unless a row has the columns of the first."""
        first, wrong = self._buffers, ""
        if gone := first.keys() - further.keys() - _ALWAYS:
            wrong = f"has no {', '.join(sorted(gone))}, which the first row has"
        elif new := further.keys() - first.keys():
            wrong = f"has {', '.join(sorted(new))}, which the first row has not"
        else:
            for name, value in further.items():
                if np.shape(value) != first[name].shape[1:]:
                    wrong = f"has {name} of shape {np.shape(value)}, and the first row of {first[name].shape[1:]}"
        if wrong:
            raise RecordingError(
                f"{self._where}row {self._rows} {wrong}; give the same columns in every row, NaN where one is unknown"
            )

    def _check_extras(self, extras: Mapping[str, Array], further: Mapping[str, Array]) -> None:
        """Raises RecordingError for extra columns with a name that a recording uses itself, or with another shape than
        one axis. `further`: columns of the first sample beside those of every state."""
        used = _ALWAYS | _COMMANDS | {"wrench"} | further.keys()
        if taken := sorted(extras.keys() & used):
            raise RecordingError(
                f"{self._where}extra column {', '.join(taken)}: a recording has a column of that name; give it another"
            )
        for name, value in extras.items():
            if np.ndim(value) != 1:
                raise RecordingError(f"{self._where}extra column {name}: its shape is {np.shape(value)}, not (n,)")

    def _begin(self, sample: Sample, further: Mapping[str, Array]) -> None:
        fields = [pa.field("t", pa.float64()), pa.field("tick", pa.int64())]
        self._buffers = {"t": np.empty(BATCH), "tick": np.empty(BATCH, dtype=np.int64)}
        vectors = {name: getattr(sample.state, name) for name in _VECTORS} | dict(further)
        for name, value in vectors.items():
            fields.append(pa.field(name, pa.list_(pa.float64(), len(value))))
            self._buffers[name] = np.empty((BATCH, len(value)))
        fields = [field.with_metadata({"unit": UNITS.get(field.name, "")}) for field in fields]
        schema = pa.schema(fields, metadata={"allegro_twin": json.dumps(self._meta)})
        self._put(schema.serialize())
        self._done = _Written(0, 1)
        self._schema = schema

    def _flush(self) -> None:
        count = self._rows - self._done.rows
        if not count:
            return
        columns = [arrow_column(buffer[:count]) for buffer in self._buffers.values()]
        self._put(pa.record_batch(columns, schema=self._schema).serialize())
        self._done = _Written(self._rows, self._done.messages + 1)

    def _put(self, message: Any) -> None:
        """Write after what is done, wherever an earlier attempt ended."""
        try:
            self._sink.put(self._done.messages + 1, message)
        except RecordingError as error:
            rows = self._done.rows
            self._schema, self._done, self._ended = None, self._done._replace(rows=self._rows), True
            if not self._own:
                raise
            rest = (
                f"its first {rows} rows are readable: --partial" if rows else "no row of it is whole, and it is removed"
            )
            raise RecordingError(f"{error}; {rest}") from error.__cause__


def _readable(state: HandState, before: tuple[float, float]) -> bool:
    """Whether a reader surely takes a state after one at t, s, and tick; in a few microseconds."""
    return bool(
        before[0] < state.t < math.inf
        and state.tick > before[1]
        and np.isfinite(state.position).all()
        and not np.isinf(state.velocity).any()
        and not np.isinf(state.torque).any()
        and not (np.abs(state.gravity) >= STRONGEST).any()
    )


def command_columns(command: Command) -> dict[str, Array]:
    """The columns of a command, one axis each. NaN stands for a part that is left to the hand."""
    if isinstance(command, TorqueCommand):
        return {"command_torque": command.torque}
    open_ = np.full(len(command.position), np.nan)
    duration = np.nan if command.duration is None else command.duration
    return {
        "command_position": command.position,
        "command_effort": open_ if command.effort is None else command.effort,
        "command_duration": np.array([duration]),
    }


def recorded_command(columns: Mapping[str, Array], row: int) -> Command:
    """Read the command back from a row with the columns of `command_columns`."""
    if "command_torque" in columns:
        return TorqueCommand(columns["command_torque"][row])
    effort, duration = columns["command_effort"][row], float(columns["command_duration"][row, 0])
    return PositionCommand(
        columns["command_position"][row],
        None if np.isnan(effort).all() else effort,
        None if np.isnan(duration) else duration,
    )


def check_other_file(into: Path, recording: Path) -> None:
    """Raise ConfigError where what is to be recorded would replace the recording that is read."""
    if into.resolve() == recording.resolve():
        raise ConfigError(f"--record {into}: that is the recording itself; name another file")


def record(
    samples: Iterable[Sample],
    place: str | Path | Sink,
    spec: HandSpec,
    period: float,
    *,
    meta: Mapping[str, Any] | None = None,
    extras: ExtraColumns | None = None,
) -> Iterator[Sample]:
    """Write every sample before it is passed on (a stage), to a file or a track."""
    recorder = Recorder(place, spec, period, meta)
    with closing_noted(recorder), closing_noted(recorder):  # A signal may interrupt the first call.
        for sample in samples:
            recorder.add(sample, extras() if extras is not None else None)
            yield sample
