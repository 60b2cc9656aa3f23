"""Hands that answer when they are asked, real and virtual."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from allegro_twin.app.backends.can import Scene
from allegro_twin.app.backends.protocols import LANGUAGES
from allegro_twin.app.backends.simulated import simulated
from allegro_twin.app.config import VIRTUAL_PORT, PolledSettings, RunConfig, SceneSettings
from allegro_twin.app.config.polled import LineSettings, PolledFaultSettings
from allegro_twin.drivers.base.line_noise import Noise
from allegro_twin.drivers.base.lockstep import LockstepPort
from allegro_twin.drivers.base.port import BITS, Port
from allegro_twin.drivers.polled.backend import PolledBackend
from allegro_twin.drivers.polled.device import VirtualHand
from allegro_twin.drivers.polled.exchange import Exchange
from allegro_twin.drivers.polled.faults import Event, FaultPlan
from allegro_twin.drivers.polled.scale import Scale
from allegro_twin.drivers.polled.settings import HostSettings
from allegro_twin.drivers.polled.wire import Wire
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root, read_yaml
from allegro_twin.files.schema import parse
from allegro_twin.spec import HandSpec


def make_polled(config: RunConfig, settings: PolledSettings, spec: HandSpec, scene: Scene) -> PolledBackend:
    """The hand on its line; `scene` is filled in when the hand is virtual. Raises ConfigError or LinkError."""
    language = LANGUAGES[type(settings)]
    size = language.per_period
    if config.period < size * BITS / settings.baud:
        raise ConfigError(
            f"period {config.period:g} s is too short at {settings.baud} baud: {size} bytes take "
            f"{size * BITS / settings.baud:.5f} s"
        )
    host = HostSettings(
        period=config.period,
        watchdog=settings.watchdog,
        tries=settings.tries,
        keeper=settings.keeper,
        latency=settings.latency,
    )

    def wire(exchange: Exchange) -> Wire:
        return language.wire(settings, exchange, host.watchdog_counts)

    return PolledBackend(spec, scale_of(config, settings, spec), _opener(config, settings, spec, scene), wire, host)


def scale_of(config: RunConfig, settings: PolledSettings, spec: HandSpec) -> Scale:
    """What ticks and currents of a config's hand are worth. Raises ConfigError for a hand that has another line."""
    language = LANGUAGES[type(settings)]
    if spec.n_actuators != language.motors or "position" not in spec.commands:
        raise ConfigError(
            f"backend.kind {settings.kind} is for {language.motors} motors that go to positions; {spec.name} has "
            f"{spec.n_actuators} actuators and takes {', '.join(spec.commands)}"
        )
    if settings.mode not in spec.commands:
        raise ConfigError(f"backend.mode {settings.mode}: {spec.name} takes {', '.join(spec.commands)}")
    return Scale.of(spec, language.ticks, settings.torque_per_ampere or _described(config.hand.model))


def virtual_hand(config: RunConfig, settings: PolledSettings, spec: HandSpec, scene: Scene, step: float) -> VirtualHand:
    """Such a hand as the config describes it, with physics behind it that go into `scene`. Raises ConfigError."""
    scale = scale_of(config, settings, spec)
    language = LANGUAGES[type(settings)]
    if settings.baud not in language.bauds:
        known = " or ".join(map(str, language.bauds))
        raise ConfigError(f"backend.baud is {settings.baud}; such a hand has {known}")
    behind = replace(spec, commands=(*spec.commands, "limited_position"))  # One motor alone can be dead.
    scene.sim, scene.trial = simulated(settings.scene or SceneSettings(kind="sim"), config.task, behind, step)
    plan = _plan(settings.faults)
    return VirtualHand(scene.sim, lambda: language.electronics(settings), scale, settings.baud, plan)


def _opener(config: RunConfig, settings: PolledSettings, spec: HandSpec, scene: Scene) -> Callable[[], Port]:
    if settings.port == VIRTUAL_PORT:
        hand = virtual_hand(config, settings, spec, scene, config.period)
        return lambda: LockstepPort(hand, settings.baud)

    def opened() -> Port:
        from allegro_twin.drivers.base.adapter import Adapter

        return Adapter(settings.port, settings.baud)

    return opened


def _described(model: str) -> float | list[float]:
    """`torque_per_ampere` of the block `line` of the hand's file. Raises ConfigError."""
    card = Path(model)
    path = card if card.suffix == ".yaml" else data_root() / "conf" / "hands" / f"{model}.yaml"
    block = read_yaml(path).get("line")
    if block is None:
        raise ConfigError(f"backend.torque_per_ampere is missing, and {path} has no block `line` that says it")
    return parse(LineSettings, block, f"{path}: line").torque_per_ampere


def _plan(settings: PolledFaultSettings | None) -> FaultPlan | None:
    if settings is None:
        return None
    script = tuple(Event(e.at, e.what, e.which) for e in settings.script)
    return FaultPlan(Noise(settings.lose, settings.garble, settings.seed), script)
