"""The whole cell: a thing is seen, taken and held; and what goes wrong ends by its name with the arm standing still."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from allegro_twin.cell.arm.faults import Silent
from allegro_twin.cell.assembly import Room, make_room
from allegro_twin.cell.journal.observers import Onlookers
from allegro_twin.cell.journal.pictures import Kept
from allegro_twin.cell.run import Report, perform
from allegro_twin.cell.settings import LabSettings
from allegro_twin.cell.states import Now
from allegro_twin.files.assets import data_root
from allegro_twin.files.schema import load_settings

SETTINGS = load_settings(LabSettings, data_root() / "conf" / "lab_allegro.yaml")


def room_of(**changes: Any) -> Room:
    return make_room(LabSettings.model_validate(SETTINGS.model_dump() | changes))


def still(room: Room) -> bool:
    """Whether the arm stands, to a hundredth of a radian a second."""
    return float(np.abs(room.cell.world.data.qvel[:7]).max()) < 0.02


def states(report: Report) -> list[str]:
    return [state for _, state in report.events]


def test_a_thing_is_seen_taken_lifted_and_said_to_be_held(tmp_path: Path) -> None:
    room = room_of()
    kept = Kept(room, tmp_path)
    looking = Onlookers(room, [kept])
    report = perform(room, arm=looking.arm, hand=looking.hand, entered=looking.entered, prepared=looking.prepared)
    assert str(report.end) == "held"
    assert states(report) == [
        "ToSecurityPose", "Look", "ToTargetPose", "Approach", "ClosingHand", "ToLiftedPose", "Validate", "Done",
    ]  # fmt: skip
    assert report.truly
    assert report.error < 0.003
    assert report.grasp == "apple"
    assert report.checked is not None
    assert report.checked.by_fingers
    assert report.end.sentence == ""
    assert report.checked.weight == pytest.approx(0.068, abs=0.06)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["before.png", "end.png", "grasp.png"]
    kept.close()
    room.close()


@pytest.mark.slow
def test_by_events_the_same_is_done_in_less_time() -> None:
    clock, event = room_of(), room_of(decide={"by": "event"})
    slow, fast = perform(clock), perform(event)
    assert (slow.end.word, fast.end.word) == ("held", "held")
    assert fast.events[-1][0] < slow.events[-1][0]


def test_a_camera_that_is_frozen_is_named_and_nothing_moves() -> None:
    room = room_of()
    room.camera.freeze()
    report = perform(room)
    assert str(report.end) == "fault: camera"
    assert "it is frozen, or its cable is out" in report.end.sentence
    assert states(report) == ["ToSecurityPose", "Look", "Done"]
    assert still(room)


def test_a_thing_outside_the_workspace_is_refused_and_nothing_moves() -> None:
    room = room_of(objects=[{"name": "apple", "at": [0.19, 0.0]}])
    report = perform(room)
    assert str(report.end) == "refused: outside"
    assert "outside the workspace" in report.end.sentence
    assert still(room)


def test_an_empty_table_is_refused() -> None:
    room = room_of()
    gone = perform(room, entered=lambda now: away(room, now, "Look"))
    assert str(gone.end) == "refused: no_object"


@pytest.mark.slow
def test_a_thing_that_is_taken_away_is_missed_by_weight() -> None:
    room = room_of(validation={"by": "force"}, decide={"retries": 0})
    report = perform(room, entered=lambda now: away(room, now, "Approach"))
    assert str(report.end) == "missed"
    assert report.end.sentence == "the thing is not in the hand"
    assert not report.truly


@pytest.mark.parametrize("at", [0.3, 3.5])
def test_a_hand_that_falls_silent_is_named_and_the_arm_stands_still(at: float) -> None:
    room = room_of()
    report = perform(replace(room, hand=Silent(room.hand, at)))
    assert str(report.end) == "fault: hand silent"
    assert still(room)


def test_an_arm_that_falls_silent_is_named_and_holds_itself() -> None:
    room = room_of()
    report = perform(replace(room, arm=Silent(room.arm, 3.0)))
    assert str(report.end) == "fault: arm silent"
    assert still(room)


def away(room: Room, now: Now, when: str, name: str = "apple") -> None:
    """Somebody takes the thing off the table when a state begins."""
    if now.state == when:
        room.cell.world.data.joint(name).qpos[:3] = [2.0, 2.0, 1.0]
