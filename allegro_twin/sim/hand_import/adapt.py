"""Somebody else's MJCF of the hand, put under our names: joints, tips and torque motors."""

from __future__ import annotations

import importlib
import warnings
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import mujoco
import numpy as np

from allegro_twin.errors import ConfigError, unknown
from allegro_twin.kinematics.orientation import matrix_from_quaternion, quaternion_conjugate, quaternion_product
from allegro_twin.sim.drivetrain import lugre_friction
from allegro_twin.spec import ForeignModel, HandSpec
from allegro_twin.types import Array

PID_PLUGIN = "mujoco.pid"
WORLD = "world"
"""Root of a hand whose fingers hang on the world itself."""
_FETCHED = {"wonik_allegro": "robot_descriptions.allegro_hand_mj_description"}
"""Folders that robot_descriptions has, and in which of its modules; it fetches them at the first import."""


def find_mjcf(spec: HandSpec) -> Path:
    """The file of a foreign model: where its map says, else from robot_descriptions, which fetches MuJoCo Menagerie
    once and keeps it. Raises ConfigError with both ways."""
    assert spec.foreign is not None
    path = Path(spec.foreign.mjcf)
    if path.is_file():
        return path
    ways = f"set `mjcf` in its file to your copy (docs/reference/hands.md); hand {spec.serial}: no MJCF at {path}"
    if path.parent.name not in _FETCHED:
        raise ConfigError(ways)
    try:
        from git import GitError

        folder = Path(_fetched(_FETCHED[path.parent.name], GitError))
    except ImportError as error:
        raise ConfigError(f"pip install 'allegro-twin[menagerie]' fetches it, or {ways} ({error})") from error
    if not (folder / path.name).is_file():
        raise ConfigError(f"robot_descriptions has no {path.name} in {folder}; {ways}")
    return folder / path.name


def _fetched(module: str, git_error: type[Exception]) -> str:
    try:
        return str(importlib.import_module(module).PACKAGE_PATH)
    except git_error as error:
        text = " ".join(str(error).split())[:200]
        raise ConfigError(f"robot_descriptions could not fetch Menagerie: {text}; set `mjcf` to a copy") from error


def read_mjcf(file: Path) -> mujoco.MjSpec:
    """With its angles in radians, as all that is edited into it. Raises ConfigError."""
    if file.suffix.lower() == ".urdf":
        raise ConfigError(f"{file}: a URDF: `allegro-twin hand new {file.name}` makes an MJCF of it")
    try:
        plain = _without_pid_plugin(file)
        spec = mujoco.MjSpec.from_file(str(file)) if plain is None else mujoco.MjSpec.from_string(plain)
    except ValueError as error:
        raise ConfigError(f"{file}: not a readable MJCF: {str(error).strip().splitlines()[0]}") from error
    if spec.compiler.degree:
        _to_radians(spec)
    return spec


def _without_pid_plugin(file: Path) -> str | None:
    """The text of a file whose actuators are MuJoCo's PID plugin, with position servos of the same kp, kd and force
    range in their place: no command could stand for the plugin's integral and its slew. None: it has none."""
    try:
        text = file.read_text()
        if PID_PLUGIN not in text:
            return None
        root = ElementTree.fromstring(text)
    except (OSError, ElementTree.ParseError, UnicodeDecodeError):
        return None  # MuJoCo says what is wrong.
    settings = {}
    for extension in root.findall("extension"):
        for plugin in [each for each in extension.findall("plugin") if each.get("plugin") == PID_PLUGIN]:
            for instance in plugin.findall("instance"):
                settings[instance.get("name")] = {c.get("key"): c.get("value") for c in instance.findall("config")}
            extension.remove(plugin)
    for actuators in root.findall("actuator"):
        for servo in [each for each in actuators.findall("plugin") if each.get("plugin") == PID_PLUGIN]:
            gains = settings.get(servo.get("instance"), {}) | {c.get("key"): c.get("value") for c in servo}
            servo.tag = "position"
            kept = {key: value for key, value in servo.attrib.items()
                    if key not in ("plugin", "instance", "dyntype", "actdim")}  # fmt: skip
            for child in list(servo):
                servo.remove(child)
            servo.attrib.clear()
            servo.attrib.update(kept | {"kp": gains.get("kp") or "1", "kv": gains.get("kd") or "0"})
    compiler = root.find("compiler")
    compiler = ElementTree.SubElement(root, "compiler") if compiler is None else compiler
    for key in ("meshdir", "texturedir"):
        folder = file.resolve().parent / (compiler.get(key) or compiler.get("assetdir") or "")
        compiler.set(key, str(folder))
    return ElementTree.tostring(root, encoding="unicode")


