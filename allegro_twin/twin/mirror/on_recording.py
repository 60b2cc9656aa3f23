"""Runs a mirror over samples or a recording, and derives thresholds from a free motion."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from allegro_twin.errors import ConfigError, HandFault
from allegro_twin.hands.description.calibration import Version
from allegro_twin.loop import to_the_end
from allegro_twin.recording.missed import hold_missed, read_by_twin
from allegro_twin.recording.reader import Recording, load
from allegro_twin.recording.recorder import check_other_file, record
from allegro_twin.recording.replay import ReplayBackend, replay_samples
from allegro_twin.spec import HandSpec
from allegro_twin.twin.identify.results.findings import LEFT
from allegro_twin.twin.mirror.contact_detection import SETTLED, Contact, find_contacts
from allegro_twin.twin.mirror.factory import mirror_for_recording
from allegro_twin.twin.mirror.fault_detection import Thresholds
from allegro_twin.twin.mirror.fault_list import HIDES
from allegro_twin.twin.mirror.faults import FaultReport
from allegro_twin.twin.mirror.mirror import Mirror
from allegro_twin.types import Array, Sample, Vector

SOON = 1.5
"""s before a fault first showed in a window, from which on its effects may look like contacts: a window."""
MADE = ("format", "version", "hand", "period")
"""What a recorder writes itself into a recording's metadata."""


class FreeMotion(NamedTuple):
    """Thresholds and misfit from a motion that touches nothing."""

    thresholds: Thresholds
    excess: Vector
    """Disturbance that the file leaves in it, rms, in times what noise alone makes, (n,)."""
    residual: Vector
    """Disturbance that the file leaves in it, rms, (n,), N·m."""
    hand: str
    """The file, or empty for the nominal hand."""
    path: Path
    serial: str
    """Serial of the hand in the motion, empty where it has no name."""

    @property
    def unexplained(self) -> NDArray[np.bool_]:
        """Joints that the file does not explain, (n,): with the factor at which `identify` says so."""
        return np.asarray(self.excess > LEFT)


@dataclass(frozen=True, slots=True, eq=False)
class MirrorResult:
    """Estimates and contacts of a mirror over a motion."""

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
    free: FreeMotion | None = None
    """The motion that thresholds are from."""


class MirrorLog:
    """Collects what a mirror estimates, row by row."""

    def __init__(self, mirror: Mirror) -> None:
        self.mirror = mirror
        self._rows: list[tuple[float, tuple[Array | NDArray[np.bool_], ...]]] = []

    def watch(self, samples: Iterable[Sample]) -> Iterator[Sample]:
        """Observe samples and pass them on (a stage). Raises as `Mirror.watch`."""
        each = self.mirror
        for sample in samples:
            try:
                each.observe(sample)
            except HandFault:
                self._add(sample)  # What stops the hand belongs to what happened.
                raise
            self._add(sample)
            yield sample

    def _add(self, sample: Sample) -> None:
        each = self.mirror
        latest = each.columns()
        off = sample.state.position - latest["predicted"]
        touched = latest["event"][: len(each.spec.fingers)] > 0.0
        row = (latest["disturbance"], off, each.moving, each.contact_thresholds, each.observer.spread, touched)
        self._rows.append((sample.state.t, row))  # In one step, which Ctrl-C does not divide.

    @property
    def rows(self) -> int:
        """How many periods there are estimates of."""
        return max(len(self._rows) - 1, 0)

    def columns(self) -> tuple[Array, Array, NDArray[np.bool_], Array, Array, NDArray[np.bool_]]:
        """Disturbances, N·m, reported minus predicted positions, rad, which joints moved, contact thresholds, N·m, and
        the spread of disturbances by noise alone, N·m, (rows, n) each; which fingers were touched, (rows, fingers)."""
        rows = zip(*(row for _, row in self._rows[1:]), strict=True)
        disturbance, off, moving, above, spread, touched = (np.array(column) for column in rows)
        return disturbance, off, moving, above, spread, touched

    def result(self, free: FreeMotion | None = None) -> MirrorResult:
        """What was found up to now, with at least one row."""
        each, t = self.mirror, np.array([t for t, _ in self._rows[1:]])
        disturbance, off, _, above, _, touched = self.columns()
        touches = tuple(find_contacts(t, touched, disturbance, above, each.spec))
        return MirrorResult(t, disturbance, off, above, touches, each.faults, each.unchecked_faults, free)


