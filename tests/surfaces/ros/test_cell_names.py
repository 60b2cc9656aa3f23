"""A cell's further names on ROS 2: frames and topics of the lab's report, and MoveIt's planning scene."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from allegro_twin.cell.assembly import Cell
from allegro_twin.cell.settings import RosNameSettings
from allegro_twin.errors import ConfigError
from allegro_twin.files.schema import parse_settings
from allegro_twin.hands.description.arms import load_arm_spec
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.kinematics.pose import Pose
from allegro_twin.recording.events import DeviceSample, JournalEntry, SessionEvent
from allegro_twin.recording.messages.message_types import ros_types
from allegro_twin.recording.messages.planning_scene import PLANNING_SCENE
from allegro_twin.surfaces.ros.bridge import Publication
from allegro_twin.surfaces.ros.cell_topics import PUBLISHED, CellTopics
from allegro_twin.types import HandState, Sample, TorqueCommand
from tests.recording.test_planning_scene import CLUTTER, FOUND

REPORT = {
    "hand_frame": "hand_frame", "object_frame": "object_frame", "target_hand": "target_hand",
    "target_arm": "target_arm", "target_security": "target_security", "target_lift": "target_lift",
    "arm_states": "franka/joint_states", "hand_states": "qbhand1/joint_states",
}  # fmt: skip
"""The report's names, as docs/reference/topics.md has them."""
SEVEN = np.array([0.1, 0.2, 0.3, 1.0, 0.0, 0.0, 0.0])
LED = JournalEntry("states", {"t": 1.0, "state": "ToTargetPose", "tries": 1, "palm": SEVEN, "clutter": CLUTTER})
SEEN = JournalEntry("perception", {"t": 1.0, "verdict": "found", "target": SEVEN, **FOUND})


def cell_topics(**names: Any) -> CellTopics:
    """Of as much of a cell as topics ask for."""
    base, wait = Pose(np.zeros(3), np.eye(3)), Pose(np.array([-0.2, 0.0, 0.4]), np.eye(3))
    robot = SimpleNamespace(spec=load_arm_spec("fer"), base=base)
    settings = SimpleNamespace(ros=RosNameSettings(**names), lift=0.15)
    cell = SimpleNamespace(robot=robot, hand=SimpleNamespace(spec=load_spec("allegro", "right")), security=wait,
                           settings=settings)  # fmt: skip
    return CellTopics(cast(Cell, cell), ros_types())


def publications(topics: CellTopics, *events: SessionEvent) -> list[Publication]:
    makers = [topics.messages(event) for event in events]
    return [each for maker in makers if maker is not None for each in maker(5)]


def frames(found: list[Publication]) -> dict[str, Any]:
    return {each.child_frame_id: each.transform.translation
            for topic, message in found if topic.startswith("/tf") for each in message.transforms}  # fmt: skip


def sample(device: str) -> DeviceSample:
    n = 7 if device == "arm" else 16
    state = HandState(t=0.0, tick=0, position=np.full(n, 0.1), velocity=np.zeros(n), torque=np.zeros(n),
                      temperature=np.full(n, np.nan), gravity=np.zeros(3))  # fmt: skip
    extras = {"tool": SEVEN, "goal": 2.0 * SEVEN, "force": np.zeros(6)}
    return DeviceSample(device, Sample(state, TorqueCommand(np.zeros(n))), extras)


def test_without_names_a_cell_publishes_what_it_did_and_a_planning_scene() -> None:
    topics = cell_topics()
    assert [topic.name for topic in topics.published] == [*(topic.name for topic in PUBLISHED), "planning_scene"]
    assert publications(topics, SEEN) == []
    assert not set(REPORT.values()) & set(
        frames([*topics.first(0), *publications(topics, sample("hand"), sample("arm"))])
    )


def test_the_planning_scene_is_published_when_the_hand_is_led_to_what_was_seen() -> None:
    topics = cell_topics()
    found = dict(publications(topics, SEEN, LED))
    names = [each.id for each in found["planning_scene"].world.collision_objects]
    assert names == ["table", "target", "object_0"]
    assert found["planning_scene"].__msgtype__ == PLANNING_SCENE


def test_an_object_that_is_no_longer_seen_is_taken_out_of_the_scene() -> None:
    topics = cell_topics()
    publications(topics, SEEN, LED)
    empty = JournalEntry("states", {**LED.row, "clutter": np.empty((0, 6))})
    scene = dict(publications(topics, empty))["planning_scene"]
    assert [(each.id, each.operation) for each in scene.world.collision_objects][-1] == ("object_0", 1)
    again = dict(publications(topics, empty))["planning_scene"]
    assert [each.id for each in again.world.collision_objects] == ["table", "target"]


def test_before_anything_was_seen_there_is_no_scene() -> None:
    assert "planning_scene" not in dict(publications(cell_topics(), LED))


def test_a_refusal_of_perception_moves_no_frame() -> None:
    refused = JournalEntry("perception", {"t": 1.0, "verdict": "no_object", "sentence": "nothing there"})
    assert publications(cell_topics(**REPORT), refused) == []


def test_the_reports_frames_and_sources_are_there_under_its_names() -> None:
    topics = cell_topics(**REPORT)
    found = [*topics.first(0), *publications(topics, sample("hand"), sample("arm"), SEEN, LED)]
    placed = frames(found)
    assert {name for key, name in REPORT.items() if not key.endswith("states")} <= set(placed)
    assert (placed["hand_frame"].x, placed["target_arm"].x, placed["target_security"].x) == (0.1, 0.2, -0.2)
    assert placed["target_lift"].z == pytest.approx(0.3 + 0.15)
    assert placed["object_frame"].z == 0.05
    states = {topic: message.name for topic, message in found if topic.endswith("joint_states")}
    assert states["franka/joint_states"] == list(load_arm_spec("fer").joints)
    assert states["qbhand1/joint_states"] == list(load_spec("allegro", "right").joints)
    assert len(states["joint_states"]) == 23


def test_no_planning_scene_where_its_topic_is_none() -> None:
    topics = cell_topics(planning_scene=None)
    assert [topic.name for topic in topics.published] == [topic.name for topic in PUBLISHED]
    assert "planning_scene" not in dict(publications(topics, SEEN, LED))


@pytest.mark.parametrize("name", ["a b", "9lives", "a//b", ""])
def test_a_name_that_ros_does_not_take_is_refused(name: str) -> None:
    with pytest.raises(ConfigError, match="hand_frame"):
        parse_settings(RosNameSettings, {"hand_frame": name}, "x")
