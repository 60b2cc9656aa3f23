"""The controller block: how a hand is driven."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from allegro_twin.files.schema import Gravity, PerJoint, Positive, Vector3
from allegro_twin.learning.mpc.settings import MpcSettings, PoseCamera
from allegro_twin.plugins import ControllerSettings


class TorqueSettings(ControllerSettings):
    """Set and keep the same torques."""

    takes_posture = False

    kind: Literal["torque"]
    torque: PerJoint = 0.0
    """N·m."""


class GravitySettings(ControllerSettings):
    """Carry the hand's own weight."""

    takes_posture = False

    kind: Literal["gravity"]
    gravity: Gravity | None = None
    """m/s² in the palm frame; default: what the hand reports."""


class PositionSettings(ControllerSettings):
    """Perform the task under PD or PID control."""

    kind: Literal["pd", "pid"]
    gains: str = "default"
    """Name in the hand's card (`gains`), or of a hand of ours in conf/gains/<model>.yaml."""
    speed: Positive = 1.0
    """To a posture: the peak, of the joint that travels furthest, rad/s."""
    profile: Literal["linear", "minimum_jerk"] = "minimum_jerk"
    compensate: bool = True
    """Carry the hand's weight by feed-forward."""
    inverse_dynamics: bool = False
    """Feed forward what the motion needs by the hand's own file: inertia, damping, friction, cables, at its delay."""
    gravity: Gravity | None = None
    """m/s² in the palm frame; default: what the hand reports."""


class LimpSettings(ControllerSettings):
    """Let go of the joints."""

    takes_posture = False

    kind: Literal["limp"]


class FollowSettings(ControllerSettings):
    """Perform the task with a hand whose firmware closes the loop."""

    kind: Literal["position"]
    speed: Positive = 1.0
    """To a posture: the peak, of the joint that travels furthest, rad/s."""
    profile: Literal["linear", "minimum_jerk"] = "minimum_jerk"
    effort: PerJoint | None = None
    """The most that each motor may give, N·m; default: what the hand allows."""


class CartesianSettings(ControllerSettings):
    """Bring an arm's flange to a pose, as on a spring: docs/explanation/arm_control.md."""

    takes_posture = False

    kind: Literal["impedance", "compliance"]
    position: Vector3
    """Position of the flange in the base's frame, m."""
    turn: Vector3 = (0.0, 0.0, 0.0)
    """From the orientation at the start, a rotation vector in the axes of the base, rad."""
    stiffness: Positive | None = None
    """N/m; default: 200 of the impedance, 500 of the compliance."""
    angular_stiffness: Positive | None = None
    """N·m/rad; default: 10 and 50."""
    speed: Positive = 0.25
    """Speed limit on the path there, m/s."""
    turning: Positive = 1.0
    """At most, rad/s."""
    iterations: Annotated[int, Field(ge=1)] = 1
    """Iterations of the compliance in a cycle: more are faster."""


class PolicySettings(ControllerSettings):
    """Let a trained policy decide."""

    kind: Literal["policy"]
    file: str
    """.onnx or .zip, by path or by its name in conf/policies."""
    trust: bool = False
    """Load a .zip too, which can run any program: its maker is trusted."""


class PlanningSettings(ControllerSettings):
    """Plan for the task's episode, by sampling: docs/explanation/model_predictive_control.md."""

    kind: Literal["mpc"]
    planning: MpcSettings | None = None
    """Default: the settings of the task in conf/mpc (`_real` with `time: real`), or those of `allegro-twin mpc`."""
    time: Literal["lockstep", "real"] = "lockstep"
    """`lockstep`: the time of a simulated hand stands still while it thinks. `real`: it does not; plans are made beside
    the hand."""
    camera: PoseCamera | None = None
    """How the object of a simulated hand is observed; default: its true pose, every control period."""
    threads: Annotated[int, Field(ge=0)] = 0
    """0: one a processor."""


OwnController = Annotated[
    TorqueSettings
    | GravitySettings
    | PositionSettings
    | LimpSettings
    | FollowSettings
    | PolicySettings
    | PlanningSettings
    | CartesianSettings,
    Field(discriminator="kind"),
]