def _to_radians(spec: mujoco.MjSpec) -> None:
    for joint in spec.joints:
        if joint.type in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_BALL):
            joint.range = np.radians(joint.range)
            joint.ref, joint.springref = np.radians(joint.ref), np.radians(joint.springref)
    turned = [
        element.alt for kind in ("bodies", "geoms", "sites", "cameras", "frames") for element in getattr(spec, kind)
    ]
    for alt in [*turned, *(body.ialt for body in spec.bodies)]:
        if alt.type == mujoco.mjtOrientation.mjORIENTATION_EULER:
            alt.euler = np.radians(alt.euler)
        if alt.type == mujoco.mjtOrientation.mjORIENTATION_AXISANGLE:
            alt.axisangle = np.append(alt.axisangle[:3], np.radians(alt.axisangle[3]))
    spec.compiler.degree = False


def take_out_gears(spec: mujoco.MjSpec) -> None:
    """Remove the gears of actuators: positions become those of the driven joint, rad or m, and a motor's command the
    torque or the force there, N·m or N."""
    for actuator in spec.actuators:
        gear = float(actuator.gear[0])
        if lugre_friction.is_friction_only(actuator.gaintype, actuator.gainprm) or gear == 0.0:
            continue
        bias = actuator.biasprm.copy()
        damping = bias[2] if bias[2] > 0.0 else gear**2 * bias[2]  # Above 0 it is a damping ratio.
        actuator.biasprm[:3] = [gear * bias[0], gear**2 * bias[1], damping]
        actuator.forcerange = np.sort(gear * actuator.forcerange)
        gain = gear * float(actuator.gainprm[0])
        if not bias[:3].any():
            actuator.ctrlrange, gain = np.sort(gain * actuator.ctrlrange), 1.0
        actuator.gainprm[0], actuator.gear[0] = gain, 1.0


@contextmanager
def quiet() -> Iterator[None]:
    """Without the warnings that say nothing about a hand: lost texture coordinates of a mesh, and names of parts that
    are attached without a prefix."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="obj_decoder: invalid or missing face texture")
        warnings.filterwarnings("ignore", message="Attaching a spec with an empty prefix")
        yield


def compile_model(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Compile, `quiet`. Raises ValueError."""
    with quiet():
        return spec.compile()


def adapt_hand(theirs: mujoco.MjSpec, spec: HandSpec, foreign: ForeignModel) -> mujoco.MjSpec:
    """Their hand with its palm in our axes, their actuators under our names, a site and a contact sensor at each tip.

    Raises ConfigError with the nearest name when the card names something that the file does not have.
    """
    take_out_gears(theirs)
    if foreign.root == WORLD:
        theirs = _under_a_palm(theirs)
    root = _get(theirs.bodies, "palm_link" if foreign.root == WORLD else foreign.root, "body", foreign.mjcf)
    if root.parent != theirs.worldbody:
        raise ConfigError(f"{foreign.mjcf}: root {foreign.root} hangs on {root.parent.name}; take that, or cut it free")
    if list(root.joints):
        raise ConfigError(f"{foreign.mjcf}: root {foreign.root} has a joint ({root.joints[0].name}): a palm is held")
    for element in (*theirs.worldbody.geoms, *theirs.worldbody.lights, *theirs.worldbody.cameras, *theirs.keys):
        theirs.delete(element)
    for other in theirs.worldbody.bodies:
        if other != root:
            theirs.delete(other)
    for name, ours in zip(foreign.joints, spec.joints, strict=True):
        _get(theirs.actuators, name, "actuator", foreign.mjcf).name = ours
    mute = [each.name for each in theirs.actuators if lugre_friction.is_friction_only(each.gaintype, each.gainprm)]
    if extra := [each.name for each in theirs.actuators if each.name not in (*spec.joints, *mute)]:
        raise ConfigError(f"{foreign.mjcf}: nobody drives {extra[0]}: the card's `driven` leaves it out")
    for follower in spec.followers:
        _get(theirs.joints, follower.name, "joint", foreign.mjcf)
    for pair in foreign.touching:
        first, second = (
            "palm_link" if name == WORLD else _get(theirs.bodies, name, "body", foreign.mjcf).name for name in pair
        )
        theirs.add_exclude(bodyname1=first, bodyname2=second)
    root.name = "palm_link"
    _follow(theirs, {foreign.root: "palm_link"})
    if foreign.palm is not None:
        _turn(root, quaternion_conjugate(foreign.palm))
    _add_tips(theirs, spec, foreign)
    return theirs


