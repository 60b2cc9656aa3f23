"""Drivers for hands on CAN and serial lines, and virtual hands that speak the same protocols.

What is named here is loaded when it is first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from allegro_twin._lazy import exports

if TYPE_CHECKING:
    from allegro_twin.drivers.can.codec.versions import make_codec
    from allegro_twin.drivers.can.config import CanSettings, FaultSettings, FirmwareSettings
    from allegro_twin.drivers.can.driver.backend import CanBackend
    from allegro_twin.drivers.can.virtual.firmware import Firmware
    from allegro_twin.drivers.dynamixel.config import DynamixelSettings
    from allegro_twin.drivers.dynamixel.driver.backend import DynamixelBackend
    from allegro_twin.drivers.franka import FrankaSettings
    from allegro_twin.drivers.polled.backend import PolledBackend
    from allegro_twin.drivers.qb.config import QbSettings
    from allegro_twin.drivers.schunk.config import SchunkSettings

__all__ = [
    "CanBackend",
    "CanSettings",
    "DynamixelBackend",
    "DynamixelSettings",
    "FaultSettings",
    "Firmware",
    "FirmwareSettings",
    "FrankaSettings",
    "PolledBackend",
    "QbSettings",
    "SchunkSettings",
    "make_codec",
]
__getattr__, __dir__ = exports(
    __name__,
    {
        "can.codec.versions": ("make_codec",),
        "can.config": (
            "CanSettings",
            "FaultSettings",
            "FirmwareSettings",
        ),
        "can.driver.backend": ("CanBackend",),
        "can.virtual.firmware": ("Firmware",),
        "dynamixel.config": ("DynamixelSettings",),
        "dynamixel.driver.backend": ("DynamixelBackend",),
        "franka": ("FrankaSettings",),
        "polled.backend": ("PolledBackend",),
        "qb.config": ("QbSettings",),
        "schunk.config": ("SchunkSettings",),
    },
)
