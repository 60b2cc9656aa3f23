"""Recordings as a LeRobot data set, version 3.0 of its layout, and back.

One episode per recording. `observation.state`, `observation.velocity` and `action` are float32, as LeRobot's policies
expect them. Every column of the recording is there a second time unchanged, so the way back loses nothing.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet
from numpy.typing import NDArray

from allegro_twin.errors import RecordingError
from allegro_twin.files.atomic_write import atomic_folder
from allegro_twin.recording.arrow_writer import arrow_column
from allegro_twin.recording.exchange.episodes import (
    KEPT,
    action_of,
    check_numbers,
    check_recordings,
    number_names,
    rebuild_recording,
    task_of,
)
from allegro_twin.recording.reader import Recording, numpy_column

VERSION = "v3.0"
CHUNK = 1000  # Files per folder: the format's own default.
MEGABYTES = 100  # Size of a data file: the format's own default.
DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
EPISODES = "meta/episodes/chunk-000/file-000.parquet"
OURS = "meta/allegro_twin.jsonl"
"""What the format has no place for: the metadata of every recording."""
QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
_INDEX = "__index_level_0__"  # How pandas names an index that has no name.
Columns = dict[str, NDArray[Any]]


class DatasetOrigin(NamedTuple):
    """Source of a data set."""

    robot: str
    period: float
    """Between two frames, s."""
    labels: Mapping[str, list[str]]
    """Labels of the numbers of some features."""


class LerobotEpisode(NamedTuple):
    """An episode as the format expects it."""

    task: str
    """Text of the task."""
    columns: Columns
    """Features, one row per frame: `action`, and whatever else there is."""


class EpisodeLocation(NamedTuple):
    """Location of the rows of an episode."""

    chunk: int
    file: int
    begin: int
    end: int


def to_lerobot(recordings: Sequence[Recording], folder: Path) -> None:
    """Write a new data set, whole or not at all. Raises ConfigError for a folder with content, or for recordings of
    different hands, periods or columns, or with a column of something else than numbers; RecordingError when the disk
    does not allow it."""
    check_recordings(recordings, folder)
    for each in recordings:
        check_numbers(each, "a LeRobot set")
    first = recordings[0]
    names = {"observation.state": "position", "observation.velocity": "velocity", "action": action_of(first)[0]}
    labels = {name: number_names(first.spec, what, first.columns[what].shape[1]) for name, what in names.items()}
    with atomic_folder(folder) as temporary:
        origin = DatasetOrigin(first.spec.name, first.period, labels)
        write_dataset(
            [LerobotEpisode(task_of(recording), _columns(recording)) for recording in recordings], origin, temporary
        )
        (temporary / OURS).write_text("".join(json.dumps(dict(recording.meta)) + "\n" for recording in recordings))


def write_dataset(sources: Sequence[LerobotEpisode], origin: DatasetOrigin, folder: Path) -> None:
    """Write a data set into an empty folder, one episode per element."""
    tasks = sorted({each.task for each in sources})
    episodes, index = [], 0
    for number, each in enumerate(sources):
        episodes.append(each.columns | _numbered(each, origin.period, number, index, tasks.index(each.task)))
        index += len(each.columns["action"])
    places = list(_data(episodes, folder))
    (folder / EPISODES).parent.mkdir(parents=True)
    known = [name for name in episodes[0] if not any(np.isnan(columns[name]).any() for columns in episodes)]
    stats = [{name: statistics(columns[name]) for name in known} for columns in episodes]
    whole = {name: statistics(np.concatenate([columns[name] for columns in episodes])) for name in known}
    rows = episode_rows(places, [each.task for each in sources], stats)
    for table, name in ((rows, EPISODES), (task_table(tasks), "meta/tasks.parquet")):
        with (folder / name).open("wb") as file:
            pa.parquet.write_table(table, file)
    (folder / "meta/stats.json").write_text(json.dumps(whole, indent=4))
    content = info_json(origin, episodes[0], len(sources), len(tasks), index) | {
        "codebase_version": VERSION, "chunks_size": CHUNK, "data_files_size_in_mb": MEGABYTES, "data_path": DATA,
    }  # fmt: skip
    (folder / "meta/info.json").write_text(json.dumps(content, indent=4))


def from_lerobot(folder: Path, episode: int = 0) -> Recording:
    """Read one episode back as the recording that it was. Raises RecordingError for a data set of other origin or
    version."""
    ours = folder / OURS
    if not ours.is_file():
        raise RecordingError(f"{folder} has no {OURS}: it was not made of recordings of this package")
    metas = [json.loads(line) for line in ours.read_text().splitlines()]
    if not 0 <= episode < len(metas):
        raise RecordingError(f"{folder} has no episode {episode}; there are {len(metas)}")
    version = json.loads((folder / "meta/info.json").read_text())["codebase_version"]
    if version != VERSION:
        raise RecordingError(
            f"{folder} has version {version}; this program reads {VERSION}: lerobot's convert_dataset_v21_to_v30 "
            "makes one of the other"
        )
    try:
        path, table = _rows(folder, episode)
    except (OSError, pa.ArrowException) as error:
        raise RecordingError(f"{folder}: not a readable episode: {' '.join(str(error).split())}") from error
    kept = [name for name in table.column_names if name.startswith(f"{KEPT}.")]
    columns = {name.removeprefix(f"{KEPT}."): numpy_column(table.column(name)) for name in kept}
    return rebuild_recording(path, metas[episode], columns, f"{folder}, episode {episode}")


def _rows(folder: Path, episode: int) -> tuple[Path, pa.Table]:
    """The file that contains an episode, and its rows there."""
    listed = ["data/chunk_index", "data/file_index"]
    with (folder / EPISODES).open("rb") as file:
        place = pa.parquet.read_table(file, columns=listed).slice(episode, 1).to_pylist()[0]
    path = folder / DATA.format(chunk_index=place[listed[0]], file_index=place[listed[1]])
    with path.open("rb") as file:
        return path, pa.parquet.read_table(file, filters=[("episode_index", "=", episode)])


def _data(episodes: Sequence[Columns], folder: Path) -> Iterator[EpisodeLocation]:
    """Write the rows of all episodes, several to a file, each a row group of its own."""
    number, size, index = 0, 0, 0
    writer: Any = None
    with ExitStack() as opened:
        for columns in episodes:
            table = pa.table({name: arrow_column(values) for name, values in columns.items()})
            if writer is not None and size + table.nbytes > MEGABYTES * 2**20:
                opened.close()
                writer, size, number = None, 0, number + 1
            if writer is None:
                path = folder / DATA.format(chunk_index=number // CHUNK, file_index=number % CHUNK)
                path.parent.mkdir(parents=True, exist_ok=True)
                file = opened.enter_context(path.open("wb"))
                writer = opened.enter_context(pa.parquet.ParquetWriter(file, table.schema))
            writer.write_table(table)
            size += table.nbytes
            yield EpisodeLocation(number // CHUNK, number % CHUNK, index, index + len(table))
            index += len(table)


def _columns(recording: Recording) -> Columns:
    """All features of an episode, one row per frame, and all columns unchanged."""
    columns = recording.columns
    found: Columns = {
        "observation.state": columns["position"].astype(np.float32),
        "observation.velocity": columns["velocity"].astype(np.float32),
        "action": action_of(recording)[1].astype(np.float32),
    }
    return found | {f"{KEPT}.{name}": values for name, values in columns.items()}


def _numbered(sources: LerobotEpisode, period: float, episode: int, index: int, task: int) -> Columns:
    """The index columns of an episode's frames."""
    rows = np.arange(len(sources.columns["action"]))
    return {
        "timestamp": (rows * period).astype(np.float32),
        "frame_index": rows,
        "episode_index": np.full(len(rows), episode),
        "index": index + rows,
        "task_index": np.full(len(rows), task),
    }


