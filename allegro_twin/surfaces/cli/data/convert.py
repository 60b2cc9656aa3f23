"""Conversions of recordings: tables, Rerun files, bags, bus logs and data sets of demonstrations."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

from allegro_twin.app.config import load_config
from allegro_twin.errors import ConfigError, unknown

FORMATS = ("lerobot", "minari", "rosbag2")
_ONE_WAY = (".csv", ".parquet", ".rrd")  # Exports that nothing reads back.


def convert(path: Path, target: Path, *, partial: bool, track: str | None = None, config: str | None = None) -> int:
    """Write a recording in the format of the target's suffix; `config` has its hand's card. Returns the number of
    rows."""
    from allegro_twin.recording.reader import load
    from allegro_twin.surfaces.cli.start import view

    writers: dict[str, Callable[[Any, Path], None]] = {".parquet": _parquet, ".csv": _csv, ".rrd": _rrd, ".mcap": _mcap}
    if target.suffix not in writers:
        raise ConfigError(unknown("export format", target.suffix, writers))
    cell = view.cell_recording(path)
    if cell is not None and track is None and target.suffix == ".rrd":
        return view.cell_to_rrd(cell, target, partial=partial)
    recording = _with_card(load(cell or path, partial=partial, track=track), config)
    writers[target.suffix](recording, target)
    return len(recording)


def _with_card(recording: Any, config: str | None) -> Any:
    """A recording whose hand is described by the card that a config names. Raises ConfigError for another hand."""
    from allegro_twin.hands.description.specs import load_spec

    if config is None:
        return recording
    hand = load_config(config).hand
    spec = load_spec(hand.model, hand.side, hand.serial)
    if spec.joints != recording.spec.joints:
        raise ConfigError(f"--config {config}: {recording.path} is of {recording.spec.name}, which has other joints")
    if not spec.card:
        raise ConfigError(f"--config {config}: its hand {spec.name} has no card: leave it out")
    meta = recording.meta | {"hand": recording.meta["hand"] | {"card": str(Path(spec.card).resolve())}}
    return replace(recording, meta=meta)


def from_log(path: Path, target: Path, config: str | None, bus: str | None) -> tuple[int, str]:
    """Make a recording of a bus log. Returns its rows and a summary of irregularities. Raises RecordingError,
    ConfigError."""
    if path.suffix in _ONE_WAY:
        raise ConfigError(
            f"{path}: a {path.suffix} does not become a recording again; bus logs, bags and data sets do: keep the "
            ".arrow that it was made of"
        )
    if config is None:
        raise ConfigError(f"{path}: a bus log does not say whose it is; name a config of that hand with --config")
    from allegro_twin.app.bus_log import make_recording

    found = make_recording(load_config(config), path, target, bus)
    return found.states, found.summary()


def from_bag(path: Path, target: Path, config: str | None, topic: str | None) -> tuple[int, str, tuple[str, ...]]:
    """Make a recording of a bag, ours or of a config's hand. Returns its rows, where they are from, and what is left
    out. Raises RecordingError, ConfigError."""
    from allegro_twin.app.rig import spec_of
    from allegro_twin.recording.exchange.episodes import write_arrow
    from allegro_twin.recording.exchange.rosbag import from_bag as read

    if target.suffix != ".arrow":
        raise ConfigError(f"{target}: a bag becomes a recording, which ends in .arrow; export that one then")
    settings = None if config is None else load_config(config)
    spec = None if settings is None else spec_of(settings)
    recording = read(path, spec, 0.003 if settings is None else settings.period, topic)
    write_arrow(recording, target)
    return len(recording), str(recording.meta.get("source", "")), recording.notes


def to_dataset(recordings: list[Path], folder: Path, kind: str, *, partial: bool, config: str | None = None) -> int:
    """Write a data set of `kind`. Returns the number of its rows. Raises ConfigError or RecordingError."""
    from allegro_twin.recording.exchange.episodes import check_recordings
    from allegro_twin.recording.exchange.lerobot import to_lerobot
    from allegro_twin.recording.exchange.minari import to_minari
    from allegro_twin.recording.exchange.rosbag import to_rosbag2
    from allegro_twin.recording.reader import load

    if kind not in FORMATS:
        raise ConfigError(unknown("data set format", kind, FORMATS))
    if kind == "rosbag2" and len(recordings) > 1:
        raise ConfigError(f"{len(recordings)} recordings are as many bags: give one with --format rosbag2")
    loaded = [_with_card(load(path, partial=partial), config) for path in recordings]
    if kind == "rosbag2":
        check_recordings(loaded, folder)
        to_rosbag2(loaded[0], folder)
    else:
        (to_lerobot if kind == "lerobot" else to_minari)(loaded, folder)
    return sum(len(recording) for recording in loaded)


def from_dataset(folder: Path, target: Path, episode: int) -> int:
    """Write one episode of a data set as a recording. Returns its rows. Raises ConfigError or RecordingError."""
    from allegro_twin.recording.exchange.episodes import write_arrow
    from allegro_twin.recording.exchange.lerobot import from_lerobot
    from allegro_twin.recording.exchange.minari import DATA, from_minari

    if target.suffix != ".arrow":
        raise ConfigError(f"{target}: an episode becomes a recording again, which ends in .arrow")
    recording = from_minari(folder, episode) if (folder / DATA).exists() else from_lerobot(folder, episode)
    write_arrow(recording, target)
    return len(recording)


def _mcap(recording: Any, target: Path) -> None:
    from allegro_twin.recording.exchange.rosbag import to_mcap

    to_mcap(recording, target)


def _parquet(recording: Any, target: Path) -> None:
    from allegro_twin.recording.exchange.tables import to_parquet

    to_parquet(recording, target)


def _csv(recording: Any, target: Path) -> None:
    from allegro_twin.recording.exchange.tables import to_csv

    to_csv(recording, target)


def _rrd(recording: Any, target: Path) -> None:
    from allegro_twin.app.session import rerun_stage
    from allegro_twin.recording.replay import ReplayBackend, replay_samples
    from allegro_twin.surfaces.cli.start.view import add_verdict

    viewer_of, shown = rerun_stage()
    from allegro_twin.files.atomic_write import atomic_file
    from allegro_twin.viewing.scenery import scenery

    backend = ReplayBackend(recording)
    with atomic_file(target) as temporary:
        viewer = viewer_of(recording.spec, scenery(recording.spec, recording.meta)).to_file(temporary, target)
        with closing(viewer):
            for _ in shown(replay_samples(backend), viewer, backend.extras):
                pass
            add_verdict(viewer, recording)
