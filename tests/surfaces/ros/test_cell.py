"""A program on ROS sees the cell, leads its arm and its fingers, and cannot harm them."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import pytest

from allegro_twin.cell.assembly import Cell
from allegro_twin.cell.journal.observers import ObserverCamera, Observers
from allegro_twin.cell.remote.remote_control import RemoteControl, run_remote_control
from allegro_twin.kinematics.orientation import matrix_from_quaternion
from allegro_twin.kinematics.pose import Pose
from allegro_twin.recording.messages import build
from allegro_twin.recording.messages import message_types as v
from allegro_twin.surfaces.ros import cell_topics as topics
from allegro_twin.surfaces.ros import open_cell
from allegro_twin.surfaces.ros.joint_trajectory import TRAJECTORY
from allegro_twin.surfaces.ros.node_api import QosProfile
from allegro_twin.types import Vector
from tests.cell.test_run import cell_of
from tests.surfaces.ros.conftest import DOMAIN, Peer, waited
from tests.surfaces.ros.test_bridge import trajectory

LOG = QosProfile(1000, latched=True)

pytestmark = pytest.mark.realtime


class Served(NamedTuple):
    """A cell that lives in a thread."""

    made: Cell

    @property
    def palm(self) -> Vector:
        """Where it really is, (3,), m."""
        body = self.made.robot.world.data.body(self.made.hand.spec.root)
        return np.array(body.xpos)


@pytest.fixture
def cell(namespace: str) -> Iterator[Served]:
    made, over = cell_of(), threading.Event()
    remote = RemoteControl(made)
    with open_cell(made, remote, namespace=namespace, domain=DOMAIN) as bridge:

        def live() -> None:
            lens = ObserverCamera(made, 5.0)  # A thread's pictures are its own.
            run_remote_control(remote, Observers(made, [bridge], lens), lambda t: over.is_set())
            lens.close()

        thread = threading.Thread(target=live, daemon=True)
        thread.start()
        served = Served(made)
        waited(lambda: bool(served.palm.any()), "the cell did not begin", 30.0)
        yield served
        over.set()
        thread.join()
    made.close()


def target(types: v.RosTypes, cell: Served, place: Any, frame: str = "world", turn: Any = None) -> Any:
    """A target_frame with the palm's own orientation where it waits."""
    pose = np.concatenate([place, cell.made.security.quaternion if turn is None else turn])
    return build.pose(types, 0, frame, pose)


def test_joint_states_have_arm_and_hand_in_one_message(cell: Served, peer: Peer) -> None:
    began = time.time() - 60.0  # Since before the cell was opened.
    peer.hear(topics.STATES, v.JOINT_STATE)
    message = peer.listen(10.0, lambda topic, message: True)
    assert message.name == [*cell.made.robot.spec.joints, *cell.made.hand.spec.joints]
    np.testing.assert_allclose(message.position[:7], cell.made.posture, atol=0.02)
    assert len(message.effort) == len(message.velocity) == 23
    assert began < v.nanoseconds(message.header.stamp) / 1e9 < time.time()


def test_points_wrench_pose_and_frames_are_where_the_cell_has_them(cell: Served, peer: Peer) -> None:
    peer.hear(topics.POINTS, v.CLOUD)
    cloud = peer.listen(20.0, lambda topic, message: True)
    peer.hear(topics.POSE, v.POSE)
    peer.hear(topics.WRENCH, v.WRENCH)
    peer.hear("/tf", v.TF, QosProfile(100))
    peer.hear("/tf_static", v.TF, QosProfile(1, latched=True))
    frames: dict[str, Any] = {}

    def known(topic: str, message: Any) -> bool:
        if topic.startswith("/tf"):
            frames.update({each.child_frame_id: each for each in message.transforms})
        wanted = {peer.full(topics.POSE), peer.full(topics.WRENCH)} <= {name for name, _ in peer.heard}
        return wanted and {"target_frame", "camera_depth_optical_frame", "fer_link0"} <= set(frames)

    peer.listen(20.0, known)
    heard = dict(peer.heard)
    pose, wrench = heard[peer.full(topics.POSE)], heard[peer.full(topics.WRENCH)]
    place = pose.pose.position
    np.testing.assert_allclose([place.x, place.y, place.z], cell.palm, atol=2e-3)
    assert (pose.header.frame_id, wrench.header.frame_id) == ("world", "world")
    assert abs(wrench.wrench.force.z) < 6.0  # Four and a half standard deviations of the sensor's noise.
    assert {"palm_link", "fer_link7", "fer_link0", "link_15.0_tip"} <= set(frames)
    assert (cloud.height, cloud.width, cloud.point_step) == (480, 640, 12)
    points = np.frombuffer(bytes(cloud.data), "<f4").reshape(480, 640, 3)
    hung = frames["camera_depth_optical_frame"].transform
    turn = matrix_from_quaternion([hung.rotation.w, hung.rotation.x, hung.rotation.y, hung.rotation.z])
    world = points[240, 320] @ turn.T + [hung.translation.x, hung.translation.y, hung.translation.z]
    assert np.isnan(points).any()
    assert abs(world[0]) < 0.06  # In the middle of the picture: the apple.
    assert -0.01 < world[2] < 0.09


