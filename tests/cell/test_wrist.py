"""A camera at the wrist, and another hand: the same cell by another config."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from allegro_twin.cell.assembly import Cell, make_cell
from allegro_twin.cell.perception.pipeline import Detection
from allegro_twin.cell.run import perform
from allegro_twin.cell.settings import LabSettings
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root
from allegro_twin.files.schema import load_settings


def cell_of(config: str) -> Cell:
    return make_cell(load_settings(LabSettings, data_root() / "conf" / f"{config}.yaml"))


@pytest.fixture(scope="module")
def wrist() -> Cell:
    return cell_of("lab_allegro_wrist")


def look(cell: Cell) -> tuple[np.ndarray, np.ndarray]:
    """Depth from where the arm waits, (rows, columns), m, and which pixels are the robot's."""
    cell.arm.reset()
    cell.hand.reset()
    frame = cell.camera.capture(cell.robot.world.data)
    assert cell.self_filter is not None
    return frame.depth, cell.self_filter.mask(cell.posture, cell.open)


def test_what_the_wrist_camera_sees_of_the_hand_is_known_to_the_pixel(wrist: Cell) -> None:
    depth, mine = look(wrist)
    near = np.nan_to_num(depth, nan=9.0) < 0.35  # The fingers; the table is 0.5 m away.
    assert near.mean() > 0.02
    assert mine[near].mean() > 0.995
    for axis in (0, 1):  # And a little around it.
        for step in (-3, 3):
            assert mine[np.roll(near, step, axis)].mean() > 0.99
    assert 0.05 < mine.mean() < 0.25


def test_a_hand_that_stands_otherwise_is_seen_otherwise(wrist: Cell) -> None:
    assert wrist.self_filter is not None
    bent = wrist.self_filter.mask(wrist.posture, wrist.open + 0.5)
    assert (bent != wrist.self_filter.mask(wrist.posture, wrist.open)).mean() > 0.01


def test_the_workspace_is_seen_past_the_hand(wrist: Cell) -> None:
    _, mine = look(wrist)
    frame = wrist.camera.capture(wrist.robot.world.data)
    corners = np.array([[x, y, z] for x in (-0.13, 0.13) for y in (-0.13, 0.13) for z in (0.0, 0.1)])
    at = (corners - frame.pose.position) @ frame.pose.rotation
    lens = frame.lens
    columns = np.rint(lens.fx * at[:, 0] / at[:, 2] + lens.cx).astype(int)
    rows = np.rint(lens.fy * at[:, 1] / at[:, 2] + lens.cy).astype(int)
    assert ((columns > 0) & (columns < lens.width) & (rows > 0) & (rows < lens.height)).all()
    assert not mine[rows, columns].any()


@pytest.mark.slow
def test_without_the_hand_cut_out_a_finger_would_be_a_thing(wrist: Cell) -> None:
    wrist.arm.reset()
    wrist.hand.reset()
    wrist.robot.world.data.joint("apple").qpos[:3] = [2.0, 2.0, 1.0]
    wrist.hand.read()
    frame = wrist.camera.capture(wrist.robot.world.data)
    open_region = wrist.settings.perception.region.model_copy(
        update={"lower": (-0.3, -0.35, -0.05), "upper": (0.25, 0.35, 0.6)}
    )
    pipeline = type(wrist.pipeline)(wrist.settings.perception.model_copy(update={"region": open_region}))
    assert wrist.self_filter is not None
    seen = pipeline.detect(frame.cloud, frame.pose.position, frame.pose.rotation)
    cut = wrist.self_filter.remove_robot(frame.cloud, wrist.posture, wrist.open)
    clean = pipeline.detect(cut, frame.pose.position, frame.pose.rotation)
    assert isinstance(seen, Detection) or seen.reason != "no_object"
    assert not isinstance(clean, Detection)
    assert clean.reason == "no_object"


@pytest.mark.slow
def test_with_the_camera_at_the_wrist_a_thing_is_taken(wrist: Cell) -> None:
    report = perform(wrist)
    assert str(report.end) == "held"
    assert report.is_lifted
    assert report.error < 0.003


@pytest.mark.slow
def test_a_model_o_that_closes_its_own_loop_takes_a_can() -> None:
    report = perform(cell_of("lab_model_o"))
    assert str(report.end) == "held"
    assert report.is_lifted


def test_a_wrist_without_reach_is_refused_before_anything_moves() -> None:
    settings = load_settings(LabSettings, data_root() / "conf" / "lab_model_o.yaml")
    far = settings.security.model_copy(update={"facing": (1.0, 0.0, 0.0), "fingers": (0.0, 0.0, -1.0)})
    with pytest.raises(ConfigError, match="fer does not reach"):
        make_cell(settings.model_copy(update={"security": far}))


@pytest.mark.slow
def test_the_hand_is_cut_out_as_it_was_when_the_picture_was_taken(wrist: Cell) -> None:
    asked: list[np.ndarray] = []

    class Spy:
        def remove_robot(self, cloud: np.ndarray, arm: np.ndarray, hand: np.ndarray) -> np.ndarray:
            asked.append(np.concatenate([arm, hand]))
            assert wrist.self_filter is not None
            return wrist.self_filter.remove_robot(cloud, arm, hand)

    perform(replace(wrist, self_filter=Spy()))  # type: ignore[arg-type]  # As much of one as is used.
    np.testing.assert_allclose(asked[0], np.concatenate([wrist.posture, wrist.open]), atol=0.02)
