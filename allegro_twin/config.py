"""The run config: one block a part, and `kind` picks the implementation."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from allegro_twin.files.assets import find
from allegro_twin.files.schema import Settings, load
from allegro_twin.spec import Side

PerJoint = float | list[float]
"""One value for every joint, or one each."""
Positive = Annotated[float, Field(gt=0)]
Vector3 = tuple[float, float, float]


class HandSettings(Settings):
    model: str = "allegro"
    side: Side = "right"
    serial: str = ""
    """File in conf/hands with what was measured on this very hand."""


class SimSettings(Settings):
    """A hand in MuJoCo: alone, or in a scenario."""

    kind: Literal["sim"]
    scenario: str | None = None
    """Name or path of a scenario: its objects, table and wrist."""
    grasp: str | None = None
    """With a scenario: another grasp than the one it names."""
    thing: str | None = None
    """With a scenario: another object of the catalogue in place of the first."""
    facing: Vector3 = (1.0, 0.0, 0.0)
    """Without a scenario: where the palm looks, world axes; z is up."""
    fingers: Vector3 = (0.0, 0.0, 1.0)
    """Without a scenario: where stretched fingers point."""
    posture: str | PerJoint | None = None
    """Joint positions at reset; default: the scenario's pre-shape, else the nearest to zero inside the limits."""


class ReplaySettings(Settings):
    """A recording in place of a hand."""

    kind: Literal["replay"]
    file: Path
    partial: bool = False
    """Use the readable rows of a recording that was cut short."""


class TorqueSettings(Settings):
    """Set and keep the same torques."""

    kind: Literal["torque"]
    torque: PerJoint = 0.0
    """N·m."""


class GravitySettings(Settings):
    """Carry the hand's own weight."""

    kind: Literal["gravity"]
    gravity: Vector3 | None = None
    """m/s² in the palm frame; default: what the hand reports."""


class PositionSettings(Settings):
    """Go to a posture, or perform the scenario's grasp, under PD or PID control."""

    kind: Literal["pd", "pid"]
    gains: str = "default"
    """Name in conf/gains/<model>.yaml."""
    posture: str | PerJoint | None = None
    """Where to go; default: the scenario's grasp, else `home`."""
    speed: Positive = 1.0
    """Peak, of the joint that travels furthest, rad/s."""
    profile: Literal["linear", "minimum_jerk"] = "minimum_jerk"
    compensate: bool = True
    """Carry the hand's weight by feed-forward."""
    gravity: Vector3 | None = None
    """m/s² in the palm frame; default: what the hand reports."""


class LimitSettings(Settings):
    """What the guard lets through; docs/safety.md."""

    torque: PerJoint | None = None
    """N·m; default: the hand's own clip, which is also the highest possible."""
    velocity: PerJoint = 12.0
    """rad/s."""
    margin: Annotated[float, Field(ge=-0.6)] = 0.0
    """Soft stops this far inside the joint limits, rad; negative: outside, to look for the real ones."""


class RunConfig(Settings):
    """Everything that `allegro-twin run` needs."""

    hand: HandSettings = HandSettings()
    backend: Annotated[SimSettings | ReplaySettings, Field(discriminator="kind")]
    controller: Annotated[TorqueSettings | GravitySettings | PositionSettings, Field(discriminator="kind")]
    limits: LimitSettings = LimitSettings()
    period: Positive = 0.003
    """s. The hand reports every 3 ms."""
    seconds: Positive | None = None
    """How long to run; default: until the scenario, the motion or the recording ends."""


def load_config(name: str | Path) -> RunConfig:
    """A config by path, or by its name in conf/. Raises ConfigError with file, path, value and nearest key."""
    path = find(name, "config", "conf")
    return load(RunConfig, path)
