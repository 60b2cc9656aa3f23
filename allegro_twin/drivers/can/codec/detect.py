"""Detection of the hands that report on a bus, for error messages."""

from __future__ import annotations

from collections.abc import Collection
from functools import cache

from allegro_twin.drivers.can.codec.codec import Codec
from allegro_twin.drivers.can.codec.frames import Frame
from allegro_twin.drivers.can.codec.messages import FingerPosition, FingertipPressure
from allegro_twin.drivers.can.codec.v4 import V4
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


@cache
def _v5_alone() -> frozenset[int]:
    """Identifiers of the fingertip pressures, which no v4 hand has. Those of other firmware, from 0x50 on, are not
    among them: an early v4 hand took its torques there (docs/reference/can_protocol.md)."""
    v5 = make_codec("v5")
    return frozenset(v5.encode(FingertipPressure(pair, (0.0, 0.0))).id for pair in ((0, 1), (2, 3)))


def contradiction(codec: Codec, frame: Frame) -> str:
    """Why a frame cannot be on the bus of a hand of this version, whose other frames a v5 hand's look like; empty where
    it can be."""
    first_v4 = isinstance(codec, V4) and codec.version == "v4" and not codec.device
    if not first_v4 or frame.id not in _v5_alone() or frame.remote or len(frame.data) != 8:
        return ""
    return f"frame {frame} is a v5 hand's pressure at two fingertips, which no v4 hand has: correct `backend.version`"


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
