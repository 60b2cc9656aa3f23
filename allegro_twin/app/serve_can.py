"""The other end of a config's bus, where a virtual hand can be."""

from __future__ import annotations

import logging
from ipaddress import ip_address
from pathlib import Path
from typing import TYPE_CHECKING, Any

from allegro_twin.app.config import RunConfig
from allegro_twin.app.rig import SimulatedScene, context_of
from allegro_twin.drivers.can.config import VIRTUAL, CanSettings
from allegro_twin.drivers.can.link.buses import LOCAL, Bus, open_bus
from allegro_twin.drivers.can.opening import checkup_of as can_checkup
from allegro_twin.drivers.can.opening import firmware_of
from allegro_twin.drivers.can.tools.checkup import Checkup
from allegro_twin.drivers.can.virtual.firmware import Firmware
from allegro_twin.drivers.can.virtual.lockstep import LockstepBus
from allegro_twin.drivers.can.virtual.shared_bus import VirtualHands
from allegro_twin.errors import ConfigError

if TYPE_CHECKING:
    from allegro_twin.grasping.verdict import TrialReport

log = logging.getLogger(__name__)


def virtual_firmware(config: RunConfig, scene: SimulatedScene, *, step: float, restart: bool) -> Firmware:
    """The virtual hand of a config, whose physics step by `step` s; its simulation goes into `scene`. Raises
    ConfigError."""
    if not isinstance(config.backend, CanSettings):
        kind = config.backend.kind
        raise ConfigError(f"a virtual hand needs `backend: {{kind: can, …}}`; this config has kind {kind}")
    return firmware_of(config.backend, context_of(config, scene), step=step, restart=restart)


def checkup_of(config: RunConfig) -> Checkup:
    """A checkup of the link to a config's hand; a virtual hand is put on its bus. Raises ConfigError."""
    if not isinstance(config.backend, CanSettings):
        raise ConfigError(
            f"only a hand on a bus has a link to check; this config has backend {config.backend.kind}: `allegro-twin "
            "check-backend` checks any backend against the contract"
        )
    return can_checkup(config.backend, context_of(config, SimulatedScene()))


def virtual_hands(
    configs: list[RunConfig], *, step: float | None, scenes: list[SimulatedScene], restart: bool
) -> VirtualHands:
    """The hands of some configs on one bus. `step`: s; default: the configs' period. Raises ConfigError."""
    firmwares: list[Firmware] = []
    for config in configs:
        if step is not None and step > config.period:
            raise ConfigError(f"a step of {step} s is longer than the hand's period of {config.period} s")
        scene = SimulatedScene()
        firmwares.append(virtual_firmware(config, scene, step=step or config.period, restart=restart))
        scenes.append(scene)
    _check_apart(configs, firmwares)
    first = configs[0].backend
    assert isinstance(first, CanSettings)
    return VirtualHands(firmwares, first.faults)


def _check_apart(configs: list[RunConfig], firmwares: list[Firmware]) -> None:
    """Raise ConfigError for two hands that would answer to the same frames."""
    names = [
        (firmware.codec.version, config.backend.device if firmware.codec.version == "v4" else 0)
        for config, firmware in zip(configs, firmwares, strict=True)
        if isinstance(config.backend, CanSettings)
    ]
    for version, device in names:
        if names.count((version, device)) > 1:
            what = f"with device {device}; give each its own" if version == "v4" else "which have no device id"
            raise ConfigError(f"one bus cannot tell apart two hands of version {version}, {what}")


def far_end(settings: CanSettings) -> Bus:
    """What is at the hand's end of a config's bus: a serial adapter on a pseudo-terminal for slcan, a daemon for
    socketcand, the same bus for everything else. Raises LinkError or ConfigError."""
    if settings.interface == "slcan":
        from allegro_twin.drivers.can.virtual.slcan import SlcanDevice

        return SlcanDevice(Path(settings.channel), settings.bitrate)
    if settings.interface == "socketcand":
        from allegro_twin.drivers.can.virtual.socketcand import DEFAULT_PORT, SocketcandServer

        host, port = settings.options.get("host", "127.0.0.1"), settings.options.get("port", DEFAULT_PORT)
        if not _loopback(str(host)):
            log.warning("listening on %s: whoever reaches port %s moves this hand", host, port)
        return SocketcandServer(settings.channel, str(host), int(port))
    if settings.interface == VIRTUAL:
        raise ConfigError(f"{VIRTUAL} is a bus inside one program; serve on slcan, socketcand or a real interface")
    return open_bus(settings.interface, settings.channel, settings.bitrate, settings.options)


def _loopback(host: str) -> bool:
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def local(settings: CanSettings) -> bool:
    """Whether the other programs of this computer are on the same bus."""
    return settings.interface in LOCAL


def judged(scene: SimulatedScene, hand: Firmware) -> TrialReport | None:
    """Watch the scenario of a served hand; its verdict at the moment when it is over."""
    trial, state = scene.trial, hand.state
    if trial is None or not hand.serving or state.t > trial.seconds + hand.period / 2:
        return None
    trial.see(state)
    return trial.report() if state.t >= trial.seconds - hand.period / 2 else None


class VirtualBus(LockstepBus):
    """python-can's own door to a virtual hand: `can.Bus(interface="allegro-virtual", channel="can_virtual")`.

    `channel` is a config, or several with commas between them for several hands on one bus.
    """

    def __init__(self, channel: Any = "can_virtual", **ignored: Any) -> None:
        from allegro_twin.app.config import load_config

        self.scenes: list[SimulatedScene] = []
        configs = [load_config(name.strip()) for name in str(channel).split(",")]
        super().__init__(virtual_hands(configs, step=None, scenes=self.scenes, restart=False), channel)
