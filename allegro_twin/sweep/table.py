"""Results as Arrow tables: of a unit, of a whole sweep in the order of its items, and as Parquet files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from allegro_twin.errors import ConfigError, RecordingError
from allegro_twin.files.atomic_write import atomic_file
from allegro_twin.sweep.jobs import Result

KEY, ERROR = "key", "error"
"""Columns that every table has beside those of the function: which item, and why it has no row (null: it has one)."""


def unit_table(keys: Sequence[str], results: Sequence[Result], who: str) -> Any:
    """A pyarrow.Table of one unit of the function `who`. Raises ConfigError for rows that do not fit each other."""
    rows = [{} if isinstance(each, str) else each for each in results]
    names = list(next((row for row in rows if row), {}))
    for row, result in zip(rows, results, strict=True):
        if not isinstance(result, str) and row.keys() != set(names):
            raise ConfigError(f"{who}: every row must have the same names; {sorted(set(names) ^ row.keys())} differ")
    if {KEY, ERROR} & set(names):
        raise ConfigError(f"{who}: a row names {KEY!r} or {ERROR!r}, which are the sweep's own; choose another name")
    columns = {KEY: pa.array(keys, pa.string())}
    for name in names:
        try:
            columns[name] = pa.array([row.get(name) for row in rows])
        except (pa.ArrowInvalid, pa.ArrowTypeError) as error:
            raise ConfigError(f"{who}: column {name!r}: {' '.join(str(error).split())}") from error
    columns[ERROR] = pa.array([each if isinstance(each, str) else None for each in results], pa.string())
    return pa.table(columns)


def ordered_table(tables: Sequence[Any], keys: Sequence[str]) -> Any:
    """The rows of those keys, in their order, as one pyarrow.Table whose columns do not depend on how the rows were
    spread over the tables. Raises ConfigError where a column has types that do not fit each other."""
    place = {key: number for number, key in reversed(list(enumerate(keys)))}
    sources = [(column.to_pylist(), table) for table in tables for column in [table[KEY]]]
    ordered = sorted(sources, key=lambda source: min((place.get(key, len(keys)) for key in source[0]), default=0))
    try:
        whole = pa.concat_tables([table for _, table in ordered], promote_options="permissive")
    except (pa.ArrowInvalid, pa.ArrowTypeError) as error:
        raise ConfigError(f"rows of a sweep do not fit each other: {' '.join(str(error).split())}") from error
    row = {key: number for number, key in enumerate(key for found, _ in ordered for key in found)}
    names = [name for name in whole.column_names if name not in (KEY, ERROR)]
    chosen = whole.select([KEY, *names, ERROR]).take(pa.array([row[key] for key in keys], pa.int64()))
    return chosen.combine_chunks()


def write_results(path: Path, table: Any, stamps: Mapping[str, str], first: Mapping[str, Sequence[Any]]) -> None:
    """Write a table with further columns before its own, and `stamps` as the file's metadata. Raises RecordingError
    where the disk refuses."""
    columns = {name: pa.array(values) for name, values in first.items()}
    columns |= {name: table[name] for name in table.column_names}
    whole = pa.table(columns).replace_schema_metadata(dict(stamps))
    with atomic_file(path) as temporary, temporary.open("wb") as file:
        pq.write_table(whole, file)


def read_results(path: Path) -> tuple[Any, dict[str, str]]:
    """The table of such a file and its stamps. Raises RecordingError."""
    try:
        with path.open("rb") as file:  # Arrow opens only names that are UTF-8; Python opens every one.
            table = pq.read_table(file)
        return table, {key.decode(): value.decode() for key, value in (table.schema.metadata or {}).items()}
    except (OSError, pa.ArrowInvalid, ValueError) as error:
        said = " ".join(str(error).split())
        raise RecordingError(f"{path}: cannot be read: {said}; write it anew from its folder of parts") from error


def latest_rows(tables: Sequence[Any], by: str) -> Any:
    """One table: for each value in the column `by` the rows of the last table that has it."""
    last = {value: number for number, table in enumerate(tables) for value in table[by].unique().to_pylist()}
    kept = [
        table.filter(pc.is_in(table[by], pa.array([value for value, at in last.items() if at == number], pa.string())))
        for number, table in enumerate(tables)
    ]
    return pa.concat_tables(kept, promote_options="permissive")
