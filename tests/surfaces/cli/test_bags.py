"""A recording becomes a bag that others read, and a bag a recording."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="needs the extra ros2")

from allegro_twin.app.config import load_config
from allegro_twin.errors import ConfigError, RecordingError
from allegro_twin.recording.exchange.rosbag import from_bag, is_bag, to_mcap, to_rosbag2
from allegro_twin.recording.messages import message_types as v
from allegro_twin.recording.messages.bag_topics import NAMESPACE, STATES, bag_topics
from allegro_twin.recording.messages.build import joint_states
from allegro_twin.recording.reader import Recording, load
from allegro_twin.spec import HandSpec
from allegro_twin.types import HandState, frozen
from tests.surfaces.cli.conftest import Run

Write = Callable[[Recording, Path], None]


@pytest.fixture
def recording(recording_path: Path) -> Recording:
    return load(recording_path)


def bag_of(path: Path, messages: list[tuple[str, int, Any]], *, ros1: bool = False) -> Path:
    """A bag as somebody else's node writes it."""
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    words = v.ros_types()
    if ros1:
        store: Any = get_typestore(Stores.ROS1_NOETIC)
        with Writer1(path) as first:
            opened: dict[str, Any] = {}
            for topic, at, message in messages:
                if topic not in opened:
                    opened[topic] = first.add_connection(topic, message.__msgtype__, typestore=store)
                header = store.types["std_msgs/msg/Header"](
                    seq=0, stamp=store.types["builtin_interfaces/msg/Time"](
                        sec=message.header.stamp.sec, nanosec=message.header.stamp.nanosec), frame_id="")  # fmt: skip
                old = store.types[v.JOINT_STATE](header, message.name, message.position, message.velocity,
                                                 message.effort)  # fmt: skip
                first.write(opened[topic], at, store.serialize_ros1(old, v.JOINT_STATE))
        return path
    with Writer(path, version=8, storage_plugin=StoragePlugin.MCAP) as writer:
        opened = {}
        for topic, at, message in messages:
            if topic not in opened:
                opened[topic] = writer.add_connection(topic, message.__msgtype__, typestore=words.store)
            writer.write(opened[topic], at, words.encode(message))
    return path


def states(spec: HandSpec, count: int = 200, step: float = 0.003) -> list[tuple[str, int, Any]]:
    """What the manufacturer's driver says: joints by name, speeds, and effort in its own unit."""
    words, found = v.ros_types(), []
    rng = np.random.default_rng(0)
    for k in range(count):
        at = 10**18 + round((k * step + float(rng.uniform(0, 0.0005))) * 1e9)
        position = frozen(np.clip(np.full(spec.n_joints, 0.3 + 0.1 * np.sin(k / 30)), spec.lower, spec.upper))
        still = frozen(np.zeros(spec.n_joints))
        state = HandState(k * step, k, position, still, still, still, frozen(np.zeros(3)))
        found.append(("/allegroHand_0/joint_states", at, joint_states(words, at, [(spec, state)])))
    return found


@pytest.mark.parametrize(("write", "name"), [(to_mcap, "rec.mcap"), (to_rosbag2, "rec")])
def test_a_recording_comes_back_from_a_bag_bit_for_bit(
    recording: Recording, tmp_path: Path, write: Write, name: str
) -> None:
    write(recording, tmp_path / name)
    assert is_bag(tmp_path / name)
    back = from_bag(tmp_path / name, None, 0.003)
    assert dict(back.meta) == dict(recording.meta)
    assert back.columns.keys() == recording.columns.keys()
    for column, values in recording.columns.items():
        np.testing.assert_array_equal(back.columns[column], values)
        assert back.columns[column].dtype == values.dtype


