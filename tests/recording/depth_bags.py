"""ROS 2 bags with depth, as a camera's driver records them."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from allegro_twin.recording.messages import build
from allegro_twin.recording.messages import message_types as v
from allegro_twin.recording.messages.message_types import RosTypes, ros_types
from allegro_twin.types import Array

DEPTH, INFO, POINTS = "/camera/depth/image_rect_raw", "/camera/depth/camera_info", "/camera/depth/color/points"
FRAME = "camera_depth_optical_frame"
LENS = (64, 48, 40.0, 41.0, 31.0, 23.0)
SECOND = 10**9


class BagWriter:
    """Writes messages of any type."""

    def __init__(self, writer: Any) -> None:
        self.types: RosTypes = ros_types()
        self._writer, self._open = writer, dict[str, Any]()

    def write(self, topic: str, at: int, message: Any) -> None:
        """`at`: ns."""
        kind = message.__msgtype__
        if topic not in self._open:
            self._open[topic] = self._writer.add_connection(
                topic, kind, msgdef=self.types.definition(kind), rihs01=self.types.hash(kind)
            )
        self._writer.write(self._open[topic], at, self.types.encode(message))

    def image(self, at: int, depth: Array, encoding: str = "16UC1", *, topic: str = DEPTH, pad: int = 0) -> None:
        """Depth as numbers of the encoding, with `pad` bytes after each row."""
        kind = {"16UC1": "<u2", "32FC1": "<f4"}.get(encoding, "u1")
        rows = np.ascontiguousarray(depth.astype(kind)).view(np.uint8).reshape(len(depth), -1)
        data = np.pad(rows, [(0, 0), (0, pad)])
        self.write(topic, at, self.types.make(
            "sensor_msgs/msg/Image", header=self.types.header(at, FRAME), height=depth.shape[0], width=depth.shape[1],
            encoding=encoding, is_bigendian=0, step=data.shape[1], data=data.ravel()))  # fmt: skip

    def info(
        self, at: int, lens: tuple[float, ...] = LENS, d: tuple[float, ...] = (0.0,) * 5, topic: str = INFO
    ) -> None:
        w, h, fx, fy, cx, cy = lens
        region = self.types.make("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0,
                                 do_rectify=False)  # fmt: skip
        self.write(topic, at, self.types.make(
            "sensor_msgs/msg/CameraInfo", header=self.types.header(at, FRAME), height=int(h), width=int(w),
            distortion_model="plumb_bob", d=np.array(d), k=np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1.0]),
            r=np.eye(3).ravel(), p=np.array([fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1.0, 0]), binning_x=0, binning_y=0,
            roi=region))  # fmt: skip

    def cloud(self, at: int, points: NDArray[np.floating], topic: str = POINTS) -> None:
        self.write(topic, at, build.cloud(self.types, at, FRAME, points.astype(np.float32)))

    def transform(self, at: int, parent: str, child: str, values: Array, topic: str = "/tf_static") -> None:
        """`values`: position, m, and quaternion w x y z."""
        made = build.transform(self.types, at, parent, child, values)
        self.write(topic, at, self.types.make(v.TF, transforms=[made]))


@contextmanager
def bag(path: Path) -> Iterator[BagWriter]:
    """A bag to write: one .mcap file, or a folder with SQLite."""
    from rosbags.rosbag2 import StoragePlugin, Writer

    mcap = path.suffix == ".mcap"
    folder = path.with_suffix("") if mcap else path
    plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
    with Writer(folder, version=8, storage_plugin=plugin) as writer:
        yield BagWriter(writer)
    if mcap:
        shutil.move(next(folder.glob("*.mcap")), path)
        shutil.rmtree(folder)
