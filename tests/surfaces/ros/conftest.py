"""A hand on a ROS domain of this test run's own, and a program beside it."""

from __future__ import annotations

import itertools
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from allegro_twin.app.config import RunConfig
from allegro_twin.recording.messages import message_types as v
from allegro_twin.spec import HandSpec
from allegro_twin.surfaces.hand import Hand
from allegro_twin.types import Vector

pytest.importorskip("rosbags", reason="needs the extra ros2")
pytest.importorskip("cyclonedds", reason="needs the extra ros2")

from allegro_twin.surfaces.ros import open_bridge
from allegro_twin.surfaces.ros.bridge import RosBridge
from allegro_twin.surfaces.ros.node import Node
from allegro_twin.surfaces.ros.node_api import PLAIN, QosProfile
from tests.patience import comes_true, wait_for

DOMAIN = 1 + os.getpid() % 100
_numbers = itertools.count()


@dataclass
class Peer:
    """A program on ROS that hears and says things to one hand."""

    node: Node
    types: v.RosTypes
    namespace: str
    heard: list[tuple[str, Any]] = field(default_factory=list)

    def hear(self, topic: str, kind: str, quality: QosProfile = PLAIN) -> None:
        self.node.subscribe(self.full(topic), kind, quality)
        self.kinds[self.full(topic)] = kind

    kinds: dict[str, str] = field(default_factory=dict)

    def full(self, topic: str) -> str:
        return topic if topic.startswith("/") else f"{self.namespace}/{topic}"

    def say(self, topic: str, message: Any) -> None:
        if self.full(topic) not in self.node._writers:
            self.node.advertise(self.full(topic), message.__msgtype__)
            self.settle(topic)
        self.node.publish(self.full(topic), message)

    def settle(self, topic: str) -> None:
        """Until somebody listens: what is published before that is lost, as it is in ROS."""
        writer = self.node._writers[self.full(topic)]
        waited(lambda: len(writer.get_matched_subscriptions()) > 0, f"nobody hears {topic}")

    def listen(self, seconds: float, until: Callable[[str, Any], bool] = lambda topic, message: False) -> Any:
        """What comes, decoded, up to the first that fulfils the condition, which is returned."""
        found: list[Any] = []

        def heard() -> bool:
            for topic, data, _ in self.node.wait(0.05):
                message = self.types.decode(data, self.kinds[topic])
                self.heard.append((topic, message))
                if until(topic, message):
                    found.append(message)
                    return True
            return False

        return found[0] if comes_true(heard, seconds) else None

    def refusal(self, seconds: float = 5.0) -> str:
        """The next line on /rosout."""
        found = self.listen(seconds, lambda topic, message: topic == "/rosout")
        return "" if found is None else str(found.msg)

    def joint_cmd(self, spec: HandSpec, position: Vector, *, stamp: int = 0, names: list[str] | None = None) -> None:
        self.say("joint_cmd", self.types.make(
            v.JOINT_STATE, header=self.types.header(stamp), name=list(spec.joints) if names is None else names,
            position=np.asarray(position, dtype=float), velocity=np.zeros(0), effort=np.zeros(0)))  # fmt: skip

    def lib_cmd(self, word: str) -> None:
        self.say("lib_cmd", self.types.make(v.STRING, data=word))


def waited(condition: Callable[[], bool], what: str, seconds: float = 10.0) -> bool:
    """Whether it came true; where it does not in so many seconds, a failure that says `what`."""
    wait_for(condition, what, seconds)
    return True


@pytest.fixture(scope="session")
def types() -> v.RosTypes:
    return v.ros_types()


@pytest.fixture
def namespace() -> str:
    return f"/test_{os.getpid()}_{next(_numbers)}"


@pytest.fixture
def make_peer(types: v.RosTypes, namespace: str) -> Iterator[Callable[[], Peer]]:
    made: list[Peer] = []

    def make() -> Peer:
        peer = Peer(Node(types, f"peer_{len(made)}", "/", DOMAIN), types, namespace)
        made.append(peer)
        return peer

    yield make
    for peer in made:
        peer.node.close()


@pytest.fixture
def peer(make_peer: Callable[[], Peer]) -> Peer:
    return make_peer()


def sim_config(**blocks: Any) -> RunConfig:
    return RunConfig.model_validate({"backend": {"kind": "sim"}, "controller": {"kind": "pid"}} | blocks)


@contextmanager
def bridged(config: RunConfig, namespace: str, **settings: Any) -> Iterator[tuple[Hand, RosBridge]]:
    """A hand that lives by itself, with a bridge that serves in a thread."""
    over = threading.Event()
    with (
        Hand.open(config, background=True) as hand,
        open_bridge(hand, namespace=namespace, domain=DOMAIN, **settings) as bridge,
    ):
        thread = threading.Thread(target=bridge.serve, args=(over.is_set,), daemon=True)
        thread.start()
        try:
            yield hand, bridge
        finally:
            over.set()
            thread.join(timeout=5.0)
