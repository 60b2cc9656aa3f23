"""Recordings as ROS bags, and bags as recordings: exported ones unchanged, others from their joint_states."""

from __future__ import annotations

import json
import re
import shutil
import sqlite3
import struct
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from allegro_twin.errors import ConfigError, RecordingError, unknown
from allegro_twin.files.atomic_write import atomic_file, atomic_folder
from allegro_twin.recording.arrow_writer import FORMAT, VERSION
from allegro_twin.recording.exchange.bag_times import bag_times
from allegro_twin.recording.exchange.episodes import check_numbers, rebuild_recording
from allegro_twin.recording.messages import message_types as v
from allegro_twin.recording.messages.bag_topics import COLUMN, META, BagMessage, BagTopic, bag_messages, bag_topics
from allegro_twin.recording.messages.build import joint_index, joint_order
from allegro_twin.recording.messages.message_types import RosTypes, ros_types
from allegro_twin.recording.reader import Recording
from allegro_twin.recording.spec_json import spec_to_json
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector

SUFFIXES = (".mcap", ".db3", ".bag")
MEASURED = "joint_states"
"""Last name of a topic on which joints are measured, by the convention of ROS; on others they may be commands."""
_URI = re.compile(r"[?#]|%[0-9a-fA-F]{2}")
"""Parts of a path that rosbags gives to SQLite as they are, which takes them for those of a URI."""
_FASTEST = 1e-4  # s; messages that come faster come twice.
_OFF = 0.2  # Share of the period: further off, the config's period is not the bag's.


class _JointStates(NamedTuple):
    """The messages of a topic with the joints of a hand, in the order of the bag."""

    stamps: list[int]
    """ns."""
    recorded: list[int]
    """ns, by the recorder's clock."""
    position: list[Vector]
    """(n,), rad."""
    velocity: list[Vector]
    """(n,), rad/s; NaN: none given, or none that is finite."""
    others: int
    """Messages with no joint of the hand."""
    no_speed: int
    """Messages with speeds of which some are not finite."""


def is_bag(path: Path) -> bool:
    """Whether a path is a bag: an .mcap, .db3 or ROS 1 .bag file, or a folder of rosbag2."""
    return path.suffix in SUFFIXES or (path / "metadata.yaml").is_file()


def from_bag(path: Path, spec: HandSpec | None, period: float, topic: str | None = None) -> Recording:
    """Read a recording from a bag. A bag that was exported from a recording gives that recording again. From any other
    bag, of ROS 1 or 2, the sensor_msgs/JointState of the joints of `spec` on `topic` is taken, each message by its own
    names, about every `period` s; None: on the only topic with such joints that is called `joint_states`. Speeds that
    are not finite are unknown, NaN. The recording's `notes` say what is left out. Raises RecordingError for a file that
    is no bag, and for rows that no reader takes, ConfigError for a bag of another hand or with several such topics."""
    if not path.exists():
        raise RecordingError(f"no bag at {path}")
    with open_bag(path) as reader:
        if any(each.topic == META for each in reader.connections):
            if topic is not None:
                raise ConfigError(f"{path} was exported from a recording, which is read whole: leave out `topic`")
            return _exported(path, reader)
        if spec is None:
            raise ConfigError(f"{path} does not say whose it is; name a config of that hand with --config")
        return _foreign(path, reader, spec, period, topic)


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


def header_stamp(reader: Any, data: bytes) -> int:
    """The stamp, ns, of a message that begins with a header, without decoding it: it follows four bytes, in ROS 2 of
    encapsulation, in ROS 1 of `seq`. Raises ValueError for a message that is cut."""
    if len(data) < 12:
        raise ValueError(f"a message of {len(data)} bytes has no header")
    second, part = struct.unpack_from("<iI" if not reader.is2 or data[1] & 1 else ">iI", data, 4)
    return int(second) * 10**9 + int(part)


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
    return rebuild_recording(path, meta, columns, str(path))


