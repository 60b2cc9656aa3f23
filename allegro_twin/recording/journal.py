"""Journals: rare events in a track beside the samples, one row per event, written at once."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, Literal, TypeAlias

import numpy as np
import pyarrow as pa

from allegro_twin.errors import RecordingError
from allegro_twin.recording.arrow_writer import END, FORMAT, VERSION, Sink

FieldKind: TypeAlias = Literal["number", "count", "word", "numbers", "array"]
"""Type of a field: a float, an int, a text, a list of floats, or an array of any type and shape, which is
compressed."""
_TYPES: dict[FieldKind, pa.DataType] = {
    "number": pa.float64(),
    "count": pa.int64(),
    "word": pa.string(),
    "numbers": pa.list_(pa.float64()),
    "array": pa.struct([("type", pa.string()), ("shape", pa.list_(pa.int64())), ("packed", pa.large_binary())]),
}
_CODEC = "zstd"


class Journal:
    """Writes events of one kind to a track. `fields`: type of each field, by name; an event that lacks a field has
    None.

    Raises RecordingError when the disk is full; the events before stay readable.
    """

    def __init__(self, sink: Sink, fields: Mapping[str, FieldKind], meta: Mapping[str, Any] | None = None) -> None:
        self._sink, self._fields, self._count, self._ended = sink, fields, 1, False
        content = {"format": FORMAT, "version": VERSION, "fields": dict(fields), **(meta or {})}
        columns = [pa.field(name, _TYPES[kind]) for name, kind in fields.items()]
        self._schema = pa.schema(columns, metadata={"allegro_twin": json.dumps(content)})
        self._sink.put(1, self._schema.serialize())

    def add(self, **values: Any) -> None:
        """Write one event; by convention `t` is its time, s."""
        if self._ended:
            return
        row = [pa.array([_pack(values.get(name), kind)], _TYPES[kind]) for name, kind in self._fields.items()]
        self._put(pa.record_batch(row, schema=self._schema).serialize())

    def close(self) -> None:
        """End the track. Idempotent. Raises RecordingError."""
        if not self._ended:
            self._put(END)
            self._ended = True

    def _put(self, message: Any) -> None:
        try:
            self._sink.put(self._count + 1, message)
        except RecordingError:
            self._ended = True
            raise
        self._count += 1


def unpack_event(row: Mapping[str, Any], fields: Mapping[str, FieldKind]) -> dict[str, Any]:
    """Convert a row that was read back to the values that were added; lists become arrays (k,)."""
    return {name: _unpack(row[name], kind) for name, kind in fields.items()}


def _pack(value: Any, kind: FieldKind) -> Any:
    if value is None or kind in ("number", "count", "word"):
        return value
    array = np.ascontiguousarray(value)
    if kind == "numbers":
        return array.astype(np.float64).ravel().tolist()
    return {"type": array.dtype.str, "shape": list(array.shape), "packed": pa.compress(array.tobytes(), _CODEC, True)}


def _unpack(value: Any, kind: FieldKind) -> Any:
    if value is None or kind in ("number", "count", "word"):
        return value
    if kind == "numbers":
        return np.array(value, dtype=np.float64)
    kept = np.dtype(value["type"])
    size = int(np.prod(value["shape"], dtype=np.int64)) * kept.itemsize
    data = pa.decompress(value["packed"], size, _CODEC, True)
    return np.frombuffer(data, kept).reshape(value["shape"])