def test_target_frame_leads_the_palm_no_faster_than_it_may(cell: Served, peer: Peer, types: v.RosTypes) -> None:
    wanted = np.array([-0.15, 0.1, 0.38])
    peer.say(topics.TARGET, target(types, cell, wanted))
    assert waited(lambda: bool(np.linalg.norm(cell.palm - wanted) < 0.01), "not there", 20.0)
    foot = cell.made.robot.base.position
    peer.say(topics.TARGET, target(types, cell, np.array([-0.2, 0.0, 0.4]) - foot, "fer_link0"))
    assert waited(
        lambda: bool(np.linalg.norm(cell.palm - [-0.2, 0.0, 0.4]) < 0.01), "not there, in the base's frame", 20.0
    )


@pytest.mark.parametrize(
    ("place", "frame", "turn", "said"),
    [
        ([float("nan"), 0.0, 0.4], "world", None, "target_frame: position.x is nan; the arm stays: give a whole pose"),
        ([-0.1, 0.0, 0.05], "world", None, "would be in the table, at .* mm: nothing moves"),
        ([-0.1, 0.0, -0.3], "world", None, "is outside .* the arm stays; ask for a place inside, or set `follow`"),
        ([0.3, 0.4, 0.6], "world", None, "does not reach"),
        ([-0.1, 0.0, 0.4], "map", None, "target_frame is in 'map'; this cell knows 'world' and 'fer_link0'"),
        ([-0.1, 0.0, 0.4], "world", [0.0, 0.0, 0.0, 0.0], "its quaternion has length 0, not 1"),
    ],
)  # fmt: skip
def test_a_target_that_cannot_be_is_refused_in_a_sentence_and_the_arm_stands(
    cell: Served, peer: Peer, types: v.RosTypes, place: Any, frame: str, turn: Any, said: str
) -> None:
    import re

    peer.hear("/rosout", v.LOG, LOG)
    before = cell.palm
    peer.say(topics.TARGET, target(types, cell, place, frame, turn))
    found = peer.listen(10.0, lambda topic, message: message.level == 30)
    assert found is not None
    assert re.search(said, found.msg), found.msg
    assert "\n" not in found.msg
    time.sleep(0.3)
    assert np.linalg.norm(cell.palm - before) < 2e-3


def test_a_trajectory_moves_the_fingers_and_one_that_cannot_be_does_not(
    cell: Served, peer: Peer, types: v.RosTypes
) -> None:
    spec, hand = cell.made.hand.spec, cell.made.robot.hand_sim
    peer.hear("/rosout", v.LOG, LOG)
    goal = cell.made.open + 0.2
    peer.say(TRAJECTORY, trajectory(types, spec, [0.8], goal[None]))

    def there() -> bool:
        return bool(np.abs(hand.data.qpos[hand._qpos] - goal).max() < 0.06)

    waited(there, "the fingers did not come", 20.0)
    far = goal.copy()
    far[3] = 3.0
    for message, said in (
        (trajectory(types, spec, [1.0], far[None]), "outside its limits"),
        (trajectory(types, spec, [0.01], cell.made.open[None]), "is where the guard stops: slow down"),
        (trajectory(types, spec, [1.0], goal[None, 1:], names=list(spec.joints[1:])), "lacks joint_0.0"),
    ):
        peer.say(TRAJECTORY, message)
        found = peer.listen(10.0, lambda topic, message: message.level == 30)
        assert said in found.msg
    assert there()


def test_while_the_state_machine_leads_nobody_else_does(namespace: str, peer: Peer, types: v.RosTypes) -> None:
    made = cell_of()
    with open_cell(made, namespace=namespace, domain=DOMAIN):
        peer.hear("/rosout", v.LOG, LOG)
        peer.say(topics.TARGET, target(types, Served(made), [-0.1, 0.0, 0.4]))
        assert "the state machine leads the cell; begin it with --follow" in peer.refusal()
    made.close()


def test_a_pose_comes_back_from_its_message(types: v.RosTypes) -> None:
    turn = np.array([0.5, -0.5, 0.5, 0.5])
    message = build.pose(types, 7, "world", np.array([1.0, 2.0, 3.0, *turn]))
    found = build.pose_in(types.decode(types.encode(message), v.POSE), "x")
    assert isinstance(found, Pose)
    np.testing.assert_allclose(found.position, [1.0, 2.0, 3.0])
    np.testing.assert_allclose(found.rotation, matrix_from_quaternion(turn))
