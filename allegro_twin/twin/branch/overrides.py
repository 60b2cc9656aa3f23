"""What is to be otherwise, from text."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

from allegro_twin.app.config import RunConfig
from allegro_twin.errors import ConfigError, unknown
from allegro_twin.files.assets import parse_yaml
from allegro_twin.sim.model.joints import JointChange
from allegro_twin.spec import HandSpec

Changes: TypeAlias = Mapping[str, Any]
"""By key: of PHYSICS, or `controller.…` as in a config."""
PHYSICS = ("friction", "damping", "frictionloss", "strength")
_CONTROLLER = "controller."


def changes_of(texts: list[str]) -> dict[str, Any]:
    """`friction=0.5` and the like. Raises ConfigError."""
    found = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not equals or not key:
            raise ConfigError(f"--set {text}: say key=value, for example friction=0.5 or controller.gains=v4")
        if key not in PHYSICS and not key.startswith(_CONTROLLER):
            raise ConfigError(f"--set {text}: {unknown('key', key, [*PHYSICS, 'controller.gains'])}")
        found[key] = parse_yaml(f"value: {value}", f"--set {text}")["value"]
        if key in PHYSICS and (isinstance(found[key], bool) or not isinstance(found[key], int | float)):
            raise ConfigError(f"--set {text}: {key} needs a number, not {value}")
        if key in PHYSICS and not 0.0 <= found[key] < float("inf"):
            raise ConfigError(f"--set {text}: {key} is 0 or more")
    return found


def change_of(changes: Changes, spec: HandSpec) -> JointChange:
    """Of the hand itself. Raises ConfigError for what nobody can change in such a hand."""
    if "strength" in changes and "torque" not in spec.commands:
        raise ConfigError(f"--set strength: {spec.name} closes its own loop; damping and frictionloss can be set")
    return JointChange(changes.get("damping"), changes.get("frictionloss"), changes.get("strength", 1.0))


def of_controller(changes: Changes) -> dict[str, Any]:
    """The keys of the controller's block that change."""
    found = {key: value for key, value in changes.items() if key.startswith(_CONTROLLER)}
    return {key.removeprefix(_CONTROLLER): value for key, value in found.items()}


def changed(config: RunConfig, changes: Changes) -> RunConfig:
    """The config with its controller changed; the same one where that is not asked for."""
    own = of_controller(changes)
    return config.changed(controller=own) if own else config
