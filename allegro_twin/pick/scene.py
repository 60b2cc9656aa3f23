"""One cell with one thing: an arm and a hand that begin over it, and move together, period by period."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from allegro_twin.cell.arm.arm_with_hand import ArmWithHand, make_arm_with_hand
from allegro_twin.cell.arm.impedance import Impedance, ImpedanceState, Stiffness
from allegro_twin.cell.arm.limits import at_limit
from allegro_twin.cell.arm.target import CartesianTarget, Smoothing
from allegro_twin.cell.motion.finger_paths import SteeredReference, finger_controller
from allegro_twin.control.controllers import ReferenceMemory
from allegro_twin.control.trajectory import SetPoint
from allegro_twin.kinematics.arm import rotate, rotation_between
from allegro_twin.kinematics.hand import HandKinematics
from allegro_twin.kinematics.pose import Pose
from allegro_twin.pick.settings import PickSettings
from allegro_twin.safety import GuardMemory
from allegro_twin.sim.contact.contacts import Obstruction, find_contacts, obstructions
from allegro_twin.sim.engine.backend import DeviceState
from allegro_twin.sim.engine.world import WorldState
from allegro_twin.sim.objects.catalogue import PlacedObject, load_object, standing_orientation
from allegro_twin.spec import HandSpec
from allegro_twin.types import HandState, Vector

_LEASH = (0.06, 0.3)
"""m and rad: a set-point is no farther ahead of the palm."""
_LOWER, _UPPER = np.array([-0.35, -0.4, 0.02]), np.array([0.3, 0.4, 0.6])
"""Limits of the palm's set-point in the world, m."""
_AIR = 1e-4  # m. So that a thing settles instead of being pushed out of the table.


class SceneState(NamedTuple):
    """State that decides how a scene goes on."""

    world: WorldState
    devices: tuple[DeviceState, DeviceState]
    """The arm's and the hand's."""
    guards: tuple[GuardMemory, GuardMemory]
    """The arm's and the hand's."""
    arm: HandState
    hand: HandState
    path: tuple[Vector, Vector, float]
    aim: Pose
    hanging: ImpedanceState
    followed_since: float


class LinearPath:
    """A path that goes from goal to goal in straight lines, one a decision."""

    def __init__(self, position: Vector, seconds: float) -> None:
        self.goal, self._seconds = position, seconds
        self._before, self._begin = position, 0.0

    def save(self) -> tuple[Vector, Vector, float]:
        """Copy of the state that decides how it goes on."""
        return self.goal, self._before, self._begin

    def restore(self, state: tuple[Vector, Vector, float]) -> None:
        """Go on from what `save` returned."""
        self.goal, self._before, self._begin = state

    def head_for(self, t: float, goal: Vector) -> None:
        """From `t` on, s, to a posture, (n,), rad, which it reaches at the next decision."""
        self._before, self.goal, self._begin = self.goal, goal, t

    def __call__(self, t: float) -> SetPoint:
        part = min(max((t - self._begin) / self._seconds, 0.0), 1.0)
        way = self.goal - self._before
        return SetPoint(self._before + part * way, way / self._seconds if part < 1.0 else np.zeros_like(way))


