"""A tendon hand as URDF: its tree of links and joints, for Pinocchio, ROS and everybody else's tools.

URDF knows no tendons, so the file says of a joint what pulls it and no more: `<follows motor="…"/>`, which readers
pass over, and a limit of no effort. How far it follows is in the hand's card; there is no `mimic`, for it is not tied.
"""

from __future__ import annotations

from xml.etree.ElementTree import Element, SubElement, fromstring

import numpy as np

from allegro_twin.hands.description import inertia
from allegro_twin.hands.description.facts import BoxFacts, TipFacts
from allegro_twin.hands.generate.text import document, number, numbers
from allegro_twin.kinematics.orientation import euler_from_matrix, matrix_from_quaternion

_SPEED = 10.0  # rad/s. OWN: URDF asks for a number, and nobody has published one.
_NOWHERE = (0.0, 0.0, 0.0)


def tendon_urdf(mjcf: str) -> str:
    """The text of the file, from that of the hand's MJCF."""
    hand = fromstring(mjcf)
    name, (palm,) = hand.attrib["model"], hand.findall("worldbody/body")
    root = Element("robot", name=f"{name}_right")
    for material in hand.findall("asset/material"):
        SubElement(SubElement(root, "material", name=material.attrib["name"]), "color", rgba=material.attrib["rgba"])
    _link(root, palm, "palm_link")
    _children(root, palm, "palm_link", _motors(hand), _efforts(hand))
    return document(root, f"tendons/{name}")


def _motors(hand: Element) -> dict[str, str]:
    """The motor of each joint."""
    found = {each.attrib["joint"]: each.attrib["name"] for each in hand.findall("actuator/*[@joint]")}
    for tendon in hand.findall("tendon/fixed"):
        found |= {each.attrib["joint"]: tendon.attrib["name"] for each in tendon.findall("joint")}
    for tied in hand.findall("equality/joint"):
        found[tied.attrib["joint1"]] = found[tied.attrib["joint2"]]
    return found


def _efforts(hand: Element) -> dict[str, str]:
    """The most that a motor gives to a joint that it turns itself, N·m."""
    turned = hand.findall("actuator/*[@joint]")
    return {each.attrib["joint"]: each.attrib["forcerange"].split()[-1] for each in turned}


def _children(root: Element, body: Element, parent: str, motors: dict[str, str], efforts: dict[str, str]) -> None:
    for child in body.findall("body"):
        name = f"{child.attrib['name']}_link"
        _link(root, child, name)
        hinge = child.find("joint")
        if hinge is None:
            _joint(root, f"{name}_fixed", "fixed", parent, name, child)
        else:
            _hinge(_joint(root, hinge.attrib["name"], "revolute", parent, name, child), hinge, motors, efforts)
        for end in child.findall("geom[@type='sphere'][@name]"):
            tip = f"{end.attrib['name'].removesuffix('_end')}_tip"
            SubElement(root, "link", name=tip)
            _joint(root, f"{tip}_joint", "fixed", name, tip, end)
        _children(root, child, name, motors, efforts)


def _hinge(joint: Element, hinge: Element, motors: dict[str, str], efforts: dict[str, str]) -> None:
    name = hinge.attrib["name"]
    lower, upper = hinge.attrib["range"].split()
    SubElement(joint, "axis", xyz=hinge.attrib["axis"])
    effort = efforts.get(name, "0")
    SubElement(joint, "limit", lower=lower, upper=upper, effort=effort, velocity=number(_SPEED))
    SubElement(joint, "dynamics", damping=hinge.attrib["damping"], friction=hinge.attrib["frictionloss"])
    if name not in efforts and name in motors:
        SubElement(joint, "follows", motor=motors[name])


def _joint(root: Element, name: str, kind: str, parent: str, child: str, placed: Element) -> Element:
    """`placed`: what of the MJCF says where the child is."""
    joint = SubElement(root, "joint", name=name, type=kind)
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=child)
    turn = np.array([float(value) for value in placed.attrib.get("quat", "1 0 0 0").split()])
    angles = euler_from_matrix(matrix_from_quaternion(turn)).tolist()
    SubElement(joint, "origin", xyz=placed.attrib.get("pos", "0 0 0"), rpy=numbers(angles))
    return joint


def _link(root: Element, body: Element, name: str) -> None:
    link, parts = SubElement(root, "link", name=name), []
    for geom in body.findall("geom"):
        parts.append(_mass(geom))
        _shapes(link, "visual", geom)
        if geom.attrib["class"] == "collision":
            _shapes(link, "collision", geom)
    properties = inertia.combine(parts)
    element = Element("inertial")
    SubElement(element, "origin", xyz=numbers(properties.center), rpy="0 0 0")
    SubElement(element, "mass", value=number(properties.mass))
    names = (("ixx", 0, 0), ("ixy", 0, 1), ("ixz", 0, 2), ("iyy", 1, 1), ("iyz", 1, 2), ("izz", 2, 2))
    SubElement(element, "inertia", {key: number(properties.inertia[i, j]) for key, i, j in names})
    link.insert(0, element)


def _shapes(link: Element, role: str, geom: Element) -> None:
    """URDF has no capsule: a cylinder and the spheres at its ends."""
    size = _floats(geom, "size")
    match geom.attrib["type"]:
        case "box":
            edges = {"size": numbers(2.0 * half for half in size)}
            shapes = [("box", edges, tuple(_floats(geom, "pos")))]
        case "sphere":
            shapes = [("sphere", {"radius": number(size[0])}, tuple(_floats(geom, "pos")))]
        case _:
            start, end = _ends(geom)
            tube = {"radius": number(size[0]), "length": number(end - start)}
            ball = {"radius": number(size[0])}
            shapes = [("cylinder", tube, (0.0, 0.0, (start + end) / 2.0))]
            shapes += [("sphere", ball, (0.0, 0.0, z)) for z in (start, end)]
    for shape, values, at in shapes:
        part = SubElement(link, role)
        SubElement(part, "origin", xyz=numbers(at), rpy="0 0 0")
        SubElement(SubElement(part, "geometry"), shape, values)
        if role == "visual":
            SubElement(part, "material", name=geom.attrib["material"])


def _mass(geom: Element) -> inertia.MassProperties:
    mass, size = float(geom.attrib["mass"]), _floats(geom, "size")
    x, y, z = _floats(geom, "pos") if "pos" in geom.attrib else _NOWHERE
    match geom.attrib["type"]:
        case "box":
            half = (size[0], size[1], size[2])
            return inertia.box_inertia(mass, BoxFacts(half, (x, y, z)))
        case "sphere":
            return inertia.MassProperties(mass, np.array([x, y, z]), np.eye(3) * 0.4 * mass * size[0] ** 2)
    start, end = _ends(geom)
    return inertia.tip_inertia(TipFacts("", mass, size[0], start, end))


def _ends(geom: Element) -> tuple[float, float]:
    """Length of a capsule, which lies along its link's z, m."""
    _, _, start, _, _, end = _floats(geom, "fromto")
    return start, end


def _floats(element: Element, key: str) -> list[float]:
    return [float(value) for value in element.attrib[key].split()]
