"""Scene compilation: one MuJoCo model of a hand and the objects around it, by edits of an MjSpec."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple
from warnings import catch_warnings, filterwarnings

import mujoco

from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root
from allegro_twin.hands.description.appearance import STAND, TABLE
from allegro_twin.kinematics.orientation import quaternion_from_vector, quaternion_product
from allegro_twin.sim.drivetrain import drivetrain
from allegro_twin.sim.drivetrain.servos import limit_forces
from allegro_twin.sim.hand_import.adapt import adapt_hand, compile_model, find_mjcf, read_mjcf, rename_parts
from allegro_twin.sim.model.arm_with_hand import MountedHand, add_pedestal, attach_hand, set_load
from allegro_twin.sim.model.contact_sensors import add_contact_sensors
from allegro_twin.sim.model.physics import Physics
from allegro_twin.sim.model.plate import PicturePlate, add_plate
from allegro_twin.sim.model.wrist import WRIST_JOINTS, add_wrist
from allegro_twin.sim.objects.catalogue import PlacedObject, add_object
from allegro_twin.spec import HandSpec
from allegro_twin.spec.arm import ArmSpec
from allegro_twin.types import Array


class TrayBox(NamedTuple):
    """A tray with four walls."""

    x: float
    """Its middle, m."""
    y: float
    length: float
    """Outer edges along x and y, m."""
    width: float
    height: float
    """Height of the walls, m."""


TABLE_END = 0.45
"""m from the world's origin, along x and y, to which a table goes unless something else is said."""
WALL = 0.006
"""m, thickness of a tray's walls and floor."""


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """Everything around the hand, or the arm."""

    position: Array
    """Palm, or an arm's base, in the world, shape (3,), m."""
    quaternion: Array
    """Orientation of the palm, or of an arm's base, in the world: w, x, y, z."""
    objects: Sequence[PlacedObject] = ()
    friction: float = 0.8
    """Sliding friction of every contact."""
    table: bool = False
    """A table top at z = 0."""
    edge: float = TABLE_END
    """x at which it ends, m."""
    stand: tuple[float, float, float, float, float] | None = None
    """A block on the table: its place x, y, its edges along x, y, and its height, m."""
    tray: TrayBox | None = None
    """A tray on the table."""
    wrist: bool = False
    """The palm hangs on a gantry that can move it, instead of being fixed."""
    slide: bool = False
    """Whether the palm's gantry has only the vertical slide."""
    presented: bool = False
    """Somebody holds the first thing, moves it and lets go of it."""
    physics: Physics = field(default_factory=Physics)
    every_shape: bool = False
    """Things have a geom for each primitive shape: scenes of different ones then have the same layout."""
    plates: Sequence[PicturePlate] = ()
    """Pictures in the scene, such as a calibration pattern."""
    sensed: bool = False
    """Sensors measure the force of each link on the first thing."""


def hand_spec(spec: HandSpec) -> mujoco.MjSpec:
    """The hand's or the arm's own MJCF, or the foreign one that its file names, under our names."""
    if spec.card and spec.foreign is None:
        raise ConfigError(
            f"hand {spec.name}: its card {spec.card} is gone or has other joints: say --config, or --hand"
        )
    path = data_root() / "models" / "mjcf" / f"{spec.name}.xml"
    file = find_mjcf(spec) if spec.foreign is not None else path
    if not file.is_file():
        raise ConfigError(
            f"hand {spec.name}: no MJCF at {file}; of a hand with a card, say the config that has it: --config"
        )
    hand = read_mjcf(file)
    if spec.foreign is not None and spec.foreign.keeps:
        return adapt_hand(hand, spec, spec.foreign)
    if spec.foreign is not None:
        rename_parts(hand, spec, spec.foreign)
    for index, name in enumerate(spec.joints):
        joint, motor = hand.joint(name), hand.actuator(name)
        joint.range = [spec.lower[index], spec.upper[index]]
        joint.damping = [spec.actuation.damping[index], 0, 0]
        joint.armature = spec.actuation.armature[index]
        joint.frictionloss = spec.actuation.frictionloss[index]
        limit = spec.actuation.torque_limit[index]
        motor.forcerange = [-limit, limit]
        motor.ctrlrange = motor.forcerange if spec.actuation.stiffness is None else joint.range
    if spec.drive is not None:
        drivetrain.build_drive(hand, spec, spec.drive)
    return hand


