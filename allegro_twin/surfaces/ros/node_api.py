"""ROS node API: the operations of a ROS 1 or ROS 2 node that a bridge needs, and the parts that both share."""

from __future__ import annotations

import re
from typing import NamedTuple, Protocol
from uuid import UUID

from allegro_twin.errors import ConfigError
from allegro_twin.recording.messages.message_types import Message

NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


class Received(NamedTuple):
    """A message that came, as CDR bytes of ROS 2."""

    topic: str
    data: bytes
    sender: UUID
    """The program that sent it."""


class QosProfile(NamedTuple):
    """Quality of service, in ROS 2's words; always reliable, which is its default."""

    depth: int = 10
    latched: bool = False
    """Transient local: who comes later gets the last one too."""


PLAIN = QosProfile()
"""ROS 2's default."""


class RosTopic(NamedTuple):
    """One topic; a name without a slash in front is in the session's namespace."""

    name: str
    kind: str
    quality: QosProfile
    what: str
    """For the table in docs/reference/topics.md."""


class RosNode(Protocol):
    """A node, as far as a bridge knows it."""

    def advertise(self, topic: str, kind: str, quality: QosProfile = PLAIN) -> None: ...
    def subscribe(self, topic: str, kind: str, quality: QosProfile = PLAIN) -> None: ...
    def publish(self, topic: str, message: Message) -> None: ...
    def wait(self, seconds: float) -> list[Received]: ...


def full(topic: str, namespace: str) -> str:
    """A topic with its namespace in front, unless it has one."""
    return topic if topic.startswith("/") else f"{namespace.rstrip('/')}/{topic}"


def checked(namespace: str) -> str:
    """A namespace as ROS has it, with a slash in front. Raises ConfigError."""
    parts = namespace.strip("/").split("/")
    if namespace.strip("/") and not all(NAME.fullmatch(part) for part in parts):
        raise ConfigError(f"a ROS namespace has letters, digits and _ between slashes, not {namespace!r}")
    return "/" + namespace.strip("/")
