"""One Parquet file of a sweep's results, with what they depend on in it; several tables as one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from allegro_twin.errors import RecordingError
from allegro_twin.files.atomic_write import whole_file


def write_results(path: Path, table: Any, stamps: Mapping[str, str], first: Mapping[str, Sequence[Any]]) -> None:
    """Write a table with further columns before its own, and `stamps` as the file's metadata. Raises RecordingError
    where the disk refuses."""
    columns = {name: pa.array(values) for name, values in first.items()}
    columns |= {name: table[name] for name in table.column_names}
    whole = pa.table(columns).replace_schema_metadata(dict(stamps))
    with whole_file(path) as temporary:
        pq.write_table(whole, temporary)


def read_results(path: Path) -> tuple[Any, dict[str, str]]:
    """The table of such a file and its stamps. Raises RecordingError."""
    try:
        table = pq.read_table(path)
        return table, {key.decode(): value.decode() for key, value in (table.schema.metadata or {}).items()}
    except (OSError, pa.ArrowInvalid, ValueError) as error:
        said = " ".join(str(error).split())
        raise RecordingError(f"{path}: cannot be read: {said}; write it anew from its folder of parts") from error


def latest(tables: Sequence[Any], by: str) -> Any:
    """One table: of each value in the column `by` the rows of the last table that has it."""
    last = {value: number for number, table in enumerate(tables) for value in table[by].unique().to_pylist()}
    kept = [
        table.filter(pc.is_in(table[by], pa.array([value for value, at in last.items() if at == number], pa.string())))
        for number, table in enumerate(tables)
    ]
    return pa.concat_tables(kept, promote_options="permissive")
