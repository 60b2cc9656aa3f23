"""Grasps as YAML that people read: poses of the palm in the object's frame, angles by finger."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from allegro_twin.errors import ConfigError
from allegro_twin.files.atomic_write import atomic_file
from allegro_twin.files.schema import Settings, load_settings
from allegro_twin.files.yaml_edit import replace_document
from allegro_twin.grasping.interchange.grasps import FRAMES, PALM, STAGES, Grasps, check_grasps, check_hand
from allegro_twin.grasping.interchange.orders import check_limits
from allegro_twin.hands.library.entries import Angles, angles_by_finger, joint_vector
from allegro_twin.spec import HandSpec, Side

Pose = Annotated[list[float], Field(min_length=7, max_length=7)]


class StagePose(Settings):
    """One posture and where the hand then is."""

    pose: Pose
    """Pose of `frame` in the world of `object_pose`: position, m; w, x, y, z."""
    angles: Angles


class YamlGrasp(Settings):
    """One grasp."""

    object_pose: Pose
    scale: Annotated[float, Field(gt=0)] = 1.0
    approach: tuple[StagePose, ...] = ()
    preshape: StagePose
    close: StagePose
    squeeze: StagePose


class YamlGrasps(Settings):
    """Grasps of one hand on one object."""

    object: str
    """A name of the catalogue, or a mesh, which is looked for beside this file, then in the working directory."""
    hand: str | None = None
    """The model of hand that they are of; None: the one that they are read for."""
    side: Side = "right"
    frame: str = PALM.name
    """Frame of the hand: `palm`, ours, or `menagerie`."""
    grasps: tuple[YamlGrasp, ...]


def read_yaml_grasps(path: Path, spec: HandSpec) -> Grasps:
    """The grasps of a file. Raises ConfigError."""
    file, where = load_settings(YamlGrasps, path), str(path)
    if file.frame not in FRAMES:
        raise ConfigError(f"{where}: frame is one of {', '.join(FRAMES)}, not {file.frame!r}")
    check_hand(file.hand, file.side, spec, where)
    stages = [[*entry.approach, entry.preshape, entry.close, entry.squeeze] for entry in file.grasps]
    if len({len(row) for row in stages}) > 1:
        raise ConfigError(f"{where}: every grasp of a file has an approach of the same number of stages")
    poses = [[stage.pose for stage in row] for row in stages]
    joints = [[joint_vector(s.angles, spec, f"{where}: grasp {k}") for s in row] for k, row in enumerate(stages)]
    if joints:
        check_limits(np.array(joints, dtype=np.float64), spec, where)
    return check_grasps(
        spec, poses, joints, [entry.object_pose for entry in file.grasps] or np.zeros((0, 7)),
        [entry.scale for entry in file.grasps], object_name=file.object, frame=FRAMES[file.frame], source=where,
    )  # fmt: skip


def write_yaml_grasps(path: Path, grasps: Grasps) -> None:
    """Write grasps to a file; read again they are the same to the last bit. Raises RecordingError."""
    content = {
        "object": grasps.object,
        "hand": grasps.spec.model,
        "side": grasps.spec.side,
        "frame": grasps.frame.name,
        "grasps": [_entry(grasps, row) for row in range(len(grasps))],
    }
    with atomic_file(path) as temporary:
        temporary.write_text(replace_document("", content, str(path)), encoding="utf-8")


def _entry(grasps: Grasps, row: int) -> dict[str, Any]:
    stages = [
        {"pose": pose.tolist(), "angles": angles_by_finger(joints, grasps.spec)}
        for pose, joints in zip(grasps.hand[row], grasps.joints[row], strict=True)
    ]
    entry = {"object_pose": grasps.object_pose[row].tolist(), "scale": float(grasps.scale[row])}
    way = {"approach": stages[:-3]} if len(stages) > 3 else {}
    return entry | way | dict(zip(STAGES, stages[-3:], strict=True))
