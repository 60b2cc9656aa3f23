"""A recording that somebody edited is refused on load, in a line that names the column and the row, or the metadata."""

from __future__ import annotations

import json
import math
import os
import re
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from allegro_twin.errors import RecordingError
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.recording.arrow_writer import arrow_column
from allegro_twin.recording.missed import hold_missed
from allegro_twin.recording.reader import load, load_cell, read_stream
from allegro_twin.recording.recorder import BATCH, Recorder
from allegro_twin.recording.recorder import record as recorded
from allegro_twin.spec import HandSpec
from allegro_twin.types import Sample, frozen
from tests.recording.test_cell_recording import path as cell  # noqa: F401  # A fixture.
from tests.recording.test_recording import record, sample

ROWS = 230


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("whole") / "r.arrow"
    record(path, load_spec(), ROWS)
    return path


def write(path: Path, table: pa.Table, meta: Any = None) -> Path:
    if meta is not None:
        text = meta if isinstance(meta, str | bytes) else json.dumps(meta)
        table = table.replace_schema_metadata({"allegro_twin": text})
    with pa.OSFile(str(path), "wb") as sink, pa.ipc.new_stream(sink, table.schema) as writer:
        writer.write_table(table)
    return path


def changed(table: pa.Table, column: str, place: Any, value: Any) -> pa.Table:
    """The table with other values at a place of a column."""
    chunk = table.column(column).combine_chunks()
    flat = chunk.flatten() if pa.types.is_fixed_size_list(chunk.type) else chunk
    values = flat.to_numpy().copy().reshape(len(table), -1)
    values[place] = value
    values = values if pa.types.is_fixed_size_list(chunk.type) else values[:, 0]
    return table.set_column(table.schema.get_field_index(column), column, arrow_column(values))


def without(table: pa.Table, column: str, row: int, joint: int | None = None) -> pa.Table:
    """The table with a null in a row of a column, or for one joint in it, as other programs write NaN."""
    rows = table.column(column).to_pylist()
    if joint is None:
        rows[row] = None
    else:
        rows[row][joint] = None
    kind = table.schema.field(column).type
    return table.set_column(table.schema.get_field_index(column), column, pa.array(rows, type=kind))


Edit = Callable[[pa.Table], pa.Table]


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (lambda table: table.take(list(range(ROWS))[::-1]), r"row 1: tick is 228 after 229; it must increase"),
        (lambda table: pa.concat_tables([table.slice(0, 100), table.slice(99)]), r"row 100: tick is 99 after 99"),
        (lambda table: changed(table, "tick", slice(None), 5), r"row 1: tick is 5 after 5"),
        (lambda table: changed(table, "t", 50, np.nan), r"row 50: t is nan, not a finite number"),
        (lambda table: changed(table, "t", 50, 0.0), r"row 50: t is 0 after 0\.147"),
        (lambda table: changed(table, "position", (50, 3), np.nan), r"row 50: position\[3\] is nan"),
        (lambda table: without(table, "position", 50), r"row 50: position\[0\] is nan"),
        (lambda table: without(table, "position", 50, 3), r"row 50: position\[3\] is nan"),
        (lambda table: without(table, "t", 50), r"row 50: t is nan"),
        (lambda table: without(table, "tick", 50), r"row 50: tick is nan"),
        (lambda table: changed(table, "command_torque", (7, 15), np.inf), r"row 7: command_torque\[15\] is inf"),
        (lambda table: changed(table, "gravity", (50, 1), 1e5), r"row 50: gravity\[1\] is 100000 at 0\.150 s"),
        (lambda table: changed(table, "torque", (50, 1), -np.inf), r"row 50: torque\[1\] is -inf at .*; make it NaN"),
        (lambda table: changed(table, "t", slice(None), 3.0 * np.arange(ROWS)[:, None]), r"3 s on .* milliseconds"),
        (lambda table: changed(table, "t", slice(None), 0.006 * np.arange(ROWS)[:, None]), r"0\.006 s on in each tick"),
        (lambda table: changed(table, "position", slice(None), 20.0), r"go to 20, .* in degrees: divide them by 57"),
        (lambda table: table.drop_columns(["torque"]), "has no column torque"),
        (lambda table: table.drop_columns(["command_torque"]), "has no column command_torque"),
        (lambda table: table.drop_columns(["t"]), "has no column t"),
        (lambda table: table.set_column(2, "position", arrow_column(np.zeros((ROWS, 4)))), r"position has \(4,\)"),
        (lambda table: table.set_column(0, "t", pa.array(["0"] * ROWS)), "column t has object, not numbers"),
    ],
)  # fmt: skip
def test_rows_and_columns_that_a_hand_cannot_have_given_are_refused(
    edit: Edit, said: str, written: Path, tmp_path: Path
) -> None:
    stream = read_stream(written)
    path = write(tmp_path / "e.arrow", edit(stream.table), stream.meta)
    row = re.match(r"row (\d+)", said)
    for partial in (False, True) if row is None else (False,):
        with pytest.raises(RecordingError, match=said) as caught:
            load(path, partial=partial)
        assert str(caught.value).startswith(str(path))
        assert "\n" not in str(caught.value)
    if row is not None:
        assert str(caught.value).endswith(f"; with --partial the {row[1]} rows before it are read")
        before = load(path, partial=True)
        assert (len(before), before.complete) == (int(row[1]), False)
        assert {len(column) for column in before.columns.values()} == {int(row[1])}


