"""Link frames of a hand for ROS, from its URDF."""

from __future__ import annotations

from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from allegro_twin.files.assets import data_root
from allegro_twin.kinematics.orientation import matrix_from_quaternion
from allegro_twin.recording.messages.build import transform
from allegro_twin.recording.messages.message_types import TF, Message, RosTypes
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector


class LinkFrame(NamedTuple):
    """A link and its place on its parent."""

    parent: str
    child: str
    xyz: Vector
    """(3,), m, in the parent's frame."""
    turn: Vector
    """Quaternion x, y, z, w at the joint's zero."""
    axis: Vector | None
    """Unit vector, (3,), in the child's frame; None: a fixed link."""
    joint: int
    """Index in `spec.all_joints`; -1: none."""
    slides: bool = False
    """Whether it moves along the axis, m, instead of about it, rad."""


def urdf_text(spec: HandSpec) -> str:
    """The hand's URDF, with mesh paths that a viewer on this machine finds; of a hand without one, by its card, frames,
    joints and inertias from the model file that simulates it."""
    folder = data_root() / "models"
    if spec.card or not (folder / "urdf" / f"{spec.name}.urdf").is_file():
        from allegro_twin.kinematics.tree import link_tree
        from allegro_twin.kinematics.urdf import urdf_from_tree

        return urdf_from_tree(link_tree(spec), spec)
    text = (folder / "urdf" / f"{spec.name}.urdf").read_text()
    return text.replace('filename="../', f'filename="file://{folder}/')


class LinkFrames:
    """The frame tree of one hand."""

    def __init__(self, spec: HandSpec) -> None:
        root = ElementTree.fromstring(urdf_text(spec))
        frames = [_frame(joint, spec) for joint in root.iter("joint")]
        self.moving = [frame for frame in frames if frame.axis is not None]
        self.fixed = [frame for frame in frames if frame.axis is None]
        children = {frame.child for frame in frames}
        self.root = next(frame.parent for frame in frames if frame.parent not in children)
        self._spec = spec
        self._index = np.array([frame.joint for frame in self.moving])
        self._axis = np.array([frame.axis for frame in self.moving])
        self._turn = np.array([frame.turn for frame in self.moving])
        self._place = np.array([frame.xyz for frame in self.moving])
        self._slides = np.array([frame.slides for frame in self.moving])[:, None]
        self._along = np.einsum("kij,kj->ki", matrix_from_quaternion(np.roll(self._turn, 1, axis=1)), self._axis)

    def transforms_at(self, types: RosTypes, stamp: int, position: Vector) -> Message:
        """TFMessage of all joints at a posture, (n,), rad."""
        moved = self._spec.all_positions(position)[self._index, None]
        half = np.where(self._slides, 0.0, moved) / 2.0
        turns = _multiply(self._turn, np.hstack([np.sin(half) * self._axis, np.cos(half)]))
        places = self._place + np.where(self._slides, moved, 0.0) * self._along
        return _message(types, stamp, self.moving, places, turns)

    def static_transforms(self, types: RosTypes, stamp: int) -> Message:
        """TFMessage of the fixed frames: the fingertips on their links."""
        places, turns = (np.array([getattr(frame, key) for frame in self.fixed]) for key in ("xyz", "turn"))
        return _message(types, stamp, self.fixed, places, turns)


def _frame(joint: ElementTree.Element, spec: HandSpec) -> LinkFrame:
    def part(name: str, key: str) -> str:
        found = joint.find(name)
        return "" if found is None else found.get(key, "")

    name = str(joint.get("name"))
    fixed = joint.get("type") == "fixed" or name not in spec.all_joints
    xyz, rpy = (np.array((part("origin", key) or "0 0 0").split(), dtype=float) for key in ("xyz", "rpy"))
    axis = None if fixed else np.array((part("axis", "xyz") or "1 0 0").split(), dtype=float)
    index = -1 if fixed else spec.all_joints.index(name)
    slides = joint.get("type") == "prismatic"
    return LinkFrame(part("parent", "link"), part("child", "link"), xyz, _quaternion(rpy), axis, index, slides)


def _quaternion(rpy: Vector) -> Vector:
    """Quaternion x, y, z, w of URDF's fixed-axis roll, pitch, yaw."""
    half = rpy / 2.0
    sine, cosine = np.sin(half), np.cos(half)
    single = [np.append(np.eye(3)[k] * sine[k], cosine[k]) for k in range(3)]
    turned: Vector = _multiply(_multiply(single[2][None], single[1][None]), single[0][None])[0]
    return turned


def _multiply(a: Array, b: Array) -> Array:
    """Products of quaternions x, y, z, w, (k, 4) each."""
    vector = a[:, 3:] * b[:, :3] + b[:, 3:] * a[:, :3] + np.cross(a[:, :3], b[:, :3])
    return np.hstack([vector, (a[:, 3] * b[:, 3] - (a[:, :3] * b[:, :3]).sum(axis=1))[:, None]])


def _message(types: RosTypes, stamp: int, frames: list[LinkFrame], places: Array, turns: Array) -> Message:
    """`places`: (k, 3), m; `turns`: quaternions x, y, z, w, (k, 4)."""
    poses = [np.array([*place, turn[3], *turn[:3]]) for place, turn in zip(places, turns, strict=True)]
    each = zip(frames, poses, strict=True)
    return types.make(TF, transforms=[transform(types, stamp, frame.parent, frame.child, pose) for frame, pose in each])
