"""Opens a Schunk hand on our layout of its frames, real or virtual, from its block of a config."""

from __future__ import annotations

from allegro_twin.drivers.polled.opening import Protocol
from allegro_twin.drivers.schunk import codec
from allegro_twin.drivers.schunk.config import SchunkSettings
from allegro_twin.drivers.schunk.device import SchunkDevice
from allegro_twin.drivers.schunk.host import SchunkWire
from allegro_twin.plugins import BackendKind

PROTOCOL: Protocol[SchunkSettings] = Protocol(
    motors=codec.ACTUATORS,
    ticks=codec.TICKS,
    bauds=(codec.BAUD,),
    per_period=codec.PER_PERIOD,
    wire=lambda settings, exchange, watchdog: SchunkWire(exchange, watchdog),
    electronics=lambda settings: SchunkDevice(),
)
KIND = BackendKind(SchunkSettings, PROTOCOL.open, PROTOCOL.virtual_hand)
