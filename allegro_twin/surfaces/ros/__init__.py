"""Sessions on ROS: a hand on ROS 2, without ROS installed, or on ROS 1, and a cell on ROS 2.

A bridge is an observer of its session, whose loop it never turns.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from allegro_twin.recording.messages.message_types import ros_types, ros_types_by_name
from allegro_twin.surfaces.hand import Hand
from allegro_twin.surfaces.ros.bridge import NODE, RosBridge
from allegro_twin.surfaces.ros.hand_topics import NAMESPACE, HandTopics

if TYPE_CHECKING:
    from allegro_twin.cell.assembly import Cell
    from allegro_twin.cell.remote.remote_control import RemoteControl


def _ignore(reason: str) -> None:
    """Nobody is interested in refusals."""


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
    on_refusal: Callable[[str], None] = _ignore,
) -> Iterator[RosBridge]:
    """Put a hand on ROS 2; `serve` then publishes and obeys.

    `rate`: Hz, of what is published; `speed`: rad/s, of motions without a time; `network`: beyond this machine;
    `on_refusal` gets the reason of every refused command. Raises ConfigError, LinkError.
    """
    from allegro_twin.surfaces.ros.node import Node

    types = ros_types_by_name(distro)
    node = Node(types, NODE, namespace, domain, network=network)
    try:
        bridge = RosBridge(HandTopics(hand, types, rate=rate, speed=speed), node, on_refusal)
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
    on_refusal: Callable[[str], None] = _ignore,
) -> Iterator[RosBridge]:
    """Put a hand on ROS 1, by rospy, at the master of ROS_MASTER_URI; arguments as of `open_bridge`."""
    from allegro_twin.surfaces.ros.ros1 import Ros1Node

    types = ros_types()
    node = Ros1Node(types, NODE, namespace)
    try:
        yield RosBridge(HandTopics(hand, types, rate=rate, speed=speed), node, on_refusal)
    finally:
        node.close()


@contextmanager
def open_cell(
    cell: Cell,
    remote: RemoteControl | None = None,
    *,
    namespace: str = "/",
    domain: int = 0,
    distro: str = "jazzy",
    rate: float = 100.0,
) -> Iterator[RosBridge]:
    """Put a cell on ROS 2, on this machine alone, as an observer of its events. `remote` carries out commands; None:
    the state machine leads the cell, and commands are refused. Raises ConfigError, LinkError."""
    from allegro_twin.surfaces.ros.cell_topics import CellTopics
    from allegro_twin.surfaces.ros.node import Node

    types, over = ros_types_by_name(distro), threading.Event()
    node = Node(types, NODE, namespace, domain)
    try:
        bridge = RosBridge(CellTopics(cell, types, remote, rate=rate), node, _ignore)
        node.announce()
        thread = threading.Thread(target=bridge.serve, args=(over.is_set,), name="allegro_twin ros cell", daemon=True)
        thread.start()
        try:
            yield bridge
        finally:
            over.set()
            thread.join(timeout=2.0)
    finally:
        node.close()
