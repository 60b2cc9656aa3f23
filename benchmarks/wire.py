"""What the codecs cost: a period's eight frames, each encoded and decoded, beside `struct` alone."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from struct import Struct

from allegro_twin.drivers.can.codec import messages as m
from allegro_twin.drivers.can.codec.codec import Codec
from allegro_twin.drivers.can.codec.messages import Message
from allegro_twin.drivers.can.codec.versions import make_codec
from allegro_twin.hands.description.calibration import Version

TURNS, ROUNDS = 3000, 9
VERSIONS: tuple[Version, ...] = ("v2", "v4", "v5plus")
Figure = tuple[str, float, float, str]


def figures() -> Iterator[Figure]:
    """Four torques and four positions, at both ends of the bus; and what of it the host's end is."""
    bare = _seconds(_bare)
    yield "eight frames packed and unpacked by struct alone", 1e6 * bare, 40.0, "us"
    slowest = 0.0
    for version in VERSIONS:
        codec = make_codec(version)
        both = _seconds(_both_ends(codec))
        slowest = max(slowest, both)
        yield f"a period's eight frames encoded and decoded, {version}", 1e6 * both, 40.0, "us"
        yield (
            f"  the host's half: torques encoded, positions decoded, {version}",
            1e6 * _seconds(_host(codec)),
            20.0,
            "us",
        )
    yield "frames encoded and decoded, thousands a second (at least)", 8e-3 / slowest, 300.0, ""


def _period() -> tuple[list[m.SetTorque], list[m.FingerPosition]]:
    torques = [m.SetTorque(finger, (0.11, -0.22, 0.05, 0.001)) for finger in range(4)]
    return torques, [m.FingerPosition(finger, (0.1, 0.7, -0.1, 1.2)) for finger in range(4)]


def _both_ends(codec: Codec) -> Callable[[], None]:
    torques, positions = _period()
    messages: list[Message] = [*torques, *positions]

    def work() -> None:
        for message in messages:
            codec.decode(codec.encode(message))

    return work


def _host(codec: Codec) -> Callable[[], None]:
    torques, positions = _period()
    reports = [codec.encode(position) for position in positions]

    def work() -> None:
        for torque in torques:
            codec.encode(torque)
        for report in reports:
            codec.decode(report)

    return work


def _bare() -> None:
    four = _FOUR
    for _ in range(8):
        four.unpack(four.pack(132, -264, 60, 1))


_FOUR = Struct("<4h")


def _seconds(work: Callable[[], None]) -> float:
    """The best of several rounds: others use the machine too."""
    rounds = []
    for _ in range(ROUNDS):
        start = time.perf_counter()
        for _ in range(TURNS):
            work()
        rounds.append((time.perf_counter() - start) / TURNS)
    return min(rounds)
