"""A run of the cell in Rerun: everything is there, at its time and in its place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

pytest.importorskip("rerun", reason="needs the extra view")

from allegro_twin.cell.camera.camera import DepthCamera
from allegro_twin.cell.journal.observers import Observers
from allegro_twin.cell.journal.recording import SessionRecorder
from allegro_twin.cell.run import LabReport, perform
from allegro_twin.recording.events import DeviceSample, session_events
from allegro_twin.recording.reader import CellRecording, load_cell
from allegro_twin.surfaces.cli.main import app
from allegro_twin.viewing.rerun.viewer import viewer_of, write_events
from tests.cell.test_run import cell_of
from tests.viewing.test_viewer import Rows, rows_of

Run = tuple[CellRecording, LabReport]


@pytest.mark.slow
def test_a_run_that_ends_before_the_arm_heads_for_anything_is_drawn_with_its_end(tmp_path: Path) -> None:
    cell = cell_of()
    assert isinstance(cell.camera, DepthCamera)
    cell.camera.freeze()
    recorded = SessionRecorder(cell, tmp_path / "lab.arrow")
    looking = Observers(cell, [recorded])
    perform(cell, arm=looking.arm, hand=looking.hand, on_state=looking.on_state, on_prepare=looking.on_prepare)
    recorded.close()
    cell.close()
    found = load_cell(tmp_path / "lab.arrow")
    write_events(session_events(found), viewer_of(found), tmp_path / "lab.rrd")
    drawn = rows_of(tmp_path / "lab.rrd")
    assert [row["state"][0] for _, row in drawn["cell/state"]] == ["ToSecurityPose", "Look", "fault: camera"]
    for path in ("world/arm/fer_link7/look", "world/palm/look", "world/objects/apple/look", "arm/torque"):
        assert drawn[path], path


@pytest.fixture(scope="module")
def drawn(run: tuple[CellRecording, LabReport], tmp_path_factory: pytest.TempPathFactory) -> Rows:
    path = tmp_path_factory.mktemp("view") / "lab.rrd"
    write_events(session_events(run[0]), viewer_of(run[0]), path)
    return rows_of(path)


@pytest.mark.slow
def test_the_scene_has_the_arm_the_hand_the_thing_the_cloud_and_every_frame(drawn: Rows) -> None:
    for path in (
        "world/fixed", "world/arm/fer_link7/look", "world/flange/look", "world/palm/look", "world/objects/apple/look",
        "world/seen/points", "world/seen/fitted", "world/target", "world/goal", "world/tool", "world/camera/cloud",
        "cell/colour", "cell/depth",
    ):  # fmt: skip
        assert drawn[path], path


@pytest.mark.slow
def test_the_arms_last_link_carries_the_hand_where_the_encoders_say(drawn: Rows, run: Run) -> None:
    """Links are drawn by their own chain; flange and palm by another: they agree."""
    chain = np.eye(4)
    chain[:3, 3] = drawn["world/arm"][0][1]["translation"][0]
    arm = run[0].device("arm")
    base, flange = chain[:3, 3], drawn["world/flange"]
    assert base == pytest.approx([-0.55, 0.0, 0.0])
    last = drawn["world/arm/fer_link7"][-1][1]
    turn = np.array(last["mat3x3"][0]).reshape(3, 3).T
    place = base + np.array(last["translation"][0])
    found = place + turn @ [0.0, 0.0, 0.107]  # The flange on link 7, franka.github.io.
    np.testing.assert_allclose(found, flange[-1][1]["translation"][0], atol=1e-3)
    np.testing.assert_allclose(flange[-1][1]["translation"][0], arm.columns["flange"][-1, :3], atol=2e-3)


@pytest.mark.slow
def test_states_are_marked_at_their_times_with_the_end_and_a_log_of_reasons(drawn: Rows, run: Run) -> None:
    marks = [(t, row["state"][0]) for t, row in drawn["cell/state"]]
    assert [name for _, name in marks][:3] == ["ToSecurityPose", "Look", "ToTargetPose"]
    assert marks[-1][1] == "held"
    assert marks[-1][0] == pytest.approx(run[1].events[-1][0])
    words = [row["text"][0] for _, row in drawn["cell/log"]]
    assert any("a sphere of 75 x 75 x 75 mm" in line for line in words)
    assert "ToTargetPose: grasp apple" in words
    assert words[-1] == "Done — held"


@pytest.mark.slow
def test_the_force_is_smoothed_and_says_the_weight_after_the_lift(drawn: Rows, run: Run) -> None:
    samples = [each for each in session_events(run[0]) if isinstance(each, DeviceSample) and each.device == "arm"]
    noise = float(np.std([each.extras["force"][2] for each in samples[-100:]]))
    smooth = [row["scalars"][2] for _, row in drawn["cell/force"][-15:]]
    assert noise > 1.0
    assert float(np.std(smooth)) < 0.5
    torques = [row["scalars"] for _, row in drawn["arm/torque"] if "scalars" in row]  # What names them may come first.
    assert len(torques[0]) == 7


@pytest.mark.slow
def test_the_command_writes_a_file_for_rerun_and_a_track_for_tables(
    run: tuple[CellRecording, LabReport], tmp_path: Path
) -> None:
    done = CliRunner().invoke(app, ["export", str(run[0].path), str(tmp_path / "a.rrd")])
    assert done.exit_code == 0, done.output
    assert rows_of(tmp_path / "a.rrd")["cell/state"]
    done = CliRunner().invoke(app, ["export", str(run[0].path), str(tmp_path / "a.csv"), "--track", "arm"])
    assert done.exit_code == 0, done.output
    assert "position.fer_joint1" in (tmp_path / "a.csv").read_text().splitlines()[0]
