"""Codec of each version of the hand."""

from __future__ import annotations

from functools import cache

from allegro_twin.drivers.can.codec.codec import Codec
from allegro_twin.drivers.can.codec.v1_v3 import V1To3
from allegro_twin.drivers.can.codec.v4 import V4
from allegro_twin.drivers.can.codec.v5 import V5, V5Plus
from allegro_twin.errors import ConfigError
from allegro_twin.hands.description.calibration import HandCalibration, Version

LAST_DEVICE: dict[Version, int] = {"v1": 0, "v2": 0, "v3": 0, "v4": 3, "v5": 0, "v5plus": 0}
"""Highest device id. v5: the low two bits of its identifiers are always zero (v5 manual, IC docs)."""


@cache
def make_codec(version: Version, calibration: HandCalibration | None = None, device: int = 0) -> Codec:
    """The codec of one hand on the bus. Raises ConfigError for a device id that the version does not have."""
    last = LAST_DEVICE[version]
    if not 0 <= device <= last:
        raise ConfigError(f"device {device} does not exist: a {version} hand has device ids 0 to {last}")
    own = calibration or HandCalibration()
    match version:
        case "v4":
            return V4(own, device)
        case "v5":
            return V5(own)
        case "v5plus":
            return V5Plus(own)
        case _:
            return V1To3(version, own)
