"""A recording converts to what other programs read, whole or not at all."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.csv
import pyarrow.parquet
import pytest

from allegro_twin.errors import ConfigError, RecordingError
from allegro_twin.files.atomic_write import atomic_file
from allegro_twin.recording.exchange.episodes import write_arrow
from allegro_twin.recording.exchange.tables import to_csv, to_parquet
from allegro_twin.recording.reader import Recording, load


def test_parquet_holds_the_same_columns_and_the_metadata(recording_path: Path, tmp_path: Path) -> None:
    recording = load(recording_path)
    to_parquet(recording, tmp_path / "r.parquet")
    table = pyarrow.parquet.read_table(tmp_path / "r.parquet")
    assert table.column_names == list(recording.columns)
    np.testing.assert_array_equal(np.array(table["position"].to_pylist()), recording.columns["position"])
    assert b'"allegro_right"' not in table.schema.metadata[b"allegro_twin"]
    assert b'"model": "allegro"' in table.schema.metadata[b"allegro_twin"]


def test_csv_has_a_column_per_joint_by_name(recording_path: Path, tmp_path: Path) -> None:
    recording = load(recording_path)
    to_csv(recording, tmp_path / "r.csv")
    table = pyarrow.csv.read_csv(tmp_path / "r.csv")
    np.testing.assert_array_equal(table["position.thumb_3"].to_numpy(), recording.columns["position"][:, 15])
    assert {"t", "tick", "gravity.2", "command_torque.index_0"} <= set(table.column_names)


def test_only_columns_of_joints_are_named_by_joint_whatever_their_width_is(
    recording_path: Path, tmp_path: Path
) -> None:
    recording = load(recording_path)
    n = recording.spec.n_joints
    poses = {"flange": np.zeros((len(recording), n)), "target": np.zeros((len(recording), n))}
    to_csv(replace(recording, columns={**recording.columns, **poses}), tmp_path / "r.csv")
    names = pyarrow.csv.read_csv(tmp_path / "r.csv").column_names
    assert [name for name in names if name.startswith("flange.")] == [f"flange.{k}" for k in range(n)]
    assert [name for name in names if name.startswith("target.")] == [
        f"target.{k}" for k in recording.spec.joint_labels
    ]


def test_a_column_of_lists_is_no_part_of_a_csv_and_is_named(recording_path: Path, tmp_path: Path) -> None:
    recording = load(recording_path)
    lists = np.array([[1.0]] * len(recording) + [None], object)[:-1]
    with pytest.raises(ConfigError, match="column note has list<item: double>, which a .csv has no place for"):
        to_csv(replace(recording, columns={**recording.columns, "note": lists}), tmp_path / "r.csv")
    assert not (tmp_path / "r.csv").exists()


@pytest.mark.parametrize("write", [to_csv, to_parquet, write_arrow])
def test_a_recording_becomes_a_file_whose_name_is_not_utf8(
    write: Callable[[Recording, Path], None], recording_path: Path, tmp_path: Path
) -> None:
    recording, folder = load(recording_path), tmp_path / "n\udce4me"
    write(recording, folder / "n\udce4me")
    write(recording, tmp_path / "name")
    assert (folder / "n\udce4me").read_bytes() == (tmp_path / "name").read_bytes()
    assert len(list(folder.iterdir())) == 1


def test_a_file_that_fails_half_way_leaves_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "kept.csv"
    path.write_text("old")
    with pytest.raises(RecordingError, match="cannot write"), atomic_file(path) as temporary:
        temporary.write_text("half")
        raise OSError(28, "No space left on device")
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]
