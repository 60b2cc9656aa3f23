"""Journal entries in Rerun: states of a cell, detections of its perception, pictures of its camera."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import rerun as rr

from allegro_twin.recording.events import JournalEntry
from allegro_twin.types import Array

_POINT, _AXES = 0.0012, 0.08  # m.
_CLOUD = 4  # Of every so many rows and columns a point is drawn.
_THING, _FITTED = (255, 120, 20), (255, 120, 20, 120)
_JPEG = 85
_PLANE = 0.08  # m: how far before the camera its picture hangs in the scene.


def draw_entry(stream: rr.RecordingStream, entry: JournalEntry) -> None:
    """Draw one entry of a journal."""
    row = entry.row
    stream.set_time("time", duration=float(row["t"]))
    match entry.track:
        case "states":
            _state(stream, row)
        case "perception":
            _perception(stream, row)
        case "pictures":
            _picture(stream, row)
    stream.reset_time()


def _state(stream: rr.RecordingStream, row: Mapping[str, Any]) -> None:
    again = f" (try {row['tries']})" if row["tries"] > 1 else ""
    mark, words, level = row["state"] + again, row["state"] + again, rr.TextLogLevel.INFO
    if row["state"] == "ToTargetPose":
        words += f": grasp {row['grasp']}"
    end = row.get("end")
    if row.get("sentence") and end is None:
        words, level = f"{row['reason']}: {row['sentence']}", rr.TextLogLevel.WARN
    if end is not None:
        reason = f": {row['reason']}" if row["reason"] else ""
        words += f" — {end}{reason}" + (f"; {row['sentence']}" if row["sentence"] else "")
        level = rr.TextLogLevel.INFO if end == "held" else rr.TextLogLevel.WARN
        mark = f"{end}{reason}"
    stream.log("cell/state", rr.StateChange(state=mark))
    stream.log("cell/log", rr.TextLog(words, level=level))


def _perception(stream: rr.RecordingStream, row: Mapping[str, Any]) -> None:
    if row["verdict"] != "found":
        words = f"perception: {row['verdict']}; {row['sentence']}"
        stream.log("cell/log", rr.TextLog(words, level=rr.TextLogLevel.WARN))
        return
    size = " x ".join(f"{1e3 * edge:.0f}" for edge in row["size"])
    words = f"perception: a {row['shape']} of {size} mm, {len(row['points'])} points, fit {1e3 * row['error']:.1f} mm"
    stream.log("cell/log", rr.TextLog(words, level=rr.TextLogLevel.INFO))
    stream.log("world/seen/points", rr.Points3D(row["points"], colors=[_THING], radii=[_POINT]))
    pose = row["pose"]
    fitted = rr.Boxes3D(
        half_sizes=[np.array(row["size"]) / 2.0], centers=[pose[:3]], quaternions=[pose[[4, 5, 6, 3]]],
        colors=[_FITTED], fill_mode="majorwireframe",
    )  # fmt: skip
    stream.log("world/seen/fitted", fitted)
    if row["target"] is not None:
        stream.log("world/target", _pose(row["target"]), rr.TransformAxes3D(_AXES))


def _picture(stream: rr.RecordingStream, row: Mapping[str, Any]) -> None:
    fx, fy, cx, cy = row["lens"]
    depth = row["depth"]
    high, wide = depth.shape
    stream.log("world/camera", _pose(row["camera"]))
    matrix = [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]
    lens = rr.Pinhole(
        image_from_camera=matrix, resolution=[wide, high], camera_xyz=rr.ViewCoordinates.RDF,
        image_plane_distance=_PLANE,
    )  # fmt: skip
    stream.log("world/camera/lens", lens)
    stream.log("cell/depth", rr.DepthImage(depth, meter=1000.0, colormap=rr.components.Colormap.Turbo))
    if row["colour"] is not None:
        picture = rr.Image(row["colour"]).compress(jpeg_quality=_JPEG)
        stream.log("cell/colour", picture)
    points = _cloud(depth[::_CLOUD, ::_CLOUD], np.array([fx, fy, cx, cy]) / _CLOUD)
    stream.log("world/camera/cloud", rr.Points3D(points, colors=[(90, 100, 115)], radii=[_POINT]))


def _cloud(depth: Array, lens: Array) -> Array:
    """Points of a depth picture, mm, 0 unknown, in the camera's frame, (k, 3), m."""
    rows, columns = np.nonzero(depth)
    z = depth[rows, columns] / 1000.0
    fx, fy, cx, cy = lens
    return np.stack([(columns - cx) / fx * z, (rows - cy) / fy * z, z], axis=1).astype(np.float32)


def _pose(pose: Array) -> rr.Transform3D:
    """Rerun transform of a pose: position, m, and quaternion w x y z."""
    return rr.Transform3D(translation=pose[:3], quaternion=pose[[4, 5, 6, 3]])
