"""Hands on a CAN bus, and virtual hands to put on one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from allegro_twin.app.backends.hidden_truth import loosened, truth_of
from allegro_twin.app.backends.simulated import simulated
from allegro_twin.app.config import VIRTUAL, CanSettings, FaultSettings, FirmwareSettings, RunConfig, SceneSettings
from allegro_twin.drivers.can.codec.codec import Codec
from allegro_twin.drivers.can.codec.versions import make_codec
from allegro_twin.drivers.can.driver import realtime
from allegro_twin.drivers.can.driver.backend import CanBackend
from allegro_twin.drivers.can.driver.buses import shared
from allegro_twin.drivers.can.driver.link import Port
from allegro_twin.drivers.can.driver.settings import HostSettings
from allegro_twin.drivers.can.tools.checkup import Checkup
from allegro_twin.drivers.can.virtual.faults import Event, FaultPlan
from allegro_twin.drivers.can.virtual.firmware import Firmware, Identity
from allegro_twin.drivers.can.virtual.lockstep import LockstepLink
from allegro_twin.drivers.can.virtual.shared_bus import VirtualHands
from allegro_twin.errors import ConfigError
from allegro_twin.hands.description.hands import load_spec
from allegro_twin.hands.description.wiring import NOTHING, load_wiring
from allegro_twin.spec import HandSpec
from allegro_twin.types import frozen

if TYPE_CHECKING:
    from allegro_twin.grasping.trial import Trial
    from allegro_twin.sim.engine.backend import SimBackend

_HARDWARE = {"v1": 0x0100, "v2": 0x0200, "v3": 0x0300, "v4": 0x0400, "v5": 0x0500, "v5plus": 0x0500}


@dataclass(slots=True)
class Scene:
    """What is behind a virtual hand in this program; nothing behind a real one."""

    sim: SimBackend | None = None
    trial: Trial | None = None


def make_can(config: RunConfig, settings: CanSettings, spec: HandSpec, scene: Scene) -> CanBackend:
    """The hand on its bus; `scene` is filled in when the hand is virtual. Raises ConfigError or LinkError."""
    codec = codec_of(config, settings)
    realtime.ask(settings.realtime)
    return CanBackend(spec, codec, opener(config, settings, spec, codec, scene), host_settings(config, settings))


def checkup_of(config: RunConfig) -> Checkup:
    """A checkup of the hand that a config describes; virtual hands are put on their bus. Raises ConfigError."""
    settings = config.backend
    if not isinstance(settings, CanSettings):
        raise ConfigError(f"only a hand on a bus has a link to check; this config has backend {settings.kind}")
    spec = spec_of(config)
    codec = codec_of(config, settings)
    realtime.ask(settings.realtime)
    return Checkup(spec, codec, opener(config, settings, spec, codec, Scene()), host_settings(config, settings))


def host_settings(config: RunConfig, settings: CanSettings) -> HostSettings:
    """How a config wants the hand on its bus dealt with."""
    return HostSettings(
        period=config.period,
        timeout=settings.timeout,
        deadman=settings.deadman,
        velocity_cutoff=settings.velocity_cutoff,
        keeper=settings.keeper,
        identify=settings.identify,
        gravity=settings.gravity,
        imu_period=settings.imu,
    )


def spec_of(config: RunConfig, over: Mapping[str, Any] = NOTHING) -> HandSpec:
    """The hand that a config describes; on a bus its version decides how much torque its driver lets through."""
    version = config.backend.version if isinstance(config.backend, CanSettings) else None
    return load_spec(config.hand.model, config.hand.side, config.hand.serial, version, over)


def codec_of(config: RunConfig, settings: CanSettings, over: Mapping[str, Any] = NOTHING) -> Codec:
    """The codec of the hand that a config describes. Raises ConfigError."""
    wiring = load_wiring(config.hand.model, config.hand.serial, over)
    version = settings.version or wiring.version
    if version is None:
        raise ConfigError("backend.version is missing, and no hand's own file gives it: v1, v2, v3, v4, v5 or v5plus")
    if settings.version and wiring.version and settings.version != wiring.version:
        raise ConfigError(f"backend.version is {settings.version}; {config.hand.serial} is a {wiring.version} hand")
    return make_codec(version, wiring.calibration, settings.device)


def firmware_of(config: RunConfig, scene: Scene, *, step: float, restart: bool) -> Firmware:
    """A virtual hand as the config describes it, stepping by `step` seconds; its simulation goes into `scene`."""
    settings = config.backend
    if not isinstance(settings, CanSettings):
        raise ConfigError(f"a virtual hand needs `backend: {{kind: can, …}}`; this config has kind {settings.kind}")
    truth = truth_of(settings)
    codec, quirks = codec_of(config, settings, truth), settings.firmware or FirmwareSettings()
    spec = loosened(spec_of(config, truth), settings.faults)
    if quirks.clip == "full":
        limit = load_wiring(config.hand.model, config.hand.serial, truth).calibration.full_torque(codec.version)
        spec = replace(spec, actuation=replace(spec.actuation, torque_limit=frozen(limit)))
    scene.sim, scene.trial = simulated(settings.scene or SceneSettings(kind="sim"), config.task, spec, step)
    who = Identity(serial=_serial(config, codec), hardware=_HARDWARE[codec.version])
    pressures = _pressures(scene.sim) if codec.version.startswith("v5") else None
    servo = quirks.servo == "required"
    return Firmware(scene.sim, codec, who, pressures=pressures, restart=restart, servo=servo)


def fault_plan(settings: FaultSettings | None) -> FaultPlan | None:
    """The faults block of a config."""
    if settings is None:
        return None
    values = settings.model_dump(exclude={"script"})
    return FaultPlan(**values, script=tuple(Event(e.at, e.what, e.which, e.amount) for e in settings.script))


def opener(config: RunConfig, settings: CanSettings, spec: HandSpec, codec: Codec, scene: Scene) -> Callable[[], Port]:
    """How to get on the config's bus."""
    if settings.interface != VIRTUAL:
        load = (codec, config.period)
        return lambda: shared(settings.interface, settings.channel, settings.bitrate, settings.options).port(load)
    firmware = firmware_of(config, scene, step=config.period, restart=True)
    hands = VirtualHands([firmware], fault_plan(settings.faults))
    return lambda: LockstepLink(hands, spec.name).port()


def _serial(config: RunConfig, codec: Codec) -> str:
    """Eight characters. v5 says type and side in the third and fourth (V5R :344)."""
    if codec.version.startswith("v5"):
        kind, side = "B" if codec.version == "v5plus" else "A", config.hand.side[0].upper()
        return f"5T{kind}{side}0001"
    return (config.hand.serial or "VIRTUAL1")[-8:]


def _pressures(sim: SimBackend) -> Callable[[], np.ndarray[tuple[int], np.dtype[np.float64]]]:
    from allegro_twin.sim.engine.fingertip_pressure import FingertipPressure

    return FingertipPressure(sim)
