"""Parts of an episode that all data set formats share, and the conversion back to a recording."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from allegro_twin.errors import ConfigError, RecordingError
from allegro_twin.files.atomic_write import atomic_file
from allegro_twin.recording.arrow_writer import arrow_column
from allegro_twin.recording.reader import Recording
from allegro_twin.recording.validation import check_recording
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array

KEPT = "recording"
"""Name under which a data set keeps every column of a recording unchanged, beside what its own format asks for."""


_OF_JOINTS = {
    *("position", "velocity", "torque", "temperature", "target", "predicted", "disturbance"),
    *("command_torque", "command_position", "command_effort"),
}


def number_names(spec: HandSpec, column: str, width: int) -> list[str]:
    """Names of a vector's numbers: `position.index_0`, of joints; `palm.0`, of others, whatever their width is."""
    of_joints = column in _OF_JOINTS and width == spec.n_joints
    return [f"{column}.{label}" for label in (spec.joint_labels if of_joints else range(width))]


def check_new_folder(folder: Path) -> None:
    """Raise ConfigError for a path that is a file or a folder with content."""
    if folder.exists() and not folder.is_dir():
        raise ConfigError(f"{folder} is a file: a data set is written in one go, into a new folder")
    if folder.exists() and any(folder.iterdir()):
        raise ConfigError(f"{folder} is not empty: a data set is written in one go, into a new folder")


def check_recordings(recordings: Sequence[Recording], folder: Path) -> None:
    """Raise ConfigError for a folder with content, or for recordings of different hands, periods or columns."""
    check_new_folder(folder)
    first = recordings[0]
    for other in recordings[1:]:
        if (other.spec.name, other.period) != (first.spec.name, first.period):
            raise ConfigError(f"{other.path} is of {other.spec.name} every {other.period} s; {first.path} of "
                              f"{first.spec.name} every {first.period} s: they make two data sets")  # fmt: skip
        if other.columns.keys() != first.columns.keys():
            differ = ", ".join(sorted(other.columns.keys() ^ first.columns.keys()))
            raise ConfigError(f"{other.path} and {first.path} do not both have {differ}: they make two data sets")


def check_numbers(recording: Recording, what: str, *, nulls: bool = False, text: bool = False) -> None:
    """Raise ConfigError for a column that somebody added and that has something else than numbers; `what` takes none
    such, but perhaps truth values with `nulls`, or `text` and bytes without NUL."""
    out = "leave the column out, or export to .parquet"
    for name, values in recording.columns.items():
        if np.issubdtype(values.dtype, np.number) or values.dtype == bool:
            continue
        cells: list[Any] = values.ravel().tolist() if values.dtype == object else []
        kinds = {type(cell) for cell in cells}
        if nulls and kinds and kinds <= {bool, type(None)}:
            continue
        if not text or kinds not in ({str}, {bytes}):
            takes = "numbers, text or bytes" if text else "numbers"
            raise ConfigError(f"{recording.path}: column {name} has no {takes}, and {what} takes nothing else: {out}")
        if any(("\0" if kinds == {str} else b"\0") in cell for cell in cells):
            raise ConfigError(f"{recording.path}: column {name} has NUL in it, which {what} has no place for: {out}")


def action_of(recording: Recording) -> tuple[str, Array]:
    """What a learner should imitate: the position controller's set-points, rad, or the command where there are none;
    and the name of that column."""
    for name in ("target", "command_position", "command_torque"):
        if name in recording.columns:
            return name, recording.columns[name]
    raise RecordingError(f"{recording.path} has no command to learn from")


def observation_of(recording: Recording) -> Array:
    """Joint positions, rad, and speeds, rad/s, (k, 2 n)."""
    columns = recording.columns
    return np.concatenate([columns["position"], columns["velocity"]], axis=1)


def task_of(recording: Recording) -> str:
    """Text of the task, from the config that made the recording."""
    config = recording.meta.get("config", {})
    task, controller = config.get("task", {}), config.get("controller", {})
    if task.get("scenario") or task.get("grasp"):
        return f"grasp: {Path(task.get('scenario') or task['grasp']).stem}"
    return f"{controller.get('kind', 'unknown')}: {task.get('posture') or controller.get('file') or 'motion'}"


def rebuild_recording(path: Path, meta: Mapping[str, Any], columns: Mapping[str, Array], what: str) -> Recording:
    """Make a recording in memory from what a data set or a bag has, which error messages call `what`. Raises
    RecordingError for columns and rows that `load` refuses."""
    for values in columns.values():
        values.setflags(write=False)
    return Recording(path, meta, check_recording(what, meta, columns, partial=None), complete=True)


def write_arrow(recording: Recording, path: Path) -> None:
    """Write a recording in memory as an .arrow file. Raises RecordingError when the disk does not allow it."""
    from allegro_twin.recording.recorder import UNITS

    arrays = {name: arrow_column(values) for name, values in recording.columns.items()}
    fields = [pa.field(name, a.type).with_metadata({"unit": UNITS.get(name, "")}) for name, a in arrays.items()]
    schema = pa.schema(fields, metadata={"allegro_twin": json.dumps(dict(recording.meta))})
    with atomic_file(path) as temporary, temporary.open("wb") as file, pa.ipc.new_stream(file, schema) as writer:
        writer.write_table(pa.table(list(arrays.values()), schema=schema))
