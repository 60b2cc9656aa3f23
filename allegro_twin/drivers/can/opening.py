"""Opens a hand on a CAN bus, real or virtual, from its block of a config."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from allegro_twin.backend import HandBackend
from allegro_twin.drivers.can.codec.codec import Codec
from allegro_twin.drivers.can.codec.versions import make_codec
from allegro_twin.drivers.can.config import CanSettings, FaultSettings, FirmwareSettings
from allegro_twin.drivers.can.driver import realtime
from allegro_twin.drivers.can.driver.backend import CanBackend
from allegro_twin.drivers.can.driver.host_settings import CanHostSettings
from allegro_twin.drivers.can.link.buses import shared
from allegro_twin.drivers.can.link.shared_bus import BusPort
from allegro_twin.drivers.can.tools.checkup import Checkup
from allegro_twin.drivers.can.virtual.firmware import Firmware, Identity
from allegro_twin.drivers.can.virtual.lockstep import LockstepLink
from allegro_twin.drivers.can.virtual.shared_bus import VirtualHands
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import find_file, read_yaml
from allegro_twin.hands.description.calibration import NOTHING, load_wiring
from allegro_twin.hands.settings import HandSettings
from allegro_twin.plugins import BackendContext, BackendKind
from allegro_twin.spec import HandSpec
from allegro_twin.types import frozen

_HARDWARE = {"v1": 0x0100, "v2": 0x0200, "v3": 0x0300, "v4": 0x0400, "v5": 0x0500, "v5plus": 0x0500}
_BLOCKS = ("actuation", "drive", "wire")
"""Blocks of a hand's file in which a virtual hand may differ from what its host believes."""


def open_can(settings: CanSettings, context: BackendContext) -> CanBackend:
    """The hand on its bus. Raises ConfigError or LinkError."""
    return CanBackend(*_session(settings, context))


def _session(
    settings: CanSettings, context: BackendContext
) -> tuple[HandSpec, Codec, Callable[[], BusPort], CanHostSettings]:
    spec, codec = context.spec(settings.version), codec_of(settings, context.hand)
    context.check(spec)
    realtime.ask(settings.realtime)
    return spec, codec, port_opener(settings, context, spec, codec), host_settings(settings, context.period)


def checkup_of(settings: CanSettings, context: BackendContext) -> Checkup:
    """A checkup of the hand on its bus; a virtual hand is put on its bus. Raises ConfigError."""
    return Checkup(*_session(settings, context))


def host_settings(settings: CanSettings, period: float) -> CanHostSettings:
    """The settings of a session with a hand on its bus. `period`: of control, s."""
    return CanHostSettings(
        period=period,
        timeout=settings.timeout,
        deadman=settings.deadman,
        velocity_cutoff=settings.velocity_cutoff,
        keeper=settings.keeper,
        identify=settings.identify,
        gravity=settings.gravity,
        imu_period=settings.imu,
    )


def codec_of(settings: CanSettings, hand: HandSettings, over: Mapping[str, Any] = NOTHING) -> Codec:
    """The codec of a config's hand; `over` overrides what the hand's file says. Raises ConfigError."""
    wiring = load_wiring(hand.model, hand.serial, over)
    version = settings.version or wiring.version
    if version is None:
        raise ConfigError("backend.version is missing, and no hand's own file gives it: v1, v2, v3, v4, v5 or v5plus")
    if settings.version and wiring.version and settings.version != wiring.version:
        raise ConfigError(f"backend.version is {settings.version}; {hand.serial} is a {wiring.version} hand")
    return make_codec(version, wiring.calibration, settings.device)


def firmware_of(settings: CanSettings, context: BackendContext, *, step: float, restart: bool) -> Firmware:
    """A virtual hand whose physics step by `step` seconds. Raises ConfigError."""
    truth = hidden_truth(settings)
    codec, quirks = codec_of(settings, context.hand, truth), settings.firmware or FirmwareSettings()
    spec = _loosened(context.spec(settings.version, truth), settings.faults)
    if quirks.clip == "full":
        limit = load_wiring(context.hand.model, context.hand.serial, truth).calibration.full_torque(codec.version)
        spec = replace(spec, actuation=replace(spec.actuation, torque_limit=frozen(limit)))
    sim = context.simulate(settings.scene, spec, step)
    who = Identity(serial=_serial(context.hand, codec), hardware=_HARDWARE[codec.version])
    pressures = _pressures(sim) if codec.version.startswith("v5") else None
    servo = quirks.servo == "required"
    return Firmware(sim, codec, who, pressures=pressures, restart=restart, servo=servo)


def port_opener(settings: CanSettings, context: BackendContext, spec: HandSpec, codec: Codec) -> Callable[[], BusPort]:
    """How to get on the config's bus."""
    if not settings.virtual:
        load = (codec, context.period)
        return lambda: shared(settings.interface, settings.channel, settings.bitrate, settings.options).port(load)
    firmware = firmware_of(settings, context, step=context.period, restart=True)
    hands = VirtualHands([firmware], settings.faults)
    return lambda: LockstepLink(hands, spec.name).port()


def hidden_truth(settings: CanSettings) -> Mapping[str, Any]:
    """The blocks that override a hand's file in a virtual hand's own program. Raises ConfigError."""
    truth = settings.scene.truth if settings.scene is not None else None
    if truth is None:
        return NOTHING
    if isinstance(truth, str):
        table = read_yaml(find_file(truth, "hand", "conf/hands"))
        return {name: table[name] for name in _BLOCKS if name in table}
    return truth


def _loosened(spec: HandSpec, faults: FaultSettings | None) -> HandSpec:
    """Spec of the hand with a play that can grow in the joints that its faults may loosen; by chance: the
    fingertips."""
    if faults is None:
        return spec
    joints = {event.which for event in faults.script if event.what == "loose"}
    joints |= {finger.joints[-1] for finger in spec.fingers} if faults.failures else set()
    if not joints:
        return spec
    from allegro_twin.sim.drivetrain.backlash import allow_backlash

    return allow_backlash(spec, sorted(joints))


def _serial(hand: HandSettings, codec: Codec) -> str:
    """Eight characters. v5 says type and side in the third and fourth (V5R :344)."""
    if codec.version.startswith("v5"):
        kind, side = "B" if codec.version == "v5plus" else "A", hand.side[0].upper()
        return f"5T{kind}{side}0001"
    return (hand.serial or "VIRTUAL1")[-8:]


def _pressures(sim: HandBackend) -> Callable[[], np.ndarray[tuple[int], np.dtype[np.float64]]] | None:
    """None for physics that are no simulation of ours, such as a hidden hand's or an episode's."""
    from allegro_twin.sim.engine.backend import SimBackend
    from allegro_twin.sim.engine.fingertip_pressure import PressureSensors

    return PressureSensors(sim) if isinstance(sim, SimBackend) else None


KIND = BackendKind(CanSettings, open_can)
