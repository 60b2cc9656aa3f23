"""Recorded hand tracking: a file's frames, checked as a whole before anything moves."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.files.csv_table import parse_csv
from allegro_twin.spec import SIDES, Side
from allegro_twin.spec.hand import check_side
from allegro_twin.surfaces.teleop.targets import COUNT, palm_length, wrong_size
from allegro_twin.types import Array, Vector

HEADER = ["t", *(f"{axis}{k}" for k in range(COUNT) for axis in "xyz")]
"""Columns of a `.csv`: s, then m."""
_SLOWEST = 1.0  # s between frames: in ms every tracker below 1000 frames/s has more.


@dataclass(frozen=True, slots=True, eq=False)
class HandTrack:
    """Tracked motion of a person's hand."""

    times: Vector
    """s, ascending, (k,)."""
    landmarks: Array
    """(k, 21, 3), m, in any frame; NaN where no hand was seen."""
    side: Side | None = None
    """Which of the person's hands, where the file says so."""


def read_track(path: Path) -> HandTrack:
    """The frames of a `.npz`, `.csv` or `.json`. Raises ConfigError, one line, for the first thing that is wrong."""
    readers: dict[str, Callable[[bytes, Path], HandTrack]] = {".npz": _npz, ".csv": _csv, ".json": _json}
    if path.suffix not in readers:
        raise ConfigError(f"{path}: hand tracking is a file in {', '.join(readers)}, or `webcam`")
    if path.exists() and not path.is_file():
        raise ConfigError(f"{path}: cannot be read: it is {'a folder' if path.is_dir() else 'no plain file'}")
    try:
        content = path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    return _checked(readers[path.suffix](content, path), path)


def _npz(content: bytes, path: Path) -> HandTrack:
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            found = {name: arrays[name] for name in arrays.files}
    except (ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise ConfigError(f"{path}: not a .npz of plain numbers") from error
    _check_no_side(found | {"side": None}, str(path))
    if missing := [name for name in ("t", "landmarks") if name not in found]:
        raise ConfigError(f"{path}: lacks the array {missing[0]!r}; it has {', '.join(sorted(found)) or 'none'}")
    try:
        times, points = (np.asarray(found[name], dtype=np.float64) for name in ("t", "landmarks"))
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{path}: t and landmarks must be numbers") from error
    if times.ndim != 1 or points.shape != (len(times), COUNT, 3):
        raise ConfigError(f"{path}: landmarks has shape {points.shape}; {len(times)} frames need "
                          f"({len(times)}, {COUNT}, 3)")  # fmt: skip
    return HandTrack(times, points, _side(str(found["side"]) if "side" in found else None, path))


def _csv(content: bytes, path: Path) -> HandTrack:
    names, rows = parse_csv(content, path)
    if names != HEADER:
        raise ConfigError(f"{path}: its first line must be {','.join(HEADER[:5])},…,{HEADER[-1]}: {len(HEADER)} names")
    numbers = []
    for line, row in rows:
        try:
            numbers.append([float(value) if value else np.nan for value in row])
        except ValueError as error:
            raise ConfigError(f"{path}:{line}: {error}") from error
    table = np.array(numbers).reshape(-1, len(HEADER))
    return HandTrack(table[:, 0], table[:, 1:].reshape(-1, COUNT, 3))


def _json(content: bytes, path: Path) -> HandTrack:
    try:
        document: Any = json.loads(content)
    except ValueError as error:
        raise ConfigError(f"{path}: not valid JSON: {error}") from error
    frames = document.get("frames") if isinstance(document, dict) else None
    if not isinstance(frames, list):
        raise ConfigError(f"{path}: must hold a mapping with a list of `frames`")
    _check_no_side(document | {"side": None}, str(path))
    pairs = [_frame(frame, f"{path}: frame {number}") for number, frame in enumerate(frames)]
    side = document.get("side")
    return HandTrack(
        np.array([t for t, _ in pairs]),
        np.array([points for _, points in pairs]).reshape(-1, COUNT, 3),
        _side(None if side is None else str(side), path),
    )


def _frame(frame: Any, where: str) -> tuple[float, Array]:
    t = frame.get("t") if isinstance(frame, dict) else None
    if not isinstance(t, int | float) or isinstance(t, bool):
        raise ConfigError(f"{where}: needs `t`, s, and `landmarks`")
    try:
        t = float(t)
    except OverflowError as error:
        raise ConfigError(f"{where}: t has too many digits to be a time, s") from error
    _check_no_side(frame, where)
    if "landmarks" not in frame:
        raise ConfigError(f"{where}: has no `landmarks`; a frame without a hand has null there")
    points = frame["landmarks"]
    if points is None:
        return t, np.full((COUNT, 3), np.nan)
    if not isinstance(points, list) or len(points) != COUNT:
        raise ConfigError(f"{where}: needs {COUNT} landmarks or null, "
                          f"not {len(points) if isinstance(points, list) else points!r}")  # fmt: skip
    try:
        return t, np.array(points, dtype=np.float64).reshape(COUNT, 3)
    except (TypeError, ValueError, OverflowError) as error:
        raise ConfigError(f"{where}: a landmark is three numbers, m") from error


def _check_no_side(unread: Mapping[str, Any], where: str) -> None:
    """Raises ConfigError for a side among values that nobody reads."""
    for key, value in unread.items():
        if str(value).lower() in SIDES:
            raise ConfigError(f"{where}: {key} is {value!s}, and the side is the file's own `side`: right or left")


def _side(text: str | None, path: Path) -> Side | None:
    if text is not None:
        check_side(text, f"{path}: side")
    return text  # type: ignore[return-value]  # Checked.


def _checked(track: HandTrack, path: Path) -> HandTrack:
    times = track.times
    if not len(times):
        raise ConfigError(f"{path}: holds no frame")
    if not np.isfinite(times).all():
        raise ConfigError(f"{path}: t of frame {int(np.argmin(np.isfinite(times)))} is not a number")
    if (np.diff(times) <= 0.0).any():
        k = int(np.argmax(np.diff(times) <= 0.0))
        raise ConfigError(f"{path}: t must ascend; after frame {k} it goes from {times[k]:g} to {times[k + 1]:g} s")
    if len(times) > 1 and (step := float(np.median(np.diff(times)))) > _SLOWEST:
        raise ConfigError(f"{path}: a frame every {step:.3g} s follows no hand: t is in s, not in ms or µs")
    whole = np.isfinite(track.landmarks).all(axis=(1, 2))
    if not whole.any():
        raise ConfigError(f"{path}: no frame has a whole hand of {COUNT} landmarks: all have NaN")
    if said := wrong_size(float(np.median([palm_length(points) for points in track.landmarks[whole]]))):
        raise ConfigError(f"{path}: {said}")
    return track