def info_json(
    origin: DatasetOrigin, columns: Mapping[str, NDArray[Any]], count: int, tasks: int, frames: int
) -> dict[str, Any]:
    """The part of info.json that depends on the content: `count` episodes."""
    features = {}
    for name, values in columns.items():
        shape = list(values.shape[1:] or (1,))
        features[name] = {"dtype": str(values.dtype), "shape": shape, "names": origin.labels.get(name)}
    return {
        "robot_type": origin.robot,
        "total_episodes": count,
        "total_frames": frames,
        "total_tasks": tasks,
        "video_files_size_in_mb": 200,  # There are none; LeRobot's own writer writes this number all the same.
        "video_path": None,
        "fps": round(1.0 / origin.period),  # An integer in this format, which tolerates 0.1 ms per frame.
        "splits": {"train": f"0:{count}"},
        "features": features,
    }


def statistics(values: NDArray[Any]) -> dict[str, list[Any]]:
    """Statistics of the rows of a feature, number by number. Features with NaN have none."""
    rows = values.reshape(len(values), -1)
    if rows.dtype == bool:
        rows = rows.astype(np.float64)  # Means are shares of true.
    found = {"min": rows.min(axis=0), "max": rows.max(axis=0), "mean": rows.mean(axis=0), "std": rows.std(axis=0)}
    found |= {name: np.quantile(rows, part, axis=0) for name, part in QUANTILES.items()}
    return {name: value.tolist() for name, value in found.items()} | {"count": [len(rows)]}


def episode_rows(
    places: Sequence[EpisodeLocation], tasks: Sequence[str], stats: Sequence[Mapping[str, Mapping[str, list[Any]]]]
) -> pa.Table:
    """One row per episode: location, task and statistics."""
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
    """One row per task, with its text as the index of the pandas table that LeRobot reads."""
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
