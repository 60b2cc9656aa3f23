"""Messages are those of ROS 2, byte for byte, and say of a hand what it is."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.recording.messages import build
from allegro_twin.recording.messages import message_types as v
from allegro_twin.recording.messages.frames import LinkFrames, urdf_text
from allegro_twin.spec import HandSpec, Side
from allegro_twin.surfaces.ros import cell_topics
from allegro_twin.surfaces.ros.hand_topics import PUBLISHED, SUBSCRIBED
from allegro_twin.surfaces.ros.node import struct
from allegro_twin.types import Array

KINDS = sorted(
    {entry.kind for entry in (*PUBLISHED, *SUBSCRIBED, *cell_topics.PUBLISHED, *cell_topics.SUBSCRIBED)} | {v.NODES}
)


def filled(types: v.RosTypes, kind: str, rng: np.random.Generator) -> Any:
    """A message of a type with something in every field, nested ones and lists of odd lengths too."""
    return types.make(kind, **{name: _value(types, shape, rng) for name, shape in types.fields(kind)})


def _value(types: v.RosTypes, shape: Any, rng: np.random.Generator) -> Any:
    node, args = shape
    if node.name == "NAME":
        return filled(types, args, rng)
    if node.name == "BASE":
        if args[0] == "string":
            return "é" * int(rng.integers(0, 7))
        if args[0].startswith("float"):
            return float(np.float32(rng.normal()))
        return int(rng.integers(0, 100)) if args[0] != "bool" else bool(rng.integers(2))
    length = args[1] if node.name == "ARRAY" else int(rng.integers(0, 5))
    values = [_value(types, args[0], rng) for _ in range(length)]
    if args[0][0].name == "NAME" or args[0][1][0] == "string":
        return values
    kind = {"char": "uint8", "byte": "uint8", "octet": "uint8"}.get(args[0][1][0], args[0][1][0])
    return np.array(values, dtype=kind)


@pytest.mark.parametrize("distro", v.DISTROS)
@pytest.mark.parametrize("kind", KINDS)
def test_cyclone_dds_and_rosbags_write_the_same_bytes_for_every_type(kind: str, distro: v.Distro) -> None:
    types, rng = v.ros_types(distro), np.random.default_rng(1)
    for _ in range(20):
        data = types.encode(filled(types, kind, rng))
        read = struct(types, kind).deserialize(data)
        again = read.serialize(use_version_2=False)
        assert again.ljust(len(data), b"\0") == data.ljust(len(again), b"\0")
        assert types.encode(types.decode(data, kind)) == data


@pytest.mark.parametrize(
    ("kind", "known"),
    [  # As `ros2 topic info --verbose` prints them on Iron and later.
        (v.JOINT_STATE, "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"),
        (v.STRING, "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"),
    ],
)
def test_types_have_the_hashes_that_real_systems_print(types: v.RosTypes, kind: str, known: str) -> None:
    assert types.hash(kind) == known


def test_a_participants_id_has_the_length_of_its_distribution() -> None:
    lengths = {distro: dict(v.ros_types(distro).fields("rmw_dds_common/msg/Gid"))["data"][1][1] for distro in v.DISTROS}
    assert lengths["humble"] == 24
    assert lengths["jazzy"] == lengths["lyrical"] == 16


def matrix(transform: Any) -> Array:
    q, p = transform.rotation, transform.translation
    x, y, z, w = q.x, q.y, q.z, q.w
    turn = np.eye(4)
    turn[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    turn[:3, 3] = p.x, p.y, p.z
    return turn


def test_frames_end_where_the_kinematics_have_the_fingertips(types: v.RosTypes, side: Side) -> None:
    spec = load_spec(side=side)
    frames, model = LinkFrames(spec), hand_kinematics(spec)
    assert frames.root == "palm_link"
    for seed in range(5):
        position = np.random.default_rng(seed).uniform(spec.lower, spec.upper)
        moving, fixed = frames.transforms_at(types, 7, position), frames.static_transforms(types, 7)
        placed = {frames.root: np.eye(4)}
        for each in (*moving.transforms, *fixed.transforms):
            placed[each.child_frame_id] = placed[each.header.frame_id] @ matrix(each.transform)
        for finger, pose in model.fingertips(position).items():
            found = placed[spec.finger(finger).tip]
            np.testing.assert_allclose(found[:3, 3], pose.position, atol=1e-12)
            np.testing.assert_allclose(found[:3, :3], pose.rotation, atol=1e-12)


def test_the_description_names_meshes_that_are_there(spec: HandSpec) -> None:
    from pathlib import Path
    from xml.etree import ElementTree

    meshes = [mesh.get("filename", "") for mesh in ElementTree.fromstring(urdf_text(spec)).iter("mesh")]
    assert meshes
    assert all(name.startswith("file://") and Path(name.removeprefix("file://")).is_file() for name in meshes)


def test_joints_may_come_in_any_order_and_under_each_of_their_names(spec: HandSpec) -> None:
    backwards = list(reversed(spec.joints))
    assert build.joint_order(spec, backwards, "x") == list(reversed(range(spec.n_joints)))
    assert build.joint_order(spec, spec.aliases, "x") == list(range(spec.n_joints))
    assert build.joint_order(spec, [name.replace(".", "_") for name in spec.joints], "x") == list(range(spec.n_joints))
    assert build.joint_order(spec, [], "x") == list(range(spec.n_joints))


@pytest.mark.parametrize(
    ("names", "words_"),
    [
        (["joint_0.0"], r"lacks joint_1.0, .* it needs all 16 joints of allegro_right"),
        (["joint_99.0"], r"no joint named 'joint_99.0'; did you mean 'joint_9.0'"),
        (["joint_0.0", "index_0"], r"names the joint index_0 twice"),
    ],
)
def test_joints_that_are_missing_unknown_or_double_are_named(spec: HandSpec, names: list[str], words_: str) -> None:
    with pytest.raises(ConfigError, match=words_):
        build.joint_order(spec, names, "joint_cmd")


def test_a_hand_of_another_shape_has_its_own_names(types: v.RosTypes, spec: HandSpec) -> None:
    three = dataclasses.replace(spec, joints=spec.joints[:3], aliases=spec.aliases[:3])
    assert build.joint_order(three, ["index_2", "index_0", "index_1"], "x") == [1, 2, 0]


def test_bytes_of_something_else_are_refused_in_one_line(types: v.RosTypes) -> None:
    with pytest.raises(ConfigError, match="5 bytes are no sensor_msgs/msg/JointState"):
        types.decode(b"\0\1\0\0\5", v.JOINT_STATE)


@pytest.mark.parametrize("kind", KINDS)
def test_bytes_that_were_cut_or_changed_never_raise_anything_else(types: v.RosTypes, kind: str) -> None:
    rng = np.random.default_rng(2)
    data, refused = types.encode(filled(types, kind, rng)), 0
    for _ in range(200):
        damaged = bytearray(data[: int(rng.integers(0, len(data) + 1))])
        for _ in range(int(rng.integers(0, 4))):
            if damaged:
                damaged[int(rng.integers(len(damaged)))] = int(rng.integers(256))
        try:
            types.decode(bytes(damaged), kind)
        except ConfigError:
            refused += 1
    assert refused > 0
