"""Bus load of hands: a frame that waits too long comes in the next period."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeAlias

from allegro_twin.drivers.can.codec.codec import Codec
from allegro_twin.drivers.can.codec.frames import bits
from allegro_twin.errors import ConfigError

CEILING = 0.8  # Of the bus: beyond it frames of low priority begin to wait for whole periods.
Load: TypeAlias = tuple[Codec, float]
"""A hand's codec, and its period, s."""


def share(load: Load, bitrate: int) -> float:
    """How much of a bus one hand takes at worst, 0 … 1: four torque and four position frames a period, on v5 two of
    pressures."""
    codec, period = load
    frames = 10 if codec.version.startswith("v5") else 8
    return frames * bits(8) / (bitrate * period)


def check_load(loads: Iterable[Load | None], bitrate: int, bus: str) -> float:
    """What all hands on a bus take of it. Raises ConfigError when it is more than the bus can carry."""
    shares = [share(load, bitrate) for load in loads if load is not None]
    total = sum(shares)
    if total > CEILING:
        each = " + ".join(f"{value:.0%}" for value in shares)
        raise ConfigError(
            f"{bus} would be {total:.0%} full ({each}; at most {CEILING:.0%}): use a longer period or another bus"
        )
    return total
