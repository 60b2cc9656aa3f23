"""The ROS topics of a cell: states, forces, points and frames out, targets of the palm and the fingers in."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any
from uuid import UUID

import numpy as np

from allegro_twin.cell.assembly import Cell
from allegro_twin.cell.camera.intrinsics import Intrinsics
from allegro_twin.cell.journal.rows import pose_numbers
from allegro_twin.cell.journal.scene_objects import scene_objects
from allegro_twin.cell.remote.remote_control import FingersCommand, PalmCommand, RemoteControl, StayCommand
from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.pose import Pose, compose
from allegro_twin.recording.events import DeviceSample, SessionEvent
from allegro_twin.recording.messages import build
from allegro_twin.recording.messages import message_types as v
from allegro_twin.recording.messages.frames import LinkFrames
from allegro_twin.recording.messages.planning_scene import PLANNING_SCENE, planning_scene, register_moveit
from allegro_twin.surfaces.ros.bridge import QUIET, Maker, Publication, SessionTopics
from allegro_twin.surfaces.ros.joint_trajectory import TRAJECTORY, joint_path
from allegro_twin.surfaces.ros.node_api import QosProfile, RosTopic
from allegro_twin.types import Vector

NAMESPACE = "/"
CAMERA = "camera_depth_optical_frame"
"""The camera's frame, as realsense-ros names it."""
_GOAL = "target_frame"  # Where the flange is to be.
_CONTROLLER = "cartesian_compliance_controller"
"""As FZI's cartesian_controllers name the one of the lab's report, and its topics."""
STATES = "joint_states"
POINTS = "camera/depth/color/points"
"""As realsense-ros names them."""
WRENCH = f"{_CONTROLLER}/ft_sensor_wrench"
POSE = f"{_CONTROLLER}/current_pose"
TARGET = f"{_CONTROLLER}/target_frame"
PUBLISHED = (
    RosTopic(STATES, v.JOINT_STATE, QosProfile(), "arm and hand in one: positions, speeds, applied torques"),
    RosTopic(POSE, v.POSE, QosProfile(), "the palm in `world`"),
    RosTopic(WRENCH, v.WRENCH, QosProfile(), "what the world does to the hand at the flange, in the axes of `world`"),
    RosTopic(POINTS, v.CLOUD, QosProfile(), "what the depth camera sees, a point a pixel, in its optical frame"),
    RosTopic("/tf", v.TF, QosProfile(100), "links of arm and hand, palm, target and camera"),
    RosTopic("/tf_static", v.TF, QosProfile(1, latched=True), "the arm's base in `world`, fingertips on their links"),
    RosTopic("/rosout", v.LOG, QosProfile(1000, latched=True), "states, and every command that was refused, and why"),
)
PLANNING = RosTopic(
    "planning_scene",
    PLANNING_SCENE,
    QosProfile(1, latched=True),
    "when the hand is led to what was seen: a difference to MoveIt's scene",
)
"""Where the cell's config does not name it otherwise."""
SUBSCRIBED = (
    RosTopic(TARGET, v.POSE, QosProfile(), "where the palm is to be, in `world` or the arm's base"),
    RosTopic(TRAJECTORY, v.TRAJECTORY, QosProfile(), "postures of the fingers, rad, and when, s; no points: stay"),
)


