"""The run config: one block a part; `kind` chooses the backend and the controller."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, model_validator

from allegro_twin.app.config_rules import contradiction
from allegro_twin.app.controller_settings import OwnController
from allegro_twin.drivers.can.config import CanSettings
from allegro_twin.drivers.dynamixel.config import DynamixelSettings
from allegro_twin.drivers.qb.config import QbSettings
from allegro_twin.drivers.schunk.config import SchunkSettings
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import find_file, read_yaml
from allegro_twin.files.schema import Positive, Settings, parse_settings
from allegro_twin.hands.settings import (
    HandSettings,
    LimitSettings,
    TaskSettings,
    scenario_files,
    scenario_side,
    with_card_side,
)
from allegro_twin.plugins import BACKENDS, CONTROLLERS
from allegro_twin.recording.settings import ReplaySettings
from allegro_twin.sim.settings import SimSettings

OwnBackend = Annotated[
    SimSettings | CanSettings | DynamixelSettings | QbSettings | SchunkSettings | ReplaySettings,
    Field(discriminator="kind"),
]


class RunConfig(Settings):
    """Everything that `allegro-twin run` needs."""

    another_kind = "arm"  # Of a cell: conf/lab_*.yaml.

    hand: HandSettings = HandSettings()
    backend: Annotated[OwnBackend, BACKENDS]
    controller: Annotated[OwnController, CONTROLLERS]
    task: TaskSettings = TaskSettings()
    limits: LimitSettings = LimitSettings()
    period: Positive = 0.003
    """s. The hand reports every 3 ms."""
    seconds: Positive | None = None
    """How long to run; default: until the scenario, the motion or the recording ends."""

    @model_validator(mode="before")
    @classmethod
    def _of_scenario(cls, values: Any) -> Any:
        """The side of the scenario, where the hand leaves it open."""
        if not isinstance(values, Mapping):
            return values
        hand = _block(values.get("hand"))
        side = None if hand is None or "side" in with_card_side(hand, "model") else scenario_side(_scenarios(values))
        return values if hand is None or side is None else {**values, "hand": {**hand, "side": side}}

    @model_validator(mode="after")
    def _everything_is_read(self) -> RunConfig:
        line = contradiction(self.task, self.controller, self.backend)
        if line is not None:
            raise ValueError(line)
        return self

    def changed(self, **blocks: Any) -> RunConfig:
        """This config with other blocks, or other keys in a block that is given as a mapping. Raises ConfigError."""
        content = self.model_dump(exclude_unset=True)
        for name, block in blocks.items():
            merged = isinstance(block, Mapping) and isinstance(content.get(name, {}), dict) and "kind" not in block
            content[name] = {**content.get(name, {}), **block} if merged else block
        return parse_settings(RunConfig, content, "config")


def _block(block: Any) -> Mapping[str, Any] | None:
    """A block of a config as its keys; None for what is none."""
    given = block.model_dump(exclude_unset=True) if isinstance(block, Settings) else {} if block is None else block
    return given if isinstance(given, Mapping) else None


def _scenarios(values: Mapping[str, Any]) -> tuple[Any, ...]:
    """The scenarios that a config's task names: its own, or among the objects of its episode."""
    task = _block(values.get("task")) or {}
    environment = (_block(task.get("episode")) or {}).get("environment")
    objects = environment.get("objects") if isinstance(environment, Mapping) else None
    return (task.get("scenario"), *scenario_files(objects))


def load_config(name: str | Path) -> RunConfig:
    """A config by path, or by its name in conf/; a hand's card and own file are looked for beside it, then where the
    process runs. Raises ConfigError with file, path, value and nearest key."""
    path = find_file(name, "config", "conf")
    content = read_yaml(path)
    hand = content.get("hand")
    for key in ("model", "serial"):
        if isinstance(hand, Mapping) and isinstance(hand.get(key), str):
            beside = path.parent / hand[key]
            if beside.suffix == ".yaml" and beside.is_file():
                hand = {**hand, key: str(beside)}
                content = content | {"hand": hand}
    config = parse_settings(RunConfig, content, str(path))
    check_scenario_side(config, config.task.scenario, str(path))
    return config


def check_scenario_side(config: RunConfig, scenario: str | Path | None, name: str) -> None:
    """Raises ConfigError for a scenario that says another side than the config of that name."""
    side = None if scenario is None else scenario_side([scenario])
    if side is not None and side != config.hand.side:
        raise ConfigError(
            f"{scenario} is for the {side} hand (its `side`), and {name} has the {config.hand.side} one (hand.side): "
            "leave one of them out, or take a config of that hand"
        )