MANY, ROOM = 48, 96 * 2**20
"""Geoms for contacts, from which on a simulation has so many bytes for them. MuJoCo's own guess is 14 MiB, of which a
hand in the middle of an object of 40 pieces leaves nothing, and MuJoCo then drops all contacts but for a warning.
Memory that no contact needs is never touched."""


def compile_scene(spec: HandSpec, stage: Stage, mounted: MountedHand | None = None) -> mujoco.MjModel:
    """The model of a hand on its stage; or of an arm, with a hand on its flange. Raises ConfigError when MuJoCo refuses
    it."""
    scene = hand_spec(spec)
    if isinstance(spec, ArmSpec):
        set_load(scene, spec, spec.load)
        add_pedestal(scene, stage.position)
        if mounted is not None:
            attach_hand(scene, spec, hand_spec(mounted.hand), mounted.mount)
    stage.physics.options(scene)
    friction = stage.physics.friction(stage.friction)
    for geom in scene.geoms:
        if geom.contype or geom.conaffinity:
            geom.friction = friction
    root = scene.body(spec.root)
    root.pos, root.quat = stage.position, stage.quaternion
    if spec.drive is not None and spec.drive.tilt.any():
        root.quat = quaternion_product(stage.quaternion, quaternion_from_vector(-spec.drive.tilt))
    root.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT  # A file may say it otherwise, which would count.
    if stage.wrist:
        add_wrist(scene, root, ("wrist_z",) if stage.slide else WRIST_JOINTS)
    _surroundings(scene, stage, 1.0 if spec.side == "right" else -1.0)
    for placement in stage.objects:
        add_object(scene, placement, friction, every_shape=stage.every_shape)
    if stage.presented:
        _add_presenter(scene, stage.objects[0])
    if stage.sensed:
        add_contact_sensors(scene, root, stage.objects[0].grasp_object.name)
    for plate in stage.plates:
        add_plate(scene, plate)
    stage.physics.contacts(scene)
    if sum(bool(geom.contype or geom.conaffinity) for geom in scene.geoms) > MANY:
        scene.memory = ROOM
    try:
        with catch_warnings():
            filterwarnings("ignore", message="Attaching a spec with an empty prefix")  # Nobody saves it.
            model = compile_model(scene)
    except ValueError as error:
        raise ConfigError(f"scene of {spec.name}: {str(error).strip().splitlines()[0]}") from error
    if stage.presented:
        _hold_by_centre(model, stage.objects[0].grasp_object.name)
    for each in (spec,) if mounted is None else (spec, mounted.hand):
        if "torque" not in each.commands:
            limit_forces(model, each)
    return model


