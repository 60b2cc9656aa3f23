"""A URDF of a hand as an MJCF with position servos: inertias repaired, mimic joints coupled, meshes converted."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element

import mujoco
import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.files.atomic_write import atomic_file
from allegro_twin.sim.hand_import.adapt import compile_model, quiet
from allegro_twin.sim.hand_import.meshes import UrdfMeshes
from allegro_twin.types import Array

PLACEHOLDER = 100.0
"""N·m or N. An effort from here on is no motor's of a hand; 0 is none either."""
ANGLE, WAY = 0.1, 0.005
"""rad, m. How far a servo is from its goal when it gives its full effort: the gain that a URDF does not have."""
UNKNOWN_GAIN = 5.0
"""N·m/rad (times 100: N/m). The gain where the effort is not known either."""
_FREQUENCY = 100.0  # rad/s. A loop is not faster: armature makes up what light links lack.
_LIGHTEST = 1e-3  # kg. What a moving link weighs where nothing says it.
_NUMBERS = {
    "origin": {"xyz": 3, "rpy": 3},
    "axis": {"xyz": 3},
    "limit": {"lower": 1, "upper": 1, "effort": 1},
    "dynamics": {"damping": 1, "friction": 1},
    "mimic": {"multiplier": 1, "offset": 1},
    "mass": {"value": 1},
    "inertia": dict.fromkeys(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), 1),
    "box": {"size": 3},
    "sphere": {"radius": 1},
    "cylinder": {"radius": 1, "length": 1},
    "capsule": {"radius": 1, "length": 1},
    "mesh": {"scale": 3},
}
"""How many numbers an attribute of an element has, of those that are read."""


class UrdfHand(NamedTuple):
    """A URDF, read."""

    spec: mujoco.MjSpec
    notes: list[str]
    """What was repaired, assumed and left out."""
    unknown: tuple[str, ...]
    """Joints whose largest effort the file does not say."""


def is_urdf(path: Path) -> bool:
    """Whether a model file is a URDF, or else an MJCF, by its first element. Raises ConfigError for another file."""
    wanted = "an MJCF begins with <mujoco>, a URDF with <robot>"
    if not path.is_file():
        raise ConfigError(f"{path}: {'a folder, not a model file' if path.is_dir() else 'no such file'}")
    if not path.stat().st_size:
        raise ConfigError(f"{path}: the file is empty; {wanted}")
    try:
        _, first = next(ElementTree.iterparse(path, events=("start",)))
    except (OSError, ElementTree.ParseError) as error:
        raise ConfigError(f"{path}: not an XML file ({error}); {wanted}") from error
    tag = first.tag.rpartition("}")[2]
    if tag not in ("mujoco", "robot"):
        raise ConfigError(f"{path}: its first element is <{tag}>; {wanted}")
    if tag == "mujoco" and path.suffix.lower() == ".urdf":
        raise ConfigError(f"{path}: its first element is <mujoco>, so it is an MJCF: call it {path.stem}.xml")
    return bool(tag == "robot")


def read_urdf(path: Path) -> UrdfHand:
    """Raises ConfigError for a URDF that cannot be read, and for a mesh that touches and is not there."""
    try:
        robot = ElementTree.parse(path).getroot()
    except (OSError, ElementTree.ParseError) as error:
        raise ConfigError(f"{path}: not a readable URDF: {error}") from error
    if any(element.tag.startswith("{") and "xacro" in element.tag for element in robot.iter()):
        raise ConfigError(f"{path}: it has xacro macros; `xacro {path.name} > hand.urdf` resolves them")
    _check_names(robot, path)
    _check_joints(robot, path)
    _check_numbers(robot, path)
    notes: list[str] = []
    _complete_limits(robot, path, notes)
    _check_inertias(robot, path)
    meshes = UrdfMeshes(path)
    meshes.find(robot, notes)
    shaped = _repair_inertias(robot, notes)
    for old in robot.findall("mujoco"):
        robot.remove(old)
    options = Element("mujoco")
    ElementTree.SubElement(
        options, "compiler", discardvisual="false", fusestatic="false", strippath="false", balanceinertia="false"
    )
    robot.insert(0, options)
    unlimited = _efforts(robot, notes)
    try:
        spec = mujoco.MjSpec.from_string(ElementTree.tostring(robot, encoding="unicode"), assets=meshes.assets)
    except ValueError as error:
        raise ConfigError(f"{path}: {str(error).strip().splitlines()[0]}") from error
    spec.modelname = path.stem
    for mesh in spec.meshes:
        if mesh.file in meshes.shown:
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # A label can be flat.
    _under_one_root(spec, robot)
    _hide_collisions(spec)
    _couple(spec, robot, path)
    _drive(spec, robot, path, shaped, notes)
    _exclude_touching(spec, path, notes)
    return UrdfHand(spec, notes, unlimited)


