"""Runs a mirror over a recording, and derives thresholds from a free motion."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from allegro_twin.errors import ConfigError
from allegro_twin.loop import to_the_end
from allegro_twin.recording.reader import Recording, load
from allegro_twin.recording.replay import ReplayBackend, replay_samples
from allegro_twin.spec import HandSpec
from allegro_twin.twin.mirror.contact_detection import Contact, find_contacts
from allegro_twin.twin.mirror.factory import mirror_for_recording
from allegro_twin.twin.mirror.fault_detection import Thresholds
from allegro_twin.twin.mirror.faults import FaultReport
from allegro_twin.twin.mirror.mirror import Mirror
from allegro_twin.types import Array, Sample, Vector

SOON = 1.5
"""s before a fault first showed in a window, from which on its effects may look like contacts: a window."""


@dataclass(frozen=True, slots=True, eq=False)
class MirrorResult:
    """Estimates and contacts of a mirror over a recording."""

    t: Vector
    """s, (k,)."""
    disturbance: Array
    """(k, n), N·m."""
    residual: Array
    """Reported minus predicted, (k, n), rad."""
    contact_thresholds: Array
    """Contact thresholds, (k, n), N·m."""
    contacts: tuple[Contact, ...]
    faults: tuple[FaultReport, ...]
    """In the order in which they were named; also those that ended."""
    unchecked_faults: tuple[str, ...] = ()
    """Names of faults that could not be checked."""


def possible_cause(contact: Contact, faults: Sequence[FaultReport], spec: HandSpec) -> FaultReport | None:
    """The fault that may have caused what looked like a contact: it was named soon after, on the same finger."""
    own = next(finger.joints for finger in spec.fingers if finger.name == contact.finger)
    for each in faults:
        if each.fault.joint in own and each.ended == np.inf and each.begin - SOON < contact.begin < each.named:
            return each
    return None


def mirror_recording(path: Path, hand: str, free: Path | None, gravity: Vector | None = None) -> MirrorResult:
    """Run a recording past its mirror. `free`: a recording of the same hand without contact; `gravity`: in the palm
    frame, m/s², where neither hand nor recording says it. Raises HandError."""
    recording = load(path)
    spec, thresholds = (
        recording.spec,
        Thresholds.default(recording.spec) if free is None else free_motion_thresholds(free, hand, gravity),
    )
    t, disturbance, off, _, each, above, _, touched = _run(recording, hand, thresholds, gravity)
    touches = tuple(find_contacts(t, touched, disturbance, above, spec))
    return MirrorResult(t, disturbance, off, above, touches, each.faults, each.unchecked_faults)


def free_motion_thresholds(free: Path, hand: str, gravity: Vector | None = None) -> Thresholds:
    """Thresholds from a free motion. Raises HandError."""
    recording = load(free)
    _, disturbance, _, moving, each, _, spread, _ = _run(recording, hand, None, gravity)
    gains = np.array(each.fault_detector.gains).reshape(-1, len(recording.spec.fingers))
    usual = np.median(spread, axis=0)
    disturbance = np.nan_to_num(disturbance) / np.maximum(spread / usual, 1.0)
    return Thresholds.from_free_motion(
        disturbance, moving, each.observer.held, gains, recording.period, recording.spec, usual
    )


def _run(
    recording: Recording, hand: str, thresholds: Thresholds | None, gravity: Vector | None
) -> tuple[Vector, Array, Array, NDArray[np.bool_], Mirror, Array, Array, NDArray[np.bool_]]:
    """Row by row: times, disturbances, reported minus predicted positions, which joints moved; the mirror; and, row by
    row, contact thresholds, the spread of disturbances by noise alone, and which fingers were touched."""
    each = mirror_for_recording(recording, hand, thresholds, gravity)
    t, rows = [], []
    for sample in each.watch(recorded_samples(recording)):
        latest = each.columns()
        t.append(sample.state.t)
        off = sample.state.position - latest["predicted"]
        touched = latest["event"][: len(recording.spec.fingers)] > 0.0
        spread = each.observer.spread
        rows.append((latest["disturbance"], off, each.moving, each.contact_thresholds, spread, touched))
    if len(t) < 2:
        raise ConfigError(f"{recording.path} has one row: a mirror needs a motion")
    disturbance, off, moving, above, spread, touched = (np.array(column) for column in zip(*rows[1:], strict=True))
    return np.array(t[1:]), disturbance, off, moving, each, above, spread, touched


def recorded_samples(recording: Recording) -> Iterator[Sample]:
    """All samples of a recording."""
    return to_the_end(replay_samples(ReplayBackend(recording)))