def _under_a_palm(theirs: mujoco.MjSpec) -> mujoco.MjSpec:
    """A model whose fingers hang on the world, with everything on one body instead."""
    for element in (*theirs.worldbody.lights, *theirs.worldbody.cameras, *theirs.keys):
        theirs.delete(element)
    hand = mujoco.MjSpec()
    hand.compiler.degree, hand.modelname = False, theirs.modelname
    for name in ("timestep", "integrator", "cone", "impratio", "noslip_iterations", "noslip_tolerance", "solver",
                 "iterations", "tolerance", "gravity"):  # fmt: skip
        setattr(hand.option, name, getattr(theirs.option, name))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # It is never saved, and the options are copied.
        hand.attach(theirs, prefix="", frame=hand.worldbody.add_body(name="palm_link").add_frame())
    return hand


def _turn(root: mujoco.MjsBody, turn: Array) -> None:
    """Everything in a body by a quaternion, so that the body's own frame is another."""
    frame = root.add_frame(quat=turn)
    for element in (*root.bodies, *root.geoms, *root.sites, *root.cameras, *root.lights):
        outer = element
        while outer.frame is not None:
            outer = outer.frame
        if outer != frame:
            outer.set_frame(frame)
    if root.explicitinertial:
        matrix = matrix_from_quaternion(turn)
        root.ipos = matrix @ root.ipos
        if np.isfinite(root.fullinertia).all() and root.fullinertia.any():
            xx, yy, zz, xy, xz, yz = root.fullinertia
            tensor = matrix @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ matrix.T
            root.fullinertia = tensor[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        else:
            root.iquat = quaternion_product(turn, root.iquat)


def rename_parts(hand: mujoco.MjSpec, spec: HandSpec, foreign: ForeignModel) -> None:
    """Rename its root and joints, replace its actuators by torque motors, add a site at each fingertip.

    Raises ConfigError with the nearest name when the map names something that the file does not have.
    """
    renamed = {foreign.root: "palm_link"} | dict(zip(foreign.joints, spec.joints, strict=True))
    _get(hand.bodies, foreign.root, "body", foreign.mjcf).name = "palm_link"
    for actuator in list(hand.actuators):
        hand.delete(actuator)
    for theirs, ours in zip(foreign.joints, spec.joints, strict=True):
        joint = _get(hand.joints, theirs, "joint", foreign.mjcf)
        joint.name = ours
        motor = hand.add_actuator(name=ours, target=ours, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.set_to_motor()
    _follow(hand, renamed)
    _add_tips(hand, spec, foreign)


def _add_tips(hand: mujoco.MjSpec, spec: HandSpec, foreign: ForeignModel) -> None:
    """A site and a contact sensor at each fingertip, where the card has it. Raises ConfigError for a site that has the
    tip's name already, and is elsewhere."""
    for finger in spec.fingers:
        body_name, offset = foreign.tips[finger.name]
        body = _get(hand.bodies, body_name, "body", foreign.mjcf)
        theirs = next((site for site in hand.sites if site.name == finger.tip), None)
        if theirs is None:
            body.add_site(name=finger.tip, pos=offset)
        elif theirs.parent.name != body_name or not np.allclose(theirs.pos, offset, atol=1e-6):
            raise ConfigError(
                f"{foreign.mjcf}: a site is called {finger.tip} already, elsewhere: call it, or the finger, otherwise"
            )
        name = f"{finger.name}_touch"
        for sensed in hand.sensors:
            if sensed.name == name:
                sensed.name = f"{name}_of_the_file"
        sensor = hand.add_sensor(name=name, type=mujoco.mjtSensor.mjSENS_CONTACT)
        sensor.objtype, sensor.objname = mujoco.mjtObj.mjOBJ_UNKNOWN, ""
        sensor.reftype, sensor.refname = mujoco.mjtObj.mjOBJ_BODY, body_name
        sensor.intprm = [0b11, 3, 1]  # found and force; net force; one slot.


def _follow(hand: mujoco.MjSpec, renamed: dict[str, str]) -> None:
    """What names a renamed element keeps naming it: MjSpec holds such references as text."""
    for elements, attributes in (
        (hand.excludes, ("bodyname1", "bodyname2")),
        (hand.equalities, ("name1", "name2")),
        (hand.sensors, ("objname", "refname")),
    ):
        for element in elements:
            for attribute in attributes:
                name = getattr(element, attribute)
                if name in renamed:
                    setattr(element, attribute, renamed[name])


def _get(elements: list[mujoco.MjsBody], name: str, kind: str, path: str) -> mujoco.MjsBody:
    for element in elements:
        if element.name == name:
            return element
    raise ConfigError(f"{path}: {unknown(kind, name, [e.name for e in elements])}")
