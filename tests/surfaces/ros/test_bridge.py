"""A program on ROS sees the hand, moves it, and cannot harm it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from allegro_twin.errors import ConfigError, HandFault
from allegro_twin.hands.library.library import load_posture
from allegro_twin.recording.messages import message_types as v
from allegro_twin.spec import HandSpec
from allegro_twin.surfaces.hand import Hand
from allegro_twin.surfaces.ros import open_bridge
from allegro_twin.surfaces.ros.bridge import QUIET, SenderLock, SessionTopics
from allegro_twin.surfaces.ros.hand_topics import PUBLISHED, WRENCH
from allegro_twin.surfaces.ros.joint_trajectory import TRAJECTORY
from allegro_twin.surfaces.ros.node import Node, qos_of
from allegro_twin.surfaces.ros.node_api import QosProfile, checked
from allegro_twin.types import Array, Vector
from tests.conftest import can_config
from tests.surfaces.ros.conftest import DOMAIN, Peer, bridged, sim_config, waited

LATCHED = QosProfile(1, latched=True)


@pytest.fixture
def hand(namespace: str) -> Iterator[Hand]:
    with bridged(sim_config(), namespace) as (opened, _):
        yield opened


def trajectory(
    types: v.RosTypes, spec: HandSpec, times: list[float], postures: Array, velocities: Array | None = None,
    *, names: list[str] | None = None, stamp: int = 0,
) -> Any:  # fmt: skip
    points = [
        types.make(
            "trajectory_msgs/msg/JointTrajectoryPoint",
            positions=np.asarray(row, dtype=float),
            velocities=np.zeros(0) if velocities is None else np.asarray(velocities[k], dtype=float),
            accelerations=np.zeros(0),
            effort=np.zeros(0),
            time_from_start=types.make("builtin_interfaces/msg/Duration", sec=int(t // 1), nanosec=round(t % 1 * 1e9)),
        )
        for k, (t, row) in enumerate(zip(times, postures, strict=True))
    ]
    return types.make(
        v.TRAJECTORY,
        header=types.header(stamp),
        joint_names=list(spec.joints) if names is None else names,
        points=points,
    )


def there(hand: Hand, posture: Vector, tolerance: float = 0.03) -> Callable[[], bool]:
    return lambda: bool(np.abs(hand.state.position - posture).max() < tolerance)


def test_joint_states_come_at_the_rate_with_the_hands_own_names(hand: Hand, peer: Peer) -> None:
    before = hand.state.t
    peer.hear("joint_states", v.JOINT_STATE)
    peer.listen(5.0, lambda topic, message: True)
    began = time.time()
    assert peer.listen(20.0, lambda topic, message: len(peer.heard) >= 100) is not None
    messages = [message for _, message in peer.heard]
    assert messages[0].name == list(hand.spec.joints)
    stamps = np.array([v.nanoseconds(message.header.stamp) for message in messages]) / 1e9
    assert (np.diff(stamps) > 0).all()
    most = 100.0 * (hand.state.t - before) + 1  # Of the hand's time, which may catch up with ours.
    assert len(stamps) <= most + SessionTopics.backlog + 1
    assert began - 60.0 < stamps[0] < stamps[-1] < time.time()


@pytest.mark.parametrize("rate", [30.0, 100.0, 1000.0])
def test_samples_come_at_the_rate_and_none_is_made_up_for_after_a_gap(types: v.RosTypes, rate: float) -> None:
    topics = SessionTopics(types, "hand", rate)
    ticks = [k for k in range(1000) if k >= 50 and not 200 <= k < 350]
    due = [k for k in ticks if topics._is_due(k * 0.003)]
    gaps = 0.003 * np.diff(due)
    assert due[0] == 50
    assert gaps.min() > 1.0 / rate - 0.003 - 1e-9
    assert len(due) == pytest.approx(min(rate, 1.0 / 0.003) * 0.003 * len(ticks), abs=2)


def test_who_comes_late_still_gets_the_description_and_the_frames_that_do_not_move(hand: Hand, peer: Peer) -> None:
    time.sleep(0.5)
    peer.hear("robot_description", v.STRING, LATCHED)
    peer.hear("/tf_static", v.TF, LATCHED)
    peer.listen(5.0, lambda topic, message: len(peer.heard) >= 2)
    found = dict(peer.heard)
    assert found[peer.full("robot_description")].data.startswith(f'<robot name="{hand.spec.name}"')
    tips = {finger.tip for finger in hand.spec.fingers}
    assert {each.child_frame_id for each in found["/tf_static"].transforms} == tips


def test_other_nodes_find_the_node_its_topics_and_the_hashes_of_their_types(
    hand: Hand, peer: Peer, namespace: str, types: v.RosTypes
) -> None:
    from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsParticipant, BuiltinTopicDcpsPublication
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic

    from allegro_twin.surfaces.ros.node import wire

    participant = peer.node._participant
    reader = DataReader(participant, Topic(participant, "ros_discovery_info", wire(types, v.NODES)), qos_of(LATCHED))
    mine: list[tuple[Any, Any]] = []

    def found() -> bool:
        for sample in reader.take(N=20):
            info = types.decode(sample.data, v.NODES)
            mine.extend((info, node) for node in info.node_entities_info_seq if node.node_namespace == namespace)
        return bool(mine)

    waited(found, "the node did not announce itself")
    info, node = mine[-1]
    assert node.node_name == "allegro_twin"
    endpoints = BuiltinDataReader(participant, BuiltinTopicDcpsPublication).take(N=200)
    written = {bytes(gid.data) for gid in node.writer_gid_seq}
    topics = {}
    waited(lambda: bool(endpoints.extend(  # Both are wanted.
        BuiltinDataReader(participant, BuiltinTopicDcpsPublication).take(N=200)) or
        written <= {each.key.bytes for each in endpoints}), "a topic is not to be seen")  # fmt: skip
    for each in endpoints:
        if each.key.bytes in written:
            topics[each.topic_name] = (each.type_name, dict(_userdata(each.qos)))
            assert each.participant_key.bytes == bytes(info.gid.data)
    expected = {
        topic: entry.kind
        for entry in PUBLISHED
        for topic in ([entry.name.format(finger=f.name) for f in hand.spec.fingers] if entry.name == WRENCH
                      else [entry.name])
    }  # fmt: skip
    assert topics == {
        "rt" + (name if name.startswith("/") else f"{namespace}/{name}"): (
            kind.replace("/", "::").replace("::msg::", "::msg::dds_::") + "_",
            {"typehash": types.hash(kind)},
        )
        for name, kind in expected.items()
    }
    people = BuiltinDataReader(participant, BuiltinTopicDcpsParticipant).take(N=200)
    assert ("enclave", "/") in {pair for each in people for pair in _userdata(each.qos)}


def _userdata(qos: Any) -> list[tuple[str, str]]:
    text = next((policy.data.decode() for policy in qos.policies if type(policy).__name__ == "Userdata"), "")
    return [(key, value) for key, _, value in (part.partition("=") for part in text.split(";") if part)]


@pytest.mark.parametrize("word", ["home", "rock"])
def test_the_manufacturers_words_move_the_hand(hand: Hand, peer: Peer, word: str) -> None:
    peer.lib_cmd(word)
    assert waited(there(hand, load_posture(word, hand.spec)), f"{word} was not reached")


@pytest.mark.slow
def test_words_change_controllers_and_a_saved_posture_comes_back(hand: Hand, peer: Peer) -> None:
    peer.lib_cmd("gravcomp")
    assert waited(lambda: hand.controller == "gravity", "no gravity compensation")
    peer.lib_cmd("home")
    assert waited(there(hand, load_posture("home", hand.spec)), "home was not reached")
    peer.lib_cmd("save")
    peer.lib_cmd("rock")
    assert waited(there(hand, load_posture("rock", hand.spec)), "rock was not reached")
    peer.lib_cmd("pdControl")
    assert waited(there(hand, load_posture("home", hand.spec)), "what was saved was not reached")
    peer.lib_cmd("pinch_it")
    assert waited(lambda: "pinch_index" in hand.controller, "no pinch")
    peer.lib_cmd("off")
    assert waited(lambda: hand.controller == "torque", "not off")


def test_joint_cmd_leads_the_hand_no_faster_than_the_speed(hand: Hand, peer: Peer, home: Vector) -> None:
    fastest: list[float] = []
    hand.listen(lambda sample: fastest.append(float(np.abs(sample.state.velocity).max())))
    peer.joint_cmd(hand.spec, home)
    waited(there(hand, home), "joint_cmd was not followed")
    assert max(fastest) < 3.0  # 2 rad/s, and what PID overshoots.
    for part in np.linspace(0.0, 1.0, 30):
        peer.joint_cmd(hand.spec, home + part * 0.2, stamp=time.time_ns())
        time.sleep(0.02)
    waited(there(hand, home + 0.2), "the stream was not followed")


@pytest.mark.slow
@pytest.mark.parametrize("smooth", [False, True])
def test_a_trajectory_from_another_program_moves_the_hand_on_its_bus(
    namespace: str, peer: Peer, types: v.RosTypes, home: Vector, smooth: bool
) -> None:
    config = can_config("v4", identify=True)
    with bridged(config, namespace) as (hand, _):
        ways = np.array([home, home + 0.15, home])
        rates = np.zeros_like(ways) if smooth else None
        peer.say(TRAJECTORY, trajectory(types, hand.spec, [1.5, 2.0, 2.5], ways, rates))
        assert waited(there(hand, home + 0.15, 0.04), "the middle was not reached", 20.0)
        assert waited(there(hand, home, 0.04), "the end was not reached", 20.0)


def bad(types: v.RosTypes, spec: HandSpec, home: Vector) -> dict[str, tuple[Any, str]]:
    """Trajectories that are refused, and in which words."""
    nan, far = home.copy(), home.copy()
    nan[3], far[3] = np.nan, 3.0

    def made(*what: Any, **more: Any) -> Any:
        return trajectory(types, spec, *what, **more)

    return {
        "unknown": (made([1.0], [home], names=["thumb_9", *spec.joints[1:]]), "no joint named 'thumb_9'"),
        "missing": (made([1.0], [home[1:]], names=list(spec.joints[1:])), "lacks joint_0.0: it needs all 16 joints"),
        "no names": (made([1.0], [home], names=[]), "no joint named '\\(none\\)'"),
        "short": (made([1.0], [home[1:]]), "positions has 15 numbers for 16 joints"),
        "NaN": (made([1.0], [nan]), "for joint_3.0 is nan; every value must be finite"),
        "beyond": (made([1.0], [far]), "index_3 = 3.0000 rad is .* outside its limits"),
        "back": (made([1.0, 0.5], [home, home]), "time_from_start must ascend from 0, s; it is 1, 0.5"),
        "at once": (made([0.0, 1.0], [home, home]), "its first point is .* rad from the hand, at once"),
        "fast": (made([0.01], [home]), "rad/s; 12 is where the guard stops: slow down"),
        "past": (made([1.0], [home], stamp=5 * 10**9), "s ago by its stamp; set the clocks"),
    }


def test_trajectories_that_cannot_be_are_refused_in_one_line_and_move_nothing(
    hand: Hand, peer: Peer, types: v.RosTypes, home: Vector
) -> None:
    import re

    peer.lib_cmd("home")
    waited(there(hand, home), "home was not reached")
    peer.hear("/rosout", v.LOG, QosProfile(1000, latched=True))
    peer.hear("joint_states", v.JOINT_STATE)
    for name, (message, said) in bad(types, hand.spec, home + 0.2).items():
        peer.say(TRAJECTORY, message)
        refusal = peer.refusal()
        assert re.search(said, refusal), f"{name}: {refusal!r}"
        assert "\n" not in refusal
    assert hand.controller == "pid"
    assert there(hand, home)()


def test_set_points_that_cannot_be_are_refused_and_the_hand_stays(hand: Hand, peer: Peer, home: Vector) -> None:
    peer.joint_cmd(hand.spec, home, stamp=time.time_ns())
    waited(there(hand, home), "joint_cmd was not followed")
    peer.hear("/rosout", v.LOG, QosProfile(1000, latched=True))
    nan = home.copy()
    nan[0] = np.inf
    peer.joint_cmd(hand.spec, nan)
    assert "joint_cmd for joint_0.0 is inf; every value must be finite" in peer.refusal()
    peer.joint_cmd(hand.spec, home + 0.1, stamp=7)
    assert "before that of the one before it" in peer.refusal()
    peer.joint_cmd(hand.spec, home[:3], names=list(hand.spec.joints[:3]))
    assert "lacks joint_3.0" in peer.refusal()
    peer.lib_cmd("conf/postures/home.yaml")
    assert "no word named" in peer.refusal()
    peer.say("gravity", peer.types.make(v.VECTOR, x=0.0, y=float("nan"), z=0.0))
    assert "gravity needs three finite numbers" in peer.refusal()
    peer.say("envelop_torque", peer.types.make(v.FLOAT, data=7.0))
    assert "envelop_torque must be 0 to 1, not 7" in peer.refusal()
    assert there(hand, home)()


def test_a_second_program_is_not_obeyed_but_for_off(hand: Hand, make_peer: Callable[[], Peer], home: Vector) -> None:
    first, second = make_peer(), make_peer()
    second.hear("/rosout", v.LOG, QosProfile(1000, latched=True))
    second.joint_cmd(hand.spec, home)
    over = threading.Event()

    def stream() -> None:
        while not over.is_set():
            first.joint_cmd(hand.spec, home)
            time.sleep(0.05)

    waited(there(hand, home), "nobody drove")
    time.sleep(QUIET + 0.1)
    thread = threading.Thread(target=stream)
    thread.start()
    try:
        time.sleep(0.5)
        second.joint_cmd(hand.spec, home + 0.2)
        assert "another program drives the hand" in second.refusal()
        assert there(hand, home)()
        second.lib_cmd("off")
        waited(lambda: hand.controller == "torque", "off was not obeyed")
        time.sleep(0.5)
        assert hand.controller == "torque", "the stream went on after off"
    finally:
        over.set()
        thread.join()


def test_one_drives_until_it_was_quiet_or_its_motion_is_over() -> None:
    from uuid import uuid4

    lock, a, b = SenderLock(), uuid4(), uuid4()
    assert lock.acquire(a, 0.0)
    assert not lock.acquire(b, 0.5)
    assert lock.first_refusal(b)
    assert not lock.first_refusal(b)
    assert lock.acquire(b, 1.1)
    lock.extend(b, 1.1, 5.0)
    assert not lock.acquire(a, 6.0)
    assert lock.acquire(a, 7.2)
    lock.stop(b)
    assert not lock.acquire(a, 7.9)
    assert not lock.acquire(a, 8.5)  # Quiet for 0.6 s only.
    assert lock.acquire(b, 8.5)
    assert not lock.acquire(a, 9.4)
    assert lock.acquire(a, 10.5)


def test_what_pushes_on_a_fingertip_is_told_in_newtons(hand: Hand, peer: Peer, types: v.RosTypes) -> None:
    """0.3 N·m that lead the third joint of the index finger back are what so many newtons at its tip do."""
    peer.lib_cmd("home")
    waited(there(hand, load_posture("home", hand.spec)), "home was not reached")
    peer.hear("wrench/index", v.WRENCH)
    before = peer.listen(5.0, lambda topic, message: True)
    assert hand.sim is not None
    finger, model = hand.spec.finger("index"), hand._mover.model
    _, jacobian = model.fingertip_jacobians(hand.state.position, ["index"])
    force = np.array([-2.0, 0.0, 0.5])  # N, on the tip, in the palm frame.
    torque = np.zeros(hand.spec.n_joints)
    torque[list(finger.joints)] = jacobian[0][:, list(finger.joints)].T @ force
    hand.sim.push(torque)
    time.sleep(1.5)
    peer.heard.clear()
    peer.listen(0.5)
    after = peer.heard[-1][1]
    turn = model.fingertips(hand.state.position)["index"].rotation
    felt = turn @ np.array([getattr(after.wrench.force, axis) for axis in "xyz"])
    assert after.header.frame_id == before.header.frame_id == finger.tip
    np.testing.assert_allclose(felt, force, atol=1.0)  # Dry friction carries up to that of it.


def test_a_bridge_that_ends_leaves_the_hand_as_it_is(namespace: str, home: Vector) -> None:
    with Hand.open(sim_config(), background=True) as hand:
        hand.move_to(home)
        with open_bridge(hand, namespace=namespace, domain=DOMAIN) as bridge:
            bridge.serve(iter([False, False, True]).__next__)
        now = hand.state.t
        hand.wait(0.3)
        assert hand.state.t >= now + 0.3
        assert there(hand, home)()


def test_when_the_hand_ends_the_bridge_says_why_and_ends(namespace: str, peer: Peer) -> None:
    with Hand.open(sim_config(limits={"velocity": 1.2}), background=True) as hand:
        peer.hear("/diagnostics", v.DIAGNOSTICS)
        with pytest.raises(ConfigError, match=r"set-points: .* would move at 2 rad/s; 1\.2 is where the guard stops"):
            open_bridge(hand, namespace=namespace, domain=DOMAIN).__enter__()
        with open_bridge(hand, namespace=namespace, domain=DOMAIN, speed=1.0) as bridge:
            hand.set_controller("torque", torque=0.2)  # Faster than this guard lets it.
            with pytest.raises(HandFault):
                bridge.serve()
            last = peer.listen(5.0, lambda topic, message: message.status[0].level == 2)
    assert last is not None
    assert "rad/s" in last.status[0].message


def test_names_and_domains_that_ros_does_not_allow_are_refused(types: v.RosTypes, namespace: str) -> None:
    assert checked("a/b/") == "/a/b"
    assert checked("/") == "/"
    for wrong in ("a b", "1st", "a//b", "/a/ü"):
        with pytest.raises(ConfigError, match="namespace has letters"):
            checked(wrong)
    with pytest.raises(ConfigError, match="ROS_DOMAIN_ID must be 0 to 232, not 233"):
        Node(types, "n", "/", 233)
    with pytest.raises(ConfigError, match="no ROS 2 distribution named 'jazy'; did you mean 'jazzy'"):
        v.ros_types_by_name("jazy")