def test_mcap_ros2_support_reads_the_file_and_its_types(recording: Recording, tmp_path: Path) -> None:
    reader = pytest.importorskip("mcap_ros2.reader", reason="needs mcap-ros2-support")
    to_mcap(recording, tmp_path / "rec.mcap")
    counts: dict[str, int] = {}
    for each in reader.read_ros2_messages(str(tmp_path / "rec.mcap")):
        counts[each.channel.topic] = counts.get(each.channel.topic, 0) + 1
        if each.channel.topic == STATES and counts[STATES] == 100:
            np.testing.assert_array_equal(each.ros_msg.position, recording.columns["position"][99])
            assert each.ros_msg.name == list(recording.spec.joints)
            assert abs(each.log_time_ns - round(recording.columns["t"][99] * 1e9)) <= 1
    rows = len(recording)
    assert counts[STATES] == counts["/tf"] == rows
    assert counts["/tf_static"] == counts[f"{NAMESPACE}/robot_description"] == 1


def test_no_topic_of_a_bag_is_one_that_a_hand_obeys(recording: Recording, tmp_path: Path) -> None:
    """`ros2 bag play` beside a real hand must not move it."""
    from rosbags.highlevel import AnyReader

    obeyed = {"joint_cmd", "lib_cmd", "envelop_torque", "joint_trajectory", "gravity", "torque_cmd"}
    to_mcap(recording, tmp_path / "rec.mcap")
    with AnyReader([tmp_path / "rec.mcap"]) as reader:
        heard = {each.topic for each in reader.connections if not each.topic.startswith(f"{NAMESPACE}/recording/")}
    assert not {topic.split("/")[-1] for topic in heard} & obeyed


@pytest.mark.parametrize("ros1", [False, True])
def test_a_bag_of_the_manufacturers_driver_becomes_a_recording(spec: HandSpec, tmp_path: Path, ros1: bool) -> None:
    said = states(spec)
    path = bag_of(tmp_path / ("theirs.bag" if ros1 else "theirs"), said, ros1=ros1)
    found = from_bag(path, spec, 0.003)
    assert found.spec.name == spec.name
    assert len(found) >= 195  # Two messages that are nearer than half a period are one state.
    np.testing.assert_array_equal(found.columns["position"][0], said[0][2].position)
    assert (np.diff(found.columns["tick"]) >= 1).all()
    assert (np.diff(found.columns["t"]) > 0).all()
    assert np.isnan(found.columns["torque"]).all()  # Its effort has no unit.


def test_a_run_replays_a_bag(spec: HandSpec, tmp_path: Path) -> None:
    from allegro_twin.app import assemble
    from allegro_twin.loop import run, to_the_end

    path = bag_of(tmp_path / "theirs", states(spec))
    config = tmp_path / "replay.yaml"
    config.write_text(
        f"backend: {{kind: replay, file: {path}}}\ntask: {{posture: home}}\n"
        "controller: {kind: pd, gravity: [0, 0, -9.81]}\n"
    )
    rig = assemble(load_config(config))
    assert sum(1 for _ in to_the_end(run(rig.backend, rig.controller))) >= 195


def test_a_bag_of_another_hand_is_refused_in_one_line(spec: HandSpec, tmp_path: Path) -> None:
    said = states(spec)
    for _, _, message in said:
        message.name = [f"ah_joint{k:02d}" for k in range(spec.n_joints)]
    path = bag_of(tmp_path / "another", said)
    with pytest.raises(
        ConfigError, match=r"is not of the hand allegro_right: .*no joint named 'ah_joint00'"
    ) as refused:
        from_bag(path, spec, 0.003)
    assert "\n" not in str(refused.value)


def test_a_bag_of_our_other_hand_is_refused_by_its_config(recording: Recording, tmp_path: Path) -> None:
    from allegro_twin.app import assemble

    to_mcap(recording, tmp_path / "rec.mcap")
    config = tmp_path / "replay.yaml"
    config.write_text(
        f"hand: {{side: left}}\nbackend: {{kind: replay, file: {tmp_path / 'rec.mcap'}}}\n"
        "task: {posture: home}\ncontroller: {kind: pd}\n"
    )
    with pytest.raises(ConfigError, match="is of the hand allegro_right; the config says allegro_left"):
        assemble(load_config(config))