def _foreign(path: Path, reader: Any, spec: HandSpec, period: float, topic: str | None) -> Recording:
    topic, others = _topic(path, reader, spec, topic)
    what = f"{path}: {topic}"
    heard = _joint_states(reader, topic, spec, what)
    clock = bag_times(heard.stamps, heard.recorded)
    notes = [f"{what}: {line}" for line in clock.left_out("messages")]
    if heard.others:
        notes.append(f"{what}: {heard.others} messages are left out, which have no joint of {spec.name}")
    if heard.no_speed:
        notes.append(
            f"{what}: {heard.no_speed} messages have speeds that are infinite or NaN, which are read as unknown"
        )
    if others:
        notes.append(f"{what} is read; positions of the same joints are on {', '.join(others)}, too")
    times = (clock.times[clock.kept] - clock.times[clock.kept][:1]) / 1e9
    if len(times) < 2:
        raise ConfigError("; ".join([f"{what} has {len(times)} messages in order: a recording needs 2", *notes]))
    if (step := float(np.median(np.diff(times)))) < (1 - _OFF) * period or step > (1 + _OFF) * period:
        text = f"{round(step, 4) or step:g}"
        way = f"set `period: {text}`" if step > _FASTEST else "record the topic once, with stamps"
        raise ConfigError(f"{what} comes every {text} s; the config says {period:g} s: {way}")
    ticks = np.round(times / period).astype(np.int64)
    apart = np.diff(ticks, prepend=-1) > 0
    if not apart.all():
        notes.append(f"{what}: {(~apart).sum()} of {len(apart)} messages are left out, in the period of the one before")
    rows = np.flatnonzero(clock.kept)[apart]
    blank = np.full((len(rows), spec.n_joints), np.nan)
    columns: dict[str, NDArray[Any]] = {
        "t": times[apart],
        "tick": ticks[apart],
        "position": np.array(heard.position)[rows],
        "velocity": np.array(heard.velocity)[rows],
        "torque": blank,  # Its effort has no unit: allegro_node.cpp of the manufacturer's package.
        "temperature": blank.copy(),
        "gravity": np.full((len(rows), 3), np.nan),
        "command_torque": np.zeros((len(rows), spec.n_joints)),  # Not known; a command cannot be NaN.
    }
    meta = {"format": FORMAT, "version": VERSION, "hand": spec_to_json(spec), "period": period,
            "source": f"{topic} in {path.name}"}  # fmt: skip
    return replace(rebuild_recording(path, meta, columns, what), notes=tuple(notes))


def _topic(path: Path, reader: Any, spec: HandSpec, topic: str | None) -> tuple[str, list[str]]:
    """The topic to read, and those that have the same joints, but not the name of a measurement."""
    there = sorted({each.topic for each in reader.connections if each.msgtype == v.JOINT_STATE})
    if topic is not None and topic not in there:
        raise ConfigError(f"{path} has no {v.JOINT_STATE} on {topic}; it has {', '.join(there) or 'none'}")
    reasons = {each: _unfit(reader, each, spec) for each in (there if topic is None else [topic])}
    fit = [each for each, reason in reasons.items() if not reason]
    if not fit:
        said = "; ".join(reasons.values()) or f"it has no {v.JOINT_STATE}"
        raise ConfigError(f"{path} is not of the hand {spec.name}: {said}")
    if topic is not None:
        return topic, []
    measured = [each for each in fit if each.rsplit("/", 1)[-1] == MEASURED]
    way = "choose one by `topic` of the config, or with `export --topic`"
    if len(measured) > 1:
        raise ConfigError(f"{path} has joints of {spec.name} on {', '.join(measured)}: {way}")
    if not measured:
        raise ConfigError(
            f"{path} has joints of {spec.name} on {', '.join(fit)}, and not on {MEASURED}: they may be commands; {way}"
        )
    return measured[0], [each for each in fit if each != measured[0]]


def _messages(reader: Any, topic: str) -> Iterator[tuple[int, Any]]:
    """The joint states of a topic, and when they were recorded, ns."""
    wanted = [each for each in reader.connections if (each.topic, each.msgtype) == (topic, v.JOINT_STATE)]
    for connection, at, data in reader.messages(connections=wanted):
        yield at, reader.deserialize(data, connection.msgtype)