def _check_joints(robot: Element, path: Path) -> None:
    """Raises ConfigError where links or the ends of a joint are missing, and for a joint of several coordinates."""
    links = {link.get("name") for link in robot.findall("link")}
    if not links:
        raise ConfigError(f"{path}: a URDF without a <link>: there is no hand in it")
    children = set()
    for joint in robot.findall("joint"):
        if (kind := joint.get("type")) in ("planar", "floating"):
            raise ConfigError(
                f"{path}: joint {joint.get('name')} is {kind}: it moves in several directions at once, and a motor "
                "drives one: make it fixed, or a chain of revolute and prismatic joints"
            )
        for end in ("parent", "child"):
            element = joint.find(end)
            link = None if element is None else element.get("link")
            if link not in links:
                raise ConfigError(f"{path}: joint {joint.get('name')}: its {end} {link} is no <link> of the file")
            if end == "child":
                children.add(link)
    if not links - children:
        raise ConfigError(f"{path}: every link is the child of a joint: a URDF is a tree, and one link begins it")


def _check_names(robot: Element, path: Path) -> None:
    """Raises ConfigError for a name that two links or two joints have."""
    for kind in ("link", "joint"):
        names = [element.get("name") for element in robot.findall(kind)]
        if twice := next((name for name in names if names.count(name) > 1), None):
            raise ConfigError(f"{path}: two {kind}s are called {twice}: give each a name of its own")


def _check_numbers(robot: Element, path: Path) -> None:
    """Raises ConfigError for an attribute that is read and is not of finite numbers, with link or joint; for damping
    and friction below zero."""
    for owner in (*robot.findall("link"), *robot.findall("joint")):
        for element in owner.iter():
            tag = element.tag
            for key, count in _NUMBERS[tag].items() if tag in _NUMBERS else ():
                where = f"{path}: {owner.tag} {owner.get('name')}: {tag}: {key} is {element.get(key)}"
                values = _numbers(element.get(key, " ".join(["0"] * count)))
                unlimited = key == "effort" and values == [np.inf]  # A placeholder, as others are.
                if len(values) != count or not (np.isfinite(values).all() or unlimited):
                    many = "a finite number" if count == 1 else f"{count} finite numbers"
                    raise ConfigError(f"{where}: it must be {many}")
                if tag == "dynamics" and values[0] < 0.0:
                    raise ConfigError(f"{where}, below zero: it would push the joint on")


def _numbers(text: str) -> list[float]:
    """Numbers of an attribute; none where one of them is no number."""
    try:
        return [float(word) for word in text.split()]
    except ValueError:
        return []


def _number(element: Element, key: str) -> float:
    """An attribute that `_check_numbers` has passed; 0 where it is left out."""
    return float(element.get(key, 0.0))


def _complete_limits(robot: Element, path: Path, notes: list[str]) -> None:
    """Write the end that a limit leaves out: 0. Raises ConfigError for a range that no joint has, and for one that is
    in degrees."""
    for joint in robot.findall("joint"):
        limit, kind = joint.find("limit"), joint.get("type")
        if limit is None or kind not in ("revolute", "prismatic") or not {"lower", "upper"} & set(limit.keys()):
            continue
        where, lower, upper = f"{path}: joint {joint.get('name')}", _number(limit, "lower"), _number(limit, "upper")
        left_out = {"lower", "upper"} - set(limit.keys())
        for end in left_out:
            limit.set(end, "0")
            notes.append(f"{joint.get('name')}: its limit has no {end}, which is 0 in a URDF: {lower:g} … {upper:g}")
        if lower > upper:
            why = f", the one that is left out ({left_out.pop()}) being 0" if left_out else ""
            raise ConfigError(
                f"{where}: lower {lower:g} is above upper {upper:g}{why}: exchange them, or turn its axis"
            )
        if lower == upper and joint.find("mimic") is None:
            raise ConfigError(f"{where}: lower and upper are both {lower:g}: give its range, or make it fixed")
        if kind == "revolute" and max(-lower, upper) > 2.0 * np.pi:
            raise ConfigError(
                f"{where}: its range {lower:g} … {upper:g} goes beyond a whole turn: a URDF has radians, and these "
                "look like degrees; a joint that turns on and on is `continuous`"
            )


