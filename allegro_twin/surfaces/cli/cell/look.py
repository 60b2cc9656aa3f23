"""The command `lab-look`: what a cell's perception finds in one picture, simulated, real or recorded."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from allegro_twin.errors import ConfigError

if TYPE_CHECKING:
    from allegro_twin.cell.assembly import Cell
    from allegro_twin.cell.camera.camera import CameraFrame
    from allegro_twin.cell.perception.pipeline import Detection
    from allegro_twin.cell.settings import LabSettings

REFUSED = 5
"""Exit code where perception found nothing to take."""


def lab_look(
    config: Annotated[Path, typer.Argument(help="Config of a cell, such as conf/lab_allegro.yaml.")],
    bag: Annotated[Path | None, typer.Option(help="Look at a ROS bag with depth or clouds.")] = None,
    topic: Annotated[str | None, typer.Option(help="Topic of --bag; default: its only depth.")] = None,
    at: Annotated[float, typer.Option(min=0.0, help="Take the picture so far into the bag, s.")] = 0.0,
    tf: Annotated[bool, typer.Option("--tf", help="Take the camera's pose from the bag.")] = False,
) -> None:
    """Take one picture with a cell's camera and show what is seen."""
    from allegro_twin.cell.assembly import make_cell
    from allegro_twin.cell.motion.other_objects import other_objects
    from allegro_twin.cell.perception.pipeline import Detection
    from allegro_twin.cell.settings import LabSettings
    from allegro_twin.files.assets import find_file
    from allegro_twin.files.schema import load_settings
    from allegro_twin.surfaces.cli.console import console

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
        if not isinstance(seen, Detection):
            console.print(f"refused: {seen.reason}; {seen.sentence}", highlight=False, soft_wrap=True)
            raise typer.Exit(REFUSED)
        for line in _lines(seen, len(other_objects(frame, alone, seen, settings.perception))):
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
    solid = seen.solid
    size = " x ".join(f"{1e3 * edge:.0f}" for edge in solid.size)
    x, y, z = solid.position
    return [f"seen: a {solid.shape} of {size} mm at ({x:.3f}, {y:.3f}, {z:.3f}) m", f"other objects: {others}"]
