"""MoveIt's planning scene: solids that perception saw, as moveit_msgs/PlanningScene.

The types of MoveIt and of what it builds on are no part of a ROS 2 distribution's common interfaces; their fields are
given here (moveit_msgs, branches humble and ros2, which agree; octomap_msgs, object_recognition_msgs).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from allegro_twin.kinematics.orientation import quaternion_from_matrix
from allegro_twin.kinematics.pose import Pose
from allegro_twin.recording.messages.message_types import Message, RosTypes

PLANNING_SCENE = "moveit_msgs/msg/PlanningScene"
_ADD, _REMOVE = 0, 1  # moveit_msgs/CollisionObject.
_BOX, _SPHERE, _CYLINDER = 1, 2, 3  # shape_msgs/SolidPrimitive.
_POSES = "geometry_msgs/Pose[]"
_FIELDS = {
    "object_recognition_msgs/msg/ObjectType": "string key; string db",
    "octomap_msgs/msg/Octomap": "std_msgs/Header header; bool binary; string id; float64 resolution; int8[] data",
    "octomap_msgs/msg/OctomapWithPose": "std_msgs/Header header; geometry_msgs/Pose origin; "
    "octomap_msgs/Octomap octomap",
    "moveit_msgs/msg/CollisionObject": "std_msgs/Header header; geometry_msgs/Pose pose; string id; "
    "object_recognition_msgs/ObjectType type; "
    f"shape_msgs/SolidPrimitive[] primitives; {_POSES} primitive_poses; "
    f"shape_msgs/Mesh[] meshes; {_POSES} mesh_poses; shape_msgs/Plane[] planes; {_POSES} plane_poses; "
    f"string[] subframe_names; {_POSES} subframe_poses; "
    "byte ADD=0; byte REMOVE=1; byte APPEND=2; byte MOVE=3; byte operation",
    "moveit_msgs/msg/AttachedCollisionObject": "string link_name; moveit_msgs/CollisionObject object; "
    "string[] touch_links; trajectory_msgs/JointTrajectory detach_posture; float64 weight",
    "moveit_msgs/msg/RobotState": "sensor_msgs/JointState joint_state; "
    "sensor_msgs/MultiDOFJointState multi_dof_joint_state; "
    "moveit_msgs/AttachedCollisionObject[] attached_collision_objects; bool is_diff",
    "moveit_msgs/msg/AllowedCollisionEntry": "bool[] enabled",
    "moveit_msgs/msg/AllowedCollisionMatrix": "string[] entry_names; moveit_msgs/AllowedCollisionEntry[] entry_values; "
    "string[] default_entry_names; bool[] default_entry_values",
    "moveit_msgs/msg/LinkPadding": "string link_name; float64 padding",
    "moveit_msgs/msg/LinkScale": "string link_name; float64 scale",
    "moveit_msgs/msg/ObjectColor": "string id; std_msgs/ColorRGBA color",
    "moveit_msgs/msg/PlanningSceneWorld": "moveit_msgs/CollisionObject[] collision_objects; "
    "octomap_msgs/OctomapWithPose octomap",
    "moveit_msgs/msg/PlanningScene": "string name; moveit_msgs/RobotState robot_state; string robot_model_name; "
    "geometry_msgs/TransformStamped[] fixed_frame_transforms; "
    "moveit_msgs/AllowedCollisionMatrix allowed_collision_matrix; moveit_msgs/LinkPadding[] link_padding; "
    "moveit_msgs/LinkScale[] link_scale; moveit_msgs/ObjectColor[] object_colors; "
    "moveit_msgs/PlanningSceneWorld world; bool is_diff",
}


class SceneObject(NamedTuple):
    """A solid of the scene."""

    name: str
    shape: Literal["box", "sphere", "cylinder"]
    pose: Pose
    """Pose of its middle; a cylinder's axis is its own x."""
    size: tuple[float, float, float]
    """Along its axes, m."""


def register_moveit(types: RosTypes) -> None:
    """Teach a distribution's types those of MoveIt. Idempotent."""
    if PLANNING_SCENE in types.store.types:
        return
    from rosbags.typesys import get_types_from_msg

    found: dict[str, Any] = {}
    for kind, fields in _FIELDS.items():
        found.update(get_types_from_msg("\n".join(fields.split("; ")) + "\n", kind))
    types.store.register(found)


