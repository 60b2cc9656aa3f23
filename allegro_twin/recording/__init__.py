"""Recordings of hands and cells: write, read, replay and convert them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from allegro_twin._lazy import exports

if TYPE_CHECKING:
    from allegro_twin.recording.exchange.lerobot import to_lerobot
    from allegro_twin.recording.exchange.minari import to_minari
    from allegro_twin.recording.exchange.rosbag import from_bag, to_mcap
    from allegro_twin.recording.exchange.tables import to_parquet
    from allegro_twin.recording.reader import CellRecording, Recording, load, load_cell
    from allegro_twin.recording.recorder import Recorder, record
    from allegro_twin.recording.replay import ReplayBackend

__all__ = [
    "CellRecording",
    "Recorder",
    "Recording",
    "ReplayBackend",
    "from_bag",
    "load",
    "load_cell",
    "record",
    "to_lerobot",
    "to_mcap",
    "to_minari",
    "to_parquet",
]
__getattr__, __dir__ = exports(
    __name__,
    {
        "recorder": ("Recorder", "record"),
        "reader": ("CellRecording", "Recording", "load", "load_cell"),
        "replay": ("ReplayBackend",),
        "exchange.rosbag": ("from_bag", "to_mcap"),
        "exchange.tables": ("to_parquet",),
        "exchange.lerobot": ("to_lerobot",),
        "exchange.minari": ("to_minari",),
    },
)
