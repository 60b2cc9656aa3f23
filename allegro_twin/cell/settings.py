"""Settings of a whole cell (conf/lab_*.yaml)."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from allegro_twin.cell.arm.contact_reflex import CollisionSettings
from allegro_twin.cell.camera.mount import CameraMount
from allegro_twin.cell.camera.settings import DepthCameraSettings
from allegro_twin.cell.perception.settings import PerceptionSettings
from allegro_twin.files.schema import Positive, Seed, Settings, Vector3, at_most
from allegro_twin.grasping.scenario import ScenarioObject, check_object_names
from allegro_twin.grasping.uncertainty import Uncertainty
from allegro_twin.sim.model.arm_with_hand import CAMERA
from allegro_twin.spec import Side

NotNegative = Annotated[float, Field(ge=0)]


class ArmSettings(Settings):
    """The arm and how it moves."""

    model: str
    stiffness: Annotated[Positive, at_most(1e5, "N/m")] = 1000.0
    """Translational stiffness of the Cartesian spring, N/m."""
    angular_stiffness: Annotated[Positive, at_most(1e4, "N·m/rad")] = 50.0
    """Rotational stiffness of the Cartesian spring, N·m/rad."""
    speed: Annotated[Positive, at_most(5, "m/s")] = 0.4
    """Speed limit of the set-point, m/s."""
    turning: Annotated[Positive, at_most(10, "rad/s")] = 1.6
    """Speed limit of the set-point's rotation, rad/s."""
    approach: Annotated[Positive, at_most(120, "s")] = 1.2
    """Duration of the approach, s: as in conf/protocols/table_pick.yaml, by which the grasps were found."""
    lift: Annotated[Positive, at_most(120, "s")] = 1.0
    """Duration of the lift, s: as in conf/protocols/table_pick.yaml."""
    joint_speed: Annotated[Positive, at_most(10, "rad/s")] = 1.5
    """Peak speed of the fastest joint on far paths, rad/s."""
    collision: CollisionSettings | None = CollisionSettings()
    """Thresholds beyond which the arm stops; None: it never does."""
    period: Annotated[Positive, at_most(0.1, "s")] = 0.003
    """Control period, s; the impedance is as stable as at 1 ms (docs/explanation/arm_control.md)."""


class CellHandSettings(Settings):
    """The hand on its flange."""

    model: str = "allegro"
    side: Side = "right"
    gains: str = "default"
    open: str | None = None
    """Posture of the library in which it waits. None: as it is at rest."""


class SecuritySettings(Settings):
    """Pose in which the arm waits: that of the palm in the world, out of the camera's view of the table."""

    position: Vector3 = (-0.22, 0.0, 0.4)
    """Position of the palm in the world, m."""
    facing: Vector3 = (1.0, 0.0, 0.0)
    """Direction that the palm faces, in the world."""
    fingers: Vector3 = (0.0, 0.0, -1.0)
    """Direction of stretched fingers, in the world."""


class TableObjectSettings(ScenarioObject):
    """Object on the table: from the catalogue by name, or given here as in a scenario, a mesh for instance."""


TimeLimit = Annotated[Positive, at_most(600, "s")]


class TimeoutSettings(Settings):
    """Time limits of the states, s."""

    security: TimeLimit = 6.0
    look: TimeLimit = 1.0
    target: TimeLimit = 9.0
    approach: TimeLimit = 4.0
    close: TimeLimit = 6.0
    lift: TimeLimit = 4.0
    check: TimeLimit = 6.0
    retreat: TimeLimit = 3.0
    release: TimeLimit = 12.0
    """Time limit of the motion to the tray, s."""
    open: TimeLimit = 4.0
    """Time limit of the release, s."""


class DecideSettings(Settings):
    """Timing of the state machine's decisions, and its tolerances."""

    by: Literal["clock", "event"] = "clock"
    """Trigger of decisions. `clock`: at `rate`, as in the report; `event`: at every state of the arm."""
    rate: Positive = 10.0
    """Decisions a second with `by: clock`, Hz."""
    retries: Annotated[int, Field(ge=0)] = 1
    """Number of further tries after a miss."""
    near: Annotated[Positive, at_most(0.1, "m")] = 0.006
    """Distance within which the arm has arrived, m."""
    turned: Annotated[Positive, at_most(1.57, "rad")] = 0.06
    """Angle within which the arm has arrived, rad."""


