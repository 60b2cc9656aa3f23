"""Changes of a branch, and the recorded config that they apply to."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from allegro_twin.app.config import RunConfig
from allegro_twin.errors import ConfigError, unknown
from allegro_twin.files.assets import parse_yaml
from allegro_twin.files.schema import models_in, parse_settings
from allegro_twin.plugins import Registry
from allegro_twin.recording.reader import Recording
from allegro_twin.sim.model.joints import JointChange
from allegro_twin.spec import HandSpec

Changes: TypeAlias = Mapping[str, Any]
"""Values by key: of PHYSICS, or `controller.…` as in a config."""
PHYSICS = ("friction", "damping", "frictionloss", "strength")
_CONTROLLER = "controller."


def parse_changes(texts: list[str]) -> dict[str, Any]:
    """Parse `friction=0.5` and the like. Raises ConfigError."""
    found = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not equals or not key:
            raise ConfigError(f"--set {text}: say key=value, for example friction=0.5 or controller.gains=v4")
        if key not in PHYSICS and not key.startswith(_CONTROLLER):
            raise ConfigError(f"--set {text}: {unknown('key', key, [*PHYSICS, 'controller.gains'])}")
        if key in found:
            raise ConfigError(f"--set {text}: {key} is given twice: say it once")
        found[key] = parse_yaml(f"value: {value}", f"--set {text}")["value"]
        if key in PHYSICS and (isinstance(found[key], bool) or not isinstance(found[key], int | float)):
            raise ConfigError(f"--set {text}: {key} needs a number, not {value}")
        if key in PHYSICS and not 0.0 <= found[key] < float("inf"):
            raise ConfigError(f"--set {text}: {key} is 0 or more")
    return found


def hand_change(changes: Changes, spec: HandSpec) -> JointChange:
    """The change of the hand itself. Raises ConfigError for a key that such a hand does not have."""
    if "strength" in changes and "torque" not in spec.commands:
        raise ConfigError(f"--set strength: {spec.name} closes its own loop; damping and frictionloss can be set")
    return JointChange(changes.get("damping"), changes.get("frictionloss"), changes.get("strength", 1.0))


def controller_changes(changes: Changes) -> dict[str, Any]:
    """The keys of the controller's block that change."""
    found = {key: value for key, value in changes.items() if key.startswith(_CONTROLLER)}
    return {key.removeprefix(_CONTROLLER): value for key, value in found.items()}


def apply_changes(config: RunConfig, changes: Changes) -> RunConfig:
    """The config with its controller changed; the same config where no controller key changes."""
    own = controller_changes(changes)
    return config.changed(controller=own) if own else config


def recorded_config(recording: Recording) -> RunConfig:
    """The config that a recording was made with. Raises ConfigError for one that this program does not understand, or a
    recording without one."""
    content = recording.meta.get("config")
    if content is None:
        raise ConfigError(f"{recording.path} does not say with which config it was made")
    return parse_settings(RunConfig, _written_keys(RunConfig, content), f"{recording.path}: config")


def _written_keys(model: type[BaseModel], content: Mapping[str, Any]) -> dict[str, Any]:
    """The keys that the user wrote: a recording holds all keys of a config, and those at their defaults are left
    out."""
    found = {}
    for key, value in content.items():
        field = model.model_fields[key]
        default = field.get_default(call_default_factory=True)
        if value is None or value == (list(default) if isinstance(default, tuple) else default):
            continue
        inner = _model_of(field, value) if isinstance(value, Mapping) else None
        found[key] = value if inner is None else _written_keys(inner, value)
    return found


def _model_of(field: FieldInfo, value: Mapping[str, Any]) -> type[BaseModel] | None:
    """The settings model of a block; None for a mapping without one."""
    registry = next((each for each in field.metadata if isinstance(each, Registry)), None)
    if registry is not None:
        found: type[BaseModel] = registry.kind(value["kind"]).settings
        return found
    models = models_in(field.annotation)
    return models[0] if models else None