def _surroundings(scene: mujoco.MjSpec, stage: Stage, side: float) -> None:
    """The light falls on a left hand's mirror image as on a right hand: `side` is 1 or -1."""
    world = scene.worldbody
    scene.visual.headlight.ambient = [0.35, 0.35, 0.35]
    scene.visual.headlight.diffuse = [0.35, 0.35, 0.35]
    scene.visual.global_.offwidth, scene.visual.global_.offheight = 1280, 960
    scene.visual.quality.shadowsize = 2048
    scene.stat.extent = 0.5
    scene.visual.map.znear = 0.02
    sky = scene.add_texture(name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, width=64, height=384)
    sky.builtin = mujoco.mjtBuiltin.mjBUILTIN_GRADIENT
    sky.rgb1, sky.rgb2 = [0.93, 0.95, 0.97], [0.72, 0.77, 0.83]
    world.add_light(
        name="key",
        pos=[0.4, -0.6 * side, 1.4],
        dir=[-0.3, 0.4 * side, -1.0],
        diffuse=[0.55] * 3,
        type=mujoco.mjtLightType.mjLIGHT_SPOT,
    )
    if stage.stand is not None:
        x, y, length, width, height = stage.stand
        world.add_geom(
            name="stand", type=mujoco.mjtGeom.mjGEOM_BOX, size=[length / 2, width / 2, height / 2],
            pos=[x, y, height / 2], friction=stage.physics.friction(stage.friction), rgba=[*STAND, 1.0],
        )  # fmt: skip
    if stage.tray is not None:
        _add_tray(world, stage.tray, stage.physics.friction(stage.friction))
    if stage.table:
        world.add_geom(
            name="table", type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[(stage.edge + TABLE_END) / 2, TABLE_END, 0.02], pos=[(stage.edge - TABLE_END) / 2, 0, -0.02],
            friction=stage.physics.friction(stage.friction), rgba=[*TABLE, 1.0],
        )  # fmt: skip


def _add_tray(world: mujoco.MjsBody, tray: TrayBox, friction: Sequence[float]) -> None:
    x, y, length, width, height = tray
    half, wall = (length / 2.0, width / 2.0), WALL / 2.0
    boxes = {
        "floor": ((x, y, wall), (*half, wall)),
        "left": ((x, y + half[1] - wall, height / 2.0), (half[0], wall, height / 2.0)),
        "right": ((x, y - half[1] + wall, height / 2.0), (half[0], wall, height / 2.0)),
        "front": ((x + half[0] - wall, y, height / 2.0), (wall, half[1], height / 2.0)),
        "back": ((x - half[0] + wall, y, height / 2.0), (wall, half[1], height / 2.0)),
    }
    for name, (position, size) in boxes.items():
        world.add_geom(
            name=f"tray_{name}", type=mujoco.mjtGeom.mjGEOM_BOX, size=size, pos=position, friction=friction,
            rgba=[*STAND, 1.0],
        )  # fmt: skip


PRESENTER = "presenter"
"""The body of a person who presents an object by a soft hold that is moved, and lets go."""
# Chosen so that a 50 g object yields by some 3 mm a newton and sags by 1.5 mm, like one in two fingertips: the hold
# pulls with k = 1600 /s² and is critically damped; the impedance 0.8 is how much of that it may enforce.
_STIFFNESS, _IMPEDANCE = 1600.0, 0.8


def _add_presenter(spec: mujoco.MjSpec, placement: PlacedObject) -> None:
    """Hold a thing of the scene where it is, from a body without mass that somebody moves."""
    spec.worldbody.add_body(name=PRESENTER, mocap=True, pos=placement.position, quat=placement.quaternion)
    spec.add_equality(
        name=PRESENTER,
        type=mujoco.mjtEq.mjEQ_WELD,
        objtype=mujoco.mjtObj.mjOBJ_BODY,
        name1=PRESENTER,
        name2=placement.grasp_object.name,
        # Anchor at the object's middle, pose as placed (zeros: from the model), and the weight of the rotation, m.
        data=[0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0.05, 0],
        solref=[-_STIFFNESS, -2 * _STIFFNESS**0.5],
        solimp=[_IMPEDANCE, _IMPEDANCE, 0.001, 0.5, 2],
    )


def _hold_by_centre(model: mujoco.MjModel, object_name: str) -> None:
    """Hold a presented thing by its centre of mass, which only the compiled model has: held elsewhere its weight would
    turn it, for the hold is soft."""
    hold = model.equality(PRESENTER)
    hold.data[:3] = hold.data[3:6] = model.body(object_name).ipos  # In the thing and in the presenter, who stand alike.