class CellTopics(SessionTopics):
    """Makes messages of a cell's events, and moves the targets of a cell under remote control."""

    published: Sequence[RosTopic] = PUBLISHED
    subscribed, backlog = SUBSCRIBED, 20
    occupied = f"another program leads the cell; this one is obeyed after {QUIET:g} s of quiet"

    def __init__(
        self, cell: Cell, types: v.RosTypes, remote: RemoteControl | None = None, *, rate: float = 100.0
    ) -> None:
        """`remote` carries out commands; None: the state machine leads the cell. Raises ConfigError for a rate, Hz,
        that is not positive."""
        super().__init__(types, cell.hand.spec.name, rate)
        self._cell, self._remote, self._sample = cell, remote, None
        self._arm, self._hand = LinkFrames(cell.robot.spec), LinkFrames(cell.hand.spec)
        self._latest: DeviceSample | None = None
        self._found: Mapping[str, Any] | None = None
        self._clutter = 0
        self._names = names = cell.settings.ros
        further = [
            RosTopic(names.arm_states or "", v.JOINT_STATE, QosProfile(), "the arm's joints alone"),
            RosTopic(names.hand_states or "", v.JOINT_STATE, QosProfile(), "the hand's joints alone"),
            PLANNING._replace(name=names.planning_scene or ""),
        ]
        if names.planning_scene is not None:
            register_moveit(types)
        self.published = (*PUBLISHED, *(topic for topic in further if topic.name))

    def closed(self) -> str:
        return "" if self._remote else "the state machine leads the cell; begin it with --follow to lead it from here"

    def first(self, stamp: int) -> Iterator[Publication]:
        still = self._hand.static_transforms(self._types, stamp)
        base = np.array([*self._cell.robot.base.position, 1.0, 0.0, 0.0, 0.0])
        still.transforms.append(build.transform(self._types, stamp, build.WORLD, self._arm.root, base))
        if self._names.target_security is not None:
            wait = pose_numbers(self._cell.security)
            still.transforms.append(build.transform(self._types, stamp, build.WORLD, self._names.target_security, wait))
        yield "/tf_static", still

    def messages(self, event: SessionEvent) -> Maker | None:
        if not isinstance(event, DeviceSample):
            row = event.row
            if event.track == "pictures":
                return lambda stamp: self._picture(stamp, row)
            if event.track == "perception":
                return self._seen(row)
            return (lambda stamp: self._state(stamp, row)) if event.track == "states" else None
        if event.device == "hand":
            self._latest = event
        elif self._latest is not None and self._is_due(event.sample.state.t):
            hand = self._latest
            return lambda stamp: self._moment(stamp, event, hand)
        return None

    def _moment(self, stamp: int, arm: DeviceSample, hand: DeviceSample) -> Iterator[Publication]:
        types, extras, specs = self._types, arm.extras, (self._cell.robot.spec, self._cell.hand.spec)
        states = (arm.sample.state, hand.sample.state)
        yield STATES, build.joint_states(types, stamp, list(zip(specs, states, strict=True)))
        yield POSE, build.pose(types, stamp, build.WORLD, extras["tool"])
        yield WRENCH, build.wrench(types, stamp, build.WORLD, extras["force"])
        links = self._arm.transforms_at(types, stamp, states[0].position)
        links.transforms.extend(self._hand.transforms_at(types, stamp, states[1].position).transforms)
        names = self._names
        for frame, name in (
            (self._hand.root, "tool"), (_GOAL, "goal"), (names.hand_frame, "tool"), (names.target_arm, "goal")
        ):  # fmt: skip
            if frame is not None:
                links.transforms.append(build.transform(types, stamp, build.WORLD, frame, extras[name]))
        yield "/tf", links
        for topic, device in zip((names.arm_states, names.hand_states), zip(specs, states, strict=True), strict=True):
            if topic is not None:
                yield topic, build.joint_states(types, stamp, [device])

    def _picture(self, stamp: int, row: Mapping[str, Any]) -> Iterator[Publication]:
        types, depth = self._types, row["depth"]
        fx, fy, cx, cy = row["lens"]
        metres = np.where(depth == 0, np.nan, depth / 1000.0).astype(np.float32)
        points = Intrinsics(depth.shape[1], depth.shape[0], fx, fy, cx, cy).cloud(metres)
        yield POINTS, build.cloud(types, stamp, CAMERA, points)
        place = build.transform(types, stamp, build.WORLD, CAMERA, row["camera"])
        yield "/tf", types.make(v.TF, transforms=[place])

    def _seen(self, row: Mapping[str, Any]) -> Maker | None:
        """Frames of what perception found."""
        if row["verdict"] != "found":
            return None
        self._found, names = row, self._names
        shown = [(names.object_frame, row["pose"]), (names.target_hand, row.get("target"))]
        placed = [(frame, pose) for frame, pose in shown if frame is not None and pose is not None]
        return (lambda stamp: self._frames(stamp, placed)) if placed else None

    def _frames(self, stamp: int, placed: Sequence[tuple[str, Vector]]) -> Iterator[Publication]:
        made = [build.transform(self._types, stamp, build.WORLD, frame, pose) for frame, pose in placed]
        yield "/tf", self._types.make(v.TF, transforms=made)

    def _state(self, stamp: int, row: Mapping[str, Any]) -> Iterator[Publication]:
        if "clutter" in row and self._found is not None:
            yield from self._led(stamp, row, self._found)
        end, reason, sentence = (row.get(name) or "" for name in ("end", "reason", "sentence"))
        parts = [end, reason, sentence] if end else [sentence or str(row["state"])]
        yield self.log(stamp, "states", ": ".join(filter(None, parts)), bad=bool(sentence))

    def _led(self, stamp: int, row: Mapping[str, Any], found: Mapping[str, Any]) -> Iterator[Publication]:
        """Where the hand goes, and what stands there."""
        if self._names.target_lift is not None:
            lifted = row["palm"] + np.array([0.0, 0.0, self._cell.settings.lift, 0.0, 0.0, 0.0, 0.0])
            yield from self._frames(stamp, [(self._names.target_lift, lifted)])
        if self._names.planning_scene is None:
            return
        objects = scene_objects(found, row["clutter"])
        gone = [f"object_{k}" for k in range(len(row["clutter"]), self._clutter)]
        self._clutter = len(row["clutter"])
        yield self._names.planning_scene, planning_scene(self._types, stamp, build.WORLD, objects, gone)

    def execute(self, topic: str, data: bytes, sender: UUID) -> float:
        assert self._remote is not None
        if topic == TARGET:
            self._remote.command(PalmCommand(self._pose(data)))
            return 0.0
        message = self._types.decode(data, v.TRAJECTORY)
        if not message.points:
            self._remote.command(StayCommand())
            return 0.0
        times, postures, rates, late = joint_path(message, self._cell.hand.spec, time.time_ns)
        self._remote.command(FingersCommand(times + late, postures, rates))
        return float(times[-1]) + late

    def _pose(self, data: bytes) -> Pose:
        message = self._types.decode(data, v.POSE)
        pose, frame, base = build.pose_in(message, "target_frame"), message.header.frame_id, self._arm.root
        if frame == base:
            return compose(self._cell.robot.base, pose)
        if frame not in ("", build.WORLD):
            raise ConfigError(f"target_frame is in {frame!r}; this cell knows {build.WORLD!r} and {base!r}")
        return pose