def _unfit(reader: Any, topic: str, spec: HandSpec) -> str:
    """Why no message of a topic has a position of every joint of the hand; empty where one has."""
    reason = f"{topic} has no messages"
    for _, message in _messages(reader, topic):
        names, count = list(message.name), len(message.position)
        try:
            order = _order(spec, names, topic)
        except ConfigError as error:
            reason = str(error)
            continue
        if order is None:
            reason = f"{topic}: {unknown('joint', names[0], spec.joints)}"
        elif count != (len(names) or spec.n_joints):
            reason = f"{topic} position has {count} numbers for {len(names) or spec.n_joints} joints"
        else:
            return ""
    return reason


def _order(spec: HandSpec, names: Sequence[str], what: str) -> list[int] | None:
    """For each joint of the hand its index in `names`, which may be of other devices, too; None: all of them are.
    Raises ConfigError for a joint that is missing or named twice."""
    own = [place for place, name in enumerate(names) if joint_index(spec, name) is not None]
    if names and not own:
        return None
    order = joint_order(spec, [names[place] for place in own], what)
    return [own[place] for place in order] if names else order


def _joint_states(reader: Any, topic: str, spec: HandSpec, what: str) -> _JointStates:
    """Each message by its own names. Raises ConfigError for one that lacks a joint or a number."""
    heard = _JointStates([], [], [], [], 0, 0)
    orders: dict[tuple[str, ...], list[int] | None] = {}
    blank = np.full(spec.n_joints, np.nan)
    others, no_speed = 0, 0
    for at, message in _messages(reader, topic):
        names = tuple(message.name)
        if names not in orders:
            orders[names] = _order(spec, names, f"{what}, message {len(heard.stamps) + others + 1},")
        order, count = orders[names], len(names) or spec.n_joints
        if order is None:
            others += 1
            continue
        for name in ("position", "velocity"):
            given = len(getattr(message, name))
            if given != count and (given or name == "position"):
                raise ConfigError(f"{what} {name} has {given} numbers for {count} joints")
        heard.stamps.append(v.nanoseconds(message.header.stamp))
        heard.recorded.append(at)
        heard.position.append(spec.vector(np.asarray(message.position, dtype=np.float64)[order], f"{what} position"))
        speeds = np.asarray(message.velocity, dtype=np.float64)
        speeds = speeds[order] if len(speeds) else blank
        known = np.isfinite(speeds)
        no_speed += bool(len(message.velocity)) and not known.all()
        heard.velocity.append(np.where(known, speeds, np.nan))
    return heard._replace(others=others, no_speed=no_speed)


def to_mcap(recording: Recording, path: Path) -> None:
    """Write one file, which Foxglove, PlotJuggler and `ros2 bag` open. Raises ConfigError for a column of something
    else than numbers, and RecordingError."""
    with atomic_file(path) as temporary, tempfile.TemporaryDirectory(dir=path.parent) as folder:
        bag = Path(folder) / "bag"
        _write(recording, bag, mcap=True)
        shutil.move(next(bag.glob("*.mcap")), temporary)


def to_rosbag2(recording: Recording, folder: Path) -> None:
    """Write a folder with metadata.yaml and SQLite, which every distribution reads without further packages. Raises
    ConfigError for a folder with content, a path that SQLite does not take or a column of something else than numbers,
    and RecordingError."""
    if found := _URI.search(str(folder)):
        raise ConfigError(
            f"{folder}: SQLite takes {found[0]} in a path for part of a URI: write the rosbag2 elsewhere, or an .mcap"
        )
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
    check_numbers(recording, "a bag", nulls=True)
    messages = bag_messages(ros_types(), recording.spec, recording.meta, recording.columns)
    _write_messages(folder, bag_topics(recording.columns), messages, mcap=mcap)


def _write_messages(folder: Path, topics: Sequence[BagTopic], messages: Iterable[BagMessage], *, mcap: bool) -> None:
    """Write a bag into a new folder, under a temporary name. Raises OSError, of which the caller makes an error that
    names what was asked for."""
    words = ros_types()
    from rosbags.rosbag2 import StoragePlugin, Writer, WriterError

    plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
    try:
        with Writer(folder, version=8, storage_plugin=plugin) as writer:
            opened = {topic.name: _connection(writer, words, topic) for topic in topics}
            for name, at, message in messages:
                writer.write(opened[name], at, words.encode(message))
    except (WriterError, sqlite3.Error) as error:
        raise OSError(str(error)) from error


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
