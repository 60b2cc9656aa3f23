"""Opens a hand of DYNAMIXEL servos, real or virtual, from its block of a config."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from allegro_twin.drivers.base.lockstep import LockstepLine
from allegro_twin.drivers.base.serial_line import SerialLine
from allegro_twin.drivers.dynamixel.codec.calibration import Calibration, Mounting
from allegro_twin.drivers.dynamixel.codec.table import model_named
from allegro_twin.drivers.dynamixel.config import DynamixelSettings, ServoSettings
from allegro_twin.drivers.dynamixel.driver.backend import DynamixelBackend
from allegro_twin.drivers.dynamixel.driver.host_settings import ServoHostSettings
from allegro_twin.drivers.dynamixel.virtual.hand import VirtualServoHand
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root, find_file, read_yaml
from allegro_twin.files.schema import parse_settings
from allegro_twin.hands.settings import HandSettings
from allegro_twin.plugins import BackendContext, BackendKind
from allegro_twin.spec import HandSpec


def open_dynamixel(settings: DynamixelSettings, context: BackendContext) -> DynamixelBackend:
    """The hand on its line. Raises ConfigError or LinkError."""
    spec = context.spec()
    calibration = calibration_of(settings, context.hand, spec)
    context.check(spec)
    host = ServoHostSettings(
        period=context.period,
        watchdog=settings.watchdog,
        tries=settings.tries,
        keeper=settings.keeper,
        return_delay=settings.return_delay,
    )
    return DynamixelBackend(spec, calibration, _port_opener(settings, context), host, latency=settings.latency)


def calibration_of(settings: DynamixelSettings, hand: HandSettings, spec: HandSpec) -> Calibration:
    """The servos of a config's hand: its own, or those that the hand's file describes. Raises ConfigError."""
    servos = settings.servos or _described(hand.model, hand.serial)
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


def virtual_hand(settings: DynamixelSettings, context: BackendContext, step: float) -> VirtualServoHand:
    """A hand of servos with physics behind it that step by `step` seconds. Raises ConfigError."""
    spec = context.spec()
    calibration = calibration_of(settings, context.hand, spec)
    if settings.baud not in calibration.model.bauds:
        known = ", ".join(map(str, calibration.model.bauds))
        raise ConfigError(f"backend.baud is {settings.baud}; a {calibration.model.name} has {known}")
    sim = context.simulate(settings.scene, spec, step)
    return VirtualServoHand(sim, calibration, settings.baud, plan=settings.faults)


def _port_opener(settings: DynamixelSettings, context: BackendContext) -> Callable[[], SerialLine]:
    if settings.virtual:
        hand = virtual_hand(settings, context, context.period)
        return lambda: LockstepLine(hand, settings.baud)

    def opened() -> SerialLine:
        from allegro_twin.drivers.base.serial_port import SerialPort

        return SerialPort(settings.port, settings.baud)

    return opened


def _described(model: str, serial: str) -> ServoSettings:
    """The block `servos` of the hand's own file, or of its model's."""
    own = find_file(serial, "hand", "conf/hands") if serial else None
    card = Path(model)
    nominal = card if card.suffix == ".yaml" else data_root() / "conf" / "hands" / f"{model}.yaml"
    for path in (own, nominal if nominal.is_file() else None):
        block = read_yaml(path).get("servos") if path is not None else None
        if block is not None:
            return parse_settings(ServoSettings, block, f"{path}: servos")
    raise ConfigError(f"backend.servos is missing, and no file of {model} in conf/hands describes its servos")


def _each(given: Any, n: int, name: str) -> list[Any]:
    row = given if isinstance(given, list) else [given] * n
    if len(row) != n:
        raise ConfigError(f"servos.{name} needs one value or {n}, one for each id; it has {len(row)}")
    return row


KIND = BackendKind(DynamixelSettings, open_dynamixel, virtual_hand)