def planning_scene(
    types: RosTypes, stamp: int, frame: str, objects: Sequence[SceneObject], gone: Sequence[str] = ()
) -> Message:
    """A difference to MoveIt's scene: these objects are there, in a frame, and those named in `gone` are no more."""
    register_moveit(types)
    added = [_object(types, stamp, frame, each.name, _ADD, each) for each in objects]
    removed = [_object(types, stamp, frame, name, _REMOVE, None) for name in gone]
    header, joints = types.header(0), _empty(types)
    octomap = types.make("octomap_msgs/msg/Octomap", header=header, binary=False, id="", resolution=0.0,
                         data=np.zeros(0, np.int8))  # fmt: skip
    nowhere = types.make("octomap_msgs/msg/OctomapWithPose", header=header, origin=_pose(types, None), octomap=octomap)
    world = types.make("moveit_msgs/msg/PlanningSceneWorld", collision_objects=[*added, *removed], octomap=nowhere)
    nothing = types.make("moveit_msgs/msg/AllowedCollisionMatrix", entry_names=[], entry_values=[],
                         default_entry_names=[], default_entry_values=np.zeros(0, np.bool_))  # fmt: skip
    return types.make(
        PLANNING_SCENE, name="", robot_state=joints, robot_model_name="", fixed_frame_transforms=[],
        allowed_collision_matrix=nothing, link_padding=[], link_scale=[], object_colors=[], world=world, is_diff=True,
    )  # fmt: skip


def _object(types: RosTypes, stamp: int, frame: str, name: str, operation: int, solid: SceneObject | None) -> Message:
    kind = types.make("object_recognition_msgs/msg/ObjectType", key="", db="")
    primitives = [] if solid is None else [_primitive(types, solid)]
    return types.make(
        "moveit_msgs/msg/CollisionObject", header=types.header(stamp, frame),
        pose=_pose(types, None if solid is None else _upright(solid)), id=name, type=kind,
        primitives=primitives, primitive_poses=[_pose(types, None) for _ in primitives],
        meshes=[], mesh_poses=[], planes=[], plane_poses=[], subframe_names=[], subframe_poses=[], operation=operation,
    )  # fmt: skip


def _primitive(types: RosTypes, solid: SceneObject) -> Message:
    along, across, third = solid.size
    kind, dimensions = {
        "box": (_BOX, solid.size),
        "sphere": (_SPHERE, (max(solid.size) / 2.0,)),
        "cylinder": (_CYLINDER, (along, max(across, third) / 2.0)),
    }[solid.shape]
    polygon = types.make("geometry_msgs/msg/Polygon", points=[])
    return types.make(
        "shape_msgs/msg/SolidPrimitive", type=kind, dimensions=np.array(dimensions, np.float64), polygon=polygon
    )


def _upright(solid: SceneObject) -> Pose:
    """ROS's cylinder has its axis along z, ours along x."""
    if solid.shape != "cylinder":
        return solid.pose
    x, y, z = solid.pose.rotation.T
    return Pose(solid.pose.position, np.stack([y, z, x], axis=1))


def _pose(types: RosTypes, pose: Pose | None) -> Message:
    x, y, z = (0.0, 0.0, 0.0) if pose is None else (float(value) for value in pose.position)
    turn = (1.0, 0.0, 0.0, 0.0) if pose is None else quaternion_from_matrix(pose.rotation)
    w, i, j, k = (float(value) for value in turn)
    return types.make(
        "geometry_msgs/msg/Pose",
        position=types.make("geometry_msgs/msg/Point", x=x, y=y, z=z),
        orientation=types.make("geometry_msgs/msg/Quaternion", x=i, y=j, z=k, w=w),
    )


def _empty(types: RosTypes) -> Message:
    """A robot state that says nothing: the difference is one of the world."""
    none, header = np.zeros(0), types.header(0)
    joints = types.make("sensor_msgs/msg/JointState", header=header, name=[], position=none, velocity=none, effort=none)
    free = types.make("sensor_msgs/msg/MultiDOFJointState", header=header, joint_names=[], transforms=[], twist=[],
                      wrench=[])  # fmt: skip
    return types.make(
        "moveit_msgs/msg/RobotState", joint_state=joints, multi_dof_joint_state=free, attached_collision_objects=[],
        is_diff=True,
    )  # fmt: skip
