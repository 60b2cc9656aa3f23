"""The hand as MJCF: torque motors, sensors, and collision primitives under a visual layer."""

from __future__ import annotations

from xml.etree.ElementTree import Element, SubElement

from allegro_twin.hands.description import inertia
from allegro_twin.hands.description.facts import HandFacts, JointFacts, LinkFacts
from allegro_twin.hands.generate.text import document, mesh_name, number, numbers
from allegro_twin.kinematics.orientation import quaternion_from_euler
from allegro_twin.spec import Actuation


def mjcf(hand: HandFacts, actuation: Actuation) -> str:
    """The text of the file."""
    root = Element("mujoco", model=f"{hand.name}_{hand.side}")
    SubElement(root, "compiler", angle="radian", meshdir="../meshes", autolimits="true")
    options(root)
    defaults(root)
    _assets(root, hand)
    bodies: dict[str, Element] = {}
    world = SubElement(root, "worldbody")
    for link in hand.links:
        bodies[link.name] = _body(bodies[link.parent] if link.parent else world, link, hand, actuation)
    _contact(root, hand)
    actuators, sensors = SubElement(root, "actuator"), SubElement(root, "sensor")
    for joint in hand.joints:
        _motor(actuators, joint, actuation)
        SubElement(sensors, "jointpos", name=f"{joint.name}_position", joint=joint.name)
        SubElement(sensors, "jointvel", name=f"{joint.name}_velocity", joint=joint.name)
    for finger in hand.fingers:
        # Net force on the fingertip's link, world axes; the first number counts the contacts.
        SubElement(
            sensors, "contact", name=f"{finger}_touch", body2=hand.last_link(finger).name, reduce="netforce",
            data="found force",
        )  # fmt: skip
    return document(root, hand.name)


def _motor(actuators: Element, joint: JointFacts, actuation: Actuation) -> None:
    """A source of torque; or, where the firmware closes the loop, a spring to the commanded position."""
    limit = actuation.torque_limit[joint.number]
    bounds = numbers((-limit, limit))
    if actuation.stiffness is None:
        SubElement(actuators, "motor", name=joint.name, joint=joint.name, ctrlrange=bounds, forcerange=bounds)
        return
    SubElement(
        actuators, "position", name=joint.name, joint=joint.name, kp=number(actuation.stiffness[joint.number]),
        ctrlrange=numbers((joint.lower, joint.upper)), forcerange=bounds,
    )  # fmt: skip


def options(root: Element) -> None:
    """Options of the simulation; docs/reference/allegro_model.md#contact has measurements of each."""
    SubElement(
        root, "option", timestep="0.001", integrator="implicitfast", cone="elliptic", impratio="100", jacobian="dense",
        noslip_iterations="2",
    )  # fmt: skip


def defaults(root: Element) -> None:
    """Defaults of a hand's joints and shapes."""
    top = SubElement(SubElement(root, "default"), "default", {"class": "hand"})
    # A hard stop: 0.3 N·m press a joint 2 mrad into it; MuJoCo's own default lets it give by 60.
    SubElement(top, "joint", solreflimit="0.004 1", solimplimit="0.95 0.99 0.001")
    visual = SubElement(top, "default", {"class": "visual"})
    SubElement(visual, "geom", contype="0", conaffinity="0", group="2", mass="0")
    collision = SubElement(top, "default", {"class": "collision"})
    SubElement(
        collision,
        "geom",
        group="3",
        mass="0",
        condim="4",
        friction="0.8 0.01 0.0005",
        solref="0.005 1",
        rgba=".5 .6 .7 .3",
    )


def _assets(root: Element, hand: HandFacts) -> None:
    assets = SubElement(root, "asset")
    for name, rgba in hand.colors.items():
        SubElement(assets, "material", name=name, rgba=numbers(rgba), specular="0.3", shininess="0.5")
    meshes = sorted({mesh_name(v) for link in hand.links for v in link.visuals if v.kind == "rounded"})
    for name in meshes:
        SubElement(assets, "mesh", name=name, file=f"{name}.obj")


def _body(parent: Element, link: LinkFacts, hand: HandFacts, actuation: Actuation) -> Element:
    place = {"pos": numbers(link.xyz)} if any(link.xyz) else {}
    if any(link.rpy):
        place["quat"] = numbers(quaternion_from_euler(link.rpy))
    body = SubElement(parent, "body", {"name": link.name, "childclass": "hand"} | place)
    mass, center, tensor = inertia.link_inertia(link)
    upper = numbers(tensor[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])
    SubElement(body, "inertial", pos=numbers(center), mass=number(mass), fullinertia=upper)
    if link.joint is not None:
        index = hand.joints.index(link.joint)
        SubElement(
            body, "joint", name=link.joint.name, axis=numbers(link.joint.axis),
            range=numbers((link.joint.lower, link.joint.upper)), damping=number(actuation.damping[index]),
            armature=number(actuation.armature[index]), frictionloss=number(actuation.frictionloss[index]),
        )  # fmt: skip
    _geoms(body, link)
    return body


def _geoms(body: Element, link: LinkFacts) -> None:
    for visual in link.visuals:
        look = {"class": "visual", "material": visual.color, "pos": numbers(visual.at)}
        if visual.kind == "rounded":
            SubElement(body, "geom", look, type="mesh", mesh=mesh_name(visual))
        else:
            SubElement(body, "geom", look, type="cylinder", size=numbers(visual.size), euler="1.5707963267948966 0 0")
    box = {"class": "collision", "name": f"{link.name}_box", "type": "box"}
    SubElement(body, "geom", box, pos=numbers(link.box.at), size=numbers(link.box.half))
    if link.tip is not None:
        axis = numbers((0, 0, link.tip.start, 0, 0, link.tip.end))
        shape = {"type": "capsule", "fromto": axis, "size": number(link.tip.radius)}
        SubElement(body, "geom", {"class": "visual", "material": "tip", **shape})
        SubElement(body, "geom", {"class": "collision", "name": f"{link.name}_tip", **shape})
        SubElement(body, "site", name=link.tip.name, pos=numbers((0, 0, link.tip.end)), size="0.002", group="4")


def _contact(root: Element, hand: HandFacts) -> None:
    contact = SubElement(root, "contact")
    for first, second in hand.never_collide:
        for a in (link for link in hand.links if link.kind == first):
            for b in (link for link in hand.links if link.kind == second):
                SubElement(contact, "exclude", body1=a.name, body2=b.name)
