"""A hand on ROS 2, without ROS installed: a client of `Hand` that never turns its loop."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from allegro_twin.hand import Hand
from allegro_twin.messages.vocabulary import named
from allegro_twin.ros.bridge import Bridge
from allegro_twin.ros.node import Node
from allegro_twin.ros.topics import NAMESPACE, NODE


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
    told: Callable[[str], None] = lambda line: None,
) -> Iterator[Bridge]:
    """Put a hand on ROS; `serve` then passes on what comes. `rate`: Hz, published; `speed`: rad/s, of what is asked for
    without a time; `network`: beyond this machine; `told` hears what was refused. Raises ConfigError or LinkError."""
    words = named(distro)
    node = Node(words, NODE, namespace, domain, network=network)
    try:
        yield Bridge(hand, node, words, rate=rate, speed=speed, told=told)
    finally:
        node.close()
