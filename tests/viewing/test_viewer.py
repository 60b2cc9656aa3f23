"""What Rerun is given is what the hand did: read back from the file that was written."""

from __future__ import annotations

import re
import socket
import sys
import urllib.request
from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader

from allegro_twin.errors import ConfigError, HandFault, RecordingError
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.recording.events import DeviceSample
from allegro_twin.recording.reader import load
from allegro_twin.recording.replay import ReplayBackend, replay_samples
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Sample, TorqueCommand
from allegro_twin.viewing.rerun.columns import AT_ONCE
from allegro_twin.viewing.rerun.server import claim
from allegro_twin.viewing.rerun.viewer import Look, Viewer, shown, write_events
from allegro_twin.viewing.scenery import scenery
from tests.full_disk import full_disk
from tests.test_safety import state

PHASES = [["close", 0.0, 0.1], ["shake", 0.1, 0.3]]
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
        "target": np.full(16, 0.4),
        "palm": np.array([0.1, 0.2, 0.3, *turn]),
        "object": np.array([0.4, 0.5, 0.6, *turn]),
        "contact_force": np.arange(5.0),
        "contact_point": np.array([0.1, 0.2, 0.3] + [np.nan] * 12),
        "contact_vector": np.array([0.0, 0.0, 2.0] + [0.0] * 12),
    }


def write_rrd(samples: Iterable[Sample], viewer: Viewer, path: Path, look: Look | None = None) -> None:
    events = (DeviceSample("hand", sample, look() if look is not None else {}) for sample in samples)
    write_events(events, viewer, path)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Rows:
    spec, tmp_path = load_spec(), tmp_path_factory.mktemp("written")
    viewer = Viewer(spec, scenery(spec, {"objects": [BOX], "phases": PHASES}))
    viewer.to_file(tmp_path / "a.rrd")
    for _ in shown((sample(tick) for tick in range(101)), viewer, look):
        pass
    viewer.conclude({"shake": False}, "**not held**: fell")
    viewer.close()
    return rows_of(tmp_path / "a.rrd")


