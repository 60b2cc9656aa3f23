"""A hand that answers when it is asked, as a backend."""

from __future__ import annotations

from collections.abc import Callable

from allegro_twin.drivers.base.backend import SerialBackend
from allegro_twin.drivers.base.serial_line import SerialLine
from allegro_twin.drivers.polled.driver import PolledDriver
from allegro_twin.drivers.polled.exchange import Exchange
from allegro_twin.drivers.polled.host_settings import PolledHostSettings
from allegro_twin.drivers.polled.scale import Scale
from allegro_twin.drivers.polled.wire import Wire
from allegro_twin.spec import HandSpec


class PolledBackend(SerialBackend):
    """`wire_of` speaks the hand's language through an exchange on its port."""

    def __init__(
        self,
        spec: HandSpec,
        scale: Scale,
        open_port: Callable[[], SerialLine],
        wire_of: Callable[[Exchange], Wire],
        settings: PolledHostSettings | None = None,
    ) -> None:
        chosen = settings or PolledHostSettings()

        def driver(port: SerialLine) -> PolledDriver:
            exchange = Exchange(port, spec.name, chosen.latency, chosen.tries)
            return PolledDriver(spec, scale, exchange, wire_of(exchange))

        super().__init__(spec, open_port, driver, chosen)
