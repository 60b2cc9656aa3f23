"""A recording comes back bit for bit, survives what happens to its writer, and says what is wrong with a bad file."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tracemalloc
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from allegro_twin.errors import LinkTimeout, RecordingError
from allegro_twin.files.first_error import message_of
from allegro_twin.recording import recorder as recorder_module
from allegro_twin.recording.arrow_writer import SharedFile
from allegro_twin.recording.journal import Journal
from allegro_twin.recording.reader import load, load_cell
from allegro_twin.recording.recorder import BATCH, Recorder
from allegro_twin.recording.replay import ReplayBackend, replay_samples
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, PositionCommand, Sample, TorqueCommand
from tests.full_disk import full_disk
from tests.test_safety import state


def sample(tick: int) -> Sample:
    row = np.arange(16.0) + tick
    return Sample(state(tick, position=row / 1000, velocity=-row), TorqueCommand(row / 100))


def record(path: Path, spec: HandSpec, rows: int) -> None:
    recorder = Recorder(path, spec, 0.003)
    for tick in range(rows):
        recorder.add(sample(tick))
    recorder.close()


@pytest.mark.parametrize("rows", [1, BATCH - 1, BATCH, BATCH + 1, 5 * BATCH])
def test_every_row_comes_back_bit_for_bit(rows: int, tmp_path: Path, spec: HandSpec) -> None:
    path = tmp_path / "r.arrow"
    record(path, spec, rows)
    recording = load(path)
    assert (len(recording), recording.complete) == (rows, True)
    for tick, (state_, command) in enumerate(replay_samples(ReplayBackend(recording))):
        expected = sample(tick)
        assert (state_.t, state_.tick) == (expected.state.t, tick)
        np.testing.assert_array_equal(state_.position, expected.state.position)
        np.testing.assert_array_equal(state_.temperature, np.full(16, np.nan))
        assert isinstance(command, TorqueCommand)
        np.testing.assert_array_equal(command.torque, (np.arange(16.0) + tick) / 100)


def test_a_recording_says_which_hand_it_is_of(recording_path: Path, spec: HandSpec) -> None:
    recording = load(recording_path)
    again = recording.spec
    assert (again.name, again.joints, again.fingers) == (spec.name, spec.joints, spec.fingers)
    np.testing.assert_array_equal(again.actuation.torque_limit, spec.actuation.torque_limit)
    assert recording.meta["note"] == "test"
    with pa.memory_map(str(recording_path)) as source:
        schema = pa.ipc.open_stream(source).schema
    assert schema.field("velocity").metadata == {b"unit": b"rad/s"}


WRITER = """
import sys, numpy as np
from pathlib import Path
sys.path.insert(0, {root!r})
from tests.recording.test_recording import sample
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.recording.recorder import Recorder
recorder = Recorder(Path({path!r}), load_spec(), 0.003)
tick = 0
while True:
    recorder.add(sample(tick))
    tick += 1
    print(tick, flush=True)
"""


def test_a_killed_process_loses_at_most_the_last_batch(tmp_path: Path) -> None:
    path = tmp_path / "killed.arrow"
    root = str(Path(__file__).resolve().parents[2])
    code = WRITER.format(root=root, path=str(path))
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    written = 0
    while written < 12 * BATCH + 40:
        written = int(process.stdout.readline())
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    process.stdout.close()
    recording = load(path, partial=True)  # It may have died within a batch.
    assert written - BATCH <= len(recording)
    assert not recording.complete
    np.testing.assert_array_equal(recording.columns["tick"], np.arange(len(recording)))


class Interrupting:
    """Ctrl-C at the nth line that is executed in the recorder's module."""

    def __init__(self, nth: int) -> None:
        self.left = nth

    def __call__(self, frame: FrameType, event: str, argument: object) -> Interrupting | None:
        if frame.f_code.co_filename != recorder_module.__file__:
            return None
        self.left -= event == "line"
        if self.left == 0:
            self.left = -1
            raise KeyboardInterrupt
        return self


