"""A C++ program on Debian's Fast DDS, the family of ROS 2's default middleware, hears the hand and moves it."""

from __future__ import annotations

import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from allegro_twin.recording.messages import message_types as v
from allegro_twin.surfaces.ros import cell_topics as topics
from allegro_twin.surfaces.ros.cell_topics import CAMERA
from allegro_twin.surfaces.ros.joint_trajectory import TRAJECTORY
from allegro_twin.surfaces.ros.node import dds_name
from allegro_twin.types import Vector
from tests.surfaces.ros.conftest import DOMAIN, Peer, bridged, sim_config, waited
from tests.surfaces.ros.test_bridge import trajectory
from tests.surfaces.ros.test_cell import Served, cell, target  # noqa: F401  # A fixture.

HERE = Path(__file__).parent / "fastdds"
MISSING = [name for name in ("fastddsgen", "g++") if shutil.which(name) is None]
if not Path("/usr/include/fastdds").is_dir():
    MISSING.append("libfastrtps-dev")
pytestmark = [
    pytest.mark.realtime,
    pytest.mark.skipif(bool(MISSING), reason=f"needs Debian's {' '.join(MISSING)}"),
]


@pytest.fixture(scope="session")
def echo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The program, built."""
    folder = tmp_path_factory.mktemp("fastdds")
    shutil.copy(HERE / "Messages.idl", folder)
    subprocess.run(["fastddsgen", "-typeros2", "Messages.idl"], cwd=folder, check=True, capture_output=True)
    made = [str(path) for path in folder.glob("*.cxx") if "main" not in path.name.lower()]
    subprocess.run(
        ["g++", "-O1", "-w", "-I.", *made, str(HERE / "echo.cpp"), "-lfastrtps", "-lfastcdr", "-o", "echo"],
        cwd=folder, check=True, capture_output=True,
    )  # fmt: skip
    return folder / "echo"


@contextmanager
def echoing(
    program: Path, heard: str, said: str, kind: str = v.JOINT_STATE, *, latched: bool = False
) -> Iterator[None]:
    words = [str(DOMAIN), dds_name(kind), f"rt{heard}", f"rt{said}", *(["latched"] if latched else [])]
    process = subprocess.Popen([str(program), *words], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        yield
    finally:
        process.kill()
        process.communicate()


def test_five_hundred_of_five_hundred_messages_come_back_from_fast_dds(
    echo: Path, peer: Peer, types: v.RosTypes
) -> None:
    peer.hear("pong", v.JOINT_STATE)
    with echoing(echo, peer.full("ping"), peer.full("pong")):
        message = types.make(
            v.JOINT_STATE, header=types.header(12345678901, "palm"), name=["joint_0.0", "é"],
            position=np.arange(16.0), velocity=np.full(16, np.nan), effort=np.zeros(3),
        )  # fmt: skip
        peer.say("ping", message)
        peer.listen(5.0, lambda topic, message: True)
        trips = []
        for number in range(500):
            message.position[0] = number
            began = time.perf_counter()
            peer.say("ping", message)
            back = peer.listen(2.0, lambda topic, message: True)
            trips.append(time.perf_counter() - began)
            assert types.encode(back) == types.encode(message)
    print(f"median {np.median(trips) * 1e3:.2f} ms, 99 % {np.quantile(trips, 0.99) * 1e3:.2f} ms")  # noqa: T201


def test_fast_dds_hears_the_hand_and_moves_it(
    echo: Path, make_peer: Callable[[], Peer], namespace: str, home: Vector
) -> None:
    peer = make_peer()
    with bridged(sim_config(), namespace) as (hand, _):
        peer.hear("mirror", v.JOINT_STATE)
        with echoing(echo, peer.full("joint_states"), peer.full("mirror")):
            seen = peer.listen(10.0, lambda topic, message: True)
            assert seen is not None
            assert seen.name == list(hand.spec.joints)
        with echoing(echo, peer.full("wish"), peer.full("joint_cmd")):
            time.sleep(1.0)
            peer.say("wish", peer.types.make(
                v.JOINT_STATE, header=peer.types.header(0), name=list(hand.spec.joints), position=np.array(home),
                velocity=np.zeros(0), effort=np.zeros(0)))  # fmt: skip
            waited(lambda: bool(np.abs(hand.state.position - home).max() < 0.03), "home was not reached")


@pytest.fixture
def again(echo: Path, peer: Peer) -> Callable[..., Any]:
    """What Fast DDS has heard on a topic of the cell, and says once more."""

    def heard(
        topic: str, kind: str, latched: bool = False, wanted: Callable[[Any], bool] = lambda message: True
    ) -> Any:
        name = "again_" + topic.strip("/").replace("/", "_")
        peer.hear(name, kind)
        with echoing(echo, peer.full(topic), peer.full(name), kind, latched=latched):
            return peer.listen(40.0, lambda topic, message: topic.endswith(name) and wanted(message))

    return heard


def test_fast_dds_hears_all_that_a_cell_says(
    again: Callable[..., Any],
    cell: Served,  # noqa: F811  # The fixture of that name.
) -> None:
    states = again(topics.STATES, v.JOINT_STATE)
    assert states.name == [*cell.made.robot.spec.joints, *cell.made.hand.spec.joints]
    np.testing.assert_allclose(states.position[:7], cell.made.posture, atol=0.02)

    pose = again(topics.POSE, v.POSE)
    assert pose.header.frame_id == "world"
    place = pose.pose.position
    np.testing.assert_allclose([place.x, place.y, place.z], cell.palm, atol=2e-3)

    wrench = again(topics.WRENCH, v.WRENCH)
    assert wrench.header.frame_id == "world"
    assert 0.0 < abs(wrench.wrench.force.z) < 6.0  # Four and a half standard deviations of the sensor's noise.

    cloud = again(topics.POINTS, v.CLOUD)  # 3.7 MB: in many datagrams.
    assert (cloud.header.frame_id, cloud.height, cloud.width, cloud.point_step) == (CAMERA, 480, 640, 12)
    assert [(each.name, each.offset, each.datatype) for each in cloud.fields] == [("x", 0, 7), ("y", 4, 7), ("z", 8, 7)]
    points = np.frombuffer(bytes(cloud.data), "<f4").reshape(480, 640, 3)
    assert 0.3 < points[240, 320, 2] < 1.0

    moving = again("/tf", v.TF, wanted=lambda message: len(message.transforms) > 1)  # One is of the camera alone.
    assert {"fer_link7", "palm_link", "target_frame"} <= {each.child_frame_id for each in moving.transforms}
    still = again("/tf_static", v.TF, latched=True)  # Said before Fast DDS was there.
    assert "fer_link0" in {each.child_frame_id for each in still.transforms}


def test_fast_dds_leads_the_palm_and_the_fingers_of_a_cell_and_hears_why_not(
    echo: Path,
    peer: Peer,
    types: v.RosTypes,
    again: Callable[..., Any],
    cell: Served,  # noqa: F811  # The fixture of that name.
) -> None:
    wanted, hand = np.array([-0.15, 0.1, 0.38]), cell.made.robot.hand_sim
    with echoing(echo, peer.full("wish"), peer.full(topics.TARGET), v.POSE):
        time.sleep(1.0)  # Until Fast DDS has found the cell.
        peer.say("wish", target(types, cell, wanted))
        waited(lambda: bool(np.linalg.norm(cell.palm - wanted) < 0.01), "the palm is not there", 40.0)
        peer.say("wish", target(types, cell, [-0.1, 0.0, 0.05]))
        line = again("/rosout", v.LOG, latched=True, wanted=lambda message: message.level > 20)
        assert (line.level, "would be in the table" in line.msg) == (30, True), line.msg
    time.sleep(1.5)  # Who has remote until now is quiet.
    goal = cell.made.open + 0.2
    with echoing(echo, peer.full("commands"), peer.full(TRAJECTORY), v.TRAJECTORY):
        time.sleep(1.0)
        peer.say("commands", trajectory(types, cell.made.hand.spec, [0.8], goal[None]))
        waited(lambda: bool(np.abs(hand.data.qpos[hand._qpos] - goal).max() < 0.06), "the fingers did not come", 40.0)


def test_fast_dds_hears_the_hands_description_which_was_said_before_and_says_a_word(
    echo: Path, peer: Peer, namespace: str, home: Vector, again: Callable[..., Any]
) -> None:
    with bridged(sim_config(), namespace) as (hand, _):
        assert "<robot" in again("robot_description", v.STRING, latched=True).data
        with echoing(echo, peer.full("word"), peer.full("lib_cmd"), v.STRING):
            time.sleep(1.0)
            peer.say("word", peer.types.make(v.STRING, data="home"))
            waited(lambda: bool(np.abs(hand.state.position - home).max() < 0.03), "home was not reached", 20.0)
