"""What hands on a serial line speak that answer when they are asked: one entry a language."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from allegro_twin.app.config.polled import PolledSettings, QbSettings, SchunkSettings
from allegro_twin.drivers.polled.device import Electronics
from allegro_twin.drivers.polled.exchange import Exchange
from allegro_twin.drivers.polled.wire import Wire
from allegro_twin.drivers.qb import codec as qb
from allegro_twin.drivers.qb.device import QbDevice
from allegro_twin.drivers.qb.host import QbWire
from allegro_twin.drivers.schunk import codec as schunk
from allegro_twin.drivers.schunk.device import SchunkDevice
from allegro_twin.drivers.schunk.host import SchunkWire


@dataclass(frozen=True, slots=True)
class Language:
    """`Any` is the class of settings that the language is entered with."""

    kind: str
    """As in a config's `backend.kind`."""
    motors: int
    ticks: int
    """Of a motor's whole way."""
    bauds: tuple[int, ...]
    """The speeds that such a hand can have."""
    per_period: int
    """Bytes that question and answer of a period take."""
    wire: Callable[[Any, Exchange, int], Wire]
    """The host's end: settings, exchange, the watchdog's steps."""
    electronics: Callable[[Any], Electronics]
    """A virtual hand's end, as it is when power comes."""


LANGUAGES: Mapping[type[PolledSettings], Language] = {
    QbSettings: Language(
        "qb", 1, qb.CLOSED, qb.BAUDS, qb.PER_PERIOD,
        wire=lambda settings, exchange, watchdog: QbWire(exchange, settings.id, watchdog),
        electronics=lambda settings: QbDevice(settings.id),
    ),
    SchunkSettings: Language(
        "schunk", schunk.ACTUATORS, schunk.TICKS, (schunk.BAUD,), schunk.PER_PERIOD,
        wire=lambda settings, exchange, watchdog: SchunkWire(exchange, watchdog),
        electronics=lambda settings: SchunkDevice(),
    ),
}  # fmt: skip
