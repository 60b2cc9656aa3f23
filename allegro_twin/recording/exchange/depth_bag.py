"""Depth pictures from a ROS bag: sensor_msgs/Image with CameraInfo, or PointCloud2, and where the camera was."""

from __future__ import annotations

import logging
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from allegro_twin.errors import ConfigError, RecordingError
from allegro_twin.kinematics.orientation import matrix_from_quaternion
from allegro_twin.kinematics.pose import Pose, compose, relative_to
from allegro_twin.recording.exchange.bag_times import BagTimes, bag_times
from allegro_twin.recording.exchange.rosbag import header_stamp, open_bag
from allegro_twin.recording.messages import message_types as v
from allegro_twin.types import Array

_log = logging.getLogger(__name__)
IMAGE, INFO = "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo"
_DEPTHS = {"16UC1": ("u2", 1e-3), "mono16": ("u2", 1e-3), "32FC1": ("f4", 1.0)}  # REP 118: mm, or m.
_FLOATS = {7: "f4", 8: "f8"}  # sensor_msgs/PointField.
_FARTHEST = 50.0  # m. No depth camera of a cell sees so far in half of its pixels; in mm it is 5 cm.
_ENOUGH = 100  # Points by which an organised cloud's lens is found.
_OFF = 1.0  # Pixels. Further off, an organised cloud is none of a pinhole.
_INSIDE, _CLEARLY = 0.5, 0.9  # Shares of a cloud's points in its picture: fewer are another frame's; surely so.
_AHEAD_X = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])  # REP 103: x ahead, y left, z up.
_STRAIGHT = 1e-6
_APART = 1e-3  # m, and of rotation matrices: transforms of one frame that differ.
_LATE = 500_000_000  # ns from a picture to the nearest transform of a frame that moves.
NANOSECOND = 1e-9

Lens = tuple[int, int, float, float, float, float]
"""Width and height, and fx, fy, cx, cy, pixels; the middle of the first pixel is (0, 0)."""


class BagDepth(NamedTuple):
    """A depth picture of a bag."""

    time: float
    """By its stamp, s since the first picture; by when it was recorded where no picture has a stamp."""
    depth: NDArray[np.float32]
    """(rows, columns), m along z; NaN is unknown."""
    lens: Lens
    frame: str
    """The camera's optical frame."""
    pose: Pose | None
    """Pose of that frame in the bag's `world` frame; None: the bag does not say."""


def read_depth(path: Path, topic: str | None = None, world: str = "world") -> Iterator[BagDepth]:
    """Yield the depth pictures of a topic, oldest first; None: of the bag's only depth pictures, or else its only
    clouds. The bag is open until the iterator is closed. Pictures whose stamps go back, repeat or jump are left out,
    and their number is logged.

    Raises RecordingError for a file that is no bag, ConfigError for a topic that is not there or cannot be read as
    depth, and for depths that are not in m.
    """
    if not path.exists():
        raise RecordingError(f"no bag at {path}")
    with open_bag(path) as reader:
        chosen = _topic(path, reader, topic)
        connections = [each for each in reader.connections if each.topic == chosen]
        where, info = f"{path}: {chosen}", _info(path, reader, chosen)
        clock = _clock(reader, connections)
        for line in clock.left_out("pictures"):
            _log.warning("%s: %s", where, line)
        tree, first = _Frames(path, reader, stamped=clock.stamped), clock.times[clock.kept][:1]
        if not len(first):
            raise ConfigError(f"{where} has no messages")
        heard = zip(reader.messages(connections=connections), clock.times.tolist(), clock.kept.tolist(), strict=True)
        for (connection, at, data), time, kept in heard:
            if not kept:
                continue
            message = reader.deserialize(data, connection.msgtype)
            if connection.msgtype == IMAGE:
                depth, lens = _image(message, info, where)
            else:
                depth, lens = _cloud(message, info, where)
            _check_metres(depth, where)
            frame = str(message.header.frame_id)
            yield BagDepth((time - int(first[0])) * NANOSECOND, depth, lens, frame, tree.pose(world, frame, time, at))


def _clock(reader: Any, connections: Sequence[Any]) -> BagTimes:
    """The times of a topic's messages."""
    heard = [(header_stamp(reader, data), at) for _, at, data in reader.messages(connections=connections)]
    return bag_times([stamp for stamp, _ in heard], [at for _, at in heard])


