"""Opens a recording in place of a hand, from its block of a config."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import find_file
from allegro_twin.plugins import BackendContext, BackendKind
from allegro_twin.recording.settings import ReplaySettings

if TYPE_CHECKING:
    from allegro_twin.recording.reader import Recording
    from allegro_twin.recording.replay import ReplayBackend


def open_recording(settings: ReplaySettings, context: BackendContext) -> ReplayBackend:
    """The hand that was recorded. Raises ConfigError for another hand or period than the config's, RecordingError."""
    from allegro_twin.recording.missed import hold_missed
    from allegro_twin.recording.replay import ReplayBackend

    recording, hand = hold_missed(_recording(settings, context), "gravity"), context.hand
    path, backend = recording.path, ReplayBackend(recording)
    model = Path(hand.model).stem if Path(hand.model).suffix == ".yaml" else hand.model
    if backend.spec.side != hand.side or backend.spec.model != model:
        own = backend.spec
        raise ConfigError(
            f"{path} is of the hand {own.name}; the config says {model}_{hand.side}: change `hand` to {{model: "
            f"{own.model}, side: {own.side}}}"
        )
    if abs(backend.period - context.period) > 1e-9:
        raise ConfigError(f"{path} has a period of {backend.period} s; the config says {context.period} s")
    return backend


def _recording(settings: ReplaySettings, context: BackendContext) -> Recording:
    """Recording of a .arrow file, or of a bag."""
    from allegro_twin.recording.exchange.rosbag import from_bag, is_bag
    from allegro_twin.recording.reader import load

    if is_bag(settings.file):
        return from_bag(settings.file, context.spec(), context.period, settings.topic)
    if settings.topic is not None:
        raise ConfigError(f"`topic` is for a bag; {settings.file} is none: leave it out")
    if settings.file.is_dir():
        raise ConfigError(
            f"{settings.file} is a folder, and no bag: of a data set `allegro-twin export {settings.file} one.arrow "
            "--episode 0` makes a recording of one episode, which replays"
        )
    path = find_file(settings.file, "recording", "out", ".arrow")
    return load(path, partial=settings.partial, track=settings.track)


KIND = BackendKind(ReplaySettings, open_recording, replays=True)