class GraspCheckSettings(Settings):
    """Thresholds of the grasp check, key `validation`: when an object counts as held."""

    by: Literal["force", "torque", "fingers"] = "fingers"
    """Check that decides; all are reported. `fingers`: by their positions, compared with a close on nothing."""
    samples: Annotated[int, Field(ge=1)] = 100
    """Samples of the force, where the arm waits and after the lift."""
    tare: Annotated[int, Field(ge=1)] = 1000
    """Samples of the force before the approach to an object that may be too light for `samples`."""
    long: Annotated[int, Field(ge=1)] = 1500
    """Samples of the force after the lift where nothing else confirms the grasp: a light, hidden object is weighed for
    longer."""
    least: Positive = 0.053
    """Force threshold, kg: the force sensor confirms an object that weighs more; with `by: force` it decides alone.
    `samples` detect it (docs/explanation/cell.md)."""
    noise: NotNegative = 1.3
    """Standard deviation of each sample of the simulated sensor, N: the report's 400 g are three of it."""
    torque: Annotated[Positive, at_most(10, "N·m")] = 0.1
    """Torque above which something is between the fingers, N·m: the sum of the torques that stop them, or that keep
    them from their positions around nothing."""
    most: Annotated[Positive, at_most(50, "kg")] = 1.7
    """Largest weight that can hang on the hand, kg, above `least`. A Franka arm carries 3 kg; the hand is 1.3 of
    them."""
    drift: Annotated[Positive, at_most(50, "N")] = 0.5
    """Largest change of the force sensor's zero between two rests, beyond its noise, before it is doubted, N."""

    @model_validator(mode="after")
    def _ordered(self) -> GraspCheckSettings:
        if self.least >= self.most:
            raise ValueError(f"least {self.least:g} kg is not below most {self.most:g} kg; it is in kg")
        return self


def _at_the_wrist(value: Any) -> Any:
    if value == "wrist":
        return CameraMount(site=CAMERA, position=(0.0, 0.0, 0.0), quaternion=(1.0, 0.0, 0.0, 0.0))
    return value


class CellCameraSettings(DepthCameraSettings):
    """The camera of a cell."""

    mount: Annotated[CameraMount, BeforeValidator(_at_the_wrist, json_schema_input_type=CameraMount | Literal["wrist"])]
    """Mount of the camera; `wrist` is the place for one on the hand's mount."""


class GraspPlanningSettings(Settings):
    """Search for a grasp of an object that no stored grasp suits."""

    same: NotNegative = 0.08
    """Logarithm of a ratio of extents up to which a stored grasp is taken as it is."""
    density: Positive = 700.0
    """Density by which the weight of an observed object is estimated, kg/m³: a camera does not weigh. Most packed food
    has less."""
    rounds: Annotated[int, Field(ge=1)] = 3
    """Most rounds of variations of the stored grasps."""
    closed: Annotated[int, Field(ge=1)] = 8
    """Number of variations that physics closes in each round."""
    uncertainty: Uncertainty = Uncertainty(
        position=0.004, yaw=5.0, size=0.04, mass=0.4, friction=(0.5, 1.0), torque=0.0
    )
    """Perturbations of the draws: place, size, mass and friction that camera and cell do not know."""


class TraySettings(Settings):
    """Tray in which objects are put away when the table is cleared: it stands on the table, out of perception's
    region."""

    at: tuple[float, float] = (-0.32, 0.32)
    """Middle of the tray in the world, m."""
    size: tuple[Positive, Positive] = (0.26, 0.26)
    """Outer edges along x and y, m."""
    height: Annotated[Positive, at_most(2, "m")] = 0.04
    """Height of its walls, m."""
    above: Annotated[Positive, at_most(2, "m")] = 0.04
    """Height of an object's lowest point above the walls when it is let go, m."""
    objects: Annotated[int, Field(ge=1)] = 12
    """Largest number of objects that are put away."""


