"""Whose frame is it, when it is not this hand's: for messages that say what is wrong with a bus."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

from allegro_twin.errors import ProtocolError
from allegro_twin.wire.codec import Codec, Version
from allegro_twin.wire.frames import Frame
from allegro_twin.wire.messages import FingerPosition
from allegro_twin.wire.versions import LAST_DEVICE, make_codec


@cache
def _everybody() -> tuple[tuple[Version, int, Codec], ...]:
    return tuple(
        (version, device, make_codec(version, device=device))
        for version, last in LAST_DEVICE.items()
        for device in range(last + 1)
    )


@cache
def neighbours(version: Version, identifier: int) -> bool:
    """Whether an identifier belongs to another device of the same version."""
    frame = Frame(identifier)
    return any(_reads(codec, frame) for known, _, codec in _everybody() if known == version)


def speakers(frames: Iterable[Frame]) -> str:
    """Which hands report their joints in these frames, in words; empty when none does."""
    found: dict[tuple[str, int], set[int]] = {}
    for frame in frames:
        for version, device, codec in _everybody():
            try:
                message = codec.decode(frame)
            except ProtocolError:
                continue
            if isinstance(message, FingerPosition):
                found.setdefault((version, device), set()).add(message.finger)
    return ", ".join(f"a {version} hand, device {device}" for (version, device), fingers in found.items() if fingers)


def _reads(codec: Codec, frame: Frame) -> bool:
    try:
        return codec.decode(frame) is not None
    except ProtocolError:
        return True
