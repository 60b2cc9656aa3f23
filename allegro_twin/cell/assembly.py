"""Assembly of a cell from its settings: arm, hand, objects, camera and perception."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from allegro_twin.backend import HandBackend
from allegro_twin.cell.arm.arm_with_hand import ArmWithHand, make_arm_with_hand
from allegro_twin.cell.arm.faults import DisturbedBackend
from allegro_twin.cell.camera.camera import CellCamera
from allegro_twin.cell.camera.self_filter import SelfFilter
from allegro_twin.cell.camera.sources import open_camera
from allegro_twin.cell.checks.scene_check import check_scene
from allegro_twin.cell.motion.empty_grasp import PERIOD
from allegro_twin.cell.perception.pipeline import PerceptionPipeline
from allegro_twin.cell.settings import LabSettings, SecuritySettings, TableObjectSettings
from allegro_twin.grasping.timeline import place_object
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.hands.library.library import Library
from allegro_twin.kinematics.hand import HandKinematics, hand_kinematics
from allegro_twin.kinematics.orientation import matrix_facing
from allegro_twin.kinematics.pose import Pose
from allegro_twin.sim.contact.obstacle_clearance import ObstacleClearance
from allegro_twin.sim.model.arm_with_hand import MountedHand
from allegro_twin.sim.model.plate import PicturePlate
from allegro_twin.sim.model.scene import TrayBox
from allegro_twin.sim.objects.catalogue import GraspObject, PlacedObject
from allegro_twin.types import Array, Vector

_WAITING = (0.0, -0.4, 0.0, -2.3, 0.0, 1.9, 1.3)
"""rad. Elbow up and the hand down, from where it turns to either side alike (docs/explanation/cell.md)."""


@dataclass(frozen=True, slots=True, eq=False)
class Cell:
    """Assembled cell: arm, hand, camera and perception; `replace` a part to inject a fault."""

    settings: LabSettings
    robot: ArmWithHand
    arm: HandBackend
    hand: HandBackend
    camera: CellCamera
    pipeline: PerceptionPipeline
    model: HandKinematics
    """Kinematics of the hand."""
    library: Library
    security: Pose
    """Pose of the palm where the arm waits, in the world."""
    posture: Vector
    """Posture of the arm there, (7,), rad."""
    open: Vector
    """Posture of the open hand, (n,), rad."""
    stiffness: Vector
    """Stiffness of the hand's controller, (n,), N·m/rad."""
    forces: Array
    """What its motors give at the least and at the most, (2, n), N·m: a tendon only pulls."""
    clearance: ObstacleClearance
    """What is in the way of arm and hand."""
    self_filter: SelfFilter
    """What the camera sees of arm and hand."""
    wanted: GraspObject | None = None
    """What is to be taken, where several things stand on the table; None: what has most points in the picture."""

    def close(self) -> None:
        """Let go of everything."""
        self.camera.close()
        self.self_filter.close()
        self.robot.close()


def make_cell(settings: LabSettings, plates: Sequence[PicturePlate] = (), wanted: str | None = None) -> Cell:
    """Everything, at rest at the security pose; `plates` are in the scene, too. `wanted`: the object that is to be
    taken, by its name. Raises ConfigError, one line for the first thing that is wrong."""
    spec, library = load_spec(settings.hand.model, settings.hand.side), Library()
    hand_open = spec.rest if settings.hand.open is None else library.posture(settings.hand.open, spec)
    objects, arm = [place_object(each) for each in settings.objects], settings.arm
    tray = settings.tray

    def made(posture: Vector | None, placed: Sequence[PlacedObject]) -> ArmWithHand:
        periods = (arm.period, PERIOD)
        return make_arm_with_hand(arm.model, spec, objects=placed, posture=posture, hand_posture=hand_open,
                         friction=settings.friction, periods=periods, collision=arm.collision,
                         tray=None if tray is None else TrayBox(*tray.at, *tray.size, tray.height),
                         plates=plates)  # fmt: skip

    security, posture = waiting_pose(made(None, ()), settings.security)
    robot = made(posture, objects)
    motors = [robot.world.model.actuator(name).id for name in spec.joints]
    forces = robot.world.model.actuator_forcerange[motors].T.copy()  # Before the hand limits its own efforts.
    check_scene(robot, settings, objects)
    noise = np.array([settings.validation.noise] * 3 + [0.0] * 3)
    camera = open_camera(robot.world.model, settings.camera, settings.seed)
    return Cell(
        settings, robot, DisturbedBackend(robot.arm, noise, seed=settings.seed), robot.hand,
        camera,
        PerceptionPipeline(settings.perception, settings.seed),
        hand_kinematics(spec), library, security, posture, hand_open, load_gains(settings.hand.gains, spec).kp, forces,
        ObstacleClearance(robot.spec, MountedHand(spec, robot.mount), robot.base.position),
        SelfFilter(robot, settings.camera, camera.lens),
        next((each.grasp_object for each in objects if each.grasp_object.name == wanted), None),
    )  # fmt: skip


def waiting_pose(robot: ArmWithHand, wait: SecuritySettings) -> tuple[Pose, Vector]:
    """Where the palm waits, in the world, and the arm's posture there, (n,), rad. Raises ConfigError out of reach."""
    security = Pose(np.array(wait.position), matrix_facing(wait.facing, wait.fingers))
    return security, robot.model.reach(robot.flange_for(security), near=np.array(_WAITING), tolerance=2e-3)


def with_objects(settings: LabSettings, objects: Sequence[TableObjectSettings], seed: int) -> LabSettings:
    """Settings of the same cell with other objects on the table."""
    return settings.model_copy(update={"objects": tuple(objects), "seed": seed})