@pytest.mark.filterwarnings("ignore:Exception ignored in")  # A file that was opened by a line that never ended.
def test_an_interruption_at_any_line_leaves_a_whole_recording_of_all_that_was_passed_on(
    tmp_path: Path, spec: HandSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorder_module, "BATCH", 3)
    path, nth, begun = tmp_path / "r.arrow", 0, 0
    while True:
        nth += 1
        passed, interrupting = 0, Interrupting(nth)
        samples = recorder_module.record(map(sample, range(8)), path, spec, 0.003)
        sys.settrace(interrupting)
        try:
            for _ in samples:
                passed += 1
        except KeyboardInterrupt:
            pass
        finally:
            sys.settrace(None)
        if passed:
            begun += 1
            recording = load(path)
            assert recording.complete
            assert len(recording) in (passed, passed + 1)
            np.testing.assert_array_equal(recording.columns["tick"], np.arange(len(recording)))
        if interrupting.left > 0:
            break
    assert begun > 100


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(cut=st.floats(0.0, 0.999))
def test_a_truncated_file_is_one_clear_error_and_its_whole_batches_are_offered(
    cut: float, recording_path: Path, tmp_path: Path
) -> None:
    whole = recording_path.read_bytes()
    path = tmp_path / "cut.arrow"
    path.write_bytes(whole[: int(cut * len(whole))])
    try:
        recording = load(path)
        assert len(recording) % BATCH == 0  # It was cut between batches: all that is there is readable.
    except RecordingError as error:
        message = str(error)
        assert str(path) in message
        assert "\n" not in message
        if "cut short after" in message and "after 0 whole rows" not in message:
            recording = load(path, partial=True)
            assert f"after {len(recording)} whole rows" in message
            np.testing.assert_array_equal(recording.columns["tick"], np.arange(len(recording)))


def test_a_foreign_file_is_named_with_what_was_expected(tmp_path: Path) -> None:
    path = tmp_path / "notes.arrow"
    for content, found in ((b"PAR1abcd", "a Parquet file"), (b"", "an empty file"), (b"hello world", "bytes 68 65")):
        path.write_bytes(content)
        with pytest.raises(
            RecordingError, match=f"expected an Arrow IPC stream written by allegro-twin, found {found}"
        ):
            load(path)
    with pa.OSFile(str(path), "wb") as sink, pa.ipc.new_stream(sink, pa.schema([("x", pa.int8())])) as writer:
        writer.write_batch(pa.record_batch([pa.array([1], pa.int8())], names=["x"]))
    with pytest.raises(RecordingError, match="Arrow stream of something else"):
        load(path)
    with pytest.raises(RecordingError, match="no recording at"):
        load(tmp_path / "missing.arrow")


def test_a_recording_from_a_newer_program_asks_for_an_upgrade(tmp_path: Path, spec: HandSpec) -> None:
    path = tmp_path / "new.arrow"
    record(path, spec, 3)
    table = pa.ipc.open_stream(path.read_bytes()).read_all()
    meta = json.loads(table.schema.metadata[b"allegro_twin"])
    table = table.replace_schema_metadata({"allegro_twin": json.dumps(meta | {"version": 99})})
    with pa.OSFile(str(path), "wb") as sink, pa.ipc.new_stream(sink, table.schema) as writer:
        writer.write_table(table)
    with pytest.raises(RecordingError, match="format version 99; this program reads up to 2"):
        load(path)


