"""Recordings into data sets of demonstrations, and back."""

from __future__ import annotations

from pathlib import Path

from allegro_twin.errors import ConfigError, unknown

FORMATS = ("lerobot", "minari", "rosbag2")


def packed(recordings: list[Path], folder: Path, kind: str, *, partial: bool) -> int:
    """Write a data set; the number of its rows. Raises ConfigError or RecordingError."""
    from allegro_twin.recording.exchange.episodes import check_recordings
    from allegro_twin.recording.exchange.lerobot import to_lerobot
    from allegro_twin.recording.exchange.minari import to_minari
    from allegro_twin.recording.exchange.rosbag import to_rosbag2
    from allegro_twin.recording.reader import load

    if kind not in FORMATS:
        raise ConfigError(unknown("data set format", kind, FORMATS))
    if kind == "rosbag2" and len(recordings) > 1:
        raise ConfigError(f"{len(recordings)} recordings are as many bags: give one with --format rosbag2")
    loaded = [load(path, partial=partial) for path in recordings]
    if kind == "rosbag2":
        check_recordings(loaded, folder)
        to_rosbag2(loaded[0], folder)
    else:
        (to_lerobot if kind == "lerobot" else to_minari)(loaded, folder)
    return sum(len(recording) for recording in loaded)


def unpacked(folder: Path, target: Path, episode: int) -> int:
    """Write an episode of a data set as a recording; the number of its rows. Raises ConfigError or RecordingError."""
    from allegro_twin.recording.exchange.episodes import write_arrow
    from allegro_twin.recording.exchange.lerobot import from_lerobot
    from allegro_twin.recording.exchange.minari import DATA, from_minari

    if target.suffix != ".arrow":
        raise ConfigError(f"{target}: an episode becomes a recording again, which ends in .arrow")
    recording = from_minari(folder, episode) if (folder / DATA).exists() else from_lerobot(folder, episode)
    write_arrow(recording, target)
    return len(recording)
