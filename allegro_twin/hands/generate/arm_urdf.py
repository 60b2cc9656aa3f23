"""An arm as URDF, for Pinocchio, ROS and everybody else's tools."""

from __future__ import annotations

import math
from xml.etree.ElementTree import Element, SubElement

from allegro_twin.hands.description.arms import ArmFacts, ArmLinkFacts, Rod
from allegro_twin.hands.description.facts import Triple
from allegro_twin.hands.generate.text import ARM_NOTICE, document, number, numbers
from allegro_twin.hands.generate.urdf import inertial, joint_between
from allegro_twin.spec.arm import ArmSpec


def arm_urdf(arm: ArmFacts, spec: ArmSpec) -> str:
    """The text of the file."""
    root = Element("robot", name=arm.name)
    for name, rgba in arm.colors.items():
        SubElement(SubElement(root, "material", name=name), "color", rgba=numbers(rgba))
    before, motor = "", spec.actuation
    assert motor.velocity_limit is not None
    for place, link in enumerate(arm.links):
        _link(root, link)
        if link.joint:
            k = place - 1
            joint = joint_between(root, link.joint, "revolute", before, link.name, link.xyz, (link.roll, 0.0, 0.0))
            SubElement(joint, "axis", xyz="0 0 1")
            SubElement(
                joint, "limit", lower=number(link.lower), upper=number(link.upper),
                effort=number(motor.torque_limit[k]), velocity=number(motor.velocity_limit[k]),
            )  # fmt: skip
            SubElement(joint, "dynamics", damping=number(motor.damping[k]), friction=number(motor.frictionloss[k]))
        before = link.name
    SubElement(root, "link", name=spec.flange)
    joint_between(root, f"{spec.flange}_joint", "fixed", before, spec.flange, (0.0, 0.0, arm.flange), (0.0, 0.0, 0.0))
    return document(root, arm.name, ARM_NOTICE)


def _link(root: Element, link: ArmLinkFacts) -> None:
    element = SubElement(root, "link", name=link.name)
    inertial(element, link.body)
    for rod in link.rods:
        parts: list[tuple[str, Triple]] = [("cylinder", _middle(rod))]
        if rod.kind == "capsule":  # URDF has none.
            parts += [("sphere", rod.start), ("sphere", rod.end)]
        for shape, at in parts:
            part = SubElement(element, "visual" if rod.color else "collision")
            SubElement(part, "origin", xyz=numbers(at), rpy=numbers(_along(rod) if shape == "cylinder" else (0, 0, 0)))
            size = {"radius": number(rod.radius)}
            if shape == "cylinder":
                size["length"] = number(math.dist(rod.start, rod.end))
            SubElement(SubElement(part, "geometry"), shape, size)
            if rod.color:
                SubElement(part, "material", name=rod.color)


def _middle(rod: Rod) -> Triple:
    x, y, z = ((a + b) / 2.0 for a, b in zip(rod.start, rod.end, strict=True))
    return (x, y, z)


def _along(rod: Rod) -> Triple:
    """Roll, pitch, yaw that turn z to where the rod points."""
    x, y, z = (b - a for a, b in zip(rod.start, rod.end, strict=True))
    return (0.0, math.atan2(math.hypot(x, y), z), math.atan2(y, x))
