"""The whole cell: a thing is seen, taken and held; and what goes wrong ends by its name with the arm standing still."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from allegro_twin.cell.actions.cell_actions import CellActions
from allegro_twin.cell.arm.faults import SilentBackend
from allegro_twin.cell.assembly import Cell, make_cell
from allegro_twin.cell.camera.camera import DepthCamera
from allegro_twin.cell.journal.observers import Observers, StatePictures
from allegro_twin.cell.run import LabReport, perform
from allegro_twin.cell.settings import LabSettings
from allegro_twin.cell.states import MachineState
from allegro_twin.errors import HandFault
from allegro_twin.files.assets import data_root
from allegro_twin.files.schema import load_settings
from allegro_twin.types import HandState

SETTINGS = load_settings(LabSettings, data_root() / "conf" / "lab_allegro.yaml")


def cell_of(**changes: Any) -> Cell:
    return make_cell(LabSettings.model_validate(SETTINGS.model_dump() | changes))


def still(cell: Cell) -> bool:
    """Whether the arm stands, to a hundredth of a radian a second."""
    return float(np.abs(cell.robot.world.data.qvel[:7]).max()) < 0.02


def states(report: LabReport) -> list[str]:
    return [state for _, state in report.events]


def test_a_thing_is_seen_taken_lifted_and_said_to_be_held(tmp_path: Path) -> None:
    cell = cell_of()
    kept = StatePictures(cell, tmp_path)
    looking = Observers(cell, [kept])
    report = perform(cell, arm=looking.arm, hand=looking.hand, on_state=looking.on_state, on_prepare=looking.on_prepare)
    assert str(report.end) == "held"
    assert states(report) == [
        "ToSecurityPose", "Look", "ToTargetPose", "Approach", "ClosingHand", "ToLiftedPose", "Validate", "Done",
    ]  # fmt: skip
    assert report.is_lifted
    assert report.error < 0.003
    assert report.grasp == "apple"
    assert report.checked is not None
    assert report.checked.by_fingers
    assert report.end.sentence == ""
    assert report.checked.weight == pytest.approx(0.068, abs=0.06)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["before.png", "end.png", "grasp.png"]
    kept.close()
    cell.close()


def looks_of(cell: Cell) -> list[Any]:
    """What perception says until the arm heads for a target: times and answers."""
    said: list[Any] = []

    class Enough(Exception):
        pass

    def entered(now: MachineState) -> None:
        if now.state == "ToTargetPose":
            raise Enough

    def prepare(actions: CellActions) -> None:
        actions.on_detection = lambda frame, seen: said.append((frame.time, seen))

    try:
        perform(cell, on_state=entered, on_prepare=prepare)
    except Enough:
        pass
    cell.close()
    return said


@pytest.mark.slow
def test_where_a_target_is_to_stand_still_the_cell_looks_until_it_does() -> None:
    asked = SETTINGS.perception.model_dump() | {"steady": {"count": 4, "window": 0.5}}
    assert len(looks_of(cell_of())) == 1
    looks = looks_of(cell_of(perception=asked))
    assert len(looks) >= 4
    assert len({time for time, _ in looks}) == len(looks)


@pytest.mark.slow
def test_a_target_that_does_not_stand_still_is_refused_and_the_arm_does_not_go_there() -> None:
    asked = SETTINGS.perception.model_dump() | {"steady": {"still": 1e-9, "window": 0.6}}
    report = perform(cell_of(perception=asked, timeouts=SETTINGS.timeouts.model_dump() | {"look": 1.5}))
    assert str(report.end) == "refused: unsteady"
    assert "wait until the thing and the arm stand still" in report.end.sentence
    assert "ToTargetPose" not in states(report)


@pytest.mark.slow
def test_by_events_the_same_is_done_in_less_time() -> None:
    clock, event = cell_of(), cell_of(decide={"by": "event"})
    slow, fast = perform(clock), perform(event)
    assert (slow.end.kind, fast.end.kind) == ("held", "held")
    assert fast.events[-1][0] < slow.events[-1][0]


def test_a_camera_that_is_frozen_is_named_and_nothing_moves() -> None:
    cell = cell_of()
    assert isinstance(cell.camera, DepthCamera)
    cell.camera.freeze()
    report = perform(cell)
    assert str(report.end) == "fault: camera"
    assert "it is frozen, or its cable is out" in report.end.sentence
    assert states(report) == ["ToSecurityPose", "Look", "Done"]
    assert still(cell)


def test_a_thing_outside_the_workspace_is_refused_and_nothing_moves() -> None:
    cell = cell_of(objects=[{"name": "apple", "at": [0.0, 0.25]}])
    report = perform(cell)
    assert str(report.end) == "refused: outside"
    assert "outside the workspace" in report.end.sentence
    assert still(cell)


def test_an_empty_table_is_refused() -> None:
    cell = cell_of()
    gone = perform(cell, on_state=lambda now: away(cell, now, "Look"))
    assert str(gone.end) == "refused: no_object"


@pytest.mark.slow
def test_a_thing_that_is_taken_away_is_missed_by_weight() -> None:
    cell = cell_of(validation={"by": "force"}, decide={"retries": 0})
    report = perform(cell, on_state=lambda now: away(cell, now, "Approach"))
    assert str(report.end) == "missed"
    assert report.end.sentence == "the thing is not in the hand"
    assert not report.is_lifted
    assert np.isnan(report.lifted)  # It falls for ever.
    assert report.off_table == ("apple",)


@pytest.mark.parametrize("at", [0.3, pytest.param(3.5, marks=pytest.mark.slow)])
def test_a_hand_that_falls_silent_is_named_and_the_arm_stands_still(at: float) -> None:
    cell = cell_of()
    report = perform(replace(cell, hand=SilentBackend(cell.hand, at)))
    assert str(report.end) == "fault: hand silent"
    assert still(cell)


@pytest.mark.parametrize("which", ["arm", "hand"])
def test_a_device_that_stops_is_named_whatever_its_error_says(which: str, monkeypatch: pytest.MonkeyPatch) -> None:
    cell = cell_of()
    device, other = (cell.arm, cell.hand) if which == "arm" else (cell.hand, cell.arm)
    read = device.read

    def stop() -> HandState:
        if (state := read()).t >= 0.3:
            raise HandFault(f"the simulation diverged at 0.300 s, beside {other.spec.name} and {other.spec.joints[0]}")
        return state

    monkeypatch.setattr(device, "read", stop)
    assert str(perform(cell).end) == f"fault: {which} stopped"


@pytest.mark.slow
def test_an_arm_that_falls_silent_is_named_and_holds_itself() -> None:
    cell = cell_of()
    report = perform(replace(cell, arm=SilentBackend(cell.arm, 3.0)))
    assert str(report.end) == "fault: arm silent"
    assert still(cell)


def away(cell: Cell, now: MachineState, when: str, name: str = "apple") -> None:
    """Somebody takes the thing off the table when a state begins."""
    if now.state == when:
        cell.robot.world.data.joint(name).qpos[:3] = [2.0, 2.0, 1.0]


def test_a_lift_that_the_checks_cannot_see_is_refused_with_the_least_one() -> None:
    with pytest.raises(ValidationError, match=r"lift\n.*greater than or equal to 0.08"):
        cell_of(lift=0.02)


@pytest.mark.slow
def test_an_object_is_lifted_from_where_it_stood_when_the_hand_went_for_it() -> None:
    report = perform(cell_of(objects=[{"name": "apple", "at": [0.0, 0.03, 0.2]}]))  # It falls onto the table first.
    assert (str(report.end), report.is_lifted) == ("held", True)
    assert report.lifted == pytest.approx(SETTINGS.lift, abs=0.02)


def test_a_table_that_is_not_at_the_cells_height_is_a_fault_before_the_arm_goes_anywhere() -> None:
    cell = cell_of()
    model = cell.robot.world.model
    model.geom_pos[model.geom("table").id][2] += 0.03
    report = perform(cell)
    assert str(report.end) == "fault: table"
    assert "the table stands 30 mm higher than the cell's" in report.end.sentence
    assert "ToTargetPose" not in states(report)


@pytest.mark.slow
def test_the_upper_of_a_stack_is_held_and_not_dropped_though_the_lower_stayed_where_it_stood() -> None:
    report = perform(
        cell_of(
            decide=SETTINGS.decide.model_dump() | {"retries": 0},
            objects=[
                {"name": "lower", "shape": "box", "size": [0.06, 0.06, 0.05], "mass": 0.2, "at": [0.0, 0.0]},
                {"name": "upper", "shape": "box", "size": [0.05, 0.05, 0.05], "mass": 0.1, "at": [0.0, 0.0, 0.075]},
            ],
        )
    )
    assert (str(report.end), report.object_name, report.is_lifted) == ("held", "upper", True)
    assert report.in_hand == ("upper",)
    assert "a part of what was seen as one object stayed behind" in report.end.sentence
    assert report.error < 0.006