class PickScene:
    """Scene of `ArmPick` for one kind of object; an episode begins with `begin`."""

    def __init__(self, settings: PickSettings, arm: str, spec: HandSpec, model: HandKinematics, name: str) -> None:
        self.settings, self.name, self.spec, self._hand_model = settings, name, spec, model
        self.grasp_object = load_object(name)
        placed = PlacedObject(
            self.grasp_object, (0.0, 0.0, float(self.grasp_object.half_extents()[2]) + _AIR), (1.0, 0.0, 0.0, 0.0)
        )
        self.robot: ArmWithHand = make_arm_with_hand(
            arm, spec, objects=[placed], friction=settings.friction, periods=(settings.period,) * 2
        )
        self._place = int(self.robot.world.model.joint(name).qposadr[0])
        self.arm: HandState
        self.hand: HandState

    def rest(self, at: Vector, yaw: float, arm: Vector, hand: Vector) -> None:
        """Begin anew with the thing at a place (2,), m, turned by `yaw`, rad, and both at these postures, rad."""
        robot = self.robot
        first = robot.world.model.qpos0[self._place : self._place + 7]
        first[:2], first[3:] = at, standing_orientation("z", yaw)
        robot.arm_sim.posture, robot.hand_sim.posture = arm, hand
        self.arm, self.hand = robot.arm.reset(), robot.hand.reset()

    def begin(self) -> None:
        """The controllers begin where arm and hand are."""
        settings = self.settings
        self.path = LinearPath(self.hand.position, settings.period * settings.decimation)
        self.target = CartesianTarget(self.robot.model.pose(self.arm.position))
        self.aim = self.palm
        self._law = Impedance(
            self.robot.model, self.target, Stiffness(settings.stiffness, settings.angular_stiffness),
            smoothing=Smoothing(0.4, 1.6),
        )  # fmt: skip
        self._grip = finger_controller(SteeredReference(self.path), settings.gains, self.spec, self._hand_model)
        self._hanging: ImpedanceState = self._law.start(self.arm)
        self._following: ReferenceMemory = self._grip.start(self.hand)

    def save(self) -> SceneState:
        """State of now."""
        robot = self.robot
        devices, guards = (robot.arm_sim.save(), robot.hand_sim.save()), (robot.arm.save(), robot.hand.save())
        return SceneState(
            robot.world.save(), devices, guards, self.arm, self.hand, self.path.save(), self.aim, self._hanging,
            self._following.began,
        )  # fmt: skip

    def restore(self, state: SceneState) -> None:
        """Go on, to the bit, from a state of a scene with the same settings and object."""
        robot = self.robot
        robot.world.restore(state.world)
        for device, kept in zip((robot.arm_sim, robot.hand_sim), state.devices, strict=True):
            device.restore(kept)
        for guard, memory in zip((robot.arm, robot.hand), state.guards, strict=True):
            guard.restore(memory)
        self.arm, self.hand = state.arm, state.hand
        self.begin()
        self.path.restore(state.path)
        self.aim, self._hanging = state.aim, state.hanging
        self._following = self._following._replace(began=state.followed_since)

    @property
    def palm(self) -> Pose:
        """Where the encoders say that it is, in the world."""
        return self.robot.palm(self.arm)

    @property
    def there(self) -> Pose:
        """The thing, in the world, as it is."""
        return self.robot.object_pose(self.name)

    def move(self, step: Vector, twist: Vector, posture: Vector) -> None:
        """Displace the palm's set-point, (3,), m, and turn it, (3,), rad, in the world's axes; fingers to a posture."""
        palm = self.palm
        ahead = np.clip(self.aim.position + step, _LOWER, _UPPER) - palm.position
        wide = rotation_between(palm.rotation, rotate(self.aim.rotation, twist))
        self.aim = Pose(palm.position + _short(ahead, _LEASH[0]), rotate(palm.rotation, _short(wide, _LEASH[1])))
        self.target.move(self.robot.flange_for(self.aim))
        self.path.head_for(self.hand.t, np.clip(posture, self.spec.lower, self.spec.upper))

    def pass_time(self) -> None:
        """One control period of both. Raises HandFault where a guard stops one."""
        arm, self._hanging = self._law(self.arm, self._hanging)
        hand, self._following = self._grip(self.hand, self._following)
        self.robot.arm.write(arm)
        self.robot.hand.write(hand)
        self.arm, self.hand = self.robot.arm.read(), self.robot.hand.read()

    def touched(self) -> tuple[bool, bool]:
        """Whether a finger touches the thing, and whether its last finger, the thumb, and another do."""
        world = self.robot.world
        parts = set(find_contacts(world.model, world.data, self.spec, self.name).part.tolist())
        thumb = len(self.spec.fingers) - 1
        others = any(part < thumb for part in parts)
        return others or thumb in parts, others and thumb in parts

    def obstructions(self) -> list[Obstruction]:
        """What hand and arm are in, the deepest first: the table, the thing, and one the other."""
        world = self.robot.world
        return obstructions(world.model, world.data, self.spec, self.name)

    def stuck(self) -> bool:
        """Whether a joint of the arm is at its end."""
        return at_limit(self.arm, self.robot.spec, self.robot.limits) is not None

    def close(self) -> None:
        """Let go of it."""
        self.robot.close()


def _short(vector: Vector, most: float) -> Vector:
    length = float(np.linalg.norm(vector))
    return vector if length <= most else vector * (most / length)