def _topic(path: Path, reader: Any, topic: str | None) -> str:
    shown = [each for each in reader.connections if each.msgtype in (IMAGE, v.CLOUD)]
    kinds: dict[str, str] = {each.topic: each.msgtype for each in shown}
    if topic is not None:
        if topic not in kinds:
            raise ConfigError(f"{path} has no depth on {topic}; pictures and clouds: {', '.join(kinds) or 'none'}")
        return topic
    depths = [name for name, kind in kinds.items() if kind == IMAGE and "depth" in name]
    for names in (depths, [name for name, kind in kinds.items() if kind == v.CLOUD]):
        if len(names) == 1:
            return names[0]
        if names:
            raise ConfigError(f"{path} has depth on {', '.join(sorted(names))}: choose one by `topic`")
    raise ConfigError(f"{path} has neither depth pictures nor clouds; its topics: "
                      f"{', '.join(sorted({each.topic for each in reader.connections}))}")  # fmt: skip


def _info(path: Path, reader: Any, topic: str) -> Lens | None:
    """The CameraInfo beside a topic, in its own namespace; the bag's only one where there is none."""
    every = [each for each in reader.connections if each.msgtype == INFO]
    near = [each for each in every if each.topic.rsplit("/", 1)[0] == topic.rsplit("/", 1)[0]]
    chosen = near[:1] or (every if len(every) == 1 else [])
    for connection, _, data in reader.messages(connections=chosen) if chosen else ():
        message = reader.deserialize(data, connection.msgtype)
        if np.abs(np.asarray(message.d, dtype=np.float64)).max(initial=0.0) > _STRAIGHT:
            raise ConfigError(f"{path}: {connection.topic} has lens distortion; record the rectified depth")
        k = np.asarray(message.k, dtype=np.float64)
        if not (k[0] > 0.0 and k[4] > 0.0):
            raise ConfigError(f"{path}: {connection.topic} is not calibrated: its K is {k.tolist()}")
        return int(message.width), int(message.height), float(k[0]), float(k[4]), float(k[2]), float(k[5])
    return None


def _image(message: Any, lens: Lens | None, where: str) -> tuple[NDArray[np.float32], Lens]:
    known = _DEPTHS.get(str(message.encoding))
    if known is None:
        raise ConfigError(f"{where} has pictures of {message.encoding!r}; depth is {', '.join(_DEPTHS)}")
    kind, unit = known
    order = ">" if message.is_bigendian else "<"
    high, wide, step = int(message.height), int(message.width), int(message.step)
    size = np.dtype(kind).itemsize
    data = np.asarray(message.data, np.uint8)
    if step < wide * size or len(data) < high * step:
        raise ConfigError(f"{where}: a picture of {wide} x {high} has {len(data)} bytes in rows of {step}")
    rows = np.ascontiguousarray(data[: high * step].reshape(high, step)[:, : wide * size])
    depth = rows.view(order + kind).astype(np.float32) * np.float32(unit)
    depth[~(depth > 0.0) | ~np.isfinite(depth)] = np.nan
    if lens is None:
        raise ConfigError(f"{where} has no CameraInfo beside it; record its camera_info, too")
    if lens[:2] != (wide, high):
        raise ConfigError(f"{where} has pictures of {wide} x {high} and a CameraInfo of {lens[0]} x {lens[1]}")
    return depth, lens


def _cloud(message: Any, lens: Lens | None, where: str) -> tuple[NDArray[np.float32], Lens]:
    """A cloud as a depth picture: organised ones as they are, others by the lens."""
    points, frame = _points(message, where), str(message.header.frame_id)
    if points.shape[0] > 1:
        own = lens if lens is not None and (lens[1], lens[0]) == points.shape[:2] else _fitted_lens(points, where)
        _check_organised(points, own, where, frame)
        depth = points[..., 2].copy()
        depth[~(depth > 0.0)] = np.nan
        return depth, own
    if lens is None:
        raise ConfigError(f"{where} has clouds without rows, and there is no CameraInfo: record camera_info, too")
    wide, high = lens[:2]
    known = points[0][np.isfinite(points[0]).all(axis=1)]
    _check_ahead(known, lens, where, frame)
    z = known[known[:, 2] > 0.0][:, 2]
    column, row = np.rint(_pixels(known[known[:, 2] > 0.0], lens)).astype(int)
    inside = (column >= 0) & (column < wide) & (row >= 0) & (row < high)
    depth = np.full((high, wide), np.inf, np.float32)
    np.minimum.at(depth, (row[inside], column[inside]), z[inside].astype(np.float32))
    depth[np.isinf(depth)] = np.nan
    return depth, lens