class RemoteControlSettings(Settings):
    """Limits of requests to a cell that is controlled from outside."""

    lower: Vector3 = (-0.35, -0.4, 0.03)
    """Lower corner of the box along the world's axes in which the palm may be, m."""
    upper: Vector3 = (0.3, 0.4, 0.6)
    clearance: Annotated[NotNegative, at_most(2, "m")] = 0.015
    """Least height of palm, links and fingertips above the table, m."""


Name = Annotated[str, Field(pattern=r"^/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*$")]


class RosNameSettings(Settings):
    """Further frames and topics of the cell on ROS 2, under these names; None: not published."""

    hand_frame: Name | None = None
    """Frame at the palm."""
    object_frame: Name | None = None
    """Frame at the solid that perception found."""
    target_hand: Name | None = None
    """Frame where perception would have the palm."""
    target_arm: Name | None = None
    """Frame where the flange is to be."""
    target_security: Name | None = None
    """Frame where the palm waits."""
    target_lift: Name | None = None
    """Frame of the palm after the lift."""
    arm_states: Name | None = None
    """Topic of the arm's joint states alone."""
    hand_states: Name | None = None
    """Topic of the hand's joint states alone."""
    planning_scene: Name | None = "planning_scene"
    """Topic of what was seen, for MoveIt."""


class LabSettings(Settings):
    """The whole cell."""

    arm: ArmSettings
    hand: CellHandSettings = CellHandSettings()
    camera: CellCameraSettings
    perception: PerceptionSettings
    objects: Annotated[tuple[TableObjectSettings, ...], Field(min_length=1)]
    friction: Annotated[float, Field(gt=0, le=1.0)] = 0.8
    """Friction of every contact."""
    security: SecuritySettings = SecuritySettings()
    lift: Annotated[float, Field(ge=0.08), at_most(2, "m")] = 0.15
    """Height of the lift, m; an object 5 cm higher counts as lifted, and 3 cm are left for sagging and slipping."""
    timeouts: TimeoutSettings = TimeoutSettings()
    decide: DecideSettings = DecideSettings()
    validation: GraspCheckSettings = GraspCheckSettings()
    planning: GraspPlanningSettings | None = GraspPlanningSettings()
    """Search for grasps of objects that no stored grasp suits. None: only stored grasps are taken, for objects within
    28 % of their own."""
    tray: TraySettings | None = None
    """Tray in which objects are put away, one after the other, until the table is clear. None: the first that is held
    is the end."""
    follow: RemoteControlSettings = RemoteControlSettings()
    ros: RosNameSettings = RosNameSettings()
    seed: Seed = 0
    """Seed of the camera's and the force sensor's noise."""

    @model_validator(mode="after")
    def _names(self) -> LabSettings:
        check_object_names(self.objects)
        return self

    @model_validator(mode="after")
    def _in_time(self) -> LabSettings:
        period, force = self.arm.period, self.validation
        decision = 1.0 / self.decide.rate if self.decide.by == "clock" else period
        for limit, least, by in (
            ("target", force.samples * period, "validation.samples x arm.period"),
            ("target", force.tare * period, "validation.tare x arm.period, of light objects,"),
            ("check", force.samples * period, "validation.samples x arm.period"),
            ("check", force.long * period, "validation.long x arm.period, of light objects,"),
            ("look", self.camera.latency, "camera.latency"),
            ("check", self.camera.latency, "camera.latency"),
            ("approach", self.arm.approach, "arm.approach"),
            ("lift", self.arm.lift, "arm.lift"),
        ):
            given = float(getattr(self.timeouts, limit))
            if given + decision < least:  # What is late is found at the next decision.
                raise ValueError(f"timeouts.{limit} {given:g} s is less than {by} {least:g} s, so it always runs out")
        return self

    @property
    def at_the_wrist(self) -> bool:
        """Whether the camera moves with the arm."""
        return self.camera.mount.site is not None or self.camera.mount.body is not None
