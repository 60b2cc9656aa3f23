"""Events of a cell in the order of time, live or read from a recording."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from heapq import merge
from typing import Any, NamedTuple, TypeAlias

from allegro_twin.recording.reader import CellRecording, Recording
from allegro_twin.recording.replay import ReplayBackend, replay_samples
from allegro_twin.types import Array, Sample


class DeviceSample(NamedTuple):
    """One control period of a device."""

    device: str
    """`arm` or `hand`."""
    sample: Sample
    extras: Mapping[str, Array]
    """Further columns of the device's track, (k,) each."""


class JournalEntry(NamedTuple):
    """An event of a journal."""

    track: str
    row: Mapping[str, Any]
    """Values by field; `t` is the time, s."""


SessionEvent: TypeAlias = DeviceSample | JournalEntry


def session_events(recording: CellRecording) -> Iterator[SessionEvent]:
    """Yield everything in a recording, oldest first. Raises RecordingError."""
    journals = [name for name, track in recording.tracks.items() if track.journal]
    each = [_samples(name, recording.device(name)) for name in recording.devices]
    each += [_entries(name, recording.events(name)) for name in journals]
    return (found for _, found in merge(*each, key=lambda pair: pair[0]))


def _samples(name: str, recording: Recording) -> Iterator[tuple[float, SessionEvent]]:
    backend = ReplayBackend(recording)
    for sample in replay_samples(backend):
        yield sample.state.t, DeviceSample(name, sample, backend.extras())


def _entries(name: str, rows: Iterable[Mapping[str, Any]]) -> Iterator[tuple[float, SessionEvent]]:
    for row in rows:
        yield float(row["t"]), JournalEntry(name, row)
