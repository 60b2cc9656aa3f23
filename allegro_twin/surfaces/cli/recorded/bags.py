"""Bags into recordings."""

from __future__ import annotations

from pathlib import Path

from allegro_twin.app.config import load_config
from allegro_twin.errors import ConfigError


def unpacked(path: Path, target: Path, config: str | None) -> int:
    """Make a recording of a bag, ours or of a config's hand; its rows. Raises RecordingError, ConfigError."""
    from allegro_twin.hands.description.specs import load_spec
    from allegro_twin.recording.exchange.episodes import write_arrow
    from allegro_twin.recording.exchange.rosbag import from_bag as read

    if target.suffix != ".arrow":
        raise ConfigError(f"{target}: a bag becomes a recording, which ends in .arrow; export that one then")
    settings = None if config is None else load_config(config)
    spec = None
    if settings is not None:
        spec = load_spec(settings.hand.model, settings.hand.side, settings.hand.serial)
    recording = read(path, spec, 0.003 if settings is None else settings.period)
    write_arrow(recording, target)
    return len(recording)
