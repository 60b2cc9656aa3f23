"""Opens a hand of qb electronics, real or virtual, from its block of a config."""

from __future__ import annotations

from allegro_twin.drivers.polled.opening import Protocol
from allegro_twin.drivers.qb import codec
from allegro_twin.drivers.qb.config import QbSettings
from allegro_twin.drivers.qb.device import QbDevice
from allegro_twin.drivers.qb.host import QbWire
from allegro_twin.plugins import BackendKind

PROTOCOL: Protocol[QbSettings] = Protocol(
    motors=1,
    ticks=codec.CLOSED,
    bauds=codec.BAUDS,
    per_period=codec.PER_PERIOD,
    wire=lambda settings, exchange, watchdog: QbWire(exchange, settings.id, watchdog),
    electronics=lambda settings: QbDevice(settings.id),
)
KIND = BackendKind(QbSettings, PROTOCOL.open, PROTOCOL.virtual_hand)
