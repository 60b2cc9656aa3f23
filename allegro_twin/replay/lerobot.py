"""Recordings as a data set of LeRobot, version 2.1 of its layout, and back.

One episode a recording. `observation.state`, `observation.velocity` and `action` are float32, as its policies want
them; every column of the recording is there a second time as it was, so the way back loses nothing.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet
from numpy.typing import NDArray

from allegro_twin.errors import RecordingError
from allegro_twin.files.whole import whole_folder
from allegro_twin.replay.episodes import KEPT, action_of, begin, rebuilt, task_of
from allegro_twin.replay.recording import Recording

VERSION = "v2.1"
CHUNK = 1000  # Episodes a folder: the format's own default.
DATA = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
OURS = "meta/allegro_twin.jsonl"
"""What the format has no place for: the metadata of every recording."""
Columns = dict[str, NDArray[Any]]


def to_lerobot(recordings: Sequence[Recording], folder: Path) -> None:
    """Write a new data set, whole or not at all. Raises ConfigError for a folder that has something in it, or for
    recordings of different hands, periods or columns; RecordingError when the disk does not let it."""
    begin(recordings, folder)
    with whole_folder(folder) as temporary:
        _write(recordings, temporary)


def _write(recordings: Sequence[Recording], folder: Path) -> None:
    tasks = sorted({task_of(recording) for recording in recordings})
    episodes, stats, index = [], [], 0
    for number, recording in enumerate(recordings):
        columns = _columns(recording, number, index, tasks.index(task_of(recording)))
        index += len(recording)
        path = folder / DATA.format(episode_chunk=number // CHUNK, episode_index=number)
        path.parent.mkdir(parents=True, exist_ok=True)
        pa.parquet.write_table(pa.table({name: _arrow(values) for name, values in columns.items()}), path)
        episodes.append({"episode_index": number, "tasks": [task_of(recording)], "length": len(recording)})
        stats.append({"episode_index": number, "stats": {name: _stats(values) for name, values in columns.items()}})
    (folder / "meta").mkdir()
    _lines(folder / "meta/episodes.jsonl", episodes)
    _lines(folder / "meta/episodes_stats.jsonl", stats)
    _lines(folder / "meta/tasks.jsonl", [{"task_index": k, "task": task} for k, task in enumerate(tasks)])
    _lines(folder / OURS, [dict(recording.meta) for recording in recordings])
    (folder / "meta/info.json").write_text(json.dumps(_info(recordings, columns, len(tasks), index), indent=4))


def from_lerobot(folder: Path, episode: int = 0) -> Recording:
    """One episode as the recording that it was. Raises RecordingError for a data set of other origin."""
    ours = folder / OURS
    if not ours.is_file():
        raise RecordingError(f"{folder} has no {OURS}: it was not made of recordings of this package")
    metas = [json.loads(line) for line in ours.read_text().splitlines()]
    if not 0 <= episode < len(metas):
        raise RecordingError(f"{folder} has no episode {episode}; there are {len(metas)}")
    path = folder / DATA.format(episode_chunk=episode // CHUNK, episode_index=episode)
    try:
        table = pa.parquet.read_table(path)
    except (OSError, pa.ArrowException) as error:
        raise RecordingError(f"{path}: not a readable episode: {error}") from error
    kept = [name for name in table.column_names if name.startswith(f"{KEPT}.")]
    columns = {name.removeprefix(f"{KEPT}."): _numpy(table.column(name)) for name in kept}
    return rebuilt(path, metas[episode], columns)


def _columns(recording: Recording, episode: int, index: int, task: int) -> Columns:
    """Every feature of an episode, a row a frame."""
    rows, columns = np.arange(len(recording)), recording.columns
    found: Columns = {
        "observation.state": columns["position"].astype(np.float32),
        "observation.velocity": columns["velocity"].astype(np.float32),
        "action": action_of(recording)[1].astype(np.float32),
        "timestamp": (rows * recording.period).astype(np.float32),
        "frame_index": rows,
        "episode_index": np.full(len(rows), episode),
        "index": index + rows,
        "task_index": np.full(len(rows), task),
    }
    return found | {f"{KEPT}.{name}": values for name, values in columns.items()}


def _info(recordings: Sequence[Recording], columns: Columns, tasks: int, frames: int) -> dict[str, Any]:
    spec, count = recordings[0].spec, len(recordings)
    action = action_of(recordings[0])[0]
    names = {"observation.state": "position", "observation.velocity": "velocity", "action": action}
    features = {}
    for name, values in columns.items():
        labels = [f"{names[name]}.{alias}" for alias in spec.aliases] if name in names else None
        features[name] = {"dtype": str(values.dtype), "shape": list(values.shape[1:] or (1,)), "names": labels}
    return {
        "codebase_version": VERSION,
        "robot_type": spec.name,
        "total_episodes": count,
        "total_frames": frames,
        "total_tasks": tasks,
        "total_videos": 0,
        "total_chunks": -(-count // CHUNK),
        "chunks_size": CHUNK,
        "fps": round(1.0 / recordings[0].period),  # Whole, as the format has it; it tolerates 0.1 ms a frame.
        "splits": {"train": f"0:{count}"},
        "data_path": DATA,
        "video_path": None,
        "features": features,
    }


def _stats(values: NDArray[Any]) -> dict[str, list[Any]]:
    rows = values.reshape(len(values), -1)
    found = {"min": rows.min(axis=0), "max": rows.max(axis=0), "mean": rows.mean(axis=0), "std": rows.std(axis=0)}
    return {name: value.tolist() for name, value in found.items()} | {"count": [len(rows)]}


def _lines(path: Path, rows: list[dict[str, Any]]) -> None:
    path.write_text("".join(json.dumps(row) + "\n" for row in rows))


def _arrow(values: NDArray[Any]) -> pa.Array:
    flat = pa.array(np.ascontiguousarray(values).reshape(-1))
    return flat if values.ndim == 1 else pa.FixedSizeListArray.from_arrays(flat, values.shape[1])


def _numpy(column: pa.ChunkedArray) -> NDArray[Any]:
    whole = column.combine_chunks()
    if pa.types.is_fixed_size_list(whole.type):
        return np.array(whole.flatten()).reshape(len(whole), whole.type.list_size)
    return np.array(whole)
