"""One Parquet file of a sweep's results, with what they depend on in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from allegro_twin.files.whole import whole_file


def write_results(path: Path, table: Any, stamps: Mapping[str, str], first: Mapping[str, Sequence[Any]]) -> None:
    """Write a table with further columns before its own, and `stamps` as the file's metadata. Raises RecordingError
    where the disk refuses."""
    columns = {name: pa.array(values) for name, values in first.items()}
    columns |= {name: table[name] for name in table.column_names}
    whole = pa.table(columns).replace_schema_metadata(dict(stamps))
    with whole_file(path) as temporary:
        pq.write_table(whole, temporary)
