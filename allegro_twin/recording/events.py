"""What happens in a cell, in the order of time: live as it is, or again from a recording of it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from heapq import merge
from typing import Any, NamedTuple, TypeAlias

from allegro_twin.recording.reader import Recording, Tracks
from allegro_twin.recording.replay import ReplayBackend, samples_of
from allegro_twin.types import Array, Sample


class DeviceSample(NamedTuple):
    """A period of a device."""

    device: str
    """`arm` or `hand`."""
    sample: Sample
    extras: Mapping[str, Array]
    """What is known beside it, (k,) each: further columns of its track."""


class JournalEntry(NamedTuple):
    """An event of a journal."""

    track: str
    row: Mapping[str, Any]
    """By field; `t`, s, is when."""


SessionEvent: TypeAlias = DeviceSample | JournalEntry


def session_events(recording: Tracks) -> Iterator[SessionEvent]:
    """All that was recorded, oldest first. Raises RecordingError."""
    journals = [name for name, track in recording.tracks.items() if track.journal]
    each = [_moved(name, recording.device(name)) for name in recording.devices]
    each += [_told(name, recording.events(name)) for name in journals]
    return (found for _, found in merge(*each, key=lambda pair: pair[0]))


def _moved(name: str, recording: Recording) -> Iterator[tuple[float, SessionEvent]]:
    backend = ReplayBackend(recording)
    for sample in samples_of(backend):
        yield sample.state.t, DeviceSample(name, sample, backend.extras())


def _told(name: str, rows: Iterable[Mapping[str, Any]]) -> Iterator[tuple[float, SessionEvent]]:
    for row in rows:
        yield float(row["t"]), JournalEntry(name, row)
