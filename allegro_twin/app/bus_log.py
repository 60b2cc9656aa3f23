"""Conversion of a bus log to a recording of the session that it holds."""

from __future__ import annotations

from pathlib import Path

from allegro_twin.app.config import RunConfig
from allegro_twin.app.rig import spec_of
from allegro_twin.drivers.can.codec.codec import described
from allegro_twin.drivers.can.config import CanSettings
from allegro_twin.drivers.can.opening import codec_of, host_settings
from allegro_twin.drivers.can.tools.log import samples_of_log
from allegro_twin.drivers.can.tools.samples import Found
from allegro_twin.errors import ConfigError
from allegro_twin.files.atomic_write import atomic_file
from allegro_twin.recording.recorder import record
from allegro_twin.version import __version__


def make_recording(config: RunConfig, log: Path, target: Path, bus: str | None = None) -> Found:
    """Write the session of the config's hand as a recording that replays. Raises ConfigError or RecordingError."""
    settings = config.backend
    if not isinstance(settings, CanSettings):
        raise ConfigError(f"a bus log needs a config of a hand on a bus; this one has backend {settings.kind}")
    spec = spec_of(config)
    found = Found()
    codec = codec_of(settings, config.hand)
    meta = {
        "allegro_twin": __version__,
        "calibration": described(codec),
        "config": config.model_dump(mode="json"),
        "log": log.name,
    }
    samples = samples_of_log(log, codec, host_settings(settings, config.period), found, bus)
    with atomic_file(target) as temporary:
        for _ in record(samples, temporary, spec, config.period, meta=meta):
            pass
    return found
