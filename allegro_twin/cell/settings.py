"""Settings of a whole cell (conf/lab_*.yaml)."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from allegro_twin.cell.arm.contact_reflex import CollisionSettings
from allegro_twin.cell.camera.mount import CameraMount
from allegro_twin.cell.camera.settings import DepthCameraSettings
from allegro_twin.cell.perception.settings import PerceptionSettings
from allegro_twin.files.schema import Positive, Seed, Settings, Vector3
from allegro_twin.grasping.scenario import ScenarioObject, check_object_names
from allegro_twin.grasping.uncertainty import Uncertainty
from allegro_twin.sim.model.arm_with_hand import CAMERA
from allegro_twin.spec import Side

NotNegative = Annotated[float, Field(ge=0)]


class ArmSettings(Settings):
    """The arm and how it moves."""

    model: str
    stiffness: Positive = 1000.0
    """N/m."""
    angular_stiffness: Positive = 50.0
    """N·m/rad."""
    speed: Positive = 0.4
    """Speed limit of the set-point, m/s."""
    turning: Positive = 1.6
    """rad/s."""
    approach: Positive = 1.2
    """s that the approach takes, and"""
    lift: Positive = 1.0
    """s that the lift takes: as in conf/protocols/table_pick.yaml, by which the grasps were found."""
    joint_speed: Positive = 1.5
    """Peak speed of the fastest joint on far paths, rad/s."""
    collision: CollisionSettings | None = CollisionSettings()
    """Thresholds beyond which the arm stops; None: it never does."""
    period: Positive = 0.003
    """s; the impedance is as stable as at 1 ms (docs/explanation/arm_control.md)."""


class CellHandSettings(Settings):
    """The hand on its flange."""

    model: str = "allegro"
    side: Side = "right"
    gains: str = "default"
    open: str | None = None
    """Posture of the library in which it waits. None: as it is at rest."""


class SecuritySettings(Settings):
    """Where the arm waits: the palm, in the world, out of the camera's sight of the table."""

    position: Vector3 = (-0.22, 0.0, 0.4)
    """m."""
    facing: Vector3 = (1.0, 0.0, 0.0)
    """Where the palm looks."""
    fingers: Vector3 = (0.0, 0.0, -1.0)
    """Where stretched fingers point."""


class TableObjectSettings(ScenarioObject):
    """What stands on the table: of the catalogue by name, or given here as in a scenario, a mesh for instance."""


class TimeoutSettings(Settings):
    """How long a state may last, s."""

    security: Positive = 6.0
    look: Positive = 1.0
    target: Positive = 9.0
    approach: Positive = 4.0
    close: Positive = 6.0
    lift: Positive = 4.0
    check: Positive = 6.0
    retreat: Positive = 3.0
    release: Positive = 12.0
    """To the tray, and"""
    open: Positive = 4.0
    """to let go."""


class DecideSettings(Settings):
    """When the state machine looks at what has happened."""

    by: Literal["clock", "event"] = "clock"
    """`clock`: at `rate`, as in the report; `event`: at every state of the arm."""
    rate: Positive = 10.0
    """Hz."""
    retries: Annotated[int, Field(ge=0)] = 1
    """So many times it begins anew after a miss."""
    near: Positive = 0.006
    """The arm has arrived within this, m,"""
    turned: Positive = 0.06
    """and this, rad."""


