"""What a hand needs to be told, apart from what its own config says."""

from __future__ import annotations

from dataclasses import dataclass

from lerobot.robots.config import RobotConfig


@RobotConfig.register_subclass("allegro")
@dataclass(kw_only=True)
class AllegroConfig(RobotConfig):
    """`--robot.type=allegro`."""

    config: str = "sim_right"
    """A config of allegro_twin by path or name."""
    hand: str | None = None
    """Another hand: a file of conf/hands by path or name."""
    speed: float = 4.0
    """At most, on the way to an action, rad/s."""
