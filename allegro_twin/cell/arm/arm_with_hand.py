"""An arm with a hand on its flange at a table: one simulation, two backends with one clock.

```python
can = PlacedObject(load_object("tomato_soup_can"), (0.0, 0.0, 0.0505), (1, 0, 0, 0))
cell = make_arm_with_hand("fer", hand_spec, objects=[can])
target = CartesianTarget(cell.model.pose(cell.spec.ready))
arm = run(cell.arm, Impedance(cell.model, target, Stiffness(400.0, 30.0), compensation=cell.compensation))
hand = run(cell.hand, PositionControl(Hold(hand_spec.rest)))
for turn, sample in interleave((arm, cell.arm.period), (hand, cell.hand.period)):
    ...  # `target.move(cell.flange_for(palm))` moves the palm, at any time
```
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from allegro_twin.cell.arm.contact_reflex import CollisionSettings, ContactReflex
from allegro_twin.cell.arm.limits import arm_limits
from allegro_twin.cell.arm.tool import WrenchCompensation
from allegro_twin.hands.description.arms import load_arm_spec
from allegro_twin.hands.description.mounts import HandMount, load_mount
from allegro_twin.hands.limits import hand_limits
from allegro_twin.hands.settings import LimitSettings
from allegro_twin.kinematics.arm import ArmModel
from allegro_twin.kinematics.orientation import matrix_from_quaternion
from allegro_twin.kinematics.pose import Pose, compose, relative_to
from allegro_twin.safety import Guard, Limits
from allegro_twin.sim.engine.backend import SimBackend
from allegro_twin.sim.engine.world import World
from allegro_twin.sim.model.arm_with_hand import MountedHand
from allegro_twin.sim.model.physics import Physics
from allegro_twin.sim.model.plate import PicturePlate
from allegro_twin.sim.model.scene import Stage, TrayBox, compile_scene
from allegro_twin.sim.objects.catalogue import PlacedObject
from allegro_twin.spec import HandSpec
from allegro_twin.spec.arm import ArmSpec
from allegro_twin.types import HandState, Vector

BASE = (-0.55, 0.0, 0.0)
"""Default position of the arm's base, world, m: at the edge of the table, whose top is at z = 0 and reaches 0.45 m from
the middle."""


@dataclass(frozen=True, slots=True, eq=False)
class ArmWithHand:
    """Everything that moves and is felt in the scene. The world's origin is the middle of the table's top."""

    world: World
    arm: Guard
    hand: Guard
    arm_sim: SimBackend
    """Behind the guard."""
    hand_sim: SimBackend
    mount: HandMount
    model: ArmModel
    """Kinematics and dynamics of the flange, in the base's frame."""
    compensation: WrenchCompensation
    base: Pose
    """Pose of the arm's base in the world."""
    limits: Limits
    """Limits of the arm's guard."""
    reflex: ContactReflex | None = None
    """Stops the arm where it meets something; None: nothing does."""

    @property
    def spec(self) -> ArmSpec:
        """Spec of the arm."""
        return self.model.spec

    def flange(self, state: HandState) -> Pose:
        """Pose of the flange in the world, by the arm's encoders."""
        return compose(self.base, self.model.pose(state.position))

    def palm(self, state: HandState) -> Pose:
        """Pose of the palm in the world, by the arm's encoders."""
        return compose(self.flange(state), self._palm())

    def camera(self, state: HandState) -> Pose:
        """Pose of the wrist camera's optical frame in the world, by the arm's encoders: z ahead, x to the right of its
        picture, y down."""
        mount = self.mount
        return compose(self.flange(state), Pose(mount.camera_position, matrix_from_quaternion(mount.camera_quaternion)))

    def flange_for(self, palm: Pose) -> Pose:
        """Where the flange is to be, in the base's frame as targets are, so that the palm is at a pose of the world."""
        flange = relative_to(self._palm(), Pose(np.zeros(3), np.eye(3)))
        return relative_to(self.base, compose(palm, flange))

    def wrench(self, state: HandState) -> Vector:
        """What the world does to the hand, at the flange, in the axes of the world: force and torque, (6,)."""
        flange = self.model.pose(state.position).rotation
        found = self.compensation.base_wrench(state.wrench, flange, state.gravity, np.zeros(3))
        return np.concatenate([self.base.rotation @ found[:3], self.base.rotation @ found[3:]])

    def object_pose(self, name: str) -> Pose:
        """Where a thing of the scene really is, in the world."""
        body = self.world.data.body(name)
        return Pose(body.xpos.copy(), body.xmat.reshape(3, 3).copy())

    def close(self) -> None:
        """Let go of both."""
        self.arm.close()
        self.hand.close()

    def _palm(self) -> Pose:
        return Pose(self.mount.position, matrix_from_quaternion(self.mount.quaternion))


def make_arm_with_hand(
    arm: str,
    hand: HandSpec,
    *,
    mount: str | Path = "",
    objects: Sequence[PlacedObject] = (),
    posture: Vector | None = None,
    hand_posture: Vector | None = None,
    base: tuple[float, float, float] = BASE,
    friction: float = 0.8,
    table: bool = True,
    tray: TrayBox | None = None,
    physics: Physics | None = None,
    periods: tuple[float, float] = (0.001, 0.003),
    margin: float = 0.0,
    collision: CollisionSettings | None = None,
    plates: Sequence[PicturePlate] = (),
) -> ArmWithHand:
    """The scene, compiled, and its two backends behind their guards. `periods` are the arm's and the hand's, s;
    `collision` are the thresholds beyond which the arm stops by itself, None: it never does.

    Raises ConfigError for a mount of another hand, and for what MuJoCo refuses.
    """
    held = load_mount(hand, mount)
    spec = load_arm_spec(arm, held.load)
    stage = Stage(np.array(base), np.array([1.0, 0.0, 0.0, 0.0]), objects=objects, friction=friction, table=table,
                  tray=tray, plates=plates)  # fmt: skip
    if physics is not None:
        stage = replace(stage, physics=physics)
    world = World(compile_scene(spec, stage, MountedHand(hand, held)))
    arm_sim = SimBackend(spec, world, period=periods[0], posture=posture)
    hand_sim = SimBackend(hand, world, period=periods[1], posture=hand_posture)
    limits, open_hand = arm_limits(spec, margin), hand_limits(LimitSettings(), hand)
    model = ArmModel(spec)
    reflex = None if collision is None else ContactReflex(arm_sim, ArmModel(spec), collision)
    return ArmWithHand(
        world, Guard(reflex or arm_sim, limits), Guard(hand_sim, open_hand), arm_sim, hand_sim, held, model,
        WrenchCompensation(held.load), Pose(np.array(base), np.eye(3)), limits, reflex,
    )  # fmt: skip
