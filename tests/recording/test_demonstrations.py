"""Demonstrations: recordings become data sets that other programs read, and come back as they were, to the bit."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet
import pytest

from allegro_twin.errors import ConfigError, RecordingError
from allegro_twin.recording.exchange import lerobot
from allegro_twin.recording.exchange.episodes import write_arrow
from allegro_twin.recording.exchange.lerobot import from_lerobot, to_lerobot
from allegro_twin.recording.exchange.minari import from_minari, to_minari
from allegro_twin.recording.reader import Recording, load
from allegro_twin.recording.replay import ReplayBackend, replay_samples
from allegro_twin.surfaces.cli.main import main

Pair = tuple[Callable[..., None], Callable[..., Recording]]


@pytest.fixture(params=["lerobot", "minari"])
def there_and_back(request: pytest.FixtureRequest) -> Pair:
    if request.param == "lerobot":
        return to_lerobot, from_lerobot
    pytest.importorskip("h5py", reason="Minari's files are HDF5: extra demos")
    return to_minari, from_minari


@pytest.fixture
def episodes(recording_path: Path) -> list[Recording]:
    """Two of different length."""
    first = load(recording_path)
    second = Recording(
        first.path, dict(first.meta) | {"note": "second"}, {k: v[:90] for k, v in first.columns.items()}, complete=True
    )
    return [first, second]


def differing(first: Recording, second: Recording) -> list[str]:
    """Of two recordings with the same columns and metadata, those columns that are not the same to the bit."""
    assert list(first.columns) == list(second.columns)
    assert dict(first.meta) == dict(second.meta)
    pairs = {name: (values, second.columns[name]) for name, values in first.columns.items()}
    return [
        name
        for name, (one, other) in pairs.items()
        if one.dtype != other.dtype or not np.array_equal(one, other, equal_nan=True)
    ]


def test_every_episode_comes_back_as_it_was(there_and_back: Pair, episodes: list[Recording], tmp_path: Path) -> None:
    there, back = there_and_back
    there(episodes, tmp_path / "set-v0")
    for number, episode in enumerate(episodes):
        assert not differing(episode, back(tmp_path / "set-v0", number))


def test_a_column_of_text_is_no_part_of_a_lerobot_set_and_is_named(episodes: list[Recording], tmp_path: Path) -> None:
    first = episodes[0]
    noted = replace(first, columns={**first.columns, "note": np.array(["a"] * len(first), object)})
    with pytest.raises(ConfigError, match="column note has no numbers, and a LeRobot set takes nothing else"):
        to_lerobot([noted], tmp_path / "set")
    assert not (tmp_path / "set").exists()
    extra = {"flag": np.ones(len(first), bool), "count": np.arange(len(first))}
    to_lerobot([replace(first, columns={**first.columns, **extra})], tmp_path / "set")
    assert from_lerobot(tmp_path / "set").columns["flag"].dtype == bool


@pytest.mark.parametrize("value", ["\u00e4", b"\xe4", b"a"])
def test_a_column_of_text_or_bytes_comes_back_from_a_minari_set_as_it_was(
    value: str | bytes, episodes: list[Recording], tmp_path: Path
) -> None:
    pytest.importorskip("h5py", reason="Minari's files are HDF5: extra demos")
    first = episodes[0]
    notes = {"note": np.array([value] * len(first), object), "pair": np.array([[value, value]] * len(first), object)}
    to_minari([replace(first, columns={**first.columns, **notes})], tmp_path / "set-v0")
    back = from_minari(tmp_path / "set-v0").columns
    assert [back[name].tolist() for name in notes] == [values.tolist() for values in notes.values()]


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ([1.0], "no numbers, text or bytes, and a Minari set takes nothing else"),
        (True, "no numbers, text or bytes, and a Minari set takes nothing else"),
        ("a\0b", "NUL in it, which a Minari set has no place for"),
        (b"a\0b", "NUL in it, which a Minari set has no place for"),
    ],
)
def test_a_column_that_is_no_part_of_a_minari_set_is_named(
    value: object, said: str, episodes: list[Recording], tmp_path: Path
) -> None:
    pytest.importorskip("h5py", reason="Minari's files are HDF5: extra demos")
    first = episodes[0]
    noted = replace(first, columns={**first.columns, "note": np.array([value] * len(first) + [None], object)[:-1]})
    with pytest.raises(ConfigError, match=f"column note has {said}: leave the column out"):
        to_minari([noted], tmp_path / "set-v0")
    assert not (tmp_path / "set-v0").exists()


def test_a_set_in_a_folder_whose_name_is_not_utf8_comes_back_as_it_was(
    there_and_back: Pair, episodes: list[Recording], tmp_path: Path
) -> None:
    there, back = there_and_back
    there(episodes, tmp_path / "n\udce4me" / "set-v0")
    assert not differing(episodes[1], back(tmp_path / "n\udce4me" / "set-v0", 1))


def test_what_comes_back_drives_a_replay(there_and_back: Pair, episodes: list[Recording], tmp_path: Path) -> None:
    there, back = there_and_back
    there(episodes, tmp_path / "set-v0")
    write_arrow(back(tmp_path / "set-v0", 1), tmp_path / "again.arrow")
    again = ReplayBackend(load(tmp_path / "again.arrow"))
    assert again.recording.complete
    pairs = zip(replay_samples(ReplayBackend(episodes[1])), replay_samples(again), strict=True)
    count = 0
    for (state, command), (its, their) in pairs:
        np.testing.assert_array_equal(state.position, its.position)
        np.testing.assert_array_equal(command.torque, their.torque)  # type: ignore[union-attr]  # Torques, both.
        assert state.tick == its.tick
        count += 1
    assert count == 90
    units = pyarrow.ipc.open_stream(tmp_path / "again.arrow").schema.field("position").metadata
    assert units == {b"unit": b"rad"}


def test_lerobots_layout_is_the_published_one(episodes: list[Recording], tmp_path: Path) -> None:
    folder = tmp_path / "set-v0"
    to_lerobot(episodes, folder)
    info = json.loads((folder / "meta/info.json").read_text())
    assert (info["codebase_version"], info["total_episodes"], info["total_frames"]) == ("v3.0", 2, 251 + 90)
    assert (info["fps"], info["splits"]) == (333, {"train": "0:2"})
    assert info["features"]["observation.state"]["shape"] == [16]
    assert info["features"]["action"]["names"][15] == "command_torque.thumb_3"
    table = pyarrow.parquet.read_table(folder / "data/chunk-000/file-000.parquet")
    assert set(table.column_names) == set(info["features"])
    for name, feature in info["features"].items():
        kind = table.schema.field(name).type
        width = kind.list_size if pyarrow.types.is_fixed_size_list(kind) else 1
        inner = kind.value_type if width > 1 else kind
        assert ([width], {"float": "float32", "double": "float64"}.get(str(inner), str(inner))) == (
            feature["shape"], feature["dtype"])  # fmt: skip
    assert table["index"].to_pylist() == list(range(341))
    assert table["frame_index"].to_pylist() == [*range(251), *range(90)]
    assert table["episode_index"].to_pylist() == [0] * 251 + [1] * 90
    steps = np.diff(table["timestamp"].to_numpy()[:251].astype(np.float64))
    assert np.abs(steps - 1 / info["fps"]).max() < 1e-4, "LeRobot tolerates 0.1 ms"
    rows = pyarrow.parquet.read_table(folder / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    assert [(row["length"], row["dataset_from_index"], row["dataset_to_index"]) for row in rows] == [
        (251, 0, 251), (90, 251, 341)]  # fmt: skip
    low = episodes[1].columns["position"].min(axis=0).astype(np.float32)
    np.testing.assert_array_equal(np.float32(rows[1]["stats/observation.state/min"]), low)
    assert rows[1]["stats/action/count"] == [90]
    stats = json.loads((folder / "meta/stats.json").read_text(), parse_constant=pytest.fail)  # No NaN: not JSON.
    assert stats["action"]["count"] == [341]
    assert "recording.temperature" not in stats  # It was not reported: no statistics would be true.


def test_a_long_set_goes_on_in_another_file(
    episodes: list[Recording], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lerobot, "MEGABYTES", 0.01)
    to_lerobot(episodes, tmp_path / "set-v0")
    assert len(list((tmp_path / "set-v0/data").rglob("*.parquet"))) == 2
    for number, episode in enumerate(episodes):
        assert not differing(episode, from_lerobot(tmp_path / "set-v0", number))


def test_a_set_of_another_version_says_what_makes_it_one_of_ours(episodes: list[Recording], tmp_path: Path) -> None:
    to_lerobot(episodes, tmp_path / "set-v0")
    info = tmp_path / "set-v0/meta/info.json"
    info.write_text(info.read_text().replace("v3.0", "v2.1"))
    with pytest.raises(RecordingError, match=r"has version v2.1; this program reads v3.0: lerobot's convert_dataset"):
        from_lerobot(tmp_path / "set-v0")


@pytest.mark.long
def test_lerobots_own_recording_loop_drives_the_hand_through_the_plugin() -> None:
    python = os.environ.get("LEROBOT_PYTHON", "")
    if not python:
        pytest.skip("needs LEROBOT_PYTHON, the Python of an environment with lerobot 0.4 (CONTRIBUTING.md)")
    check = Path(__file__).resolve().parents[2] / "plugins/lerobot_robot_allegro/tests/check.py"
    alone = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    done = subprocess.run([python, str(check)], capture_output=True, text=True, env=alone)
    assert done.returncode == 0, done.stderr
    assert [line.split(":")[0] for line in done.stdout.splitlines()] == ["sim_right", "can_virtual"]


@pytest.mark.long
def test_lerobots_own_library_library_loads_what_is_written_for_it(episodes: list[Recording], tmp_path: Path) -> None:
    python = os.environ.get("LEROBOT_PYTHON", "")
    if not python:
        pytest.skip("needs LEROBOT_PYTHON, the Python of an environment with lerobot 0.4 (CONTRIBUTING.md)")
    to_lerobot(episodes, tmp_path / "set-v0")
    reader = Path(__file__).with_name("reads_lerobot.py")
    found = json.loads(
        subprocess.run(
            [python, str(reader), str(tmp_path / "set-v0")], check=True, capture_output=True, text=True,
            env={k: v for k, v in os.environ.items() if k != "PYTHONPATH"} | {"HF_HOME": str(tmp_path / "hf")},
        ).stdout.splitlines()[-1]
    )  # fmt: skip
    position = [each.columns["position"].astype(np.float32) for each in episodes]
    assert (found["version"], found["episodes"], found["frames"], found["fps"]) == ("3.0", 2, 341, 333)
    assert (found["robot"], found["second_frames"], found["batches"]) == ("allegro_right", 90, 341)
    np.testing.assert_array_equal(np.array(found["state"], dtype=np.float32), position[0][100])
    np.testing.assert_array_equal(np.array(found["second"], dtype=np.float32), position[1][0])
    assert found["window"] == [3, 16]
    assert found["temperature"], "what a hand does not report stays NaN"
    assert found["features"] == ["action", "observation.state", "observation.velocity"]
    np.testing.assert_allclose(found["mean"], np.concatenate(position).mean(axis=0), rtol=1e-5, atol=1e-8)
    assert set(found["features"]) < set(found["stats"])


def test_minari_reads_what_is_written_for_it(episodes: list[Recording], tmp_path: Path) -> None:
    minari = pytest.importorskip("minari", reason="only Minari itself can say whether it reads a data set")
    to_minari(episodes, tmp_path / "allegro" / "home-v0")
    found: Any = minari.MinariDataset(tmp_path / "allegro" / "home-v0" / "data")
    assert (found.total_episodes, found.total_steps) == (2, 250 + 89)
    assert found.id == "allegro/home-v0"
    for ours, its in zip(episodes, found.iterate_episodes(), strict=True):
        columns = ours.columns
        np.testing.assert_array_equal(its.observations[:, :16], columns["position"])
        np.testing.assert_array_equal(its.observations[:, 16:], columns["velocity"])
        np.testing.assert_array_equal(its.actions, columns["command_torque"][:-1])
        assert its.truncations.tolist() == [False] * (len(ours) - 2) + [True]
        assert not its.terminations.any()
        assert found.observation_space.contains(its.observations[0])


def test_the_command_line_packs_and_unpacks(
    recording_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def call(*words: object) -> None:
        monkeypatch.setattr("sys.argv", ["allegro-twin", *map(str, words)])
        with pytest.raises(SystemExit) as ended:
            main()
        assert ended.value.code == 0

    call("export", recording_path, recording_path, tmp_path / "set-v0", "--format", "lerobot")
    call("export", tmp_path / "set-v0", tmp_path / "again.arrow", "--episode", 1)
    assert not differing(load(recording_path), load(tmp_path / "again.arrow"))


def test_what_does_not_fit_is_named(there_and_back: Pair, episodes: list[Recording], tmp_path: Path) -> None:
    there, back = there_and_back
    there(episodes, tmp_path / "set-v0")
    with pytest.raises(ConfigError, match="is not empty"):
        there(episodes, tmp_path / "set-v0")
    with pytest.raises(RecordingError, match="has no episode 2; there are 2"):
        back(tmp_path / "set-v0", 2)
    with pytest.raises(RecordingError):
        back(tmp_path / "nothing")


def test_an_episode_that_no_reader_takes_is_refused_when_it_is_read(
    there_and_back: Pair, episodes: list[Recording], tmp_path: Path
) -> None:
    there, back = there_and_back
    wrong = replace(episodes[0], columns={**episodes[0].columns, "tick": np.zeros(len(episodes[0]), dtype=np.int64)})
    there([wrong], tmp_path / "set-v0")
    with pytest.raises(
        RecordingError, match="set-v0, episode 0: row 1: tick is 0 after 0; it must increase"
    ) as refused:
        back(tmp_path / "set-v0", 0)
    assert "--partial" not in str(refused.value)


def test_recordings_that_differ_make_no_common_set(
    there_and_back: Pair, episodes: list[Recording], tmp_path: Path
) -> None:
    there, _ = there_and_back
    first, second = episodes
    more = Recording(second.path, second.meta, dict(second.columns) | {"target": np.zeros((90, 16))}, complete=True)
    with pytest.raises(ConfigError, match="do not both have target: they make two data sets"):
        there([first, more], tmp_path / "set-v0")
    assert not (tmp_path / "set-v0").exists()


def test_minaris_file_has_what_minari_asks_for(episodes: list[Recording], tmp_path: Path) -> None:
    """An episode ends with its recording: nobody ended it, so it is cut."""
    h5py = pytest.importorskip("h5py", reason="Minari's files are HDF5: extra demos")
    to_minari(episodes, tmp_path / "allegro" / "home-v0")
    with h5py.File(tmp_path / "allegro" / "home-v0" / "data" / "main_data.hdf5") as file:
        for number, ours in enumerate(episodes):
            group, steps = file[f"episode_{number}"], len(ours) - 1
            assert (group.attrs["id"], group.attrs["total_steps"]) == (number, steps)
            assert group["observations"].shape == (steps + 1, 32)
            np.testing.assert_array_equal(group["observations"][:, :16], ours.columns["position"])
            np.testing.assert_array_equal(group["actions"][()], ours.columns["command_torque"][:-1])
            assert group["truncations"][()].tolist() == [False] * (steps - 1) + [True]
            assert group["terminations"][()].tolist() == [False] * steps
            assert group["rewards"][()].tolist() == [0.0] * steps
