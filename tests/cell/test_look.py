"""`lab-look` sees the same in a cell's own picture and in a bag of that picture."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from allegro_twin.cell.actions.cell_actions import CellActions
from allegro_twin.cell.assembly import make_cell
from allegro_twin.cell.camera.camera import CameraFrame
from allegro_twin.cell.camera.settings import RecordingSource
from allegro_twin.cell.perception.errors import check_age
from allegro_twin.cell.perception.pipeline import Detection
from allegro_twin.cell.run import perform
from allegro_twin.cell.settings import LabSettings
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root
from allegro_twin.files.schema import load_settings
from allegro_twin.kinematics.orientation import quaternion_from_matrix
from allegro_twin.recording.exchange.rosbag import open_bag
from allegro_twin.recording.messages.message_types import ros_types
from allegro_twin.recording.messages.planning_scene import PLANNING_SCENE
from tests.recording.depth_bags import FRAME, SECOND, bag
from tests.surfaces.cli.conftest import Run, command

__all__ = ["command"]  # The command line in this process, as a fixture.
T0 = 1_700_000_000 * SECOND


@pytest.fixture(scope="module")
def frame() -> CameraFrame:
    """What the cell's camera sees of an apple."""
    try:
        cell = make_cell(load_settings(LabSettings, data_root() / "conf/lab_allegro.yaml"))
    except ConfigError as error:
        if "cannot render" in str(error):
            pytest.skip(str(error))
        raise
    cell.arm.reset()
    try:
        return cell.camera.capture(cell.robot.world.data)
    finally:
        cell.close()


def written(path: Path, frame: CameraFrame, *, cloud: bool = False) -> Path:
    """A bag: half a second of an empty picture, then this one."""
    place = np.concatenate([frame.pose.position, quaternion_from_matrix(frame.pose.rotation)])
    with bag(path) as made:
        made.transform(T0, "world", FRAME, place)
        made.info(T0, (*frame.lens,))
        for at, depth in ((T0, np.zeros_like(frame.depth)), (T0 + SECOND // 2, np.nan_to_num(frame.depth))):
            if cloud:
                made.cloud(at, frame.lens.cloud(np.where(depth > 0.0, depth, np.nan).astype(np.float32)))
            else:
                made.image(at, np.rint(1000.0 * depth))
    return path


def place(shown: str) -> list[float]:
    found = re.search(r"seen: a sphere of 7[0-9] mm at \((.*), (.*), (.*)\) m", shown)
    assert found, shown
    return [float(value) for value in found.groups()]


class Seen(Exception):
    """The first answer of perception."""


def test_a_bag_of_one_picture_is_looked_at_in_a_run(frame: CameraFrame, tmp_path: Path) -> None:
    with bag(tmp_path / "one.mcap") as made:
        made.info(T0, (*frame.lens,))
        made.image(T0, np.rint(1000.0 * np.nan_to_num(frame.depth)))
    settings = load_settings(LabSettings, data_root() / "conf/lab_allegro.yaml")
    source = RecordingSource(file=str(tmp_path / "one.mcap"))
    camera = settings.camera.model_copy(update={"source": source})
    cell = make_cell(settings.model_copy(update={"camera": camera}))

    def prepare(actions: CellActions) -> None:
        def seen(picture: CameraFrame, what: object) -> None:
            raise Seen(what)

        actions.on_detection = seen

    with pytest.raises(Seen) as told:
        perform(cell, on_prepare=prepare)
    cell.close()
    what = told.value.args[0]
    assert isinstance(what, Detection)
    assert what.solid.shape == "sphere"


def test_a_recording_that_has_ended_is_not_said_to_have_a_cable() -> None:
    old = check_age(1.0, 2.0, 0.3, recorded=True)
    assert old is not None
    assert "the recording's newest picture is 1.00 s old, more than 0.3 s: it has ended" in old.sentence
    assert "cable" not in old.sentence


@pytest.mark.parametrize("cloud", [False, True])
@pytest.mark.parametrize("tf", [[], ["--tf"]])
def test_a_bag_shows_the_apple_where_the_camera_saw_it(
    frame: CameraFrame, tmp_path: Path, command: Run, cloud: bool, tf: list[str]
) -> None:
    path = written(tmp_path / "look.mcap", frame, cloud=cloud)
    code, shown, _ = command("lab-look", "lab_allegro", "--bag", path, "--at", 0.5, *tf)
    assert code == 0
    assert "picture 1: 640 x 480" in shown
    np.testing.assert_allclose(place(shown), [0.0, 0.03, 0.0375], atol=0.003)


def test_an_empty_picture_is_refused_with_its_reason(frame: CameraFrame, tmp_path: Path, command: Run) -> None:
    code, shown, _ = command("lab-look", "lab_allegro", "--bag", written(tmp_path / "look.mcap", frame))
    assert code == 5
    assert "picture 0: 640 x 480, 0 % known" in shown
    assert "refused: " in shown


@pytest.mark.parametrize(
    ("options", "code", "said"),
    [
        (["--at", 0.5], 2, "--topic, --at and --tf are of a recording: name one by --bag"),
        (["--bag", "none.mcap"], 2, "no bag at none.mcap"),
    ],
)
def test_what_is_wrong_with_a_look_is_one_line(command: Run, options: list[object], code: int, said: str) -> None:
    ended, _, complaint = command("lab-look", "lab_allegro", *options)
    assert ended == code
    assert said in complaint


def test_a_time_after_the_recording_is_refused(frame: CameraFrame, tmp_path: Path, command: Run) -> None:
    path = written(tmp_path / "look.mcap", frame)
    code, _, complaint = command("lab-look", "lab_allegro", "--bag", path, "--at", 9)
    assert code == 2
    assert "--at 9 s is after the last picture, which is at 0.50 s" in complaint


def test_what_is_written_is_seen_again_and_has_moveits_planning_scene(tmp_path: Path, command: Run) -> None:
    path = tmp_path / "look.mcap"
    code, shown, _ = command("lab-look", "lab_allegro", "--out", path)
    assert code == 0
    again, shown_again, _ = command("lab-look", "lab_allegro", "--bag", path, "--tf")
    assert again == 0
    np.testing.assert_allclose(place(shown_again), place(shown), atol=1e-9)
    with open_bag(path) as reader:
        (scene,) = [
            ros_types().decode(bytes(data), PLANNING_SCENE)
            for connection, _, data in reader.messages()
            if connection.topic == "/planning_scene"
        ]
    assert [each.id for each in scene.world.collision_objects] == ["table", "target"]