def _check_inertias(robot: Element, path: Path) -> None:
    """Raises ConfigError for a mass or an inertia below zero, and for inertial data without a mass."""
    for link in robot.findall("link"):
        inertial, where = link.find("inertial"), f"{path}: link {link.get('name')}"
        mass, inertia = (None, None) if inertial is None else (inertial.find("mass"), inertial.find("inertia"))
        if inertial is not None and mass is None:
            raise ConfigError(f"{where}: its <inertial> has no <mass>: give it one, or leave out the block")
        if mass is not None and (value := _number(mass, "value")) < 0.0:
            raise ConfigError(f"{where}: its mass is {value:g} kg, below zero")
        for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz") if inertia is not None else ():
            value = _number(inertia, key)  # type: ignore[arg-type]
            if key[1] == key[2] and value < 0.0:
                raise ConfigError(f"{where}: its inertia {key} is {value:g} kg·m², below zero")


def write_mjcf(spec: mujoco.MjSpec, path: Path) -> None:
    """Write the model beside its card, and converted meshes into a folder beside it. Other meshes stay where they are,
    named relative to the new file."""
    folder = path.parent.resolve()
    for mesh in spec.meshes:
        content = spec.assets.get(mesh.file)
        if content is not None:
            file = folder / f"{path.stem}_meshes" / mesh.file
            file.parent.mkdir(parents=True, exist_ok=True)
            with atomic_file(file) as temporary:
                temporary.write_bytes(content)
            mesh.file = str(file)
        mesh.file = os.path.relpath(mesh.file, folder)
    spec.meshdir, spec.modelfiledir = "", str(folder)  # The file's names are its own, wherever this process runs.
    with quiet(), atomic_file(path) as temporary:
        temporary.write_text(spec.to_xml())


def _repair_inertias(robot: Element, notes: list[str]) -> list[str]:
    """Links whose mass the file does not say, and whose shapes tell one.

    A rigid body's principal moments satisfy a + b ≥ c; where they do not, the largest becomes what they allow, about
    the same axes. Links that move and have neither mass nor shape get a mass."""
    repaired, light, shaped = [], [], []
    moving = {joint.find("child").get("link") for joint in robot.findall("joint")  # type: ignore[union-attr]
              if joint.get("type") != "fixed"}  # fmt: skip
    for link in robot.findall("link"):
        name, inertial = str(link.get("name")), link.find("inertial")
        solid = any(link.find(f"{kind}/geometry") is not None for kind in ("collision", "visual"))
        mass = _number(inertial.find("mass"), "value") if inertial is not None else 0.0  # type: ignore[arg-type]
        if inertial is None or mass <= 0.0:
            if inertial is not None:
                link.remove(inertial)
            if name in moving and not solid:
                light.append(name)
                link.append(_point(_LIGHTEST))
            elif solid:
                shaped.append(name)
            continue
        element = inertial.find("inertia")
        if element is None:
            continue
        tensor = _tensor(element)
        moments, axes = np.linalg.eigh(tensor)
        sound = np.maximum(moments, max(1e-12, 1e-6 * float(moments.max())))
        sound[2] = min(sound[2], 0.999 * (sound[0] + sound[1]))  # `to_xml` writes six digits.
        if (sound != moments).any():
            _set_tensor(element, axes @ np.diag(sound) @ axes.T)
        if not np.allclose(sound, moments, rtol=2e-3, atol=1e-15):
            repaired.append(name)
    if repaired:
        notes.append(f"inertias that no rigid body has were repaired about the same axes: {', '.join(repaired)}")
    if light:
        notes.append(f"links without a mass or a shape weigh {_LIGHTEST:g} kg: {', '.join(light)}")
    return shaped


