"""Several devices and journals in one file: each comes back as it was, whatever happens to its writer."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Protocol

import numpy as np
import pytest

from allegro_twin.errors import RecordingError
from allegro_twin.recording import arrow_writer as sink_module
from allegro_twin.recording import journal as journal_module
from allegro_twin.recording import recorder as recorder_module
from allegro_twin.recording.arrow_writer import SharedFile
from allegro_twin.recording.events import DeviceSample, JournalEntry, session_events
from allegro_twin.recording.journal import FieldKind, Journal
from allegro_twin.recording.reader import is_cell_recording, load, load_cell
from allegro_twin.recording.recorder import BATCH, Recorder
from allegro_twin.recording.replay import ReplayBackend, replay_samples
from allegro_twin.spec import HandSpec
from allegro_twin.types import TorqueCommand
from tests.recording.test_recording import record, sample

FIELDS: dict[str, FieldKind] = {"t": "number", "count": "count", "word": "word", "pose": "numbers", "picture": "array"}


class Closing(Protocol):
    def close(self) -> None: ...


def write(path: Path, spec: HandSpec, rows: int) -> None:
    """Two devices, turn by turn, and an event every tenth period."""
    file = SharedFile(path, {"config": {"a": 1}})
    left, right = (Recorder(file.track(name), spec, 0.003) for name in ("left", "right"))
    told = Journal(file.track("told"), FIELDS)
    for tick in range(rows):
        left.add(sample(tick), {"more": np.full(3, float(tick))})
        right.add(sample(tick + 1000))
        if tick % 10 == 0:
            picture = np.full((4, 5, 3), tick, np.uint8)
            told.add(t=0.003 * tick, count=tick, word=f"é{tick}", pose=np.arange(7.0), picture=picture)
    too = Journal(file.track("too"), {"t": "number"})
    too.add(t=0.0)
    closing: list[Closing] = [left, right, told, too, file]
    for each in closing:
        each.close()


@pytest.fixture
def path(tmp_path: Path, spec: HandSpec) -> Path:
    found = tmp_path / "cell.arrow"
    write(found, spec, 2 * BATCH + 7)
    return found


def test_every_track_comes_back_as_it_was(path: Path, spec: HandSpec) -> None:
    found = load_cell(path)
    assert found.complete
    assert found.devices == ("left", "right")
    assert found.meta["config"] == {"a": 1}
    for name, first in (("left", 0), ("right", 1000)):
        device = found.device(name)
        assert device.spec.name == spec.name
        for tick, (state, command) in enumerate(replay_samples(ReplayBackend(device))):
            expected = sample(first + tick)
            np.testing.assert_array_equal(state.position, expected.state.position)
            assert isinstance(command, TorqueCommand)
            assert isinstance(expected.command, TorqueCommand)
            np.testing.assert_array_equal(command.torque, expected.command.torque)
        assert tick == 2 * BATCH + 6
    np.testing.assert_array_equal(found.device("left").columns["more"][:, 0], np.arange(2 * BATCH + 7))
    events = found.events("told")
    assert [event["count"] for event in events] == list(range(0, 2 * BATCH + 7, 10))
    assert (events[3]["word"], events[3]["t"]) == ("é30", pytest.approx(0.09))
    np.testing.assert_array_equal(events[3]["picture"], np.full((4, 5, 3), 30, np.uint8))
    assert events[3]["picture"].dtype == np.uint8


def test_what_an_event_has_not_is_none(tmp_path: Path) -> None:
    file = SharedFile(tmp_path / "f.arrow", {})
    told = Journal(file.track("told"), FIELDS)
    told.add(t=1.0)
    told.close()
    file.close()
    event = load_cell(tmp_path / "f.arrow").events("told")[0]
    assert event == {"t": 1.0, "count": None, "word": None, "pose": None, "picture": None}
    assert load_cell(tmp_path / "f.arrow").events("no such journal") == []


def test_a_device_is_replayed_from_the_shared_file_by_the_name_of_its_track(path: Path) -> None:
    assert is_cell_recording(path)
    backend = ReplayBackend(load(path, track="right"))
    np.testing.assert_array_equal(backend.reset().position, sample(1000).state.position)
    with pytest.raises(RecordingError, match="is of a whole cell: say which track of it, left or right"):
        load(path)
    with pytest.raises(RecordingError, match="no track of a device named 'rigth'; did you mean 'right'"):
        load(path, track="rigth")


def test_a_recording_of_one_device_is_what_it_was_and_has_no_tracks(tmp_path: Path, spec: HandSpec) -> None:
    record(tmp_path / "one.arrow", spec, 3)
    assert load(tmp_path / "one.arrow").meta["version"] == 1
    assert not is_cell_recording(tmp_path / "one.arrow")
    with pytest.raises(RecordingError, match="is of one device and has no track 'hand'"):
        load(tmp_path / "one.arrow", track="hand")
    with pytest.raises(RecordingError, match="is of one device, not of a cell"):
        load_cell(tmp_path / "one.arrow")


def test_all_that_happened_comes_again_in_the_order_of_time(path: Path) -> None:
    found = list(session_events(load_cell(path)))
    times = [each.row["t"] if isinstance(each, JournalEntry) else each.sample.state.t for each in found]
    assert times == sorted(times)
    assert sum(isinstance(each, DeviceSample) and each.device == "left" for each in found) == 2 * BATCH + 7
    assert [each.track for each in found if isinstance(each, JournalEntry)] == ["told", "too"] + ["told"] * 20
    first = next(each for each in found if isinstance(each, DeviceSample) and each.device == "left")
    assert set(first.extras) == {"more"}


@pytest.mark.parametrize("part", [0.1, 0.37, 0.5, 0.77, 0.93])
def test_a_file_that_was_cut_says_so_and_all_of_its_whole_batches_are_there(part: float, path: Path) -> None:
    whole = path.read_bytes()
    path.write_bytes(whole[: int(part * len(whole))])
    try:
        found = load_cell(path)
    except RecordingError as error:
        message = str(error)
        assert "is cut short after" in message
        assert "\n" not in message
        found = load_cell(path, partial=True)
    assert not found.complete
    for name, first in (("left", 0), ("right", 1000)):
        if name in found.devices and part > 0.5:
            ticks = found.device(name).columns["tick"] - first
            assert len(ticks) % BATCH == 0
            np.testing.assert_array_equal(ticks, np.arange(len(ticks)))
    counts = [event["count"] for event in found.events("told")]
    assert counts == list(range(0, 10 * len(counts), 10))
    assert len(counts) >= 10 * part


class Interrupting:
    """Ctrl-C at the nth line that is executed where recordings are written."""

    FILES = frozenset(module.__file__ for module in (recorder_module, sink_module, journal_module))

    def __init__(self, nth: int) -> None:
        self.left = nth

    def __call__(self, frame: FrameType, event: str, argument: object) -> Interrupting | None:
        if frame.f_code.co_filename not in self.FILES:
            return None
        self.left -= event == "line"
        if self.left == 0:
            self.left = -1
            raise KeyboardInterrupt
        return self


def passed_on(path: Path, spec: HandSpec, counts: list[int]) -> Iterator[None]:
    """Two devices in one file, which is closed whatever happens; `counts`: samples of each that were added."""
    file = SharedFile(path, {})
    recorders = [Recorder(file.track(name), spec, 0.003) for name in ("left", "right")]
    try:
        for tick in range(5):
            for which, recorder in enumerate(recorders):
                recorder.add(sample(tick))
                counts[which] += 1
            yield
    finally:
        closing: list[Closing] = [*recorders, file]
        for each in closing:
            try:
                each.close()
            except KeyboardInterrupt:
                each.close()
        for each in closing:
            each.close()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:Exception ignored in")  # A file that was opened by a line that never ended.
def test_an_interruption_at_any_line_loses_no_sample_of_any_track(
    tmp_path: Path, spec: HandSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorder_module, "BATCH", 2)
    path, nth, begun = tmp_path / "r.arrow", 0, 0
    while True:
        nth += 1
        counts, interrupting = [0, 0], Interrupting(nth)
        sys.settrace(interrupting)
        try:
            for _ in passed_on(path, spec, counts):
                pass
        except KeyboardInterrupt:
            pass
        finally:
            sys.settrace(None)
        if min(counts):
            begun += 1
            found = load_cell(path)
            assert found.complete
            for name, count in zip(("left", "right"), counts, strict=True):
                ticks = found.device(name).columns["tick"]
                assert len(ticks) in (count, count + 1)
                np.testing.assert_array_equal(ticks, np.arange(len(ticks)))
        if interrupting.left > 0:
            break
    assert begun > 100