def test_whoever_watches_gets_each_moment_a_few_messages_a_period(
    tmp_path: Path, spec: HandSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    sent, after, send = [], [], rr.RecordingStream.send_columns

    def counted(stream: rr.RecordingStream, path: str, **columns: Any) -> None:
        sent.append(path)
        send(stream, path, **columns)

    monkeypatch.setattr(rr.RecordingStream, "send_columns", counted)
    viewer = Viewer(spec, rate=10.0, live=True).to_file(tmp_path / "a.rrd")
    for tick in range(201):
        viewer.draw(sample(tick), look(tick))
        after.append(len(sent))
    assert 0 < np.diff(after).max() <= AT_ONCE
    viewer.close()
    rows = rows_of(tmp_path / "a.rrd")
    drawn = [0.003 * tick for tick in (0, 34, 68, 102, 136, 170)]
    assert [t for t, _ in moving(rows, "joints/position/thumb")] == pytest.approx(drawn)
    assert [t for t, _ in moving(rows, "contact/force")] == pytest.approx(drawn)


def moving(rows: Rows, name: str) -> list[tuple[float, dict[str, Any]]]:
    return [(t, row) for t, row in rows[name] if t is not None]


def still(rows: Rows, name: str) -> dict[str, Any]:
    (found,) = [row for t, row in rows[name] if t is None]
    return found


def test_samples_are_drawn_thirty_times_a_second_on_the_hands_own_clock(written: Rows) -> None:
    times = [t for t, _ in moving(written, "joints/position/index")]
    assert times[0] == 0.0
    assert times == pytest.approx([0.036 * k for k in range(9)])  # The first period of 3 ms after each 1/30 s.


@pytest.mark.parametrize(("name", "factor"), [("position", 1), ("velocity", 2), ("torque", 3), ("command", 4)])
def test_every_finger_has_its_own_numbers_and_every_joint_its_name_and_one_colour(
    name: str, factor: int, written: Rows, spec: HandSpec
) -> None:
    for finger in spec.fingers:
        for t, row in moving(written, f"joints/{name}/{finger.name}"):
            expected = factor * (np.linspace(0.0, 0.5, 16) + round(t / 0.003) / 1000)
            np.testing.assert_allclose(row["scalars"], expected[list(finger.joints)], rtol=1e-12)
        static = still(written, f"joints/{name}/{finger.name}")
        assert static["names"] == [spec.aliases[joint] for joint in finger.joints]
        assert len(set(static["colors"])) == len(finger.joints)
        assert static["colors"] == still(written, f"joints/position/{finger.name}")["colors"]


def test_torque_limits_are_lines_from_the_first_moment_to_the_last(written: Rows, spec: HandSpec) -> None:
    for finger in spec.fingers:
        rows = moving(written, f"joints/torque_limit/{finger.name}")
        assert [t for t, _ in rows] == pytest.approx([0.0, 0.288])
        limits = set(spec.actuation.torque_limit[list(finger.joints)])
        assert all(set(row["scalars"]) == limits | {-limit for limit in limits} for _, row in rows)


def test_links_palm_object_and_what_was_seen_beside_are_where_they_were(written: Rows, spec: HandSpec) -> None:
    t, row = moving(written, "world/palm/link_3.0")[-1]
    expected = hand_kinematics(spec).links(np.linspace(0.0, 0.5, 16) + round(t / 0.003) / 1000)["link_3.0"]
    np.testing.assert_allclose(row["translation"][0], expected.position, atol=1e-7)
    np.testing.assert_allclose(np.reshape(row["mat3x3"][0], (3, 3)).T, expected.rotation, atol=1e-6)  # By columns.
    for name, place in (("world/palm", [0.1, 0.2, 0.3]), ("world/objects/brick", [0.4, 0.5, 0.6])):
        _, row = moving(written, name)[0]
        np.testing.assert_allclose(row["translation"][0], place, atol=1e-7)
        np.testing.assert_allclose(row["quaternion"][0], [0.6, 0.0, 0.0, 0.8], atol=1e-7)
    assert moving(written, "joints/target/thumb")[0][1]["scalars"] == [0.4] * 4
    assert moving(written, "contact/force")[0][1]["scalars"] == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert still(written, "contact/force")["names"] == ["index", "middle", "ring", "thumb", "palm"]


def test_the_target_is_a_hand_that_one_can_see_through(written: Rows, spec: HandSpec) -> None:
    expected = hand_kinematics(spec).links(np.full(16, 0.4))["link_15.0"]
    np.testing.assert_allclose(
        moving(written, "world/palm/target/link_15.0")[0][1]["translation"][0], expected.position, atol=1e-7
    )
    assert len(moving(written, "world/palm/target/link_15.0")) == 1, "what does not change is sent again"
    assert still(written, "world/palm/target/link_15.0/look")["albedo_factor"][0] & 0xFF < 128  # Of 255, its opacity.


def test_an_arrow_ends_where_a_finger_presses_and_there_is_none_where_nothing_touches(written: Rows) -> None:
    _, row = moving(written, "world/contact")[0]
    vectors, origins = np.array(row["vectors"]), np.array(row["origins"])
    np.testing.assert_allclose(vectors[0] + origins[0], [0.1, 0.2, 0.3], atol=1e-6)
    assert vectors[0] @ [0.0, 0.0, 1.0] == pytest.approx(np.linalg.norm(vectors[0]))
    assert not vectors[1:].any()


def test_phases_and_the_verdict_are_marked_at_their_times(written: Rows) -> None:
    assert [(t, row["state"]) for t, row in moving(written, "trial/phase")] == [(0.0, ["close"]), (0.1, ["shake"])]
    assert [(t, row["state"]) for t, row in moving(written, "trial/verdict")] == [
        (0.0, [""]), (0.1, ["not held"]), (0.3, [""]),
    ]  # fmt: skip
    assert still(written, "verdict")["text"] == ["**not held**: fell"]


def test_what_moves_comes_in_columns_and_not_row_by_row(spec: HandSpec, tmp_path: Path) -> None:
    """A browser without a GPU swallows some fifty messages a second, however long each of them is."""
    write_rrd((sample(tick) for tick in range(2001)), Viewer(spec), tmp_path / "a.rrd", look)
    assert sum(1 for _ in RrdReader(tmp_path / "a.rrd").stream()) < 200


def test_the_object_has_its_size_and_stands_on_a_table_and_a_hand_alone_has_neither(
    written: Rows, spec: HandSpec, tmp_path: Path
) -> None:
    corners = np.array(still(written, "world/objects/brick/look")["vertex_positions"])
    np.testing.assert_allclose(corners.max(axis=0), [0.02, 0.025, 0.03], atol=1e-7)
    assert "world/fixed" in written
    write_rrd([sample(0)], Viewer(spec), tmp_path / "alone.rrd")
    alone = rows_of(tmp_path / "alone.rrd")
    assert not [name for name in alone if "object" in name or "fixed" in name or "palm/target" in name]
    links = {f"world/palm/{link}" for link in hand_kinematics(spec).links(np.zeros(16)) if not link.endswith("_tip")}
    assert links <= set(alone)


@pytest.mark.parametrize(
    ("shape", "size", "half"),
    [("sphere", [0.04], [0.02, 0.02, 0.02]), ("ellipsoid", [0.04, 0.06], [0.03, 0.02, 0.02])],
)
def test_round_objects_are_as_large_as_they_are(
    shape: str, size: list[float], half: list[float], spec: HandSpec, tmp_path: Path
) -> None:
    scene = scenery(spec, {"objects": [{"name": "it", "shape": shape, "size": size}]})
    write_rrd([sample(0)], Viewer(spec, scene), tmp_path / "a.rrd")
    corners = still(rows_of(tmp_path / "a.rrd"), "world/objects/it/look")["vertex_positions"]
    np.testing.assert_allclose(np.max(corners, axis=0), half, atol=3e-4)


def test_a_recording_becomes_a_file_with_its_last_sample(recording_path: Path, tmp_path: Path) -> None:
    backend = ReplayBackend(load(recording_path))
    write_rrd(replay_samples(backend), Viewer(backend.spec), tmp_path / "a.rrd", backend.extras)
    drawn = moving(rows_of(tmp_path / "a.rrd"), "joints/position/index")
    assert drawn[-1][0] == pytest.approx(0.72, abs=0.036)
    np.testing.assert_array_equal(drawn[0][1]["scalars"], backend.recording.columns["position"][0][:4])


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
    with pytest.raises(ConfigError, match="a quaternion of four numbers, not"):
        write_rrd([sample(0)], Viewer(spec), tmp_path / "a.rrd", lambda: {"palm": np.zeros(6)})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(sys.platform != "linux", reason="/proc says who listens where")
def test_the_page_is_for_this_machine_alone(spec: HandSpec) -> None:
    viewer, port = Viewer(spec), claim(0)
    try:
        address = viewer.serve(open_browser=False, web_port=port)
        assert address.startswith(f"http://127.0.0.1:{port}/?url=rerun%2Bhttp%3A%2F%2F127.0.0.1%3A")
        viewer.flush()
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/") as answer:
            assert b"rerun" in answer.read().lower()
        data = int(address.rsplit("%3A", 1)[1].split("%2F")[0])
        listening = [line.split()[1] for line in Path("/proc/net/tcp").read_text().splitlines()[1:]
                     if line.split()[3] == "0A"]  # fmt: skip
        for each in (port, data):
            assert [place for place in listening if place.endswith(f":{each:04X}")] == [f"0100007F:{each:04X}"]
    finally:
        viewer.close()


def test_a_port_that_is_none_is_refused(spec: HandSpec) -> None:
    with pytest.raises(ConfigError, match="port 99999 is no TCP port: they go from 1 to 65535"):
        Viewer(spec).serve(open_browser=False, web_port=99999)


def interrupted(path: Path, spec: HandSpec, error: BaseException, ticks: int) -> None:
    """A run that an error ends after so many samples."""

    def samples() -> Iterator[Sample]:
        yield from (sample(tick) for tick in range(ticks))
        raise error

    with Viewer(spec, scenery(spec, {})).recorded(path) as viewer:
        for each in samples():
            viewer.draw(each, look())


@pytest.mark.parametrize("error", [KeyboardInterrupt(), HandFault("the guard")])
def test_what_was_drawn_until_a_fault_or_an_interruption_is_kept(
    tmp_path: Path, spec: HandSpec, error: BaseException
) -> None:
    with pytest.raises(type(error)):
        interrupted(tmp_path / "a.rrd", spec, error, 100)
    drawn = rows_of(tmp_path / "a.rrd")
    assert max(t for rows in drawn.values() for t, _ in rows if t is not None) == pytest.approx(0.297, abs=0.04)
    assert [file.name for file in tmp_path.iterdir()] == ["a.rrd"]


@pytest.mark.parametrize(
    ("error", "ticks"),
    [(KeyboardInterrupt(), 0), (ConfigError("no such hand"), 100), (ValueError("a fault of ours"), 100)],
)
def test_what_nothing_was_drawn_into_or_what_an_error_ends_leaves_the_file_that_was_there(
    tmp_path: Path, spec: HandSpec, error: BaseException, ticks: int
) -> None:
    (tmp_path / "a.rrd").write_text("before")
    with pytest.raises(type(error)):
        interrupted(tmp_path / "a.rrd", spec, error, ticks)
    assert [file.read_text() for file in tmp_path.iterdir()] == ["before"]


def test_a_full_disk_names_the_file_that_was_asked_for(tmp_path: Path, spec: HandSpec) -> None:
    path = tmp_path / "a.rrd"
    said = pytest.raises(RecordingError, match=rf"^cannot write {re.escape(str(path))}: File too large")
    with full_disk(20_000), said, Viewer(spec, scenery(spec, {})).recorded(path) as viewer:
        for tick in range(100):
            viewer.draw(sample(tick), look())
    assert list(tmp_path.iterdir()) == []


def test_a_name_that_is_not_utf8_is_one_line_and_leaves_no_file(tmp_path: Path, spec: HandSpec) -> None:
    said = pytest.raises(ConfigError, match="n\udce4me.rrd: Rerun takes only a path that is UTF-8$")
    with said, Viewer(spec, scenery(spec, {})).recorded(tmp_path / "n\udce4me.rrd"):
        pass
    assert list(tmp_path.iterdir()) == []


def test_what_the_disk_does_not_take_later_names_the_file_too(
    tmp_path: Path, spec: HandSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(self: Viewer) -> None:
        raise RuntimeError("the writer has ended")

    monkeypatch.setattr(Viewer, "flush", fail)
    path = tmp_path / "a.rrd"
    said = pytest.raises(RecordingError, match=rf"^cannot write {re.escape(str(path))}: the writer has ended; is the")
    with said, Viewer(spec, scenery(spec, {})).recorded(path) as viewer:
        viewer.draw(sample(0), look())
    assert list(tmp_path.iterdir()) == []
