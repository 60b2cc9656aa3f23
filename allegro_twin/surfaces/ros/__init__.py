"""A hand on ROS 2, without ROS installed, or on ROS 1: a client of `Hand` that never turns its loop."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from allegro_twin.recording.messages.message_types import ros_types, ros_types_by_name
from allegro_twin.surfaces.hand import Hand
from allegro_twin.surfaces.ros.bridge import Bridge
from allegro_twin.surfaces.ros.topics import NAMESPACE, NODE

Told = Callable[[str], None]


def _nobody(line: str) -> None:
    """Hears nothing."""


@contextmanager
def open_bridge(
    hand: Hand,
    *,
    namespace: str = NAMESPACE,
    domain: int = 0,
    distro: str = "jazzy",
    rate: float = 100.0,
    speed: float = 2.0,
    network: bool = False,
    told: Told = _nobody,
) -> Iterator[Bridge]:
    """Put a hand on ROS 2; `serve` then passes on what comes. `rate`: Hz, published; `speed`: rad/s, of what is asked
    for without a time; `network`: beyond this machine; `told` hears what was refused. Raises ConfigError, LinkError."""
    from allegro_twin.surfaces.ros.node import Node

    words = ros_types_by_name(distro)
    node = Node(words, NODE, namespace, domain, network=network)
    try:
        bridge = Bridge(hand, node, words, rate=rate, speed=speed, told=told)
        node.announce()
        yield bridge
    finally:
        node.close()


@contextmanager
def open_ros1(
    hand: Hand,
    *,
    namespace: str = NAMESPACE,
    rate: float = 100.0,
    speed: float = 2.0,
    told: Told = _nobody,
) -> Iterator[Bridge]:
    """The same on ROS 1, by rospy, at the master of ROS_MASTER_URI."""
    from allegro_twin.surfaces.ros.ros1 import Ros1Node

    words = ros_types()
    node = Ros1Node(words, NODE, namespace)
    try:
        yield Bridge(hand, node, words, rate=rate, speed=speed, told=told)
    finally:
        node.close()
