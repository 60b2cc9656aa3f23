"""The hand as URDF, for Pinocchio, ROS and everybody else's tools."""

from __future__ import annotations

from xml.etree.ElementTree import Element, SubElement

from allegro_twin.hands.description import inertia
from allegro_twin.hands.description.facts import HandFacts, LinkFacts, TipFacts
from allegro_twin.hands.generate.text import document, mesh_name, number, numbers
from allegro_twin.spec import Actuation

NO_LOAD_SPEED = 9.52  # rad/s. RS303MR servo manual, p. 39; docs/reference/allegro_model.md#actuation.


def urdf(hand: HandFacts, actuation: Actuation) -> str:
    """The text of the file."""
    root = Element("robot", name=f"{hand.name}_{hand.side}")
    for name, rgba in hand.colors.items():
        SubElement(SubElement(root, "material", name=name), "color", rgba=numbers(rgba))
    for link in hand.links:
        _link(root, link)
        if link.joint is not None:
            index = hand.joints.index(link.joint)
            joint = joint_between(root, link.joint.name, "revolute", str(link.parent), link.name, link.xyz, link.rpy)
            SubElement(joint, "axis", xyz=numbers(link.joint.axis))
            SubElement(
                joint, "limit", lower=number(link.joint.lower), upper=number(link.joint.upper),
                effort=number(actuation.torque_limit[index]), velocity=number(NO_LOAD_SPEED),
            )  # fmt: skip
            SubElement(
                joint, "dynamics", damping=number(actuation.damping[index]),
                friction=number(actuation.frictionloss[index]),
            )  # fmt: skip
        if link.tip is not None:
            _tip(root, link, link.tip)
    return document(root, hand.name)


def _link(root: Element, link: LinkFacts) -> None:
    element = SubElement(root, "link", name=link.name)
    inertial(element, inertia.box_inertia(link.mass, link.box))
    for visual in link.visuals:
        part = SubElement(element, "visual")
        turn = (1.5707963267948966, 0.0, 0.0) if visual.kind == "cylinder" else (0.0, 0.0, 0.0)
        SubElement(part, "origin", xyz=numbers(visual.at), rpy=numbers(turn))
        geometry = SubElement(part, "geometry")
        if visual.kind == "rounded":
            SubElement(geometry, "mesh", filename=f"../meshes/{mesh_name(visual)}.obj")
        else:
            SubElement(geometry, "cylinder", radius=number(visual.size[0]), length=number(2.0 * visual.size[1]))
        SubElement(part, "material", name=visual.color)
    collision = SubElement(element, "collision")
    SubElement(collision, "origin", xyz=numbers(link.box.at), rpy="0 0 0")
    size = numbers(2.0 * half for half in link.box.half)
    SubElement(SubElement(collision, "geometry"), "box", size=size)


def _tip(root: Element, link: LinkFacts, tip: TipFacts) -> None:
    """The fingertip's own link: its origin is the sphere's centre, so its capsule reaches back from there."""
    element = SubElement(root, "link", name=tip.name)
    mass = inertia.tip_inertia(tip)
    back = (0.0, 0.0, (tip.start - tip.end) / 2.0)
    inertial(element, mass._replace(center=mass.center - (0.0, 0.0, tip.end)))
    for role in ("visual", "collision"):
        # URDF has no capsule: a cylinder and the sphere at its end.
        for shape, at in (("cylinder", back), ("sphere", (0.0, 0.0, 0.0))):
            part = SubElement(element, role)
            SubElement(part, "origin", xyz=numbers(at), rpy="0 0 0")
            size = {"radius": number(tip.radius)}
            if shape == "cylinder":
                size["length"] = number(tip.end - tip.start)
            SubElement(SubElement(part, "geometry"), shape, size)
            if role == "visual":
                SubElement(part, "material", name="tip")
    joint_between(
        root, tip.name.replace("link", "joint"), "fixed", link.name, tip.name, (0.0, 0.0, tip.end), (0.0, 0.0, 0.0)
    )


def joint_between(
    root: Element,
    name: str,
    kind: str,
    parent: str,
    child: str,
    xyz: tuple[float, float, float],
    rpy: tuple[float, float, float],
) -> Element:
    """A joint of a kind, and where the child is in the parent's frame at zero, m and rad."""
    joint = SubElement(root, "joint", name=name, type=kind)
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=child)
    SubElement(joint, "origin", xyz=numbers(xyz), rpy=numbers(rpy))
    return joint


def inertial(element: Element, properties: inertia.MassProperties) -> None:
    """Mass, centre and inertia of a link."""
    part = SubElement(element, "inertial")
    SubElement(part, "origin", xyz=numbers(properties.center), rpy="0 0 0")
    SubElement(part, "mass", value=number(properties.mass))
    names = (("ixx", 0, 0), ("ixy", 0, 1), ("ixz", 0, 2), ("iyy", 1, 1), ("iyz", 1, 2), ("izz", 2, 2))
    SubElement(part, "inertia", {name: number(properties.inertia[i, j]) for name, i, j in names})
