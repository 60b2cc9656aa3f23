"""Builds ROS messages (joint states, poses, wrenches, clouds, diagnostics) and reads joints and poses back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from allegro_twin.errors import ConfigError, unknown
from allegro_twin.kinematics.orientation import matrix_from_quaternion
from allegro_twin.kinematics.pose import Pose
from allegro_twin.recording.messages.message_types import (
    CLOUD,
    DIAGNOSTICS,
    JOINT_STATE,
    POSE,
    VECTOR,
    WRENCH,
    Message,
    RosTypes,
)
from allegro_twin.spec import HandSpec
from allegro_twin.types import HandState, Vector

WORLD = "world"
"""World frame; its origin is the middle of the table's top."""
_FLOAT32 = 7  # sensor_msgs/PointField.
_LENGTH = 0.01  # Tolerance of a quaternion's length.
OK, WARN, ERROR = 0, 1, 2
"""Levels of diagnostic_msgs/DiagnosticStatus."""


def joint_states(types: RosTypes, stamp: int, devices: Sequence[tuple[HandSpec, HandState]]) -> Message:
    """Several devices in one message: positions (rad), speeds (rad/s), and as effort the applied torques (N·m)."""
    rows = [(state.position, state.velocity, state.torque) for _, state in devices]
    position, velocity, torque = (np.concatenate(each) for each in zip(*rows, strict=True))
    names = [name for spec, _ in devices for name in spec.joints]
    return types.make(
        JOINT_STATE, header=types.header(stamp), name=names, position=position, velocity=velocity, effort=torque
    )


def wrench(types: RosTypes, stamp: int, frame: str, values: Vector) -> Message:
    """Force and torque, (6,), N and N·m, in a frame."""
    force, torque = _three(types, values[:3]), _three(types, values[3:])
    inner = types.make("geometry_msgs/msg/Wrench", force=force, torque=torque)
    return types.make(WRENCH, header=types.header(stamp, frame), wrench=inner)


def pose(types: RosTypes, stamp: int, frame: str, values: Vector) -> Message:
    """Position, m, and quaternion w x y z, (7,), in a frame."""
    x, y, z, qw, qx, qy, qz = (float(value) for value in values)
    inner = types.make(
        "geometry_msgs/msg/Pose",
        position=types.make("geometry_msgs/msg/Point", x=x, y=y, z=z),
        orientation=types.make("geometry_msgs/msg/Quaternion", x=qx, y=qy, z=qz, w=qw),
    )
    return types.make(POSE, header=types.header(stamp, frame), pose=inner)


def pose_in(message: Message, what: str) -> Pose:
    """Read the pose from a message. Raises ConfigError for a number that is not finite, or a quaternion that is not of
    length 1."""
    place, turn = message.pose.position, message.pose.orientation
    parts = {f"position.{axis}": getattr(place, axis) for axis in "xyz"}
    parts |= {f"orientation.{axis}": getattr(turn, axis) for axis in "wxyz"}
    for name, value in parts.items():
        if not np.isfinite(value):
            raise ConfigError(f"{what}: {name} is {value}; the arm stays: give a whole pose")
    numbers = np.array(list(parts.values()))
    length = float(np.linalg.norm(numbers[3:]))
    if abs(length - 1.0) > _LENGTH:
        raise ConfigError(f"{what}: its quaternion has length {length:.3g}, not 1; the arm stays: give an orientation")
    return Pose(numbers[:3], matrix_from_quaternion(numbers[3:]))


def cloud(types: RosTypes, stamp: int, frame: str, points: NDArray[np.float32]) -> Message:
    """Points (rows, columns, 3), m, in a frame: x right, y down, z ahead; NaN is unknown."""
    high, wide = points.shape[:2]
    data = np.ascontiguousarray(points, dtype="<f4")
    fields = [
        types.make("sensor_msgs/msg/PointField", name=name, offset=4 * k, datatype=_FLOAT32, count=1)
        for k, name in enumerate("xyz")
    ]
    return types.make(
        CLOUD, header=types.header(stamp, frame), height=high, width=wide, fields=fields, is_bigendian=False,
        point_step=12, row_step=12 * wide, data=data.view(np.uint8).ravel(), is_dense=bool(np.isfinite(data).all()),
    )  # fmt: skip