def test_export_goes_both_ways(
    command: Run, recording_path: Path, recording: Recording, tmp_path: Path, spec: HandSpec
) -> None:
    bag, folder = tmp_path / "rec.mcap", tmp_path / "bag"
    assert command("export", recording_path, bag)[0] == 0
    assert command("export", recording_path, folder, "--format", "rosbag2")[0] == 0
    for source in (bag, folder):
        target = tmp_path / f"{source.name}.arrow"
        assert command("export", source, target)[0] == 0
        for name, values in load(target).columns.items():
            np.testing.assert_array_equal(values, recording.columns[name])
    theirs = bag_of(tmp_path / "theirs", states(spec))
    code, _, error = command("export", theirs, tmp_path / "theirs.arrow")
    assert (code, "name a config of that hand with --config" in error) == (2, True)
    assert command("export", theirs, tmp_path / "theirs.arrow", "--config", "sim_right")[0] == 0
    code, _, error = command("export", bag, tmp_path / "x.csv")
    assert (code, "a bag becomes a recording, which ends in .arrow" in error) == (2, True)
    code, _, error = command("export", recording_path, recording_path, tmp_path / "two", "--format", "rosbag2")
    assert (code, "2 recordings are as many bags" in error) == (2, True)
    assert command("export", recording_path, folder, "--format", "rosbag2")[0] == 2  # It is not empty.


@pytest.mark.parametrize("target", ["hand.json", "hand.xml"])
def test_layouts_name_only_what_a_bag_of_that_hand_has(
    command: Run, recording: Recording, tmp_path: Path, target: str
) -> None:
    assert command("layout", tmp_path / target)[0] == 0
    text = (tmp_path / target).read_text()
    topics = {topic.name for topic in bag_topics(recording.columns)}
    if target.endswith(".json"):
        panels = json.loads(text)["configById"]
        paths = [each["value"] for panel in panels.values() for each in panel.get("paths", [])]
        assert len(paths) == 3 * recording.spec.n_joints
        assert {path.split(".")[0] for path in paths} <= topics
        assert panels["3D!hand"]["topics"].keys() <= topics
        assert sorted(_ids(json.loads(text)["layout"])) == sorted(panels)
    else:
        curves = [curve.get("name", "") for curve in ElementTree.fromstring(text).iter("curve")]
        assert len(curves) == 3 * recording.spec.n_joints
        assert all(curve.startswith(f"{STATES}/") for curve in curves)
        assert {curve.split("/")[3] for curve in curves} == set(recording.spec.joints)
    assert command("layout", tmp_path / "hand.txt")[0] == 2


def _ids(layout: Any) -> list[str]:
    return [layout] if isinstance(layout, str) else [*_ids(layout["first"]), *_ids(layout["second"])]


def test_bags_that_cannot_be_used_say_why(spec: HandSpec, tmp_path: Path) -> None:
    slow = bag_of(tmp_path / "slow", states(spec, step=0.01))
    with pytest.raises(ConfigError, match=r"comes every 0.01 s; the config says 0.003 s: set `period: 0.01`"):
        from_bag(slow, spec, 0.003)
    with pytest.raises(ConfigError, match="does not say whose it is; name a config of that hand with --config"):
        from_bag(slow, None, 0.003)
    broken = states(spec)
    broken[50][2].position[3] = np.nan
    with pytest.raises(ConfigError, match=r"joint_states position for joint_3.0 is nan"):
        from_bag(bag_of(tmp_path / "nan", broken), spec, 0.003)
    short = tmp_path / "cut.mcap"
    short.write_bytes(b"\x89MCAP0\r\n123")
    with pytest.raises(RecordingError, match="cut.mcap: not a readable bag") as refused:
        from_bag(short, spec, 0.003)
    assert "\n" not in str(refused.value)
    with pytest.raises(RecordingError, match="no bag at"):
        from_bag(tmp_path / "nothing.mcap", spec, 0.003)
