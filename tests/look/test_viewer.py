"""What Rerun is given is what the hand did: read back from the file that was written."""

from __future__ import annotations

import socket
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rerun.chunk import RrdReader

from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.model import HandModel
from allegro_twin.look.viewer import Viewer, write_rrd
from allegro_twin.replay.backend import ReplayBackend, samples_of
from allegro_twin.replay.recording import load
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Sample, TorqueCommand
from tests.test_safety import state

BOX = {"name": "brick", "shape": "box", "size": [0.04, 0.05, 0.06]}
Rows = dict[str, list[tuple[float | None, dict[str, Any]]]]


def rows_of(path: Path) -> Rows:
    """Of every entity its rows: the time, s, or none for what always holds, and its components."""
    found: Rows = defaultdict(list)
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        names = [name for name in batch.schema.names if ":" in name]
        times = [None] * batch.num_rows
        if "time" in chunk.timeline_names:
            times = [value / 1e9 for value in batch.column("time").cast("int64").to_pylist()]
        if not str(chunk.entity_path).startswith("/__"):
            for k, t in enumerate(times):
                row = {name.split(":")[1]: batch.column(name)[k].as_py() for name in names}
                found[str(chunk.entity_path).removeprefix("/")].append((t, row))
    return {name: sorted(rows, key=lambda row: row[0] or 0.0) for name, rows in found.items()}


def sample(tick: int) -> Sample:
    row = np.linspace(0.0, 0.5, 16) + tick / 1000
    return Sample(state(tick, position=row, velocity=2 * row, torque=3 * row), TorqueCommand(4 * row))


def look(tick: int = 0) -> dict[str, Array]:
    turn = np.array([0.8, 0.6, 0.0, 0.0])
    return {
        "target": np.full(16, 7.0),
        "palm": np.array([0.1, 0.2, 0.3, *turn]),
        "object": np.array([0.4, 0.5, 0.6, *turn]),
        "contact_force": np.arange(5.0),
    }


@pytest.fixture
def written(tmp_path: Path, spec: HandSpec) -> Rows:
    write_rrd((sample(tick) for tick in range(101)), Viewer(spec, [BOX]), tmp_path / "a.rrd", look)
    assert [path.name for path in tmp_path.iterdir()] == ["a.rrd"]
    return rows_of(tmp_path / "a.rrd")


def moving(rows: Rows, name: str) -> list[tuple[float, dict[str, Any]]]:
    return [(t, row) for t, row in rows[name] if t is not None]


def test_samples_are_drawn_thirty_times_a_second_on_the_hands_own_clock(written: Rows) -> None:
    times = [t for t, _ in moving(written, "joints/position")]
    assert times[0] == 0.0
    assert times == pytest.approx([0.036 * k for k in range(9)])  # The first period of 3 ms after each 1/30 s.


@pytest.mark.parametrize(("name", "factor"), [("position", 1), ("velocity", 2), ("torque", 3), ("command", 4)])
def test_every_series_has_its_own_numbers_and_every_joint_its_name(
    name: str, factor: int, written: Rows, spec: HandSpec
) -> None:
    drawn = moving(written, f"joints/{name}")
    for t, row in drawn:
        expected = factor * (np.linspace(0.0, 0.5, 16) + round(t / 0.003) / 1000)
        np.testing.assert_allclose(row["scalars"], expected, rtol=1e-12)
    (static,) = [row for t, row in written[f"joints/{name}"] if t is None]
    assert static["names"] == list(spec.aliases)


def test_links_palm_object_and_what_was_seen_beside_are_where_they_were(written: Rows, spec: HandSpec) -> None:
    t, row = moving(written, "world/palm/link_3.0")[-1]
    expected = HandModel(spec).links(np.linspace(0.0, 0.5, 16) + round(t / 0.003) / 1000)["link_3.0"]
    np.testing.assert_allclose(row["translation"][0], expected.position, atol=1e-7)
    np.testing.assert_allclose(np.reshape(row["mat3x3"][0], (3, 3)).T, expected.rotation, atol=1e-6)  # By columns.
    for name, place in (("world/palm", [0.1, 0.2, 0.3]), ("world/objects/brick", [0.4, 0.5, 0.6])):
        _, row = moving(written, name)[0]
        np.testing.assert_allclose(row["translation"][0], place, atol=1e-7)
        np.testing.assert_allclose(row["quaternion"][0], [0.6, 0.0, 0.0, 0.8], atol=1e-7)
    assert moving(written, "joints/target")[0][1]["scalars"] == [7.0] * 16
    assert moving(written, "contact/force")[0][1]["scalars"] == [0.0, 1.0, 2.0, 3.0, 4.0]
    (static,) = [row for t, row in written["contact/force"] if t is None]
    assert static["names"] == ["index", "middle", "ring", "thumb", "palm"]


def test_the_object_has_its_size_and_stands_on_a_table_and_a_hand_alone_has_neither(
    written: Rows, spec: HandSpec, tmp_path: Path
) -> None:
    np.testing.assert_allclose(written["world/objects/brick/look"][0][1]["half_sizes"][0], [0.02, 0.025, 0.03])
    assert "world/table" in written
    write_rrd([sample(0)], Viewer(spec), tmp_path / "alone.rrd")
    alone = rows_of(tmp_path / "alone.rrd")
    assert not [name for name in alone if "object" in name or "table" in name]
    assert {f"world/palm/{link}" for link in HandModel(spec).links(np.zeros(16))} <= set(alone)


@pytest.mark.parametrize(
    ("shape", "size", "half"),
    [("sphere", [0.04], [0.02, 0.02, 0.02]), ("ellipsoid", [0.04, 0.06], [0.03, 0.02, 0.02])],
)
def test_round_objects_are_as_large_as_they_are(
    shape: str, size: list[float], half: list[float], spec: HandSpec, tmp_path: Path
) -> None:
    write_rrd([sample(0)], Viewer(spec, [{"name": "it", "shape": shape, "size": size}]), tmp_path / "a.rrd")
    np.testing.assert_allclose(rows_of(tmp_path / "a.rrd")["world/objects/it/look"][0][1]["half_sizes"][0], half)


def test_a_recording_becomes_a_file_with_its_last_sample(recording_path: Path, tmp_path: Path) -> None:
    backend = ReplayBackend(load(recording_path))
    write_rrd(samples_of(backend), Viewer(backend.spec), tmp_path / "a.rrd", backend.extras)
    drawn = moving(rows_of(tmp_path / "a.rrd"), "joints/position")
    assert drawn[-1][0] == pytest.approx(0.72, abs=0.036)
    np.testing.assert_array_equal(drawn[0][1]["scalars"], backend.recording.columns["position"][0])


def test_without_a_screen_the_window_is_refused_with_the_way_out(
    spec: HandSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    with pytest.raises(ConfigError, match=r"no screen for Rerun's window: look in the browser with --web"):
        Viewer(spec).spawn()


def test_a_port_that_is_taken_is_refused_with_its_number(spec: HandSpec) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        port = other.getsockname()[1]
        other.listen()
        with pytest.raises(ConfigError, match=f"port {port} is taken by another program; choose another with --port"):
            Viewer(spec).serve(open_browser=False, web_port=port)


def test_a_pose_without_four_numbers_of_turn_is_refused(spec: HandSpec, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="a quaternion of four numbers"):
        write_rrd([sample(0)], Viewer(spec), tmp_path / "a.rrd", lambda: {"palm": np.zeros(6)})
    assert list(tmp_path.iterdir()) == []
