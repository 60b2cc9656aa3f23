"""Missed samples in a recording: held over a short gap, refused over a long one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from allegro_twin.errors import RecordingError
from allegro_twin.recording.reader import Recording
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector

HELD = 0.1
"""s for which what a hand reported last stands for what it missed; as long as a mirror goes on without a report."""


def hold_missed(recording: Recording, *names: str) -> Recording:
    """The recording with the gaps of columns (k, width) closed by the value before, or at its start by the first one.

    A joint or axis that is NaN throughout is not reported, and stays. So does `torque` before its first value, which a
    log of a bus that begins in the middle lacks. Raises RecordingError with the column, the row and the time for a gap
    that is longer than HELD.
    """
    own = {name: _held(recording, name) for name in names if np.isnan(recording.columns[name]).any()}
    return replace(recording, columns={**recording.columns, **own}) if own else recording


def read_by_twin(spec: HandSpec, gravity: object) -> tuple[str, ...]:
    """The columns that a model beside the hand reads: the torques of a hand that takes them, and gravity unless it is
    given."""
    return ("torque",) * ("torque" in spec.commands) + ("gravity",) * (gravity is None)


def _held(recording: Recording, name: str) -> Array:
    t, values = recording.columns["t"], recording.columns[name].copy()
    for place in range(values.shape[1]):
        row = values[:, place]
        known = np.flatnonzero(~np.isnan(row))
        if not len(known):
            continue
        first = int(known[0])
        if first and name != "torque":
            _check_gap(recording, name, place, t, 0, first)
            row[:first] = row[first]
        for k in np.flatnonzero(np.diff(known) > 1):
            _check_gap(recording, name, place, t, int(known[k]) + 1, int(known[k + 1]))
        if known[-1] + 1 < len(row):
            _check_gap(recording, name, place, t, int(known[-1]) + 1, len(row))
        held = np.maximum.accumulate(np.where(np.isnan(row), first, np.arange(len(row))))
        row[first:] = row[held[first:]]
    values.setflags(write=False)
    return values


def _check_gap(recording: Recording, name: str, place: int, t: Vector, begin: int, end: int) -> None:
    """Raise RecordingError for rows `begin` to `end` without a value that last longer than HELD."""
    lasts = (end - begin) * recording.period if end == len(t) else t[end] - t[begin]
    if lasts > HELD + 1e-9:
        raise RecordingError(
            f"{recording.path}: row {begin}: {name}[{place}] is nan from {t[begin]:.3f} s on, for {lasts:.3g} s; at "
            f"most {HELD:g} s are held: use a part in which the hand reported it"
            + (", or say --gravity where the command has it" if name == "gravity" else "")
        )
