"""Every topic of a cell: its name, type and quality. docs/ros.md has the same table (a test)."""

from __future__ import annotations

from allegro_twin.recording.messages import message_types as v
from allegro_twin.surfaces.ros.node_api import Quality
from allegro_twin.surfaces.ros.topics import TRAJECTORY, Entry

NAMESPACE = "/"
_CONTROLLER = "cartesian_compliance_controller"
"""As FZI's cartesian_controllers name the one of the lab's report, and its topics."""
STATES = "joint_states"
POINTS = "camera/depth/color/points"
"""As realsense-ros names them."""
WRENCH = f"{_CONTROLLER}/ft_sensor_wrench"
POSE = f"{_CONTROLLER}/current_pose"
TARGET = f"{_CONTROLLER}/target_frame"
PUBLISHED = (
    Entry(STATES, v.JOINT_STATE, Quality(), "arm and hand in one: positions, speeds, applied torques"),
    Entry(POSE, v.POSE, Quality(), "the palm in `world`"),
    Entry(WRENCH, v.WRENCH, Quality(), "what the world does to the hand at the flange, in the axes of `world`"),
    Entry(POINTS, v.CLOUD, Quality(), "what the depth camera sees, a point a pixel, in its optical frame"),
    Entry("/tf", v.TF, Quality(100), "links of arm and hand, palm, target and camera"),
    Entry("/tf_static", v.TF, Quality(1, latched=True), "the arm's base in `world`, fingertips on their links"),
    Entry("/rosout", v.LOG, Quality(1000, latched=True), "states, and every wish that was refused, and why"),
)
HEARD = (
    Entry(TARGET, v.POSE, Quality(), "where the palm is to be, in `world` or the arm's base"),
    Entry(TRAJECTORY, v.TRAJECTORY, Quality(), "postures of the fingers, rad, and when, s; no points: stay"),
)