@pytest.mark.parametrize("joint", [None, 3])
def test_a_null_of_another_program_is_a_nan_in_its_own_row(tmp_path: Path, written: Path, joint: int | None) -> None:
    own = read_stream(written)
    path = write(tmp_path / "null.arrow", without(own.table, "velocity", 5, joint), own.meta)
    found, wanted = load(path).columns["velocity"], load(written).columns["velocity"].copy()
    wanted[5, slice(None) if joint is None else joint] = np.nan
    np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize(
    ("value", "blank"), [(["a", "b"], [None, None]), ([[1.0], [2.0]], [None, None]), ([True, False], [np.nan, np.nan])]
)
def test_a_null_in_a_column_of_something_else_than_numbers_keeps_every_row_in_its_place(
    value: list[Any], blank: list[Any], tmp_path: Path, written: Path
) -> None:
    own = read_stream(written)
    kind = pa.list_(pa.array([value]).type.value_type, 2)
    notes = pa.array([*[value] * 5, None, *[value] * (ROWS - 6)], kind)
    found = load(write(tmp_path / "null.arrow", own.table.append_column("note", notes), own.meta)).columns["note"]
    np.testing.assert_array_equal(found[5], np.array(blank))
    assert [np.asarray(row).tolist() for row in found[[4, 6]].tolist()] == [value] * 2


@pytest.mark.parametrize("at", [1, BATCH, BATCH + 50])
@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"t": 0.0, "tick": -1}, "tick is -1 after"),
        ({"t": math.nan}, "t is nan, not a finite number"),
        ({"gravity": frozen([0.0, 0.0, -981.0])}, r"gravity\[2\] is -981 at .* s, which no hand reports"),
        ({"velocity": frozen(np.full(16, np.inf))}, r"velocity\[0\] is inf at"),
        ({"torque": frozen(np.full(16, -np.inf))}, r"torque\[0\] is -inf at"),
        ({"position": frozen(np.full(16, np.nan))}, r"position\[0\] is nan, not a finite number"),
    ],
)
def test_a_row_that_no_reader_takes_is_refused_when_it_comes_and_the_rows_before_it_are_kept(
    changes: dict[str, Any], said: str, at: int, tmp_path: Path, spec: HandSpec
) -> None:
    path = tmp_path / "r.arrow"
    rows = [sample(tick) for tick in range(at + 1)]
    rows[at] = Sample(replace(rows[at].state, **changes), rows[at].command)
    with pytest.raises(RecordingError, match=rf"r\.arrow: row {at}: {said}.*see to what the hand's backend reports$"):
        list(recorded(rows, path, spec, 0.003))
    kept = load(path)
    assert (len(kept), kept.complete) == (at, True)


METADATA: list[tuple[tuple[str, ...], Any, str]] = [
    (("period",), -1, "metadata: period is -1, not a number of seconds above 0"),
    (("period",), float("nan"), "metadata: period is nan"),
    (("period",), None, "metadata: period is None"),
    (("version",), float("nan"), "metadata: version is nan, not a whole number from 1"),
    (("version",), "x", "metadata: version is 'x'"),
    (("version",), 2, "is of a cell and has not the columns track, number, data"),
    (("hand",), None, "metadata: hand is None, not the description of a hand"),
    (("hand",), {}, "metadata: hand has no joints|metadata: hand has no model"),
    (("hand", "lower"), None, r"metadata: hand.lower is nan, not 16 finite numbers"),
    (("hand", "joints"), [], r"metadata: hand.joints is \[\], not the names of joints"),
    (("hand", "joints"), 5, "metadata: hand is damaged"),
    (("hand", "fingers"), "x", "metadata: hand is damaged"),
    (("hand", "actuation"), [], "metadata: hand is damaged"),
    (("hand", "side"), "x", "metadata: hand.side is 'x', not right or left"),
    (("hand", "serial"), None, "metadata: hand.serial is None, not a text"),
]


@pytest.mark.parametrize(("place", "value", "said"), METADATA)
def test_metadata_that_no_program_wrote_are_refused(
    place: tuple[str, ...], value: Any, said: str, written: Path, tmp_path: Path
) -> None:
    stream = read_stream(written)
    meta = json.loads(json.dumps(stream.meta))
    (meta if len(place) == 1 else meta[place[0]])[place[-1]] = value
    with pytest.raises(RecordingError, match=said):
        load(write(tmp_path / "e.arrow", stream.table, meta))