def possible_cause(contact: Contact, faults: Sequence[FaultReport], spec: HandSpec) -> FaultReport | None:
    """The fault that may have caused what looked like a contact on the same finger: one that was named soon after, or
    that hides where one of the finger's links is."""
    own = spec.finger(contact.finger).joints
    for each in faults:
        until = each.ended if each.fault.name in HIDES else each.named if each.ended == np.inf else -np.inf
        if (each.fault.joint in own or each.fault.name == "supply") and each.begin - SOON < contact.begin < until:
            return each
    return None


def mirror_recording(
    path: Path,
    hand: str,
    free: Path | None,
    gravity: Vector | None = None,
    *,
    partial: bool = False,
    into: Path | None = None,
) -> MirrorResult:
    """Run a recording past its mirror. `free`: a recording of the same hand without contact; `gravity`: in the palm
    frame, (3,), m/s², where neither hand nor recording says it; `partial`: use what is there of a recording that was
    cut short; `into`: a copy with the mirror's columns. Raises HandError."""
    recording = load(path, partial=partial)
    log, own = log_for_recording(recording, hand, free, gravity)
    run_recording(recording, log, into)
    return log.result(own)


def log_for_recording(
    recording: Recording, hand: str, free: Path | None, gravity: Vector | None = None
) -> tuple[MirrorLog, FreeMotion | None]:
    """The log of a mirror for a recording, and the motion that its thresholds are from; arguments as those of
    `mirror_recording`. Raises HandError."""
    version = (recording.meta.get("calibration") or {}).get("version")
    own = None if free is None else read_free_motion(free, hand, recording.spec, version, gravity)
    return MirrorLog(mirror_for_recording(recording, hand, None if own is None else own.thresholds, gravity)), own


def read_free_motion(
    free: Path, hand: str, spec: HandSpec, version: Version | None, gravity: Vector | None = None
) -> FreeMotion:
    """Thresholds from a free motion, and how well a hand's file explains it. `spec`, `version`: of the hand that is to
    be mirrored. Raises HandError, as for a motion of another kind of hand."""
    recording = load(free)
    _check_kind(recording, spec, version)
    log = MirrorLog(each := mirror_for_recording(recording, hand, None, gravity))
    each.fault_detector.keep_rows()
    run_recording(recording, log)
    disturbance, _, moving, _, spread, _ = log.columns()
    shapes = each.fault_detector.free_shapes()
    usual = np.median(spread, axis=0)
    disturbance = np.nan_to_num(disturbance) / np.maximum(spread / usual, 1.0)
    thresholds = Thresholds.from_free_motion(
        disturbance, moving, each.observer.held, shapes, recording.period, recording.spec, usual
    )
    left = np.sqrt(np.square(disturbance[round(SETTLED / recording.period) :]).mean(axis=0))
    return FreeMotion(thresholds, left / usual, left, hand or recording.spec.serial, free, recording.spec.serial)


def _check_kind(recording: Recording, spec: HandSpec, version: Version | None) -> None:
    """Raise ConfigError for a recording of another model, side or version of hand."""
    there, its = recording.spec, (recording.meta.get("calibration") or {}).get("version")
    for name, mine, theirs in (
        ("model", spec.model, there.model), ("side", spec.side, there.side), ("version", version, its),
    ):  # fmt: skip
        if mine is not None and theirs is not None and mine != theirs:
            raise ConfigError(
                f"--free {recording.path} is of another hand: its {name} is {theirs}, that of the hand to mirror {mine}"
            )


def run_recording(recording: Recording, log: MirrorLog, into: Path | None = None) -> None:
    """Run a recording past the mirror of a log; `into`: a copy with the mirror's columns, which is whole up to where
    Ctrl-C ends it. Raises ConfigError for one row, RecordingError where the copy cannot be written, or where the
    recording has a gap too long to hold (`hold_missed`)."""
    backend = ReplayBackend(hold_missed(recording, *read_by_twin(recording.spec, log.mirror.gravity)))
    samples = log.watch(to_the_end(replay_samples(backend)))
    if into is not None:
        check_other_file(into, recording.path)
        meta = {name: value for name, value in recording.meta.items() if name not in MADE}
        samples = record(
            samples, into, recording.spec, recording.period, meta=meta,
            extras=lambda: backend.extras() | log.mirror.columns(),
        )  # fmt: skip
    with closing(cast("Generator[Sample]", samples)):
        for _ in samples:
            pass
    if not log.rows:
        raise ConfigError(f"{recording.path} has one row: a mirror needs a motion")


def recorded_samples(recording: Recording) -> Iterator[Sample]:
    """All samples of a recording."""
    return to_the_end(replay_samples(ReplayBackend(recording)))