class GraspCheckSettings(Settings):
    """Thresholds of the grasp check, key `validation`: when an object counts as held."""

    by: Literal["force", "torque", "fingers"] = "fingers"
    """Which of the three decides; all are told. `fingers`: by where they are, compared with a close on nothing."""
    samples: Annotated[int, Field(ge=1)] = 100
    """Samples of the force, where the arm waits and after the lift."""
    tare: Annotated[int, Field(ge=1)] = 1000
    """Samples of the force before the approach to an object that may be too light for `samples`."""
    long: Annotated[int, Field(ge=1)] = 1500
    """After the lift, where nothing else confirms what is held: what is light and hidden is weighed for longer."""
    least: Positive = 0.053
    """Force threshold, kg: the force sensor confirms an object that weighs more; with `by: force` it decides alone.
    `samples` detect it (docs/explanation/cell.md)."""
    noise: NotNegative = 1.3
    """Standard deviation of each sample of the simulated sensor, N: the report's 400 g are three of it."""
    torque: Positive = 0.1
    """N·m: something is there, when the torques that stop the fingers, or that keep them from where they would be
    around nothing, sum up to more than this."""
    most: Positive = 1.7
    """kg, above `least`: nothing heavier can hang on the hand. A Franka arm carries 3 kg; the hand is 1.3 of them."""
    drift: Positive = 0.5
    """N. So much may the force sensor's zero differ between two rests, beyond its noise, before it is doubted."""

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
    """Where it stands; `wrist` is where the hand's mount has a place for one."""


class GraspPlanningSettings(Settings):
    """How a grasp is found for a thing that no stored grasp is for."""

    same: NotNegative = 0.08
    """Logarithm of a ratio of extents, up to which a stored grasp is taken as it is."""
    density: Positive = 700.0
    """kg/m³, by which what was seen is taken to weigh so much: a camera does not weigh. Most packed food has less."""
    rounds: Annotated[int, Field(ge=1)] = 3
    """Most rounds of variations of the stored grasps, and in each"""
    closed: Annotated[int, Field(ge=1)] = 8
    """so many that physics closes; what holds is tried under draws of"""
    uncertainty: Uncertainty = Uncertainty(
        position=0.004, yaw=5.0, size=0.04, mass=0.4, friction=(0.5, 1.0), torque=0.0
    )
    """what the camera and the cell do not know."""


class TraySettings(Settings):
    """Where objects are put away when the table is cleared: a tray that stands on it, out of perception's region."""

    at: tuple[float, float] = (-0.32, 0.32)
    """Its middle, world, m."""
    size: tuple[Positive, Positive] = (0.26, 0.26)
    """Outer edges along x and y, m."""
    height: Positive = 0.04
    """Height of its walls, m."""
    above: Positive = 0.04
    """An object is let go with its lowest point this far above the walls, m."""
    objects: Annotated[int, Field(ge=1)] = 12
    """So many are put away at most."""


class RemoteControlSettings(Settings):
    """What a cell that is led from outside may be asked for."""

    lower: Vector3 = (-0.35, -0.4, 0.03)
    """Where the palm may be: a box along the world's axes, m."""
    upper: Vector3 = (0.3, 0.4, 0.6)
    clearance: NotNegative = 0.015
    """Palm, links and fingertips stay this far above the table, m."""


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
    lift: Annotated[float, Field(ge=0.08)] = 0.15
    """m; what is 5 cm higher is lifted, and 3 cm are left for what sags and shifts in the hand."""
    timeouts: TimeoutSettings = TimeoutSettings()
    decide: DecideSettings = DecideSettings()
    validation: GraspCheckSettings = GraspCheckSettings()
    planning: GraspPlanningSettings | None = GraspPlanningSettings()
    """None: only stored grasps are taken, for things within 28 % of their own."""
    tray: TraySettings | None = None
    """With a tray the table is cleared: one object after the other is put there. None: the first that is held is the
    end."""
    follow: RemoteControlSettings = RemoteControlSettings()
    ros: RosNameSettings = RosNameSettings()
    seed: Seed = 0
    """Seed of the camera's and the force sensor's noise."""

    @model_validator(mode="after")
    def _names(self) -> LabSettings:
        check_object_names(self.objects)
        return self

    @property
    def at_the_wrist(self) -> bool:
        """Whether the camera moves with the arm."""
        return self.camera.mount.site is not None or self.camera.mount.body is not None
