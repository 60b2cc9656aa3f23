"""Every topic of the bridge: its name, type and quality. docs/ros.md has the same table (a test)."""

from __future__ import annotations

from typing import NamedTuple

from allegro_twin.recording.messages import message_types as v
from allegro_twin.surfaces.ros.node_api import Quality


class Entry(NamedTuple):
    """One topic; a name without a slash in front is in the hand's namespace."""

    name: str
    kind: str
    quality: Quality
    what: str


NAMESPACE = "/allegroHand_0"
"""As the manufacturer's launch file names the first hand: allegro_hand.launch, `NUM`."""
NODE = "allegro_twin"
TRAJECTORY = "allegro_hand_trajectory_controller/joint_trajectory"
"""As joint_trajectory_controller of ros2_controllers names it under a controller."""
WRENCH = "wrench/{finger}"
PUBLISHED = (
    Entry("joint_states", v.JOINT_STATE, Quality(), "positions, rad; speeds, rad/s; effort: applied torques, N·m"),
    Entry("/tf", v.TF, Quality(100), "every moving link on its parent"),
    Entry("/tf_static", v.TF, Quality(1, latched=True), "fingertips on their links"),
    Entry("robot_description", v.STRING, Quality(1, latched=True), "the hand's URDF"),
    Entry(WRENCH, v.WRENCH, Quality(), "what pushes on a fingertip, N, in its own frame"),
    Entry("/diagnostics", v.DIAGNOSTICS, Quality(), "once a second: what drives, missed periods, the hottest motor"),
    Entry("/rosout", v.LOG, Quality(1000, latched=True), "every wish that was refused, and why"),
)
HEARD = (
    Entry("joint_cmd", v.JOINT_STATE, Quality(), "positions to be at, rad"),
    Entry("lib_cmd", v.STRING, Quality(), "a word of the manufacturer's, or a posture or grasp of the library"),
    Entry("envelop_torque", v.FLOAT, Quality(), "the scale of the next `envelop`, 0 to 1"),
    Entry(TRAJECTORY, v.TRAJECTORY, Quality(), "postures, rad, and when, s"),
    Entry("gravity", v.VECTOR, Quality(), "what is compensated, palm frame, m/s²"),
)
