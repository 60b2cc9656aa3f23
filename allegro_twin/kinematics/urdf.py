"""A URDF of any hand, from the links of the model file that simulates it: frames, joints and inertias, no shapes."""

from __future__ import annotations

from xml.etree import ElementTree as Xml

import numpy as np

from allegro_twin.kinematics.orientation import euler_from_matrix, matrix_from_quaternion, quaternion_from_vector
from allegro_twin.kinematics.tree import LinkPlacement, Tree, TreeJoint, TreeLink
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array

_SAME = 1e-9  # m and of a rotation's entries: two frames that are one.


def urdf_from_tree(tree: Tree, spec: HandSpec) -> str:
    """URDF text. A link's frame is the model file's; where it is not its joint's, a link `NAME_JOINT` stands between.
    Coupled joints are joints of their own: their positions come from the hand's table, which no `mimic` can say."""
    robot = Xml.Element("robot", name=spec.name)
    for number, link in enumerate(tree.links):
        _add_link(robot, link)
        if number:
            _connect(robot, tree.links[link.parent].name, link, spec)
    for name, (index, placement) in tree.tips.items():
        Xml.SubElement(robot, "link", name=name)
        _add_joint(robot, f"{name}_joint", "fixed", tree.links[index].name, name, placement)
    Xml.indent(robot)
    return Xml.tostring(robot, encoding="unicode")


def _connect(robot: Xml.Element, parent: str, link: TreeLink, spec: HandSpec) -> None:
    """The joints that carry a link, one after the other."""
    place, last = link.placement, len(link.joints) - 1
    for number, joint in enumerate(link.joints):
        after = _back(joint)
        child = link.name if number == last and _is_identity(after) else f"{link.name}_{joint.name}"
        if child != link.name:
            Xml.SubElement(robot, "link", name=child)
        at = _times(place, LinkPlacement(joint.anchor, np.eye(3)))
        element = _add_joint(robot, joint.name, "prismatic" if joint.slides else "revolute", parent, child, at)
        Xml.SubElement(element, "axis", xyz=_numbers(joint.axis))
        _add_limit(element, joint.name, spec)
        parent, place = child, after
    if parent != link.name:
        _add_joint(robot, f"{link.name}_fixed", "fixed", parent, link.name, place)


def _add_link(robot: Xml.Element, link: TreeLink) -> None:
    inertial = Xml.SubElement(Xml.SubElement(robot, "link", name=link.name), "inertial")
    Xml.SubElement(inertial, "origin", xyz=_numbers(link.centre), rpy="0 0 0")
    Xml.SubElement(inertial, "mass", value=f"{link.mass:.9g}")
    entries = {f"i{'xyz'[i]}{'xyz'[j]}": f"{link.inertia[i, j]:.9g}" for i in range(3) for j in range(i, 3)}
    Xml.SubElement(inertial, "inertia", entries)


def _add_joint(robot: Xml.Element, name: str, kind: str, parent: str, child: str, at: LinkPlacement) -> Xml.Element:
    element = Xml.SubElement(robot, "joint", name=name, type=kind)
    Xml.SubElement(element, "origin", xyz=_numbers(at.position), rpy=_numbers(euler_from_matrix(at.rotation)))
    Xml.SubElement(element, "parent", link=parent)
    Xml.SubElement(element, "child", link=child)
    return element


def _add_limit(element: Xml.Element, name: str, spec: HandSpec) -> None:
    """Range and effort of a motor's own joint; of a coupled one the range of its table, and no effort."""
    if name in spec.joints:
        k = spec.joints.index(name)
        lower, upper, effort = float(spec.lower[k]), float(spec.upper[k]), float(spec.actuation.torque_limit[k])
    else:
        table = next(each.positions for each in spec.followers if each.name == name)
        lower, upper, effort = float(np.min(table)), float(np.max(table)), 0.0
    limit = {"lower": lower, "upper": upper, "effort": effort if np.isfinite(effort) else 0.0, "velocity": 0.0}
    Xml.SubElement(element, "limit", {key: f"{value:.9g}" for key, value in limit.items()})


def _back(joint: TreeJoint) -> LinkPlacement:
    """From a joint's frame at position zero to the link's."""
    axis = joint.axis / np.linalg.norm(joint.axis)
    if joint.slides:
        return LinkPlacement(-joint.zero * axis - joint.anchor, np.eye(3))
    turn = matrix_from_quaternion(quaternion_from_vector(-joint.zero * axis))
    return LinkPlacement(-turn @ joint.anchor, turn)


def _times(first: LinkPlacement, second: LinkPlacement) -> LinkPlacement:
    return LinkPlacement(first.position + first.rotation @ second.position, first.rotation @ second.rotation)


def _is_identity(place: LinkPlacement) -> bool:
    return bool(np.abs(place.position).max() < _SAME and np.abs(place.rotation - np.eye(3)).max() < _SAME)


def _numbers(values: Array) -> str:
    return " ".join(f"{value:.12g}" for value in np.asarray(values).tolist())