def _point(mass: float) -> Element:
    inertial = Element("inertial")
    ElementTree.SubElement(inertial, "mass", value=str(mass))
    inertia: dict[str, str] = {
        key: "1e-7" if key[1] == key[2] else "0" for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    }
    ElementTree.SubElement(inertial, "inertia", inertia)
    return inertial


def _tensor(element: Element) -> Array:
    xx, yy, zz, xy, xz, yz = (_number(element, key) for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"))
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _set_tensor(element: Element, tensor: Array) -> None:
    for key, (row, column) in {"ixx": (0, 0), "iyy": (1, 1), "izz": (2, 2), "ixy": (0, 1), "ixz": (0, 2),
                               "iyz": (1, 2)}.items():  # fmt: skip
        element.set(key, repr(float(tensor[row, column])))


def _efforts(robot: Element, notes: list[str]) -> tuple[str, ...]:
    """Take out efforts that are placeholders; the joints that have none."""
    unlimited, placeholders = [], set()
    for joint in robot.findall("joint"):
        limit = joint.find("limit")
        if joint.get("type") not in ("revolute", "continuous", "prismatic") or joint.find("mimic") is not None:
            if limit is not None:
                limit.set("effort", "0")  # A mimic joint has no motor.
            continue
        effort = _number(limit, "effort") if limit is not None else 0.0
        if not 0.0 < effort < PLACEHOLDER:
            unlimited.append(str(joint.get("name")))
            if limit is not None:
                limit.set("effort", "0")
            if effort:
                placeholders.add(effort)
    if placeholders:
        found = ", ".join(f"{value:g}" for value in sorted(placeholders))
        notes.append(f"an effort of {found} is no motor's of a hand: taken as unknown")
    return tuple(unlimited)


def _under_one_root(spec: mujoco.MjSpec, robot: Element) -> None:
    """Raises ConfigError where MuJoCo has read the first link as the world itself."""
    children = {joint.find("child").get("link") for joint in robot.findall("joint")}  # type: ignore[union-attr]
    first = next(str(link.get("name")) for link in robot.findall("link") if link.get("name") not in children)
    if not any(body.name == first for body in spec.bodies):
        raise ConfigError(f"link {first} is missing in what MuJoCo read")


def _hide_collisions(spec: mujoco.MjSpec) -> None:
    """Show a body's visual shapes, and its collision shapes only where it has no other: groups as in Menagerie."""
    for body in spec.bodies:
        shown = [geom for geom in body.geoms if not geom.contype and not geom.conaffinity]
        for geom in body.geoms if shown else ():
            geom.group = 2 if geom in shown else 3


def _couple(spec: mujoco.MjSpec, robot: Element, path: Path) -> None:
    """`mimic` as an equality of joints: q = multiplier · q_master + offset. A joint that mimics one that mimics
    follows the first. One without a range has what it is led through."""
    laws = {}
    for joint in robot.findall("joint"):
        mimic = joint.find("mimic")
        if mimic is not None:
            law = float(mimic.get("multiplier", 1.0)), _number(mimic, "offset")
            if not law[0]:
                raise ConfigError(
                    f"{path}: joint {joint.get('name')} mimics {mimic.get('joint')} with the multiplier 0: it stands "
                    f"at its offset {law[1]:g}, so make it fixed, with that in its origin"
                )
            laws[str(joint.get("name"))] = (str(mimic.get("joint")), *law)
    for equality in list(spec.equalities):  # MuJoCo's own reading of a chain of them is another.
        spec.delete(equality)
    names = {joint.name for joint in spec.joints}
    for name, (master, factor, offset) in laws.items():
        seen = {name}
        while master in laws:
            if master in seen:
                raise ConfigError(f"{path}: joint {name} mimics itself by way of {master}")
            seen.add(master)
            master, outer, shift = laws[master]
            factor, offset = factor * outer, factor * shift + offset
        if master not in names:
            raise ConfigError(f"{path}: joint {name} mimics {master}, which is no joint that moves")
        equality = spec.add_equality(type=mujoco.mjtEq.mjEQ_JOINT, name1=name, name2=master)
        equality.data[:5] = [offset, factor, 0.0, 0.0, 0.0]
        follower, driven = spec.joint(name), spec.joint(master)
        if follower.range[0] >= follower.range[1]:
            follower.range = sorted(offset + factor * end for end in driven.range)


def _drive(spec: mujoco.MjSpec, robot: Element, path: Path, shaped: list[str], notes: list[str]) -> None:
    """A position servo for every joint that mimics none. Its gain gives the full effort at 0.1 rad (5 mm); where the
    effort is unknown it is 5 N·m/rad (500 N/m). Critically damped, with as much armature as keeps it under
    100 rad/s."""
    mimics = {joint.get("name") for joint in robot.findall("joint") if joint.find("mimic") is not None}
    try:
        model = compile_model(spec)
    except ValueError as error:
        raise ConfigError(f"{path}: {str(error).strip().splitlines()[0]}") from error
    if shaped:
        masses = ", ".join(f"{name} {1e3 * float(model.body(name).mass[0]):.3g} g" for name in shaped)
        notes.append(f"masses are assumed, of the shapes filled with water, for the file has none: {masses}")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    inertia = np.empty((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    for joint in spec.joints:
        if joint.name in mimics or joint.type not in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
            continue
        number = model.joint(joint.name).id
        slide = joint.type == mujoco.mjtJoint.mjJNT_SLIDE
        limited = bool(model.jnt_actfrclimited[number])
        effort = float(model.jnt_actfrcrange[number, 1]) if limited else 0.0
        gain = effort / (WAY if slide else ANGLE) if effort else UNKNOWN_GAIN * (100.0 if slide else 1.0)
        own = float(inertia[model.jnt_dofadr[number], model.jnt_dofadr[number]])
        least = gain / _FREQUENCY**2
        joint.armature = max(0.0, least - own)
        servo = spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        servo.set_to_position(kp=gain, kv=2.0 * float(np.sqrt(gain * max(own, least))))
        if not model.jnt_limited[number]:
            joint.range, joint.limited = [-np.pi, np.pi], True
            notes.append(f"{joint.name} has no range: it may turn by ±π")
        servo.ctrlrange = joint.range
        if effort:
            servo.forcerange = [-effort, effort]
            joint.actfrcrange = [0.0, 0.0]
            joint.actfrclimited = False
    for joint in spec.joints:
        if joint.name in mimics:
            joint.armature = max(float(joint.armature), 1e-5)
    notes.append(
        f"gains are assumed: full effort at {ANGLE:g} rad ({1e3 * WAY:g} mm), {UNKNOWN_GAIN:g} N·m/rad where the "
        "effort is unknown, critically damped"
    )


def _exclude_touching(spec: mujoco.MjSpec, path: Path, notes: list[str]) -> None:
    """No contact between links that touch at rest: their shapes overlap, and would push each other for ever."""
    try:
        model = compile_model(spec)
    except ValueError as error:
        raise ConfigError(f"{path}: {str(error).strip().splitlines()[0]}") from error
    pairs = touching_pairs(model)
    for first, second in pairs:
        spec.add_exclude(bodyname1=first, bodyname2=second)
    if pairs:
        notes.append(touching_note(pairs))


def touching_pairs(model: mujoco.MjModel) -> list[tuple[str, str]]:
    """Names of the bodies whose shapes touch where a model has them at rest, each pair once."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    pairs = {tuple(sorted(int(model.geom_bodyid[geom]) for geom in contact.geom)) for contact in data.contact}
    return [(model.body(first).name, model.body(second).name) for first, second in sorted(pairs)]


def touching_note(pairs: list[tuple[str, str]]) -> str:
    """In words."""
    shown = ", ".join(f"{first} and {second}" for first, second in pairs[:3])
    what = (
        "1 pair of links touches at rest and is"
        if len(pairs) == 1
        else f"{len(pairs)} pairs of links touch at rest and are"
    )
    return f"{what} let through each other: {shown}{' …' if len(pairs) > 3 else ''}"
