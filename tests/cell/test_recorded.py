"""A run of the cell in one recording: all of it is there, and it is the run."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from allegro_twin.app.config import RunConfig
from allegro_twin.cell.journal.recording import config_hash
from allegro_twin.cell.run import LabReport, perform
from allegro_twin.cell.settings import LabSettings
from allegro_twin.errors import RecordingError
from allegro_twin.files.output_folder import UNFINISHED
from allegro_twin.recording.reader import CellRecording, load, load_cell
from allegro_twin.recording.replay import ReplayBackend, replay_samples
from tests.cell.test_run import SETTINGS, cell_of


@pytest.mark.slow
def test_the_states_and_their_times_and_the_end_are_those_of_the_run(run: tuple[CellRecording, LabReport]) -> None:
    found, report = run
    assert found.complete
    events = found.events("states")
    assert [(event["t"], event["state"]) for event in events] == list(report.events)
    assert (events[-1]["end"], events[-1]["weight"]) == ("held", report.checked.weight if report.checked else None)
    assert events[2]["grasp"] == "apple"


@pytest.mark.slow
def test_it_holds_the_config_its_hash_and_what_made_it(run: tuple[CellRecording, LabReport]) -> None:
    found, _ = run
    again = LabSettings.model_validate(found.meta["config"])
    assert again == SETTINGS
    assert found.meta["config_hash"] == config_hash(SETTINGS)
    assert config_hash(SETTINGS.model_copy(update={"lift": 0.2})) != config_hash(SETTINGS)
    assert set(found.meta) >= {"engine", "model", "look", "allegro_twin"}


@pytest.mark.slow
def test_what_perception_saw_is_there_with_its_points_and_its_target(run: tuple[CellRecording, LabReport]) -> None:
    found, report = run
    assert report.solid is not None
    (event,) = found.events("perception")
    assert (event["verdict"], event["shape"], event["others"]) == ("found", "sphere", 0)
    np.testing.assert_array_equal(event["pose"][:3], report.solid.position)
    assert np.linalg.norm(event["points"] - event["pose"][:3], axis=1).max() < 0.06
    assert event["target"][2] > event["pose"][2] + 0.08  # Above the ball, by its radius and the offset.
    assert event["known"] > 100_000


@pytest.mark.slow
def test_pictures_have_colour_and_depth_and_change_nothing_of_the_run(run: tuple[CellRecording, LabReport]) -> None:
    found, report = run
    pictures = found.events("pictures")
    assert np.diff([picture["t"] for picture in pictures]) == pytest.approx(0.5, abs=0.004)
    assert pictures[0]["colour"].shape == (480, 640, 3)
    assert pictures[0]["depth"].dtype == np.uint16
    _, _, cx, cy = pictures[0]["lens"]
    down = float(pictures[0]["depth"][round(cy), round(cx)]) / 1000.0
    assert down == pytest.approx(np.hypot(0.36, 0.41), rel=0.2)  # What stands in the middle of the table is before it.
    cell = cell_of()
    alone = perform(cell)
    cell.close()
    assert alone.events == report.events
    assert alone.checked == report.checked


@pytest.mark.slow
def test_arm_and_hand_are_replayed_from_the_one_file(run: tuple[CellRecording, LabReport]) -> None:
    from allegro_twin.app import assemble

    found, _ = run
    arm, hand = (load(found.path, track=name) for name in ("arm", "hand"))
    assert (arm.spec.name, hand.spec.name) == ("fer", "allegro_right")
    lifted = arm.columns["tool"][-1, 2] - arm.columns["tool"][:, 2].min()
    assert lifted == pytest.approx(0.15, abs=0.02)
    assert hand.columns["object"][-1, 2] > 0.15
    np.testing.assert_allclose(hand.columns["palm"][-1, :3], arm.columns["tool"][-1, :3], atol=1e-4)
    states = [state for state, _ in replay_samples(ReplayBackend(arm))]
    assert states[-1].wrench.shape == (6,)
    backend = {"kind": "replay", "file": str(found.path), "track": "hand"}
    rig = assemble(RunConfig.model_validate({"backend": backend, "controller": {"kind": "pd"}, "period": hand.period,
                                             "task": {"posture": "home"}}))  # fmt: skip
    np.testing.assert_array_equal(rig.backend.reset().position, hand.columns["position"][0])
    arm_rig = assemble(RunConfig.model_validate({
        "hand": {"model": "fer"}, "backend": backend | {"track": "arm"}, "controller": {"kind": "torque"},
        "period": arm.period}))  # fmt: skip
    np.testing.assert_array_equal(arm_rig.backend.reset().position, arm.columns["position"][0])


@pytest.mark.slow
def test_a_run_that_is_killed_leaves_all_that_was_whole(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "allegro_twin", "lab", "conf/lab_allegro.yaml", "--out", str(tmp_path)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    path = tmp_path / UNFINISHED / "lab.arrow"
    while not (path.exists() and path.stat().st_size > 1_500_000):
        assert process.poll() is None, "it ended before it could be killed"
        time.sleep(0.002)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    try:
        found = load_cell(path)
    except RecordingError as error:
        message = str(error)
        assert "is cut short after" in message
        found = load_cell(path, partial=True)
    assert not found.complete
    arm, hand = found.device("arm"), found.device("hand")
    for device in (arm, hand):
        assert len(device) % 100 == 0
        np.testing.assert_array_equal(device.columns["tick"], np.arange(len(device)))
    assert [event["state"] for event in found.events("states")][:3] == ["ToSecurityPose", "Look", "ToTargetPose"]
    assert len(found.events("perception")) == 1
