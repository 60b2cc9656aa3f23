"""A hand as LeRobot sees it: joint positions out, joint set-points in."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from lerobot.robots.robot import Robot
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

from allegro_twin import ConfigError, Hand, HandSpec, SelfCollision, load_config
from allegro_twin.app import RunConfig
from allegro_twin.hands import hand_side, load_spec
from allegro_twin.surfaces.hand import ExternalSetpoints
from lerobot_robot_allegro.config_allegro import AllegroConfig


class Allegro(Robot):
    """The hand of a config. It turns its own loop between two calls; whatever ends it, it is left limp."""

    config_class = AllegroConfig
    name = "allegro"

    def __init__(self, config: AllegroConfig) -> None:
        super().__init__(config)
        self.config = config
        self._settings = _settings(config)
        self._hand: Hand | None = None
        self._outside: ExternalSetpoints | None = None
        self._goal: np.ndarray | None = None

    @cached_property
    def spec(self) -> HandSpec:
        """Known before the hand is connected."""
        hand = self._settings.hand
        return load_spec(hand.model, hand.side, hand.serial)

    @cached_property
    def observation_features(self) -> dict[str, type]:
        """Positions, rad, and speeds, rad/s, by joint."""
        return {f"{alias}.{what}": float for what in ("pos", "vel") for alias in self.spec.aliases}

    @cached_property
    def action_features(self) -> dict[str, type]:
        """Positions, rad, by joint."""
        return {f"{alias}.pos": float for alias in self.spec.aliases}

    @property
    def is_connected(self) -> bool:
        return self._hand is not None

    def connect(self, calibrate: bool = True) -> None:
        """Open the hand, limp. Raises HandError of allegro_twin."""
        if self._hand is not None:
            raise DeviceAlreadyConnectedError(f"{self} is connected already")
        self._hand = Hand.open(self._settings, background=True)
        self._outside = ExternalSetpoints(self._hand, self.config.speed)

    @property
    def is_calibrated(self) -> bool:
        return True

    def calibrate(self) -> None:
        """Nothing: the hand's own file has it; `allegro-twin calibrate limits`."""

    def configure(self) -> None:
        """Nothing: the config of allegro_twin has said it all."""

    def get_observation(self) -> dict[str, Any]:
        """The newest state. Raises what ended the hand."""
        state = self._open().state
        values = [*state.position.tolist(), *state.velocity.tolist()]
        return dict(zip(self.observation_features, values, strict=True))

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Be at these positions; what the hand was asked for: clipped where a position lies beyond a limit by no more
        than a joint gives at its stop. Raises ConfigError for a joint that is missing, a number that is not finite,
        and a position further beyond."""
        self._open()
        if missing := [key for key in self.action_features if key not in action]:
            raise ConfigError(f"the action lacks {', '.join(missing)}")
        wanted = [float(action[key]) for key in self.action_features]
        assert self._outside is not None
        try:
            self._goal = self._outside.track(wanted, "the action")
        except SelfCollision:
            if self._goal is None:
                raise  # The hand is limp still: nothing else was asked of it.
        return dict(zip(self.action_features, self._goal.tolist(), strict=True))

    def disconnect(self) -> None:
        """Leave the hand limp. Raises LinkError when it did not confirm that."""
        hand = self._open()
        self._hand = self._outside = self._goal = None
        hand.close()

    def _open(self) -> Hand:
        if self._hand is None:
            raise DeviceNotConnectedError(f"{self} is not connected")
        return self._hand


def _settings(config: AllegroConfig) -> RunConfig:
    settings = load_config(config.config)
    if config.hand is None:
        return settings
    side = hand_side(config.hand)
    return settings.changed(hand={"serial": config.hand} | ({} if side is None else {"side": side}))
