"""The config that a recording was made with, as somebody wrote it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from allegro_twin.app.config import RunConfig
from allegro_twin.errors import ConfigError
from allegro_twin.files.schema import models_in, parse
from allegro_twin.plugins import Registry
from allegro_twin.recording.reader import Recording


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
        field = model.model_fields[key]
        default = field.get_default(call_default_factory=True)
        if value is None or value == (list(default) if isinstance(default, tuple) else default):
            continue
        inner = _model_of(field, value) if isinstance(value, Mapping) else None
        found[key] = value if inner is None else _given(inner, value)
    return found


def _model_of(field: FieldInfo, value: Mapping[str, Any]) -> type[BaseModel] | None:
    """The model of a block; None for a mapping without one."""
    registry = next((each for each in field.metadata if isinstance(each, Registry)), None)
    if registry is not None:
        found: type[BaseModel] = registry.kind(value["kind"]).settings
        return found
    models = models_in(field.annotation)
    return models[0] if models else None