def depth_image(types: RosTypes, stamp: int, frame: str, depth: NDArray[np.float32]) -> Message:
    """Depth (rows, columns), m along z, as realsense-ros has it: 16UC1, mm, 0 is unknown."""
    counts = np.rint(1000.0 * np.nan_to_num(np.clip(depth, 0.0, 65.535))).astype("<u2")
    return types.make(
        "sensor_msgs/msg/Image", header=types.header(stamp, frame), height=depth.shape[0], width=depth.shape[1],
        encoding="16UC1", is_bigendian=0, step=2 * depth.shape[1], data=counts.view(np.uint8).ravel(),
    )  # fmt: skip


def camera_info(types: RosTypes, stamp: int, frame: str, lens: tuple[int, int, float, float, float, float]) -> Message:
    """Width, height, fx, fy, cx, cy of a pinhole without distortion, pixels."""
    wide, high, fx, fy, cx, cy = lens
    region = types.make("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    return types.make(
        "sensor_msgs/msg/CameraInfo", header=types.header(stamp, frame), height=high, width=wide,
        distortion_model="plumb_bob", d=np.zeros(5), k=np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1.0]),
        r=np.eye(3).ravel(), p=np.array([fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1.0, 0]), binning_x=0, binning_y=0,
        roi=region,
    )  # fmt: skip


def transform(types: RosTypes, stamp: int, parent: str, child: str, values: Vector) -> Message:
    """Transform from a parent to a child frame: position, m, and quaternion w x y z, (7,)."""
    qw, qx, qy, qz = (float(value) for value in values[3:])
    inner = types.make(
        "geometry_msgs/msg/Transform",
        translation=_three(types, values[:3]),
        rotation=types.make("geometry_msgs/msg/Quaternion", x=qx, y=qy, z=qz, w=qw),
    )
    header = types.header(stamp, parent)
    return types.make("geometry_msgs/msg/TransformStamped", header=header, child_frame_id=child, transform=inner)


def diagnostics(types: RosTypes, stamp: int, name: str, level: int, message: str, values: Mapping[str, str]) -> Message:
    """One status with its values."""
    pairs = [types.make("diagnostic_msgs/msg/KeyValue", key=key, value=value) for key, value in values.items()]
    status = types.make(
        "diagnostic_msgs/msg/DiagnosticStatus",
        level=level, name=name, message=message, hardware_id=name, values=pairs,
    )  # fmt: skip
    return types.make(DIAGNOSTICS, header=types.header(stamp), status=[status])


def joint_order(spec: HandSpec, names: Sequence[str], what: str) -> list[int]:
    """For each joint of the hand its index in `names`; without names the hand's own order. Raises ConfigError for a
    joint that is unknown, missing or named twice."""
    if not names:
        return list(range(spec.n_joints))
    places: dict[int, int] = {}
    for place, name in enumerate(names):
        joint = joint_index(spec, name)
        if joint is None:
            raise ConfigError(f"{what}: {unknown('joint', name, spec.joints)}")
        if joint in places:
            raise ConfigError(f"{what} names the joint {name} twice")
        places[joint] = place
    if missing := [spec.joints[joint] for joint in range(spec.n_joints) if joint not in places]:
        raise ConfigError(f"{what} lacks {', '.join(missing)}: it needs all {spec.n_joints} joints of {spec.name}")
    return [places[joint] for joint in range(spec.n_joints)]


def joint_index(spec: HandSpec, name: str) -> int | None:
    """The joint of a message's name; None: no joint of the hand. ROS 2 allows no dots in names, so packages write
    `joint_3_0` for `joint_3.0`."""
    own = next((joint for joint in spec.joints if joint.replace(".", "_") == name), name)
    return next((names.index(own) for names in (spec.joints, spec.aliases) if own in names), None)


def joint_values(spec: HandSpec, values: Sequence[float], order: Sequence[int], what: str) -> Vector:
    """Numbers of a message in the hand's order, (n,), read-only. Raises ConfigError for a wrong length, or a number
    that is not finite."""
    if len(values) != len(order):
        raise ConfigError(f"{what} has {len(values)} numbers for {len(order)} joints")
    return spec.vector(np.asarray(values, dtype=np.float64)[list(order)], what)


def _three(types: RosTypes, values: Vector) -> Any:
    x, y, z = (float(value) for value in values)
    return types.make(VECTOR, x=x, y=y, z=z)
