"""Hands of DYNAMIXEL servos, real and virtual."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from allegro_twin.app.backends.can import Scene
from allegro_twin.app.backends.simulated import simulated
from allegro_twin.app.config import RunConfig, SceneSettings
from allegro_twin.app.config.dynamixel import VIRTUAL_PORT, DynamixelSettings, LineFaultSettings, ServoSettings
from allegro_twin.drivers.base.line_noise import Noise
from allegro_twin.drivers.base.lockstep import LockstepPort
from allegro_twin.drivers.base.port import Port
from allegro_twin.drivers.dynamixel.codec.calibration import Calibration, Mounting
from allegro_twin.drivers.dynamixel.codec.table import model_named
from allegro_twin.drivers.dynamixel.driver.backend import DynamixelBackend
from allegro_twin.drivers.dynamixel.driver.settings import HostSettings
from allegro_twin.drivers.dynamixel.virtual.faults import Event, FaultPlan
from allegro_twin.drivers.dynamixel.virtual.hand import VirtualHand
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root, find, read_yaml
from allegro_twin.files.schema import parse
from allegro_twin.spec import HandSpec


def make_servos(config: RunConfig, settings: DynamixelSettings, spec: HandSpec, scene: Scene) -> DynamixelBackend:
    """The hand on its line; `scene` is filled in when the hand is virtual. Raises ConfigError or LinkError."""
    calibration = calibration_of(config, settings, spec)
    host = HostSettings(
        period=config.period,
        watchdog=settings.watchdog,
        tries=settings.tries,
        keeper=settings.keeper,
        return_delay=settings.return_delay,
    )
    opener = _opener(config, settings, spec, scene)
    return DynamixelBackend(spec, calibration, opener, host, latency=settings.latency)


def calibration_of(config: RunConfig, settings: DynamixelSettings, spec: HandSpec) -> Calibration:
    """The servos of a config's hand: its own, or those that the hand's file describes. Raises ConfigError."""
    servos = settings.servos or _described(config.hand.model, config.hand.serial)
    n = len(servos.ids)
    rows = zip(
        servos.ids,
        _each(servos.current_limit, n, "current_limit"),
        _each(servos.zero, n, "zero"),
        _each(servos.direction, n, "direction"),
        _each(servos.gear, n, "gear"),
        _each(servos.torque_per_ampere, n, "torque_per_ampere"),
        _each(servos.gains, n, "gains"),
        strict=True,
    )
    calibration = Calibration(model_named(servos.model), tuple(Mounting(*row) for row in rows))
    calibration.check(spec)
    return calibration


def virtual_hand(
    config: RunConfig, settings: DynamixelSettings, spec: HandSpec, scene: Scene, step: float
) -> VirtualHand:
    """A hand of servos as the config describes it, with physics behind it that go into `scene`. Raises ConfigError."""
    calibration = calibration_of(config, settings, spec)
    if settings.baud not in calibration.model.bauds:
        known = ", ".join(map(str, calibration.model.bauds))
        raise ConfigError(f"backend.baud is {settings.baud}; a {calibration.model.name} has {known}")
    scene.sim, scene.trial = simulated(settings.scene or SceneSettings(kind="sim"), config.task, spec, step)
    return VirtualHand(scene.sim, calibration, settings.baud, plan=_plan(settings.faults))


def _opener(config: RunConfig, settings: DynamixelSettings, spec: HandSpec, scene: Scene) -> Callable[[], Port]:
    if settings.port == VIRTUAL_PORT:
        hand = virtual_hand(config, settings, spec, scene, config.period)
        return lambda: LockstepPort(hand, settings.baud)

    def opened() -> Port:
        from allegro_twin.drivers.base.adapter import Adapter

        return Adapter(settings.port, settings.baud)

    return opened


def _described(model: str, serial: str) -> ServoSettings:
    """The block `servos` of the hand's own file, or of its model's."""
    own = find(serial, "hand", "conf/hands") if serial else None
    card = Path(model)
    nominal = card if card.suffix == ".yaml" else data_root() / "conf" / "hands" / f"{model}.yaml"
    for path in (own, nominal if nominal.is_file() else None):
        block = read_yaml(path).get("servos") if path is not None else None
        if block is not None:
            return parse(ServoSettings, block, f"{path}: servos")
    raise ConfigError(f"backend.servos is missing, and no file of {model} in conf/hands describes its servos")


def _each(given: Any, n: int, name: str) -> list[Any]:
    row = given if isinstance(given, list) else [given] * n
    if len(row) != n:
        raise ConfigError(f"servos.{name} needs one value or {n}, one for each id; it has {len(row)}")
    return row


def _plan(settings: LineFaultSettings | None) -> FaultPlan | None:
    if settings is None:
        return None
    script = tuple(Event(e.at, e.what, e.which, e.amount) for e in settings.script)
    return FaultPlan(Noise(settings.lose, settings.garble, settings.seed), script)
