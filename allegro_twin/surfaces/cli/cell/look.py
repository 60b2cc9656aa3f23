"""The command `lab-look`: what a cell's perception finds in one picture, simulated, real or recorded."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from allegro_twin.errors import ConfigError
from allegro_twin.surfaces.cli import options

if TYPE_CHECKING:
    from collections.abc import Sequence

    from allegro_twin.cell.assembly import Cell
    from allegro_twin.cell.camera.camera import CameraFrame
    from allegro_twin.cell.perception.errors import PerceptionRefusal
    from allegro_twin.cell.perception.pipeline import Detection
    from allegro_twin.cell.settings import LabSettings
    from allegro_twin.types import Array

REFUSED = 5
"""Exit code where perception found nothing to take."""


def lab_look(
    config: Annotated[Path, typer.Argument(help="Config of a cell, such as conf/lab_allegro.yaml.")],
    bag: Annotated[Path | None, typer.Option(help="Look at a ROS bag with depth or clouds.")] = None,
    topic: Annotated[str | None, typer.Option(help="Topic of --bag; default: its only depth.")] = None,
    at: Annotated[float, typer.Option(min=0.0, help="Take the picture so far into the bag, s.")] = 0.0,
    tf: Annotated[bool, typer.Option("--tf", help="Take the camera's pose from the bag.")] = False,
    out: Annotated[
        Path | None,
        typer.Option(help="Write picture and planning scene, an .mcap; replaces it.", callback=options.file(".mcap")),
    ] = None,
) -> None:
    """Take one picture with a cell's camera and show what is seen."""
    from allegro_twin.cell.assembly import make_cell
    from allegro_twin.cell.motion.other_objects import other_objects
    from allegro_twin.cell.perception.pipeline import Detection
    from allegro_twin.cell.settings import LabSettings
    from allegro_twin.files.assets import find_file
    from allegro_twin.files.schema import load_settings
    from allegro_twin.surfaces.cli.console import console, say

    settings = load_settings(LabSettings, find_file(config, "config", "conf"))
    if bag is not None:
        settings = _from_bag(settings, bag, topic, tf)
    elif topic is not None or at or tf:
        raise ConfigError("--topic, --at and --tf are of a recording: name one by --bag")
    cell = make_cell(settings)
    try:
        frame = _picture(cell, at)
        alone = cell.self_filter.remove_robot(frame.cloud, cell.posture, cell.open)
        cloud = alone if settings.at_the_wrist else frame.cloud
        seen = cell.pipeline.detect(cloud, frame.pose.position, frame.pose.rotation)
        console.print(_frame_line(frame), highlight=False, soft_wrap=True)
        others = other_objects(frame, alone, seen, settings.perception) if isinstance(seen, Detection) else ()
        if out is not None:
            _write(out, frame, seen, others, settings)
        if not isinstance(seen, Detection):
            say(f"refused: {seen.reason}; {seen.sentence}")
            raise typer.Exit(REFUSED)
        for line in _lines(seen, len(others)):
            console.print(line, highlight=False, soft_wrap=True)
    finally:
        cell.close()


def _from_bag(settings: LabSettings, bag: Path, topic: str | None, tf: bool) -> LabSettings:
    from allegro_twin.cell.camera.settings import RecordingSource

    source = RecordingSource(file=str(bag), topic=topic, pose="bag" if tf else "config")
    camera = settings.camera.model_copy(update={"source": source})
    return settings.model_copy(update={"camera": camera})


def _picture(cell: Cell, at: float) -> CameraFrame:
    """The picture of a cell at rest, so many s after the first."""
    cell.arm.reset()
    cell.hand.reset()
    data = cell.robot.world.data
    frame = cell.camera.capture(data)
    if at > 0.0:
        begin, data.time = frame.time, data.time + at
        frame = cell.camera.capture(data)
        if (end := frame.time - begin) < at - 1.0:
            raise ConfigError(f"--at {at:g} s is after the last picture, which is at {end:.2f} s")
    return frame


def _frame_line(frame: CameraFrame) -> str:
    import numpy as np

    known = 100.0 * float(np.mean(~np.isnan(frame.depth)))
    x, y, z = frame.pose.position
    return (
        f"picture {frame.number}: {frame.lens.width} x {frame.lens.height}, {known:.0f} % known, from "
        f"({x:.3f}, {y:.3f}, {z:.3f}) m"
    )


def _lines(seen: Detection, others: int) -> list[str]:
    from allegro_twin.surfaces.cli.cell.lab import solid_text

    x, y, z = seen.solid.position
    return [f"seen: {solid_text(seen.solid)} at ({x:.3f}, {y:.3f}, {z:.3f}) m", f"other objects: {others}"]


def _write(
    path: Path, frame: CameraFrame, seen: Detection | PerceptionRefusal, others: Sequence[Array], settings: LabSettings
) -> None:
    """The picture as a camera's driver records it, and what was seen in it as MoveIt's planning scene."""
    import numpy as np

    from allegro_twin.cell.journal.rows import perception_entry, pose_numbers
    from allegro_twin.cell.journal.scene_objects import scene_objects
    from allegro_twin.cell.motion.other_objects import bounding_box
    from allegro_twin.cell.perception.pipeline import Detection
    from allegro_twin.kinematics.pose import Pose
    from allegro_twin.recording.exchange.rosbag import messages_to_mcap
    from allegro_twin.recording.messages import build
    from allegro_twin.recording.messages.bag_topics import BagMessage, BagTopic
    from allegro_twin.recording.messages.message_types import TF, ros_types
    from allegro_twin.recording.messages.planning_scene import planning_scene
    from allegro_twin.surfaces.ros.cell_topics import CAMERA

    words, at, lens = ros_types(), max(round(1e9 * frame.time), 0), frame.lens
    place = build.transform(words, at, build.WORLD, CAMERA, pose_numbers(Pose(*frame.pose)))
    shown = {
        "/tf_static": words.make(TF, transforms=[place]),
        "/camera/depth/camera_info": build.camera_info(words, at, CAMERA, (*lens[:2], *lens[2:])),
        "/camera/depth/image_rect_raw": build.depth_image(words, at, CAMERA, frame.depth),
    }
    if isinstance(seen, Detection):
        clutter = np.array([np.concatenate(bounding_box(points)) for points in others]).reshape(-1, 6)
        objects = scene_objects(perception_entry(frame, seen, settings.perception), clutter)
        shown["/planning_scene"] = planning_scene(words, at, build.WORLD, objects)
    latched = ("/tf_static", "/planning_scene")
    kinds = [BagTopic(name, message.__msgtype__, name in latched) for name, message in shown.items()]
    messages_to_mcap(path, kinds, [BagMessage(name, at, message) for name, message in shown.items()])
