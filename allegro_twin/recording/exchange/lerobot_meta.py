"""What a LeRobot data set says of itself: its features, its tasks, and the statistics of every episode."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
_INDEX = "__index_level_0__"  # How pandas names an index that has no name.


class Placed(Protocol):
    """Where the rows of an episode are."""

    @property
    def chunk(self) -> int: ...
    @property
    def file(self) -> int: ...
    @property
    def begin(self) -> int: ...
    @property
    def end(self) -> int: ...


class Origin(NamedTuple):
    """Where a set comes from."""

    robot: str
    period: float
    """Between two frames, s."""
    labels: Mapping[str, list[str]]
    """Names of the numbers of some features."""


def info(origin: Origin, columns: Mapping[str, NDArray[Any]], count: int, tasks: int, frames: int) -> dict[str, Any]:
    """The part of info.json that depends on what is in the set: `count` episodes."""
    features = {}
    for name, values in columns.items():
        shape = list(values.shape[1:] or (1,))
        features[name] = {"dtype": str(values.dtype), "shape": shape, "names": origin.labels.get(name)}
    return {
        "robot_type": origin.robot,
        "total_episodes": count,
        "total_frames": frames,
        "total_tasks": tasks,
        "video_files_size_in_mb": 200,  # There are none; its own writer says so much all the same.
        "video_path": None,
        "fps": round(1.0 / origin.period),  # Whole, as the format has it; it tolerates 0.1 ms a frame.
        "splits": {"train": f"0:{count}"},
        "features": features,
    }


def statistics(values: NDArray[Any]) -> dict[str, list[Any]]:
    """Of the rows of a feature, number by number. Nobody asks for those of one with NaN: none would be true."""
    rows = values.reshape(len(values), -1)
    if rows.dtype == bool:
        rows = rows.astype(np.float64)  # Shares of those that are true.
    found = {"min": rows.min(axis=0), "max": rows.max(axis=0), "mean": rows.mean(axis=0), "std": rows.std(axis=0)}
    found |= {name: np.quantile(rows, part, axis=0) for name, part in QUANTILES.items()}
    return {name: value.tolist() for name, value in found.items()} | {"count": [len(rows)]}


def episode_rows(
    places: Sequence[Placed], tasks: Sequence[str], stats: Sequence[Mapping[str, Mapping[str, list[Any]]]]
) -> pa.Table:
    """A row an episode: where it is, what it does, and its statistics."""
    rows = []
    for number, (place, task, its) in enumerate(zip(places, tasks, stats, strict=True)):
        row: dict[str, Any] = {
            "episode_index": number,
            "tasks": [task],
            "length": place.end - place.begin,
            "data/chunk_index": place.chunk,
            "data/file_index": place.file,
            "dataset_from_index": place.begin,
            "dataset_to_index": place.end,
        }
        row |= {f"stats/{name}/{key}": value for name, each in its.items() for key, value in each.items()}
        rows.append(row | {"meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0})
    return pa.Table.from_pylist(rows)


def task_table(tasks: Sequence[str]) -> pa.Table:
    """A row a task, with its text as the index of the pandas table that LeRobot reads it into."""
    pandas = {
        "index_columns": [_INDEX],
        "column_indexes": [
            {"name": None, "field_name": None, "pandas_type": "unicode", "numpy_type": "object",
             "metadata": {"encoding": "UTF-8"}}
        ],
        "columns": [
            {"name": "task_index", "field_name": "task_index", "pandas_type": "int64", "numpy_type": "int64",
             "metadata": None},
            {"name": None, "field_name": _INDEX, "pandas_type": "unicode", "numpy_type": "object", "metadata": None},
        ],
        "creator": {"library": "pyarrow", "version": pa.__version__},
        "pandas_version": "2.0.0",
    }  # fmt: skip
    table = pa.table({"task_index": pa.array(range(len(tasks)), pa.int64()), _INDEX: list(tasks)})
    return table.replace_schema_metadata({"pandas": json.dumps(pandas)})
