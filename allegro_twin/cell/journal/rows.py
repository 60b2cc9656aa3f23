"""Journal rows of a run: states, perception's findings, pictures."""

from __future__ import annotations

from typing import Any

import numpy as np

from allegro_twin.cell.actions.cell_actions import CellActions
from allegro_twin.cell.camera.camera import CameraFrame
from allegro_twin.cell.motion.other_objects import bounding_box
from allegro_twin.cell.perception.cloud import finite
from allegro_twin.cell.perception.errors import PerceptionRefusal
from allegro_twin.cell.perception.pipeline import Detection
from allegro_twin.cell.perception.settings import PerceptionSettings
from allegro_twin.cell.perception.target import GraspTarget, grasp_target
from allegro_twin.cell.states import MachineState
from allegro_twin.kinematics.pose import Pose
from allegro_twin.recording.journal import FieldKind
from allegro_twin.types import Array

EVENTS: dict[str, FieldKind] = {
    "t": "number", "state": "word", "tries": "count", "grasp": "word", "palm": "numbers", "before": "numbers",
    "weight": "number", "torque": "number", "end": "word", "reason": "word", "sentence": "word",
}  # fmt: skip
"""When each state began, s, at which try; from ToTargetPose on the grasp that was chosen, where the palm is to be for
it and before it, (7,), world; what the check said, kg and N·m; and how it ended."""
PERCEPTION: dict[str, FieldKind] = {
    "t": "number", "number": "count", "known": "count", "verdict": "word", "sentence": "word", "others": "count",
    "shape": "word", "pose": "numbers", "size": "numbers", "error": "number", "sigma": "number", "table": "numbers",
    "target": "numbers", "width": "number", "points": "array",
}  # fmt: skip
"""Columns of perception for the picture taken at `t`, s: number of known points; `found`, or the refusal; the object's
shape, pose (7,) and size (3,), m; the fit's error and the camera's scatter, m; the table's normal and height, (4,); the
target frame (7,) and its width, m; the object's points, (k, 3), float32, m. All in the world."""
PICTURES: dict[str, FieldKind] = {
    "t": "number", "number": "count", "camera": "numbers", "lens": "numbers", "colour": "array", "depth": "array",
}  # fmt: skip
"""Taken at `t`, s, from a pose (7,), world; fx, fy, cx, cy of the depth picture; colour (rows, columns, RGB); depth
(rows, columns), mm as uint16, 0 unknown, as ROS has it."""


def state_entry(now: MachineState, work: CellActions) -> dict[str, Any]:
    """A state begins."""
    way, check, end = work.target.candidate, work.held.found, now.end
    row: dict[str, Any] = {"t": now.since, "state": now.state, "tries": now.tries}
    if way is not None:
        row |= {"grasp": way.card.name, "palm": pose_numbers(way.palm), "before": pose_numbers(way.before)}
    if now.state == "ToTargetPose":
        boxes = [np.concatenate(bounding_box(points)) for points in work.target.others]
        row["clutter"] = np.array(boxes).reshape(-1, 6)  # Middle and extents of each other object, m.
    if check is not None:
        row |= {"weight": check.weight, "torque": check.torque}
    if now.state == "Retreat" and now.cause is not None:
        row |= {"reason": now.cause.reason, "sentence": now.cause.sentence}
    if end is not None:
        row |= {"end": end.kind, "reason": end.reason, "sentence": end.sentence}
    return row


def perception_entry(
    frame: CameraFrame, detection: Detection | PerceptionRefusal, settings: PerceptionSettings
) -> dict[str, Any]:
    """A picture was looked at."""
    known = int(np.count_nonzero(finite(frame.cloud)))
    row: dict[str, Any] = {"t": frame.time, "number": frame.number, "known": known}
    if not isinstance(detection, Detection):
        return row | {"verdict": detection.reason, "sentence": detection.sentence}
    solid, table = detection.solid, detection.table
    row |= {
        "verdict": "found", "others": detection.others, "shape": solid.shape, "size": solid.size, "error": solid.error,
        "pose": pose_numbers(Pose(solid.position, solid.axes)), "sigma": detection.sigma,
        "table": np.append(table.normal, table.offset), "points": detection.points.astype(np.float32),
    }  # fmt: skip
    frame_for = grasp_target(detection, settings.target)
    if isinstance(frame_for, GraspTarget):
        row |= {"target": pose_numbers(Pose(frame_for.position, frame_for.rotation)), "width": frame_for.width}
    return row


def picture_entry(frame: CameraFrame) -> dict[str, Any]:
    """A picture was taken for whoever looks on."""
    lens = frame.lens
    return {
        "t": frame.time, "number": frame.number, "camera": pose_numbers(Pose(frame.pose.position, frame.pose.rotation)),
        "lens": (lens.fx, lens.fy, lens.cx, lens.cy), "colour": frame.colour,
        "depth": np.nan_to_num(np.round(1e3 * frame.depth)).astype(np.uint16),
    }  # fmt: skip


def pose_numbers(pose: Pose) -> Array:
    """Position, m, and quaternion w x y z."""
    return np.concatenate([pose.position, pose.quaternion])
