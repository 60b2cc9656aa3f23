"""A hand on an arm's flange, in one MJCF; and what the arm is told that it carries."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.hands.description.appearance import STAND
from allegro_twin.hands.description.mounts import HandMount
from allegro_twin.spec import HandSpec
from allegro_twin.spec.arm import ArmSpec, Load
from allegro_twin.types import Array

CAMERA = "wrist_camera"
"""The site of a camera at the wrist: z ahead, x to the right of its picture, y down."""
_GRAIN = 1e-3  # kg. The flange's own mass, at which the load is carried.


class MountedHand(NamedTuple):
    """A hand and its place on the flange."""

    hand: HandSpec
    mount: HandMount


def attach_hand(arm: mujoco.MjSpec, spec: ArmSpec, hand: mujoco.MjSpec, mount: HandMount) -> None:
    """Screw a hand and its adapter on the flange. Raises ConfigError where names of the two meet."""
    names = {joint.name for joint in arm.joints} & {joint.name for joint in hand.joints}
    if names:
        raise ConfigError(f"{spec.name} and the hand both have a joint {min(names)}: rename one in its file")
    flange, adapter = arm.body(spec.flange), mount.adapter
    disc = flange.add_body(name=f"{spec.name}_adapter")
    disc.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[adapter.radius, adapter.length / 2, 0],
        pos=[0, 0, adapter.length / 2], mass=adapter.mass, rgba=[0.2, 0.21, 0.23, 1], contype=0, conaffinity=0,
    )  # fmt: skip
    flange.add_site(name=CAMERA, pos=mount.camera_position, quat=mount.camera_quaternion, size=[0.004, 0, 0], group=4)
    palm = hand.body("palm_link")
    palm.pos, palm.quat = [0, 0, 0], [1, 0, 0, 0]
    palm.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT  # As in `compile_scene`.
    frame = flange.add_frame(pos=mount.position, quat=mount.quaternion)
    warned = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda text: None)  # As in `compile_scene`.
    try:
        frame.attach_body(palm, "", "")
    finally:
        mujoco.set_mju_user_warning(warned)


def set_load(arm: mujoco.MjSpec, spec: ArmSpec, load: Load | None) -> None:
    """Let the arm carry a load: the force of a weight that is not there, upwards at its centre of mass."""
    flange = arm.body(spec.flange)
    flange.explicitinertial, flange.mass = True, _GRAIN
    flange.inertia = np.full(3, _GRAIN * 1e-4)
    flange.ipos = [0, 0, 0] if load is None else load.centre
    flange.gravcomp = 1.0 if load is None else load.mass / _GRAIN


def add_pedestal(scene: mujoco.MjSpec, position: Array) -> None:
    """A block under an arm's base, which is seen and never touched."""
    x, y, z = position
    scene.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.11, 0.11, 0.2], pos=[x, y, z - 0.2], rgba=[*STAND, 1.0],
        contype=0, conaffinity=0,
    )  # fmt: skip
