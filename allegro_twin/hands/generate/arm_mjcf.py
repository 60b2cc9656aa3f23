"""An arm as MJCF: torque motors, a force sensor at the flange, and capsules under a visual layer."""

from __future__ import annotations

from xml.etree.ElementTree import Element, SubElement

from allegro_twin.hands.description.arms import ArmFacts, ArmLinkFacts, Rod
from allegro_twin.hands.generate.mjcf import options
from allegro_twin.hands.generate.text import ARM_NOTICE, document, number, numbers
from allegro_twin.kinematics.orientation import quaternion_from_euler
from allegro_twin.spec.arm import ArmSpec


def arm_mjcf(arm: ArmFacts, spec: ArmSpec) -> str:
    """The text of the file. Every name begins with the arm's, so that a hand can hang on it."""
    root = Element("mujoco", model=arm.name)
    SubElement(root, "compiler", angle="radian", autolimits="true")
    options(root)
    _defaults(root, arm.name)
    assets = SubElement(root, "asset")
    for name, rgba in arm.colors.items():
        SubElement(assets, "material", name=f"{arm.name}_{name}", rgba=numbers(rgba), specular="0.4", shininess="0.6")
    parent = SubElement(root, "worldbody")
    for place, link in enumerate(arm.links):
        parent = _body(parent, arm, link, place, spec)
    # A body of its own, so that the sensors have something between it and the last link.
    flange = SubElement(parent, "body", name=spec.flange, pos=numbers((0, 0, arm.flange)))
    SubElement(flange, "site", name=spec.flange, size="0.004", group="4")
    contact = SubElement(root, "contact")
    for first, second in arm.never_collide:
        SubElement(contact, "exclude", body1=arm.links[first].name, body2=arm.links[second].name)
    actuators, sensors = SubElement(root, "actuator"), SubElement(root, "sensor")
    for link, limit in zip(arm.driven, spec.actuation.torque_limit, strict=True):
        bounds = numbers((-limit, limit))
        SubElement(actuators, "motor", name=link.joint, joint=link.joint, ctrlrange=bounds, forcerange=bounds)
        SubElement(sensors, "jointpos", name=f"{link.joint}_position", joint=link.joint)
        SubElement(sensors, "jointvel", name=f"{link.joint}_velocity", joint=link.joint)
    for kind in ("force", "torque"):
        SubElement(sensors, kind, name=f"{spec.flange}_{kind}", site=spec.flange)
    return document(root, arm.name, ARM_NOTICE)


def _defaults(root: Element, name: str) -> None:
    top = SubElement(SubElement(root, "default"), "default", {"class": name})
    SubElement(top, "joint", solreflimit="0.004 1", solimplimit="0.95 0.99 0.001")
    seen = SubElement(top, "default", {"class": f"{name}_visual"})
    SubElement(seen, "geom", contype="0", conaffinity="0", group="2", mass="0")
    felt = SubElement(top, "default", {"class": f"{name}_collision"})
    SubElement(
        felt, "geom", group="3", mass="0", condim="3", friction="0.6 0.01 0.0005", solref="0.005 1",
        rgba=".5 .6 .7 .3",
    )  # fmt: skip


def _body(parent: Element, arm: ArmFacts, link: ArmLinkFacts, place: int, spec: ArmSpec) -> Element:
    at = {"pos": numbers(link.xyz)} if any(link.xyz) else {}
    if link.roll:
        at["quat"] = numbers(quaternion_from_euler((link.roll, 0.0, 0.0)))
    # The maker's control carries the arm: docs/explanation/arm_control.md.
    body = SubElement(parent, "body", {"name": link.name, "childclass": arm.name, "gravcomp": "1"} | at)
    mass, centre, tensor = link.body
    upper = numbers(tensor[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])
    SubElement(body, "inertial", pos=numbers(centre), mass=number(mass), fullinertia=upper)
    if link.joint:
        motor = spec.actuation
        SubElement(
            body, "joint", name=link.joint, axis="0 0 1", range=numbers((link.lower, link.upper)),
            damping=number(motor.damping[place - 1]), armature=number(motor.armature[place - 1]),
            frictionloss=number(motor.frictionloss[place - 1]),
        )  # fmt: skip
    for k, rod in enumerate(link.rods):
        _geom(body, arm.name, rod, f"{link.name}_{k}")
    return body


def _geom(body: Element, arm: str, rod: Rod, name: str) -> None:
    shape = {"type": rod.kind, "fromto": numbers((*rod.start, *rod.end)), "size": number(rod.radius)}
    if rod.color:
        SubElement(body, "geom", {"class": f"{arm}_visual", "material": f"{arm}_{rod.color}", **shape})
    else:
        SubElement(body, "geom", {"class": f"{arm}_collision", "name": name, **shape})
