"""Conversion of a bus log to a recording of the session that it holds."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from allegro_twin.app.config import RunConfig
from allegro_twin.app.rig import spec_of
from allegro_twin.drivers.can.codec.codec import described
from allegro_twin.drivers.can.config import CanSettings
from allegro_twin.drivers.can.opening import codec_of, host_settings
from allegro_twin.drivers.can.tools.log import samples_of_log
from allegro_twin.drivers.can.tools.samples import Found
from allegro_twin.errors import ConfigError, RecordingError
from allegro_twin.files.atomic_write import atomic_file
from allegro_twin.recording.recorder import record
from allegro_twin.version import __version__

FAR = np.pi
"""rad beyond a joint's end where no joint of this hand stands: in most rows, the counts were not this version's."""


def make_recording(config: RunConfig, log: Path, target: Path, bus: str | None = None) -> Found:
    """Write the session of the config's hand as a recording that replays. Raises ConfigError or RecordingError."""
    settings = config.backend
    if not isinstance(settings, CanSettings):
        raise ConfigError(f"a bus log needs a config of a hand on a bus; this one has backend {settings.kind}")
    spec = spec_of(config)
    found, beyond, furthest = Found(), 0, 0.0
    codec = codec_of(settings, config.hand)
    meta = {
        "allegro_twin": __version__,
        "calibration": described(codec),
        "config": config.model_dump(mode="json"),
        "log": log.name,
    }
    samples = samples_of_log(log, codec, host_settings(settings, config.period), found, bus, spec.side)
    with atomic_file(target) as temporary:
        for sample in record(samples, temporary, spec, config.period, meta=meta):
            position = sample.state.position
            beyond += bool((np.maximum(position - spec.upper, spec.lower - position) > FAR).any())
            furthest = max(furthest, float(np.abs(position).max()))
        if beyond > 0.5 * found.states:
            own = "give its own encoder offsets, `hand: {serial: …}`" if codec.version in ("v1", "v2", "v3") else ""
            raise RecordingError(
                f"{log}: as a {codec.version} hand's its joints stand up to {furthest:.1f} rad from zero, more than "
                f"{FAR:.1f} rad beyond their ends: correct `backend.version`{own and f', or {own}'}"
            )
    return found
