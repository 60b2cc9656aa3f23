"""A recording becomes a bag that others read, and a bag a recording."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="needs the extra ros2")

from allegro_twin.app.config import load_config
from allegro_twin.errors import ConfigError, RecordingError
from allegro_twin.recording.exchange.rosbag import from_bag, header_stamp, is_bag, open_bag, to_mcap, to_rosbag2
from allegro_twin.recording.messages import message_types as v
from allegro_twin.recording.messages.bag_topics import NAMESPACE, STATES, bag_topics
from allegro_twin.recording.messages.build import joint_states
from allegro_twin.recording.reader import Recording, load
from allegro_twin.spec import HandSpec
from allegro_twin.types import HandState, frozen
from tests.full_disk import full_disk
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


@pytest.mark.parametrize(("name", "part"), [("b?x", "?"), ("b#y", "#"), ("b%4a", "%4a")])
def test_a_rosbag2_is_refused_where_sqlite_takes_its_path_for_another(
    name: str, part: str, recording: Recording, tmp_path: Path
) -> None:
    said = f"{re.escape(name)}: SQLite takes {re.escape(part)} in a path for part of a URI: write .* elsewhere"
    with pytest.raises(ConfigError, match=said):
        to_rosbag2(recording, tmp_path / "folder" / name)
    assert not (tmp_path / "folder").exists()


def test_a_rosbag2_in_a_folder_with_a_percent_sign_comes_back(recording: Recording, tmp_path: Path) -> None:
    for name in ("100% grip", "50%"):
        to_rosbag2(recording, tmp_path / name / name)
        assert len(from_bag(tmp_path / name / name, None, recording.period)) == len(recording)


@pytest.mark.parametrize("write", [to_mcap, to_rosbag2])
def test_a_column_of_text_is_no_part_of_a_bag_and_is_named(write: Write, recording: Recording, tmp_path: Path) -> None:
    noted = replace(recording, columns={**recording.columns, "note": np.array(["a"] * len(recording), object)})
    with pytest.raises(ConfigError, match="column note has no numbers, and a bag takes nothing else"):
        write(noted, tmp_path / "folder" / "bag.mcap")
    assert not (tmp_path / "folder").exists() or not list((tmp_path / "folder").iterdir())


def test_a_truth_value_that_is_null_is_a_nan_in_a_bag(recording: Recording, tmp_path: Path) -> None:
    flags = np.array([True, None, *[False] * (len(recording) - 2)], object)
    to_mcap(replace(recording, columns={**recording.columns, "flag": flags}), tmp_path / "bag.mcap")
    back = from_bag(tmp_path / "bag.mcap", None, recording.period).columns["flag"]
    np.testing.assert_array_equal(back[:3, 0], [1.0, np.nan, 0.0])


@pytest.mark.parametrize("write", [to_mcap, to_rosbag2])
def test_a_full_disk_names_the_bag_that_was_asked_for(write: Write, recording: Recording, tmp_path: Path) -> None:
    target = tmp_path / "folder" / "bag.mcap"
    for size in (2000, 20_000):
        with full_disk(size), pytest.raises(RecordingError, match=f"^cannot write {target}: "):
            write(recording, target)
        assert not list(target.parent.iterdir())


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


def said_at(spec: HandSpec, count: int = 200, *, begin: int = 10**18) -> list[tuple[str, int, Any]]:
    """Joints that move, a message each 3 ms, with stamps from `begin`, ns, on."""
    words, found = v.ros_types(), []
    for k in range(count):
        position = 0.3 + 0.2 * np.sin(k / 30 + np.arange(spec.n_joints))
        still = frozen(np.zeros(spec.n_joints))
        state = HandState(0.003 * k, k, frozen(position), frozen(-position), still, still, frozen(np.zeros(3)))
        at = begin + 3_000_000 * k
        found.append(("/joint_states", 10**18 + 3_000_000 * k, joint_states(words, at, [(spec, state)])))
    return found


def renamed(messages: list[tuple[str, int, Any]], topic: str) -> list[tuple[str, int, Any]]:
    return [(topic, at, message) for _, at, message in messages]


def test_each_message_of_a_bag_is_read_by_its_own_names(spec: HandSpec, tmp_path: Path) -> None:
    straight = from_bag(bag_of(tmp_path / "straight", said_at(spec)), spec, 0.003)
    said, order = said_at(spec), np.random.default_rng(0).permutation(spec.n_joints)
    for _, _, message in said[100:]:
        message.name = [message.name[k] for k in order]
        message.position, message.velocity = message.position[order], message.velocity[order]
    turned = from_bag(bag_of(tmp_path / "turned", said), spec, 0.003)
    for name, values in straight.columns.items():
        np.testing.assert_array_equal(turned.columns[name], values)


@pytest.mark.parametrize("together", [True, False])
def test_joints_of_an_arm_in_the_same_topic_are_no_part_of_the_hands(
    spec: HandSpec, tmp_path: Path, together: bool
) -> None:
    straight = from_bag(bag_of(tmp_path / "straight", said_at(spec)), spec, 0.003)
    arm, said = [f"fer_joint{k}" for k in range(1, 8)], []
    for topic, at, message in said_at(spec):
        parts = message.name, message.position, message.velocity
        if not together:
            words = v.ros_types()
            none = np.zeros(7)
            fields = {"name": arm, "position": none, "velocity": none, "effort": none}
            said.append((topic, at - 10**6, words.make(v.JOINT_STATE, header=message.header, **fields)))
        else:
            message.name = [*arm, *parts[0]]
            message.position, message.velocity = (np.concatenate([np.zeros(7), part]) for part in parts[1:])
        said.append((topic, at, message))
    found = from_bag(bag_of(tmp_path / "both", said), spec, 0.003)
    for name, values in straight.columns.items():
        np.testing.assert_array_equal(found.columns[name], values)
    others = "200 messages are left out, which have no joint of allegro_right"
    assert found.notes == (() if together else (f"{tmp_path / 'both'}: /joint_states: {others}",))


def test_a_bag_whose_stamps_begin_at_0_is_read_by_its_stamps(spec: HandSpec, tmp_path: Path) -> None:
    found = from_bag(bag_of(tmp_path / "simulated", said_at(spec, begin=0)), spec, 0.003)
    np.testing.assert_array_equal(found.columns["tick"], np.arange(200))
    assert found.notes == ()


def test_a_bag_without_stamps_is_read_by_when_it_was_recorded_and_says_so(spec: HandSpec, tmp_path: Path) -> None:
    said = said_at(spec, begin=0)
    for _, _, message in said:
        message.header.stamp.sec = message.header.stamp.nanosec = 0
    found = from_bag(bag_of(tmp_path / "unstamped", said), spec, 0.003)
    np.testing.assert_array_equal(found.columns["tick"], np.arange(200))
    (note,) = found.notes
    assert note.endswith("messages have no stamps: their times are when they were recorded")


@pytest.mark.parametrize("place", [0, 100, 199])
@pytest.mark.parametrize("second", [0, 10**9 + 1000])
def test_a_stamp_of_another_clock_costs_one_row_and_is_told(
    spec: HandSpec, tmp_path: Path, place: int, second: int
) -> None:
    said = said_at(spec)
    said[place][2].header.stamp.sec = second
    found = from_bag(bag_of(tmp_path / "jump", said), spec, 0.003)
    np.testing.assert_array_equal(
        found.columns["position"], [m.position for _, _, m in said[:place] + said[place + 1 :]]
    )
    assert found.columns["t"][-1] < 0.6
    (note,) = found.notes
    assert note.endswith(f"1 of 200 messages are left out: their times go back, or jump, first that of {place + 1}")


@pytest.mark.parametrize("ros1", [False, True])
def test_a_stamp_is_read_without_decoding_its_message(spec: HandSpec, tmp_path: Path, ros1: bool) -> None:
    said = said_at(spec, begin=10**18 + 123_456_789)
    with open_bag(bag_of(tmp_path / ("r.bag" if ros1 else "r"), said, ros1=ros1)) as reader:
        found = [header_stamp(reader, data) for _, _, data in reader.messages()]
    assert found == [v.nanoseconds(message.header.stamp) for _, _, message in said]


def test_messages_that_come_twice_are_read_once_and_counted(spec: HandSpec, tmp_path: Path) -> None:
    said = [each for topic, at, m in said_at(spec) for each in ((topic, at, m), (topic, at + 1, m))]
    found = from_bag(bag_of(tmp_path / "twice", said), spec, 0.003)
    assert len(found) == 200
    (note,) = found.notes
    assert "200 of 400 messages are left out: their times repeat that of another, first that of 2" in note
    for _, _, message in said:
        message.header.stamp.sec = message.header.stamp.nanosec = 0
    with pytest.raises(ConfigError, match=r"comes every 1e-09 s; .*: record the topic once, with stamps"):
        from_bag(bag_of(tmp_path / "unstamped", said), spec, 0.003)


def test_messages_of_one_period_are_one_row_and_counted(spec: HandSpec, tmp_path: Path) -> None:
    said = said_at(spec)
    for k, (_, _, message) in enumerate(said):
        message.header.stamp.nanosec = 2_700_000 * k
    found = from_bag(bag_of(tmp_path / "faster", said), spec, 0.003)
    (note,) = found.notes
    assert f"{200 - len(found)} of 200 messages are left out, in the period of the one before" in note
    assert len(found) < 185


def test_a_topic_that_may_be_a_command_is_read_only_where_it_is_named(
    command: Run, spec: HandSpec, tmp_path: Path
) -> None:
    path = bag_of(tmp_path / "told", renamed(said_at(spec), "/allegroHand_0/joint_cmd"))
    target = tmp_path / "told.arrow"
    code, _, error = command("export", path, target, "--config", "can_v4_right")
    assert code == 2
    assert "has joints of allegro_right on /allegroHand_0/joint_cmd, and not on joint_states" in " ".join(error.split())
    assert not target.exists()
    code, shown, _ = command("export", path, target, "--config", "can_v4_right", "--topic", "/allegroHand_0/joint_cmd")
    assert (code, shown) == (0, f"{target}: 200 rows of /allegroHand_0/joint_cmd in told\n")
    code, _, error = command("export", path, target, "--config", "can_v4_right", "--topic", "/joint_states")
    assert code == 2
    assert "has no sensor_msgs/msg/JointState on /joint_states; it has /allegro" in " ".join(error.split())


def test_the_measured_topic_is_read_beside_a_command_and_both_are_named(
    command: Run, spec: HandSpec, tmp_path: Path
) -> None:
    path = bag_of(tmp_path / "both", renamed(said_at(spec), "/a/joint_cmd") + renamed(said_at(spec), "/z/joint_states"))
    code, shown, error = command("export", path, tmp_path / "b.arrow", "--config", "can_v4_right")
    assert (code, shown) == (0, f"{tmp_path / 'b.arrow'}: 200 rows of /z/joint_states in both\n")
    assert "/z/joint_states is read; positions of the same joints are on /a/joint_cmd, too" in " ".join(error.split())


def test_two_measured_topics_are_refused_with_their_names_until_one_is_chosen(spec: HandSpec, tmp_path: Path) -> None:
    from allegro_twin.app import assemble

    topics = ("/allegroHand_0/joint_states", "/allegroHand_1/joint_states")
    path = bag_of(tmp_path / "two", [each for topic in topics for each in renamed(said_at(spec), topic)])
    with pytest.raises(ConfigError, match=rf"on {', '.join(topics)}: choose one by `topic`"):
        from_bag(path, spec, 0.003)
    assert from_bag(path, spec, 0.003, topics[1]).meta["source"] == f"{topics[1]} in two"
    config = tmp_path / "replay.yaml"
    replay = f"{{kind: replay, file: {path}, topic: {topics[1]}}}"
    config.write_text(f"backend: {replay}\ntask: {{posture: home}}\ncontroller: {{kind: pd, compensate: false}}\n")
    assemble(load_config(config))
    config.write_text(config.read_text().replace(str(path), "r.arrow"))
    with pytest.raises(ConfigError, match=r"`topic` is for a bag; r\.arrow is none"):
        assemble(load_config(config))


def test_a_replayed_bag_says_what_of_it_is_left_out(spec: HandSpec, tmp_path: Path) -> None:
    from allegro_twin.app import assemble

    said = said_at(spec)
    said[100][2].header.stamp.sec = 0
    config = tmp_path / "replay.yaml"
    config.write_text(
        f"backend: {{kind: replay, file: {bag_of(tmp_path / 'jump', said)}}}\ntask: {{posture: home}}\n"
        "controller: {kind: pd, compensate: false}\n"
    )
    (note,) = assemble(load_config(config)).device.warnings()
    assert "1 of 200 messages are left out" in note


@pytest.mark.parametrize("value", [np.inf, -np.inf, np.nan])
def test_a_speed_that_is_not_finite_is_unknown_in_a_bag_and_told(spec: HandSpec, value: float, tmp_path: Path) -> None:
    said = said_at(spec)
    for _, _, message in said[50:52]:
        message.velocity = np.array(message.velocity)
        message.velocity[3] = value
    read = from_bag(bag_of(tmp_path / "infinite", said), spec, 0.003)
    np.testing.assert_array_equal(np.argwhere(~np.isfinite(read.columns["velocity"])), [[50, 3], [51, 3]])
    assert np.isnan(read.columns["velocity"][50, 3])
    (note,) = read.notes
    assert note.endswith("/joint_states: 2 messages have speeds that are infinite or NaN, which are read as unknown")


def test_a_bag_in_degrees_or_with_too_few_speeds_is_refused(spec: HandSpec, tmp_path: Path) -> None:
    said = said_at(spec)
    for _, _, message in said:
        message.position = np.degrees(message.position)
    with pytest.raises(RecordingError, match=r"/joint_states: positions go to .* in degrees: divide them by 57\.2958"):
        from_bag(bag_of(tmp_path / "degrees", said), spec, 0.003)
    said = said_at(spec)
    said[50][2].velocity = np.zeros(4)
    with pytest.raises(ConfigError, match="velocity has 4 numbers for 16 joints"):
        from_bag(bag_of(tmp_path / "short", said), spec, 0.003)


def test_a_table_is_no_bus_log(command: Run, recording_path: Path, tmp_path: Path) -> None:
    assert command("export", recording_path, tmp_path / "a.csv")[0] == 0
    code, _, error = command("export", tmp_path / "a.csv", tmp_path / "b.arrow")
    assert code == 2
    assert "a.csv: a .csv does not become a recording again; bus logs, bags and data sets do" in " ".join(error.split())


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
