"""Recordings as a Minari data set in its HDF5 layout, and back.

One episode per recording: K states give K observations, and the commands between them K - 1 actions. Every column of
the recording is there a second time among the infos, one row per state, so the way back loses nothing.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from allegro_twin.errors import ConfigError, RecordingError
from allegro_twin.files.atomic_write import atomic_folder
from allegro_twin.recording.exchange.episodes import (
    KEPT,
    action_of,
    check_numbers,
    check_recordings,
    observation_of,
    rebuild_recording,
    task_of,
)
from allegro_twin.recording.reader import Recording

VERSION = "0.5.4"  # Version of Minari, whose layout this is.
DATA, METADATA = "data/main_data.hdf5", "data/metadata.json"
META = "allegro_twin"
"""Attribute of an episode: its recording's metadata, JSON."""


def to_minari(recordings: Sequence[Recording], folder: Path) -> None:
    """Write a new data set, whole or not at all. Minari finds it by its folder, which gives its id (`dataset_id`).
    Raises ConfigError without h5py, for a folder with content or another name, for recordings of different kinds, or
    for a column of something else than numbers, text and bytes; RecordingError when the disk does not allow it."""
    import_h5py()
    check_recordings(recordings, folder)
    for each in recordings:
        check_numbers(each, "a Minari set", text=True)
    first = recordings[0]
    content = {
        "description": f"{first.spec.name}: {'; '.join(sorted({task_of(each) for each in recordings}))}; observations "
        f"are joint positions and speeds, actions are {action_of(first)[0]}",
        "observation_space": json.dumps(box_space(observation_of(first))),
        "action_space": json.dumps(box_space(action_of(first)[1])),
    }
    steps = [len(recording) - 1 for recording in recordings]
    write_dataset(folder, steps, lambda group, number: _add(group, recordings[number]), content)


def dataset_id(folder: Path) -> str:
    """The id of a data set, `<folder above>/<folder>`: Minari looks for it there below its own folder,
    ~/.minari/datasets. Raises ConfigError for a name that does not end in a version or has other signs than Minari's
    ids."""
    if not re.fullmatch(r"[\w-]+-v\d+", folder.name):
        name = re.sub(r"[^\w-]+", "_", folder.name)
        signs = "" if name == folder.name else " has only letters, digits, _ and -, and"
        version = "" if re.search(r"-v\d+$", name) else "-v0"
        raise ConfigError(
            f"{folder}: Minari finds a set by its folder, whose name{signs} ends in a version: {name}{version}"
        )
    return f"{folder.resolve().parent.name}/{folder.name}"


def write_dataset(
    folder: Path, steps: Sequence[int], add: Callable[[Any, int], None], content: Mapping[str, str]
) -> None:
    """Write a data set, whole or not at all. `steps`: of each episode; `add`: fills the HDF5 group of an episode;
    `content`: further metadata."""
    name, made = (
        dataset_id(folder),
        BytesIO(),
    )  # HDF5 itself, on a full disk, fails in many places and with many messages.
    with import_h5py().File(made, "w", track_order=True) as file:
        for number, count in enumerate(steps):
            group = file.create_group(f"episode_{number}")
            group.attrs.update({"id": number, "total_steps": count})
            add(group, number)
    head = {
        "dataset_id": name, "minari_version": VERSION, "data_format": "hdf5", "jpeg_encoding": False,
        "total_episodes": len(steps), "total_steps": sum(steps), "dataset_size": round(len(made.getvalue()) / 1e6, 1),
    }  # fmt: skip
    with atomic_folder(folder) as temporary:
        (temporary / DATA).parent.mkdir()
        (temporary / DATA).write_bytes(made.getvalue())
        (temporary / METADATA).write_text(json.dumps(head | dict(content)))


def from_minari(folder: Path, episode: int = 0) -> Recording:
    """Read one episode back as the recording that it was. Raises RecordingError for a data set of other origin."""
    h5py, path = import_h5py(), folder / DATA
    if not path.is_file():
        raise RecordingError(f"no data set of Minari at {folder}: {DATA} is missing")
    try:
        with h5py.File(path, "r") as file:
            if (name := f"episode_{episode}") not in file:
                raise RecordingError(f"{folder} has no episode {episode}; there are {len(file)}")
            group = file[name]
            if META not in group.attrs:
                raise RecordingError(
                    f"{folder} was not made of recordings of this package: its episodes have no {META}"
                )
            kept = group["infos"][KEPT].items()
            kinds = {key: h5py.check_string_dtype(values.dtype) for key, values in kept}
            texts = {key for key, kind in kinds.items() if kind is not None and kind.encoding == "utf-8"}
            columns = {key: (values.asstr() if key in texts else values)[()] for key, values in kept}
            meta = json.loads(group.attrs[META])
    except OSError as error:
        raise RecordingError(f"{path}: not a readable HDF5 file: {error}") from error
    return rebuild_recording(path, meta, columns, f"{folder}, episode {episode}")


def _add(group: Any, recording: Recording) -> None:
    steps = len(recording) - 1
    ends = np.zeros(steps, bool)
    ends[-1:] = True  # Truncated, not terminated: the recording ended.
    group.attrs[META] = json.dumps(dict(recording.meta))
    group["observations"] = observation_of(recording)
    group["actions"] = action_of(recording)[1][:-1]
    group["rewards"] = np.zeros(steps)
    group["terminations"] = np.zeros(steps, bool)
    group["truncations"] = ends
    kept = group.create_group("infos").create_group(KEPT, track_order=True)
    for name, values in recording.columns.items():
        kept[name] = values


def box_space(values: NDArray[Any]) -> dict[str, Any]:
    """A space without bounds, as Minari writes it."""
    width = values.shape[1]
    bounds = {"low": [-np.inf] * width, "high": [np.inf] * width}
    return {"type": "Box", "dtype": str(values.dtype), "shape": [width], **bounds}


def import_h5py() -> Any:
    """Import h5py. Raises ConfigError where it is missing."""
    try:
        import h5py
    except ImportError as error:
        raise ConfigError("Minari's files need h5py: pip install 'allegro-twin[demos]'") from error
    return h5py
