"""From a bus log to a recording of the session that it holds."""

from __future__ import annotations

from pathlib import Path

import allegro_twin
from allegro_twin.build.wired import codec_of, terms_of
from allegro_twin.config import CanSettings, RunConfig
from allegro_twin.description.hands import load_spec
from allegro_twin.errors import ConfigError
from allegro_twin.files.whole import whole_file
from allegro_twin.replay.recorder import recorded
from allegro_twin.wire.heard import Told
from allegro_twin.wire.log import samples_of_log


def make_recording(config: RunConfig, log: Path, target: Path, bus: str | None = None) -> Told:
    """Write the session of the config's hand as a recording that replays. Raises ConfigError or RecordingError."""
    settings = config.backend
    if not isinstance(settings, CanSettings):
        raise ConfigError(f"a bus log needs a config of a hand on a bus; this one has backend {settings.kind}")
    spec = load_spec(config.hand.model, config.hand.side, config.hand.serial)
    told = Told()
    meta = {
        "allegro_twin": allegro_twin.__version__,
        "config": config.model_dump(mode="json"),
        "log": log.name,
    }
    samples = samples_of_log(log, codec_of(config, settings), terms_of(config, settings), told, bus)
    with whole_file(target) as temporary:
        for _ in recorded(samples, temporary, spec, config.period, meta=meta):
            pass
    return told
