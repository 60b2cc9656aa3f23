"""A config, or what stands for it on the command line, as a bus to listen to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from allegro_twin.app.config import RunConfig, load_config
from allegro_twin.drivers.can.config import VIRTUAL, CanSettings
from allegro_twin.drivers.can.link.buses import Bus, open_bus
from allegro_twin.drivers.can.opening import codec_of
from allegro_twin.drivers.can.tools.sniff import Sniffer
from allegro_twin.drivers.can.virtual.slcan import TAP
from allegro_twin.errors import ConfigError
from allegro_twin.files.schema import parse_settings
from allegro_twin.hands.description.calibration import load_wiring


def ears_of(name: str | None, given: Mapping[str, Any], options: Sequence[str] = ()) -> tuple[Bus, Sniffer]:
    """The bus of a config, and what reads it; what is `given` beside it stands in place of the config's own, and so
    does each of the `options`, KEY=VALUE.

    Raises ConfigError or LinkError.
    """
    config = None if name is None else load_config(name)
    settings = _settings(config, given)
    if settings.interface == VIRTUAL:
        raise ConfigError(f"{VIRTUAL} is a bus inside one program; log it with `allegro-twin run --wire-log` instead")
    version, calibration = settings.version, None
    if config is not None:
        config = config.model_copy(update={"backend": settings})
        version = codec_of(settings, config.hand).version
        calibration = load_wiring(config.hand.model, config.hand.serial).calibration
    own, channel = settings.options | dict(map(_option, options)), settings.channel
    if settings.interface == "slcan":
        own.setdefault("listen_only", True)  # The adapter then does not even acknowledge.
        if Path(channel + TAP).exists():  # A virtual hand's: a driver may have the other one.
            channel += TAP
    bus = open_bus(settings.interface, channel, settings.bitrate, own)
    return bus, Sniffer(version, calibration)


def _settings(config: RunConfig | None, given: Mapping[str, Any]) -> CanSettings:
    if config is None:
        return parse_settings(CanSettings, {"kind": "can", **given}, "sniff")
    if not isinstance(config.backend, CanSettings):
        raise ConfigError(f"only a bus can be listened to; this config has backend {config.backend.kind}")
    return parse_settings(CanSettings, {**config.backend.model_dump(exclude_unset=True), **given}, "sniff")


def _option(text: str) -> tuple[str, str | int]:
    key, equals, value = text.partition("=")
    if not key or not equals:
        raise ConfigError(f"--option needs KEY=VALUE, not {text!r}")
    return key, int(value) if value.isdigit() else value
