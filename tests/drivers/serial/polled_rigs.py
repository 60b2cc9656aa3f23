"""Small hands that answer when they are asked, of both languages: joints without MuJoCo, and the line to them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

import numpy as np

from allegro_twin.app.config import RunConfig
from allegro_twin.app.rig import open_backend
from allegro_twin.drivers.base.lockstep import LockstepLine
from allegro_twin.drivers.base.serial_line import SerialLine
from allegro_twin.drivers.polled.backend import PolledBackend
from allegro_twin.drivers.polled.config import PolledFaultSettings, PolledSettings
from allegro_twin.drivers.polled.device import Electronics, VirtualPolledHand
from allegro_twin.drivers.polled.exchange import Exchange
from allegro_twin.drivers.polled.host_settings import PolledHostSettings
from allegro_twin.drivers.polled.scale import Scale
from allegro_twin.drivers.polled.wire import Wire
from allegro_twin.drivers.qb import codec as qb
from allegro_twin.drivers.qb.device import QbDevice
from allegro_twin.drivers.qb.host import QbWire
from allegro_twin.drivers.schunk import codec as schunk
from allegro_twin.drivers.schunk.device import SchunkDevice
from allegro_twin.drivers.schunk.host import SchunkWire
from allegro_twin.files.schema import parse_settings
from allegro_twin.spec import HandSpec
from allegro_twin.types import HandState, PositionCommand, Vector
from tests.drivers.serial.rigs import MADE, PERIOD, Joints, small_spec

Kind = Literal["qb", "schunk"]
KINDS: tuple[Kind, Kind] = ("qb", "schunk")
MOTORS = {"qb": 1, "schunk": schunk.ACTUATORS}
BAUD = {"qb": qb.BAUDS[0], "schunk": schunk.BAUD}
TICKS = {"qb": qb.CLOSED, "schunk": schunk.TICKS}
ID = 7
KT = 2.0
"""N·m/A."""


def spec_of(kind: Kind) -> HandSpec:
    return small_spec(MOTORS[kind], ("position", "timed_position"))


def scale_of(kind: Kind) -> Scale:
    return Scale.of(spec_of(kind), TICKS[kind], KT)


def boot_of(kind: Kind) -> Callable[[], Electronics]:
    return (lambda: QbDevice(ID)) if kind == "qb" else SchunkDevice


def wire_of(kind: Kind, settings: PolledHostSettings, identifier: int = ID) -> Callable[[Exchange], Wire]:
    def wire(exchange: Exchange) -> Wire:
        if kind == "qb":
            return QbWire(exchange, identifier, settings.watchdog_counts)
        return SchunkWire(exchange, settings.watchdog_counts)

    return wire


def virtual(kind: Kind, plan: PolledFaultSettings | None = None, period: float = PERIOD) -> VirtualPolledHand:
    joints = Joints(small_spec(MOTORS[kind]), period)
    return VirtualPolledHand(joints, boot_of(kind), scale_of(kind), BAUD[kind], plan)


class Polled:
    """A virtual hand, the line to it inside this program, and the backend that drives it."""

    def __init__(
        self,
        kind: Kind,
        plan: PolledFaultSettings | None = None,
        *,
        baud: int | None = None,
        identifier: int = ID,
        settings: PolledHostSettings | None = None,
        there: VirtualPolledHand | None = None,
        wrap: Callable[[SerialLine], SerialLine] = lambda port: port,
    ) -> None:
        """`there`: the hand that is there in truth."""
        self.kind, self.hand = kind, there or virtual(kind, plan)
        self.settings = settings or PolledHostSettings(PERIOD)
        self.opened = 0

        def opened() -> SerialLine:
            self.opened += 1
            return wrap(LockstepLine(self.hand, baud or BAUD[kind]))

        self.open, self.identifier = opened, identifier
        self.backend = self.made()

    @property
    def n(self) -> int:
        return MOTORS[self.kind]

    def made(self) -> PolledBackend:
        wire = wire_of(self.kind, self.settings, self.identifier)
        made = PolledBackend(spec_of(self.kind), scale_of(self.kind), self.open, wire, self.settings)
        MADE.append(made)
        return made

    def go(self, position: float | Vector, periods: int = 1, duration: float | None = None) -> HandState:
        """Go there for so many periods; the last state."""
        for _ in range(periods):
            self.backend.write(PositionCommand(np.broadcast_to(position, self.n), duration=duration))
            state = self.backend.read()
        return state


def polled_config(hand: str, kind: str, **backend: Any) -> RunConfig:
    """A virtual hand with physics behind it."""
    content = {"hand": {"model": hand}, "backend": {"kind": kind, "port": "virtual"} | backend, "period": 0.02}
    return parse_settings(RunConfig, content | {"controller": {"kind": "position"}, "seconds": 0.5}, "test")


def on_a_polled_line(hand: str, kind: str, **backend: Any) -> PolledBackend:
    """Its backend, without a guard."""
    config = polled_config(hand, kind, **backend)
    assert isinstance(config.backend, PolledSettings)
    made = open_backend(config)
    assert isinstance(made, PolledBackend)
    return made
