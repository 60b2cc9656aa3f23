"""Recordings as tables: Parquet and CSV.

Arrow opens only names that are UTF-8; Python opens every one.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from allegro_twin.errors import ConfigError
from allegro_twin.files.atomic_write import atomic_file
from allegro_twin.recording.arrow_writer import arrow_column
from allegro_twin.recording.exchange.episodes import number_names
from allegro_twin.recording.reader import Recording


def to_parquet(recording: Recording, path: Path) -> None:
    """Write one column of lists per quantity, as in the recording; the metadata goes along as JSON."""
    arrays = {name: arrow_column(values) for name, values in recording.columns.items()}
    table = pa.table(arrays).replace_schema_metadata({"allegro_twin": json.dumps(dict(recording.meta))})
    with atomic_file(path) as temporary, temporary.open("wb") as file:
        pyarrow.parquet.write_table(table, file)


def to_csv(recording: Recording, path: Path) -> None:
    """Write one column per number, named `position.index_0`; vectors that are not of joints are numbered. Raises
    ConfigError for a column that somebody added and that has lists."""
    spec = recording.spec
    columns = {}
    for name, values in recording.columns.items():
        if values.ndim == 1:
            columns[name] = values
            continue
        labels = number_names(spec, name, values.shape[1])
        columns |= {label: np.ascontiguousarray(values[:, i]) for i, label in enumerate(labels)}
    table = pa.table(columns)
    for field in table.schema:
        if pa.types.is_nested(field.type):
            raise ConfigError(
                f"{recording.path}: column {field.name} has {field.type}, which a .csv has no place for: leave the "
                "column out, or export to .parquet"
            )
    with atomic_file(path) as temporary, temporary.open("wb") as file:
        pyarrow.csv.write_csv(table, file)