def _check_metres(depth: NDArray[np.float32], where: str) -> None:
    """Raise ConfigError for depths that look like mm."""
    known = depth[np.isfinite(depth)]
    middle = float(np.median(known)) if len(known) else 0.0
    if middle > _FARTHEST:
        raise ConfigError(
            f"{where}: half of the depths are beyond {middle:.3g} m, so they look like mm; floats are read as m: "
            "divide them by 1000, or record pictures of whole mm as 16UC1"
        )


def _pixels(points: Array, lens: Lens) -> Array:
    """Columns and rows of points with z ahead, (k, 3), m: (2, k), pixels."""
    _, _, fx, fy, cx, cy = lens
    x, y, z = points.T
    return np.stack([fx * x / z + cx, fy * y / z + cy])


def _share_inside(points: Array, lens: Lens) -> float:
    """Share of points, (k, 3), m, that a camera with z ahead sees."""
    ahead = points[points[:, 2] > 0.0]
    pixels = _pixels(ahead, lens).T
    inside = ((pixels > -1.0) & (pixels < np.array(lens[:2]))).all(axis=1)
    return float(inside.sum() / max(len(points), 1))


def _check_ahead(points: Array, lens: Lens, where: str, frame: str) -> None:
    """Raise ConfigError for a cloud, (k, 3), m, that is not in its camera's optical frame."""
    share = _share_inside(points, lens)
    if not len(points) or share >= _INSIDE:
        return
    if _share_inside(points @ _AHEAD_X.T, lens) > _CLEARLY:
        raise ConfigError(
            f"{where}: in the frame {frame} of its clouds x is ahead; record them in the optical frame, where z is"
        )
    raise ConfigError(
        f"{where}: {100.0 * (1.0 - share):.0f} % of a cloud's points are outside the picture of its CameraInfo; record "
        f"them in that camera's optical frame (theirs is {frame})"
    )


def _check_organised(points: NDArray[np.float32], lens: Lens, where: str, frame: str) -> None:
    """Raise ConfigError for an organised cloud, (rows, columns, 3), m, whose points are not in their pixels."""
    row, column = np.nonzero(np.isfinite(points).all(axis=-1))
    known = points[row, column].astype(np.float64)
    _check_ahead(known, lens, where, frame)
    ahead = known[:, 2] > 0.0
    off = np.abs(_pixels(known[ahead], lens) - np.stack([column, row])[:, ahead]).max(axis=0)
    if len(off) and np.median(off) > _OFF:
        raise ConfigError(
            f"{where}: points of a cloud are {np.median(off):.0f} pixels from where its CameraInfo has them; record "
            f"the CameraInfo of its own camera (its frame is {frame})"
        )


def _points(message: Any, where: str) -> NDArray[np.float32]:
    """(rows, columns, 3), m."""
    high, wide, step = int(message.height), int(message.width), int(message.point_step)
    fields = {str(field.name): field for field in message.fields}
    if not {"x", "y", "z"} <= set(fields) or any(fields[axis].datatype not in _FLOATS for axis in "xyz"):
        raise ConfigError(f"{where} has clouds of {', '.join(fields) or 'nothing'}; x, y and z are needed, as floats")
    order, data = ">" if message.is_bigendian else "<", np.asarray(message.data, np.uint8)
    if len(data) < high * int(message.row_step) or int(message.row_step) < wide * step:
        raise ConfigError(f"{where}: a cloud of {wide} x {high} points has {len(data)} bytes")
    rows = data[: high * int(message.row_step)].reshape(high, -1)[:, : wide * step].reshape(high, wide, step)
    parts = []
    for axis in "xyz":
        kind, offset = np.dtype(order + _FLOATS[fields[axis].datatype]), int(fields[axis].offset)
        parts.append(np.ascontiguousarray(rows[..., offset : offset + kind.itemsize]).view(kind)[..., 0])
    return np.stack(parts, axis=-1).astype(np.float32)


def _fitted_lens(points: NDArray[np.float32], where: str) -> Lens:
    """By least squares of columns on x/z and rows on y/z."""
    row, column = np.nonzero(np.isfinite(points).all(axis=-1) & (points[..., 2] > 0.0))
    if len(row) < _ENOUGH:
        raise ConfigError(f"{where}: a cloud with {len(row)} points, and no CameraInfo beside it")
    x, y, z = points[row, column].astype(np.float64).T
    found, off = [], 0.0
    for pixel, ratio in ((column, x / z), (row, y / z)):
        (f, c), *_ = np.linalg.lstsq(np.stack([ratio, np.ones_like(ratio)], axis=1), pixel, rcond=None)
        off = max(off, float(np.abs(f * ratio + c - pixel).max()))
        found.append((float(f), float(c)))
    if off > _OFF or min(f for f, _ in found) <= 0.0:
        raise ConfigError(f"{where}: its clouds are not those of a pinhole in their own frame; record camera_info")
    (fx, cx), (fy, cy) = found
    return points.shape[1], points.shape[0], fx, fy, cx, cy


