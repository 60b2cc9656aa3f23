"""The config that a recording was made with, as somebody wrote it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel

from allegro_twin.app.backends.protocols import LANGUAGES
from allegro_twin.app.config import (
    CanSettings,
    DynamixelSettings,
    FaultSettings,
    FirmwareSettings,
    FollowSettings,
    GravitySettings,
    HandSettings,
    LimpSettings,
    PolicySettings,
    PositionSettings,
    ReplaySettings,
    RunConfig,
    SceneSettings,
    SimSettings,
    TaskSettings,
    TorqueSettings,
)
from allegro_twin.app.config.dynamixel import LineFaultSettings, ServoSettings
from allegro_twin.app.config.polled import PolledFaultSettings
from allegro_twin.errors import ConfigError
from allegro_twin.files.schema import parse
from allegro_twin.hands.limits import LimitSettings
from allegro_twin.recording.reader import Recording

_BLOCKS: Mapping[str, Mapping[str, type[BaseModel]]] = {
    "backend": {"sim": SimSettings, "can": CanSettings, "dynamixel": DynamixelSettings,
                "replay": ReplaySettings, **{language.kind: each for each, language in LANGUAGES.items()}},
    "controller": {
        "pd": PositionSettings, "pid": PositionSettings, "torque": TorqueSettings, "gravity": GravitySettings,
        "policy": PolicySettings, "limp": LimpSettings, "position": FollowSettings,
    },
    "scene": {"sim": SceneSettings},
    "hand": {"": HandSettings},
    "task": {"": TaskSettings},
    "limits": {"": LimitSettings},
    "faults": {"": FaultSettings},
    "servos": {"": ServoSettings},
    "firmware": {"": FirmwareSettings},
}  # fmt: skip
_LINES: Mapping[type[BaseModel], type[BaseModel]] = {
    DynamixelSettings: LineFaultSettings, **dict.fromkeys(LANGUAGES, PolledFaultSettings),
}  # fmt: skip
"""What may go wrong on whose line."""


def config_of(recording: Recording) -> RunConfig:
    """Raises ConfigError for one that this program does not understand, or a recording that holds none."""
    content = recording.meta.get("config")
    if content is None:
        raise ConfigError(f"{recording.path} does not say with which config it was made")
    return parse(RunConfig, _given(RunConfig, content), f"{recording.path}: config")


def _given(model: type[BaseModel], content: Mapping[str, Any]) -> dict[str, Any]:
    """What somebody wrote: a recording holds all keys of a config, and one at its default is read by nobody here."""
    found = {}
    for key, value in content.items():
        default = model.model_fields[key].get_default(call_default_factory=True)
        if value is None or value == (list(default) if isinstance(default, tuple) else default):
            continue
        if key == "faults" and model in _LINES:
            value = _given(_LINES[model], value)
        elif key in _BLOCKS and isinstance(value, Mapping):
            value = _given(_BLOCKS[key].get(value.get("kind", ""), _BLOCKS[key].get("", RunConfig)), value)
        found[key] = value
    return found
