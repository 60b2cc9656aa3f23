"""MoveIt's planning scene: what was seen is there with its place and size, and what is gone is taken out."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from allegro_twin.cell.journal.scene_objects import scene_objects
from allegro_twin.kinematics.arm import rotate
from allegro_twin.kinematics.pose import Pose
from allegro_twin.recording.messages.message_types import ros_types_by_name
from allegro_twin.recording.messages.planning_scene import PLANNING_SCENE, SceneObject, planning_scene, register_moveit

TURN = rotate(np.eye(3), np.array([0.0, 0.0, 0.5]))
FOUND = {
    "shape": "cylinder", "size": (0.1, 0.066, 0.066), "table": np.array([0.0, 0.0, 1.0, 0.002]),
    "pose": np.array([0.1, 0.2, 0.05, np.sqrt(0.5), 0.0, -np.sqrt(0.5), 0.0]),
}  # fmt: skip
"""A can that stands: its own x is upright."""
CLUTTER = np.array([[0.2, -0.1, 0.03, 0.05, 0.06, 0.06]])


def sent(distro: str, objects: list[SceneObject], gone: list[str]) -> Any:
    """The message as who receives it has it."""
    types = ros_types_by_name(distro)
    data = types.encode(planning_scene(types, 7, "world", objects, gone))
    return types.decode(data, PLANNING_SCENE)


@pytest.mark.parametrize("distro", ["humble", "jazzy"])
def test_table_target_and_other_objects_are_solids_of_a_difference(distro: str) -> None:
    scene = sent(distro, scene_objects(FOUND, CLUTTER), ["object_1"])
    assert scene.is_diff
    assert scene.robot_state.is_diff
    objects = {each.id: each for each in scene.world.collision_objects}
    assert list(objects) == ["table", "target", "object_0", "object_1"]
    assert {each.header.frame_id for each in objects.values()} == {"world"}
    assert [each.operation for each in objects.values()] == [0, 0, 0, 1]
    assert objects["object_1"].primitives == []
    box = objects["object_0"]
    assert box.primitives[0].type == 1
    np.testing.assert_allclose(box.primitives[0].dimensions, [0.05, 0.06, 0.06])
    assert (box.pose.position.x, box.pose.position.y, box.pose.position.z) == (0.2, -0.1, 0.03)


def test_a_cylinder_has_its_height_first_and_stands_along_its_own_z() -> None:
    target = sent("jazzy", scene_objects(FOUND, CLUTTER), []).world.collision_objects[1]
    assert target.primitives[0].type == 3
    np.testing.assert_allclose(target.primitives[0].dimensions, [0.1, 0.033])
    q = target.pose.orientation
    up = [2 * (q.x * q.z + q.w * q.y), 2 * (q.y * q.z - q.w * q.x), 1 - 2 * (q.x**2 + q.y**2)]
    np.testing.assert_allclose(np.abs(up), [0.0, 0.0, 1.0], atol=1e-9)


def test_a_ball_is_a_sphere_by_its_radius_and_any_other_solid_the_box_around_it() -> None:
    ball = FOUND | {"shape": "sphere", "size": (0.07, 0.07, 0.07)}
    other = FOUND | {"shape": "ellipsoid"}
    made = sent("jazzy", [*scene_objects(ball, CLUTTER)[1:2], *scene_objects(other, CLUTTER)[1:2]], [])
    one, two = (each.primitives[0] for each in made.world.collision_objects)
    assert (one.type, one.dimensions.tolist()) == (2, [0.035])
    assert (two.type, two.dimensions.tolist()) == (1, [0.1, 0.066, 0.066])


def test_the_tables_top_is_where_it_was_seen() -> None:
    tilted = np.array([np.sin(0.1), 0.0, np.cos(0.1), 0.01])
    table = scene_objects(FOUND | {"table": tilted}, CLUTTER)[0]
    normal = table.pose.rotation[:, 2]
    np.testing.assert_allclose(normal, tilted[:3], atol=1e-12)
    assert normal @ table.pose.position + table.size[2] / 2.0 == pytest.approx(0.01)
    np.testing.assert_allclose(table.pose.rotation.T @ table.pose.rotation, np.eye(3), atol=1e-12)
    assert np.linalg.det(table.pose.rotation) == pytest.approx(1.0)


def test_a_turned_box_keeps_its_turn() -> None:
    made = sent("jazzy", [SceneObject("box", "box", Pose(np.zeros(3), TURN), (0.1, 0.2, 0.3))], [])
    q = made.world.collision_objects[0].pose.orientation
    assert (q.w, q.z) == pytest.approx((np.cos(0.25), np.sin(0.25)))


def test_the_types_are_those_of_moveit_and_can_be_taught_twice() -> None:
    types = ros_types_by_name("humble")
    register_moveit(types)
    register_moveit(types)
    text = types.definition(PLANNING_SCENE)
    assert "moveit_msgs/CollisionObject[] collision_objects" in text
    assert [name for name, _ in types.fields("moveit_msgs/msg/CollisionObject")][-1] == "operation"