class _Told(NamedTuple):
    """A frame in its parent."""

    stamp: int
    """ns."""
    recorded: int
    """ns, by the recorder's clock."""
    pose: Pose


class _Frames:
    """The tree of frames of a bag, over time: by stamps where the pictures have them (`stamped`) and a transform of the
    frame has one, else by when pictures and transforms were recorded."""

    def __init__(self, path: Path, reader: Any, *, stamped: bool) -> None:
        self._path, self._parents = path, dict[str, str]()
        self._poses: dict[str, list[_Told]] = defaultdict(list)
        self._stamped = set[str]()
        self._static: dict[str, Pose] = {}
        self._wrong: dict[str, str] = {}  # By frame; only a frame that is asked for matters.
        wanted = [each for each in reader.connections if each.msgtype == v.TF]
        for connection, at, data in reader.messages(connections=wanted) if wanted else ():
            static = connection.topic.endswith("static")
            for each in reader.deserialize(data, connection.msgtype).transforms:
                child, parent = str(each.child_frame_id).lstrip("/"), str(each.header.frame_id).lstrip("/")
                pose = _pose(each.transform, f"{path}: {connection.topic}, {parent} to {child}")
                if self._parents.setdefault(child, parent) != parent:
                    self._wrong[child] = f"the frame {child} is in {self._parents[child]} and in {parent}"
                if static and _differ(self._static.setdefault(child, pose), pose):
                    raise ConfigError(
                        f"{path}: the static frame {child} has two places in {parent}; record one of them"
                    )
                told = _Told(v.nanoseconds(each.header.stamp), at, pose)
                if stamped and told.stamp:
                    self._stamped.add(child)
                self._poses[child].append(told)
        for child in self._static.keys() & self._poses.keys():
            if any(_differ(self._static[child], told.pose) for told in self._poses[child]):
                self._wrong.setdefault(child, f"the frame {child} is static and moves; record one of the two")

    def pose(self, world: str, frame: str, time: int, recorded: int) -> Pose | None:
        """A frame in another at a picture's time, and when that was recorded, ns, by the nearest transforms; None where
        they are not connected. Raises ConfigError where transforms on the way contradict each other, or were told long
        before or after."""
        one, other = dict(self._up(frame, time, recorded)), dict(self._up(world, time, recorded))
        for name, there in one.items():
            if name in other:
                return relative_to(other[name], there)
        return None

    def _up(self, frame: str, time: int, recorded: int) -> Iterator[tuple[str, Pose]]:
        """A frame's pose in itself, its parent, and so on."""
        name, pose, known = frame.lstrip("/"), Pose(np.zeros(3), np.eye(3)), set[str]()
        while name not in known:
            known.add(name)
            yield name, pose
            if name not in self._parents:
                return
            if name in self._wrong:
                raise ConfigError(f"{self._path}: {self._wrong[name]}")
            own, told = name in self._stamped, self._poses[name]
            aways = [abs(each.stamp - time if own else each.recorded - recorded) for each in told]
            nearest = int(np.argmin(aways))
            away, step = aways[nearest], told[nearest].pose
            if name not in self._static and away > _LATE:
                raise ConfigError(
                    f"{self._path}: the frame {name} was told {away * NANOSECOND:.1f} s from the picture; "
                    "record /tf together with the depth"
                )
            name, pose = self._parents[name], compose(step, pose)


def _differ(one: Pose, other: Pose) -> bool:
    away = max(np.abs(one.position - other.position).max(), np.abs(one.rotation - other.rotation).max())
    return bool(away > _APART)


def _pose(transform: Any, where: str) -> Pose:
    t, q = transform.translation, transform.rotation
    place: Array = np.array([t.x, t.y, t.z])
    turn = np.array([q.w, q.x, q.y, q.z])
    if not np.isfinite(place).all() or not abs(np.linalg.norm(turn) - 1.0) < _APART:
        raise ConfigError(f"{where}: translation {place.tolist()} and quaternion {turn.tolist()} are no pose")
    return Pose(place, matrix_from_quaternion(turn))