@pytest.mark.parametrize("text", ["{", "[]", '"a"', b"\xff", "5"])
def test_metadata_that_are_no_object_are_refused(text: str | bytes, written: Path, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="no JSON|something else"):
        load(write(tmp_path / "e.arrow", read_stream(written).table, text))


def test_a_second_file_behind_the_end_of_the_first_is_told(written: Path, tmp_path: Path) -> None:
    path = tmp_path / "two.arrow"
    path.write_bytes(written.read_bytes() * 2)
    with pytest.raises(RecordingError, match=rf"goes on after its end: {written.stat().st_size} bytes.*--partial"):
        load(path)
    assert len(load(path, partial=True)) == ROWS


def test_two_cells_in_a_file_are_told(cell: Path, tmp_path: Path) -> None:  # noqa: F811  # The fixture.
    path = tmp_path / "two.arrow"
    path.write_bytes(cell.read_bytes() * 2)
    with pytest.raises(RecordingError, match="goes on after its end"):
        load_cell(path)


def test_ticks_may_jump_and_what_a_hand_does_not_report_may_be_unknown(tmp_path: Path, spec: HandSpec) -> None:
    recorder = Recorder(tmp_path / "r.arrow", spec, 0.003)
    for tick in (0, 1, 5, 9):
        given = sample(tick)
        nothing = np.full(16, np.nan)
        recorder.add(given._replace(state=type(given.state)(given.state.t, tick, given.state.position, nothing, nothing,
                                                            nothing, nothing[:3])))  # fmt: skip
    recorder.close()
    assert load(tmp_path / "r.arrow").columns["tick"].tolist() == [0, 1, 5, 9]


def test_a_busy_host_may_count_lost_periods_late_and_leave_rows_out(written: Path, tmp_path: Path) -> None:
    stream, rng = read_stream(written), np.random.default_rng(0)
    late = 0.003 * (np.arange(ROWS) + np.where(rng.random(ROWS) < 0.2, 0.9, 0.0))[:, None]
    table = changed(stream.table, "t", slice(None), late)
    kept = np.flatnonzero(rng.random(ROWS) < 0.5)
    assert len(load(write(tmp_path / "late.arrow", table, stream.meta))) == ROWS
    assert len(load(write(tmp_path / "gone.arrow", table.take(kept), stream.meta))) == len(kept)
    bursts = 0.003 * (4.0 * (np.arange(ROWS) // 4) + 0.1 * (np.arange(ROWS) % 4))[:, None]  # Four at once.
    assert (
        len(load(write(tmp_path / "bursts.arrow", changed(stream.table, "t", slice(None), bursts), stream.meta)))
        == ROWS
    )
    lost = 0.003 * (np.arange(ROWS) + 150 * (np.arange(ROWS) > 100))[:, None]  # Nobody counted the long pause.
    assert (
        len(load(write(tmp_path / "pause.arrow", changed(stream.table, "t", slice(None), lost), stream.meta))) == ROWS
    )


@pytest.mark.parametrize("column", ["gravity", "torque"])
def test_what_a_hand_missed_to_report_is_held_for_a_tenth_of_a_second_and_then_refused(
    column: str, written: Path, tmp_path: Path
) -> None:
    stream = read_stream(written)
    table = changed(stream.table, column, slice(None), np.arange(ROWS)[:, None])
    short = load(write(tmp_path / "short.arrow", changed(table, column, (slice(50, 80), 1), np.nan), stream.meta))
    held = hold_missed(short, column).columns[column]
    assert held[49:82, 1].tolist() == [49.0] * 31 + [80.0, 81.0]
    assert held[:, 0].tolist() == list(range(ROWS))
    assert np.isnan(short.columns[column][50, 1])
    long = load(write(tmp_path / "long.arrow", changed(table, column, slice(50, None), np.nan), stream.meta))
    with pytest.raises(RecordingError, match=rf"row 50: {column}\[0\] is nan from 0\.150 s on, for 0\.54 s"):
        hold_missed(long, column)


def test_a_column_that_a_hand_does_not_report_and_torques_before_the_first_stay_unknown(
    written: Path, tmp_path: Path
) -> None:
    stream = read_stream(written)
    table = changed(changed(stream.table, "gravity", slice(None), np.nan), "torque", slice(100), np.nan)
    found = hold_missed(load(write(tmp_path / "r.arrow", table, stream.meta)), "gravity", "torque").columns
    assert np.isnan(found["gravity"]).all()
    assert np.isnan(found["torque"]).all(axis=1).sum() == 100


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no such names")
def test_a_file_name_that_is_no_utf8_is_read(written: Path, tmp_path: Path) -> None:
    path = Path(os.fsdecode(os.fsencode(tmp_path) + b"/lauf\xfc.arrow"))
    path.write_bytes(written.read_bytes())
    assert len(load(path)) == ROWS
    path.write_bytes(b"")
    with pytest.raises(RecordingError, match="found an empty file"):
        load(path)
