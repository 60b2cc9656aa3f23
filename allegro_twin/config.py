"""The run config: one block a part, and `kind` picks the implementation."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from allegro_twin.description.calibration import Version
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


class FaultEvent(Settings):
    """Something that goes wrong on a virtual hand's bus at a given moment."""

    at: Annotated[float, Field(ge=0)]
    """s since the hand was switched on."""
    what: Literal["silence", "overheat", "joint_timeout", "bus_off", "power_cut", "recover"]
    which: Annotated[int, Field(ge=0, le=15)] = 0
    """`silence`: the finger, 0 … 3; `overheat`: the joint, 0 … 15."""


Probability = Annotated[float, Field(ge=0, le=1)]


class FaultSettings(Settings):
    """What to do to the frames of a virtual hand, by chance (per frame) and by script."""

    drop: Probability = 0.0
    duplicate: Probability = 0.0
    corrupt: Probability = 0.0
    delay: Probability = 0.0
    delay_by: Positive = 0.001
    """s."""
    reorder: Probability = 0.0
    seed: int = 0
    script: tuple[FaultEvent, ...] = ()


class FirmwareSettings(Settings):
    """Where sources disagree on what a hand does; for virtual hands. docs/protocol.md"""

    servo: Literal["required", "ignored"] = "required"
    """`ignored`: torques act and reports come without "servo on", as notes on a real v4 say."""
    clip: Literal["driver", "full"] = "driver"
    """The most that a motor follows: what the manufacturer's driver sends, or its full PWM."""


class CanSettings(Settings):
    """A hand on a CAN bus, real or virtual."""

    kind: Literal["can"]
    version: Version | None = None
    """Of the hand; default: what its own file says."""
    interface: str = "socketcan"
    """python-can's name of the adapter; `allegro-virtual` puts a simulated hand on a bus inside this program."""
    channel: str = "can0"
    bitrate: Annotated[int, Field(gt=0)] = 1_000_000
    """bit/s. Every hand's: manual v4.0, Baud-Rate."""
    device: Annotated[int, Field(ge=0, le=3)] = 0
    """v4: the hand's id on a shared bus."""
    options: dict[str, Any] = Field(default_factory=dict)
    """Further arguments of the python-can interface."""
    identify: bool = True
    """Ask the hand who it is and refuse the wrong one; `false` for a hand that does not answer."""
    timeout: Positive = 0.05
    """s without a whole report after which the hand counts as silent."""
    deadman: Positive | None = 0.1
    """s without a call from the program after which the hand is cut off; null: never."""
    keeper: bool = True
    """Have a process of its own watch, which also leaves the hand limp when the program dies; docs/safety.md."""
    velocity_cutoff: Positive = 30.0
    """Hz, of the low-pass behind joint velocities."""
    gravity: Vector3 | None = None
    """In the palm frame, m/s²: how the hand is mounted, where its IMU is not to be used."""
    imu: Annotated[float, Field(ge=0)] = 0.0
    """s between reports of the IMU, which then tells gravity; 0: off. No source confirms its layout."""
    realtime: bool | Literal["try"] = False
    """Ask the kernel for real-time scheduling (Linux; needs permission), so that a busy machine misses no period;
    `try`: go on with a warning where it is not allowed."""
    firmware: FirmwareSettings | None = None
    """How a virtual hand differs from what the manual says of one."""
    scene: SimSettings | None = None
    """Where a virtual hand is; only `interface: allegro-virtual` and `allegro-twin firmware` look at it."""
    faults: FaultSettings | None = None
    """What goes wrong on a virtual hand's bus."""


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
    scenario: str | None = None
    """For a hand that is not simulated here: perform the grasp of this scenario, on its timeline."""


class PolicySettings(Settings):
    """Let a trained policy decide."""

    kind: Literal["policy"]
    file: str
    """.onnx or .zip, by path or by its name in conf/policies."""
    grasp: str | None = None
    """Which of the policy's scripts it follows, where it has several; default: its first."""
    goal: str | PerJoint | None = None
    """For a policy that reaches goals: a posture, whose fingertips are the goal."""


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
    backend: Annotated[SimSettings | CanSettings | ReplaySettings, Field(discriminator="kind")]
    controller: Annotated[
        TorqueSettings | GravitySettings | PositionSettings | PolicySettings, Field(discriminator="kind")
    ]
    limits: LimitSettings = LimitSettings()
    period: Positive = 0.003
    """s. The hand reports every 3 ms."""
    seconds: Positive | None = None
    """How long to run; default: until the scenario, the motion or the recording ends."""


def load_config(name: str | Path) -> RunConfig:
    """A config by path, or by its name in conf/. Raises ConfigError with file, path, value and nearest key."""
    path = find(name, "config", "conf")
    return load(RunConfig, path)