def test_a_full_disk_is_one_error_and_what_was_written_stays_readable(
    tmp_path: Path, spec: HandSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "full.arrow"
    code = f"""
import resource, signal, sys
sys.path.insert(0, {str(Path(__file__).resolve().parents[2])!r})
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (400_000, 400_000))
from pathlib import Path
from tests.recording.test_recording import record
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.errors import RecordingError
try:
    record(Path({str(path)!r}), load_spec(), 10_000)
except RecordingError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.startswith(f"cannot go on recording to {path}")
    assert done.stdout.count("\n") == 1
    rows = int(done.stdout.split("its first ")[1].split(" rows are readable: --partial")[0])
    with pytest.raises(RecordingError, match="cut short after"):
        load(path)
    recording = load(path, partial=True)
    assert len(recording) == rows >= 4 * BATCH
    np.testing.assert_array_equal(recording.columns["tick"], np.arange(len(recording)))


@pytest.mark.parametrize("size", [0, 1000, 20_000])  # Nothing, a piece of the head, a piece of the first batch.
def test_a_full_disk_without_a_whole_batch_leaves_no_file_and_says_so(
    size: int, tmp_path: Path, spec: HandSpec
) -> None:
    path = tmp_path / "full.arrow"
    said = r"cannot go on recording to .*; no row of it is whole, and it is removed$"
    with full_disk(size), pytest.raises(RecordingError, match=said):
        record(path, spec, 5 * BATCH)
    assert not path.exists()


def test_a_full_disk_without_a_whole_batch_of_any_track_says_so(tmp_path: Path, spec: HandSpec) -> None:
    path = tmp_path / "full.arrow"
    file = SharedFile(path, {})
    hand = Recorder(file.track("hand"), spec, 0.003)
    with full_disk(20_000), pytest.raises(RecordingError, match="; no row of it is whole$"):
        for tick in range(BATCH):
            hand.add(sample(tick))
    assert load_cell(path, partial=True).devices == ()


@pytest.mark.parametrize("at", [1, BATCH + 50])
@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"palm": np.zeros(7)}, "has no force, which the first row has"),
        ({}, "has no force, palm, which the first row has"),
        ({"palm": np.zeros(7), "force": np.zeros(3), "slip": np.zeros(1)}, "has slip, which the first row has not"),
        ({"palm": np.zeros(6), "force": np.zeros(3)}, r"has palm of shape \(6,\), and the first row of \(7,\)"),
        ({"palm": np.zeros(7), "force": np.zeros(1)}, r"has force of shape \(1,\), and the first row of \(3,\)"),
    ],
)
def test_a_row_with_other_extra_columns_than_the_first_is_named_and_the_rows_before_it_are_kept(
    changed: dict[str, Array], message: str, at: int, tmp_path: Path, spec: HandSpec
) -> None:
    path, rows = tmp_path / "r.arrow", 0

    def extras() -> dict[str, Array]:
        return {"palm": np.full(7, rows), "force": np.ones(3)} if rows < at else changed

    said = rf"r\.arrow: row {at} {message}; give the same columns in every row"
    with pytest.raises(RecordingError, match=said):
        for _ in recorder_module.record(map(sample, range(300)), path, spec, 0.003, extras=extras):
            rows += 1
    recording = load(path)
    assert (len(recording), recording.complete) == (at, True)
    np.testing.assert_array_equal(recording.columns["palm"][:, 0], np.arange(at))


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("t", np.zeros(1), "extra column t: a recording has a column of that name; give it another"),
        ("position", np.zeros(16), "extra column position: a recording has a column of that name"),
        ("command_torque", np.zeros(16), "extra column command_torque: a recording has"),
        ("command_effort", np.zeros(16), "extra column command_effort: a recording has"),
        ("wrench", np.zeros(6), "extra column wrench: a recording has"),
        ("force", np.float64(1.0), r"extra column force: its shape is \(\), not \(n,\)"),
        ("force", np.zeros((2, 3)), r"extra column force: its shape is \(2, 3\), not \(n,\)"),
    ],
)
def test_an_extra_column_hides_none_of_the_recordings_own_and_has_one_axis(
    name: str, value: Array, message: str, tmp_path: Path, spec: HandSpec
) -> None:
    recorder = Recorder(tmp_path / "r.arrow", spec, 0.003)
    with pytest.raises(RecordingError, match=rf"r\.arrow: {message}"):
        recorder.add(sample(0), {name: value})
    recorder.close()


def test_a_command_of_another_kind_than_the_first_is_named(tmp_path: Path, spec: HandSpec) -> None:
    recorder = Recorder(tmp_path / "r.arrow", spec, 0.003)
    recorder.add(sample(0))
    with pytest.raises(RecordingError, match="row 1 has no command_torque, which the first row has"):
        recorder.add(Sample(state(1), PositionCommand(np.zeros(16))))
    recorder.close()
    assert len(load(tmp_path / "r.arrow")) == 1


def test_a_place_may_be_a_text(tmp_path: Path, spec: HandSpec) -> None:
    path = str(tmp_path / "r.arrow")
    assert len(list(recorder_module.record(iter([sample(0), sample(1)]), path, spec, 0.003))) == 2
    assert len(load(path)) == 2


def test_on_a_full_disk_the_other_tracks_of_a_file_end_with_the_same_error(tmp_path: Path, spec: HandSpec) -> None:
    path = tmp_path / "full.arrow"
    file = SharedFile(path, {})
    arm, hand = Recorder(file.track("arm"), spec, 0.003), Recorder(file.track("hand"), spec, 0.003)
    states = Journal(file.track("states"), {"t": "number"})
    with full_disk(100_000):
        states.add(t=0.0)
        hand.add(sample(0))
        with pytest.raises(RecordingError, match="cannot go on recording") as first:
            for tick in range(10 * BATCH):
                arm.add(sample(tick))
        arm.close()
        for each in (hand, states, file):
            with pytest.raises(RecordingError) as then:
                each.close()
            assert str(then.value) == str(first.value)
        assert str(first.value).endswith("; the rows before are readable: --partial")
    (event,) = load_cell(path, partial=True).events("states")
    assert event["t"] == 0.0


def test_a_file_that_cannot_be_made_is_an_error_before_anything_moves(tmp_path: Path, spec: HandSpec) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingError, match="cannot record to"):
        Recorder(tmp_path / "file" / "r.arrow", spec, 0.003)


def test_a_session_that_recorded_nothing_leaves_no_file(tmp_path: Path, spec: HandSpec) -> None:
    path = tmp_path / "nothing.arrow"
    recorder = Recorder(path, spec, 0.003)
    assert path.exists()  # Nobody else may take it.
    recorder.close()
    assert not path.exists()
    path.write_text("somebody else's")
    recorder.close()
    assert path.exists()


def test_what_ended_a_session_is_raised_and_a_disk_that_failed_after_it_is_its_note(spec: HandSpec) -> None:
    def hand_that_falls_silent() -> Iterator[Sample]:
        yield sample(0)
        raise LinkTimeout("no report from the hand")

    class Full:
        """A disk with room for the head of a recording."""

        def put(self, number: int, message: object) -> None:
            if number > 1:
                raise RecordingError("cannot go on recording: no space left")

        def close(self) -> None:
            pass

    with pytest.raises(LinkTimeout, match="no report from the hand") as caught:
        list(recorder_module.record(hand_that_falls_silent(), Full(), spec, 0.003))
    assert message_of(caught.value) == "no report from the hand; cannot go on recording: no space left"
    samples: Any = recorder_module.record(iter([sample(0), sample(1)]), Full(), spec, 0.003)
    next(samples)
    with pytest.raises(RecordingError, match="no space left"):  # Nothing was wrong before.
        samples.close()


@pytest.mark.slow
def test_a_long_session_needs_no_more_memory_than_a_short_one(tmp_path: Path, spec: HandSpec) -> None:
    """Ten minutes are 200,000 rows; the buffers of one batch are all that is kept."""
    recorder = Recorder(tmp_path / "long.arrow", spec, 0.003)
    for tick in range(2 * BATCH):
        recorder.add(sample(tick))
    tracemalloc.start()
    before, arrow = tracemalloc.get_traced_memory()[0], pa.total_allocated_bytes()
    for tick in range(2 * BATCH, 200_000):
        recorder.add(sample(tick))
    grown = tracemalloc.get_traced_memory()[0] - before + pa.total_allocated_bytes() - arrow
    tracemalloc.stop()
    recorder.close()
    assert grown < 1_000_000


def test_a_recording_can_be_read_while_it_is_being_written(tmp_path: Path, spec: HandSpec) -> None:
    recorder = Recorder(tmp_path / "live.arrow", spec, 0.003)
    for tick in range(250):
        recorder.add(sample(tick))
    assert len(load(tmp_path / "live.arrow")) == 200
    recorder.close()
    assert len(load(tmp_path / "live.arrow")) == 250
