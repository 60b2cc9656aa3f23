"""Detection of the hands that report on a bus, for error messages."""

from __future__ import annotations

from collections.abc import Collection
from functools import cache

from allegro_twin.drivers.can.codec.codec import Codec
from allegro_twin.drivers.can.codec.frames import Frame
from allegro_twin.drivers.can.codec.messages import FingerPosition
from allegro_twin.drivers.can.codec.versions import LAST_DEVICE, make_codec
from allegro_twin.errors import ProtocolError
from allegro_twin.hands.description.calibration import Version


@cache
def _everybody() -> tuple[tuple[Version, int, Codec], ...]:
    return tuple(
        (version, device, make_codec(version, device=device))
        for version, last in LAST_DEVICE.items()
        for device in range(last + 1)
    )


@cache
def of_other_device(version: Version, identifier: int) -> bool:
    """Whether an identifier belongs to another device of the same version."""
    frame = Frame(identifier)
    return any(_reads(codec, frame) for known, _, codec in _everybody() if known == version)


def reporting(frames: Collection[Frame]) -> str:
    """Which hands report their joints in these frames, in words; empty when none does.

    Versions that report with the same frames are named together: `a v1, v2 or v3 hand`.
    """
    found: dict[frozenset[int], list[str]] = {}
    for version, device, codec in _everybody():
        identifiers = frozenset(frame.id for frame in frames if _reports(codec, frame))
        if identifiers:
            found.setdefault(identifiers, []).append(f"{version}{f' (device {device})' if device else ''}")
    return ", ".join(f"a {_either(names)} hand" for names in found.values())


def _reports(codec: Codec, frame: Frame) -> bool:
    try:
        return isinstance(codec.decode(frame), FingerPosition)
    except ProtocolError:
        return False


def _either(names: list[str]) -> str:
    return " or ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def _reads(codec: Codec, frame: Frame) -> bool:
    try:
        return codec.decode(frame) is not None
    except ProtocolError:
        return True
