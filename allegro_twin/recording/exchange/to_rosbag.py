"""Recordings as bags of ROS 2, an .mcap file or a rosbag2 folder."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

from allegro_twin.errors import RecordingError
from allegro_twin.files.atomic_write import whole_file, whole_folder
from allegro_twin.recording.messages.recorded import Topic, rows, topics_of
from allegro_twin.recording.messages.vocabulary import Vocabulary, vocabulary
from allegro_twin.recording.reader import Recording


def to_mcap(recording: Recording, path: Path) -> None:
    """One file, which Foxglove, PlotJuggler and `ros2 bag` open. Raises RecordingError."""
    with whole_file(path) as temporary, tempfile.TemporaryDirectory(dir=path.parent) as folder:
        bag = Path(folder) / "bag"
        _write(recording, bag, mcap=True)
        shutil.move(next(bag.glob("*.mcap")), temporary)


def to_rosbag2(recording: Recording, folder: Path) -> None:
    """A folder with metadata.yaml and SQLite, which every distribution reads as it is installed. Raises ConfigError for
    a folder that has something in it, and RecordingError."""
    with whole_folder(folder) as temporary:
        inner = temporary / "bag"
        _write(recording, inner, mcap=False)
        for file in inner.iterdir():
            shutil.move(file, temporary / file.name)
        inner.rmdir()


def _write(recording: Recording, folder: Path, *, mcap: bool) -> None:
    words = vocabulary()
    from rosbags.rosbag2 import StoragePlugin, Writer, WriterError

    plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
    try:
        with Writer(folder, version=8, storage_plugin=plugin) as writer:
            opened = {topic.name: _connection(writer, words, topic) for topic in topics_of(recording.columns)}
            for name, at, message in rows(words, recording.spec, recording.meta, recording.columns):
                writer.write(opened[name], at, words.encode(message))
    except (OSError, WriterError) as error:
        raise RecordingError(f"cannot write the bag {folder.parent}: {error}") from error


def _connection(writer: object, words: Vocabulary, topic: Topic) -> object:
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
