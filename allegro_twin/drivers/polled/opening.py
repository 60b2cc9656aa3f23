"""Opens a hand that answers when it is asked, real or virtual, from its block of a config."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Generic, TypeVar

from allegro_twin.drivers.base.lockstep import LockstepLine
from allegro_twin.drivers.base.serial_line import BITS, SerialLine
from allegro_twin.drivers.polled.backend import PolledBackend
from allegro_twin.drivers.polled.config import LineSettings, PolledSettings
from allegro_twin.drivers.polled.device import Electronics, VirtualPolledHand
from allegro_twin.drivers.polled.exchange import Exchange
from allegro_twin.drivers.polled.host_settings import PolledHostSettings
from allegro_twin.drivers.polled.scale import Scale
from allegro_twin.drivers.polled.wire import Wire
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root, read_yaml
from allegro_twin.files.schema import parse_settings
from allegro_twin.plugins import BackendContext
from allegro_twin.spec import HandSpec

S = TypeVar("S", bound=PolledSettings)


@dataclass(frozen=True, slots=True)
class Protocol(Generic[S]):
    """The protocol of such a hand, at both ends of the line; `S`: its block of a config."""

    motors: int
    ticks: int
    """Ticks of a motor's whole range."""
    bauds: tuple[int, ...]
    """The speeds that such a hand can have."""
    per_period: int
    """Bytes that question and answer of a period take."""
    wire: Callable[[S, Exchange, int], Wire]
    """The host's end: settings, exchange, the watchdog's steps."""
    electronics: Callable[[S], Electronics]
    """A virtual hand's end, as it is when power comes."""

    def open(self, settings: S, context: BackendContext) -> PolledBackend:
        """The hand on its line. Raises ConfigError or LinkError."""
        spec, size, period = context.spec(), self.per_period, context.period
        scale = self.scale(settings, context, spec)
        context.check(spec)
        if period < size * BITS / settings.baud:
            raise ConfigError(
                f"period {period:g} s is too short at {settings.baud} baud: {size} bytes take "
                f"{size * BITS / settings.baud:.5f} s"
            )
        host = PolledHostSettings(
            period=period,
            watchdog=settings.watchdog,
            tries=settings.tries,
            keeper=settings.keeper,
            latency=settings.latency,
        )

        def wire(exchange: Exchange) -> Wire:
            return self.wire(settings, exchange, host.watchdog_counts)

        return PolledBackend(spec, scale, self._opener(settings, context), wire, host)

    def scale(self, settings: S, context: BackendContext, spec: HandSpec) -> Scale:
        """What ticks and currents of a config's hand are worth. Raises ConfigError for a hand that has another line."""
        if spec.n_actuators != self.motors or "position" not in spec.commands:
            raise ConfigError(
                f"backend.kind {settings.kind} is for {self.motors} motors that go to positions; {spec.name} has "
                f"{spec.n_actuators} actuators and takes {', '.join(spec.commands)}"
            )
        if settings.mode not in spec.commands:
            raise ConfigError(f"backend.mode {settings.mode}: {spec.name} takes {', '.join(spec.commands)}")
        return Scale.of(spec, self.ticks, settings.torque_per_ampere or _described(context.hand.model))

    def virtual_hand(self, settings: S, context: BackendContext, step: float) -> VirtualPolledHand:
        """Such a hand with physics behind it that step by `step` seconds. Raises ConfigError."""
        spec = context.spec()
        scale = self.scale(settings, context, spec)
        if settings.baud not in self.bauds:
            known = " or ".join(map(str, self.bauds))
            raise ConfigError(f"backend.baud is {settings.baud}; such a hand has {known}")
        behind = replace(spec, commands=(*spec.commands, "limited_position"))  # One motor alone can be dead.
        sim = context.simulate(settings.scene, behind, step)
        return VirtualPolledHand(sim, lambda: self.electronics(settings), scale, settings.baud, settings.faults)

    def _opener(self, settings: S, context: BackendContext) -> Callable[[], SerialLine]:
        if settings.virtual:
            hand = self.virtual_hand(settings, context, context.period)
            return lambda: LockstepLine(hand, settings.baud)

        def opened() -> SerialLine:
            from allegro_twin.drivers.base.serial_port import SerialPort

            return SerialPort(settings.port, settings.baud)

        return opened


def _described(model: str) -> float | list[float]:
    """`torque_per_ampere` of the block `line` of the hand's file. Raises ConfigError."""
    card = Path(model)
    path = card if card.suffix == ".yaml" else data_root() / "conf" / "hands" / f"{model}.yaml"
    block = read_yaml(path).get("line")
    if block is None:
        raise ConfigError(f"backend.torque_per_ampere is missing, and {path} has no block `line` that says it")
    return parse_settings(LineSettings, block, f"{path}: line").torque_per_ampere
