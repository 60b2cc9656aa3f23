"""Recordings as ROS bags, and bags as recordings: exported ones unchanged, others from their joint_states."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from allegro_twin.errors import ConfigError, RecordingError
from allegro_twin.files.atomic_write import atomic_file, atomic_folder
from allegro_twin.recording.arrow_writer import FORMAT, VERSION
from allegro_twin.recording.exchange.episodes import rebuild_recording
from allegro_twin.recording.messages import message_types as v
from allegro_twin.recording.messages.bag_topics import COLUMN, META, BagMessage, BagTopic, bag_messages, bag_topics
from allegro_twin.recording.messages.build import joint_order, joint_values
from allegro_twin.recording.messages.message_types import RosTypes, ros_types
from allegro_twin.recording.reader import Recording
from allegro_twin.recording.spec_json import spec_to_json
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array

SUFFIXES = (".mcap", ".db3", ".bag")
_OFF = 0.2  # Share of the period: further off, the config's period is not the bag's.


class _JointStates(NamedTuple):
    """The joint_states of a bag."""

    topic: str
    times: list[float]
    """s."""
    messages: list[Any]


def is_bag(path: Path) -> bool:
    """Whether a path is a bag: an .mcap, .db3 or ROS 1 .bag file, or a folder of rosbag2."""
    return path.suffix in SUFFIXES or (path / "metadata.yaml").is_file()


def from_bag(path: Path, spec: HandSpec | None, period: float) -> Recording:
    """Read a recording from a bag. A bag that was exported from a recording gives that recording again. From any other
    bag, of ROS 1 or 2, the sensor_msgs/JointState of the joints of `spec` is taken, about every `period` s. Raises
    RecordingError for a file that is no bag, ConfigError for a bag of another hand."""
    if not path.exists():
        raise RecordingError(f"no bag at {path}")
    with open_bag(path) as reader:
        if any(each.topic == META for each in reader.connections):
            return _exported(path, reader)
        if spec is None:
            raise ConfigError(f"{path} does not say whose it is; name a config of that hand with --config")
        return _foreign(path, reader, spec, period)


@contextmanager
def open_bag(path: Path) -> Iterator[Any]:
    """A reader of rosbags, while the block lasts. Raises RecordingError for a file that is no bag."""
    words = v.ros_types()
    from rosbags.highlevel import AnyReader, AnyReaderError
    from rosbags.rosbag2 import ReaderError

    try:
        with AnyReader([path], default_typestore=words.store) as reader:
            yield reader
    except (AnyReaderError, ReaderError, AssertionError, EOFError, OSError, ValueError) as error:
        if isinstance(error, (ConfigError, RecordingError)):
            raise
        text = " ".join(str(error).split()) or type(error).__name__
        raise RecordingError(f"{path}: not a readable bag: {text}") from error


def _exported(path: Path, reader: Any) -> Recording:
    meta: dict[str, Any] = {}
    found: dict[str, list[Array]] = {}
    wanted = [each for each in reader.connections if each.topic == META or each.topic.startswith(COLUMN)]
    for connection, _, data in reader.messages(connections=wanted):
        message = reader.deserialize(data, connection.msgtype)
        if connection.topic == META:
            meta = json.loads(message.data)
        else:
            found.setdefault(connection.topic.removeprefix(COLUMN), []).append(np.array(message.data))
    if meta.get("format") != FORMAT or "t" not in found:
        raise RecordingError(f"{path} has no whole recording under {META}")
    columns: dict[str, Array] = {}
    for name, numbers in found.items():
        values = np.array(numbers)
        columns[name] = values[:, 0] if name in ("t", "tick") else values
    columns["tick"] = columns["tick"].astype(np.int64)
    return rebuild_recording(path, meta, columns)


def _foreign(path: Path, reader: Any, spec: HandSpec, period: float) -> Recording:
    heard = _joint_states(path, reader, spec)
    what = f"{path}: {heard.topic}"
    order = joint_order(spec, heard.messages[0].name, what)
    positions = np.array([joint_values(spec, each.position, order, f"{what} position") for each in heard.messages])
    unknown = np.full(spec.n_joints, np.nan)
    speeds = np.array(
        [np.asarray(each.velocity)[order] if len(each.velocity) == len(order) else unknown for each in heard.messages]
    )
    times = np.array(heard.times) - heard.times[0]
    if (step := float(np.median(np.diff(times)))) < (1 - _OFF) * period or step > (1 + _OFF) * period:
        text = f"{round(step, 4):g}"
        raise ConfigError(f"{what} comes every {text} s; the config says {period:g} s: set `period: {text}`")
    ticks = np.round(times / period).astype(np.int64)
    kept = np.concatenate([[True], np.diff(np.maximum.accumulate(ticks)) > 0])
    blank, count = np.full((int(kept.sum()), spec.n_joints), np.nan), int(kept.sum())
    columns: dict[str, Array] = {
        "t": times[kept],
        "tick": ticks[kept],
        "position": positions[kept],
        "velocity": speeds[kept],
        "torque": blank,  # Its effort has no unit: allegro_node.cpp of the manufacturer's package.
        "temperature": blank.copy(),
        "gravity": np.full((count, 3), np.nan),
        "command_torque": np.zeros((count, spec.n_joints)),  # Not known; a command cannot be NaN.
    }
    meta = {"format": FORMAT, "version": VERSION, "hand": spec_to_json(spec), "period": period,
            "source": f"{heard.topic} in {path.name}"}  # fmt: skip
    return rebuild_recording(path, meta, columns)


def _joint_states(path: Path, reader: Any, spec: HandSpec) -> _JointStates:
    """The joint states of the one topic that belongs to this hand."""
    states = [each for each in reader.connections if each.msgtype == v.JOINT_STATE]
    reasons = []
    for connection in sorted(states, key=lambda each: (not each.topic.endswith("joint_states"), each.topic)):
        times, messages = [], []
        for _, at, data in reader.messages(connections=[connection]):
            message = reader.deserialize(data, connection.msgtype)
            stamp = v.nanoseconds(message.header.stamp)
            times.append((stamp or at) / 1e9)
            messages.append(message)
        if len(messages) < 2:
            reasons.append(f"{connection.topic} has {len(messages)} messages")
            continue
        try:
            joint_order(spec, messages[0].name, connection.topic)
            joint_values(spec, messages[0].position, list(range(len(messages[0].position))), connection.topic)
        except ConfigError as error:
            reasons.append(str(error))
            continue
        return _JointStates(connection.topic, times, messages)
    there = "; ".join(reasons) or f"it has no {v.JOINT_STATE}"
    raise ConfigError(f"{path} is not of the hand {spec.name}: {there}")


def to_mcap(recording: Recording, path: Path) -> None:
    """Write one file, which Foxglove, PlotJuggler and `ros2 bag` open. Raises RecordingError."""
    with atomic_file(path) as temporary, tempfile.TemporaryDirectory(dir=path.parent) as folder:
        bag = Path(folder) / "bag"
        _write(recording, bag, mcap=True)
        shutil.move(next(bag.glob("*.mcap")), temporary)


def to_rosbag2(recording: Recording, folder: Path) -> None:
    """Write a folder with metadata.yaml and SQLite, which every distribution reads without further packages. Raises
    ConfigError for a folder with content, and RecordingError."""
    with atomic_folder(folder) as temporary:
        inner = temporary / "bag"
        _write(recording, inner, mcap=False)
        for file in inner.iterdir():
            shutil.move(file, temporary / file.name)
        inner.rmdir()


def messages_to_mcap(path: Path, topics: Sequence[BagTopic], messages: Iterable[BagMessage]) -> None:
    """Write messages of our own into one file. Raises RecordingError."""
    with atomic_file(path) as temporary, tempfile.TemporaryDirectory(dir=path.parent) as folder:
        bag = Path(folder) / "bag"
        _write_messages(bag, topics, messages, mcap=True)
        shutil.move(next(bag.glob("*.mcap")), temporary)


def _write(recording: Recording, folder: Path, *, mcap: bool) -> None:
    messages = bag_messages(ros_types(), recording.spec, recording.meta, recording.columns)
    _write_messages(folder, bag_topics(recording.columns), messages, mcap=mcap)


def _write_messages(folder: Path, topics: Sequence[BagTopic], messages: Iterable[BagMessage], *, mcap: bool) -> None:
    words = ros_types()
    from rosbags.rosbag2 import StoragePlugin, Writer, WriterError

    plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
    try:
        with Writer(folder, version=8, storage_plugin=plugin) as writer:
            opened = {topic.name: _connection(writer, words, topic) for topic in topics}
            for name, at, message in messages:
                writer.write(opened[name], at, words.encode(message))
    except (OSError, WriterError) as error:
        raise RecordingError(f"cannot write the bag {folder.parent}: {error}") from error


def _connection(writer: object, words: RosTypes, topic: BagTopic) -> object:
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    never = QosTime(0, 0)
    quality = Qos(
        QosHistory.KEEP_LAST, 1 if topic.latched else 10, QosReliability.RELIABLE,
        QosDurability.TRANSIENT_LOCAL if topic.latched else QosDurability.VOLATILE,
        never, never, QosLiveliness.AUTOMATIC, never, False,
    )  # fmt: skip
    connection: object = writer.add_connection(  # type: ignore[attr-defined]  # rosbags is not typed here.
        topic.name,
        topic.kind,
        msgdef=words.definition(topic.kind),
        rihs01=words.hash(topic.kind),
        offered_qos_profiles=[quality],
    )
    return connection
