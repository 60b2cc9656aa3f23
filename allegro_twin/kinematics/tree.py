"""A hand's links and joints as plain data, whatever file they come from, and as a Pinocchio model."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from allegro_twin._lazy import provided
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array


class LinkPlacement(NamedTuple):
    """Pose of a frame in another."""

    position: Array
    """(3,), m."""
    rotation: Array
    """(3, 3), its columns are the frame's axes."""


class TreeJoint(NamedTuple):
    """A hinge or a slide that carries a link."""

    name: str
    axis: Array
    """(3,), in the link's axes."""
    anchor: Array
    """(3,), in the link's frame, m."""
    zero: float
    """Position at which the link is where its placement says, rad or m."""
    slides: bool


class TreeLink(NamedTuple):
    """A rigid body, and how it hangs on its parent."""

    name: str
    parent: int
    """Index of the parent; the palm is the first link and its own parent."""
    placement: LinkPlacement
    """In the parent's frame, with the joints at `zero`."""
    joints: tuple[TreeJoint, ...]
    mass: float
    """kg."""
    centre: Array
    """Centre of mass in the link's frame, (3,), m."""
    inertia: Array
    """About the centre of mass, (3, 3), kg·m²."""


class Tree(NamedTuple):
    """The links of a hand, parents before children."""

    links: tuple[TreeLink, ...]
    tips: dict[str, tuple[int, LinkPlacement]]
    """For each fingertip's frame the index of the link that it is on, and where."""


def link_tree(spec: HandSpec) -> Tree:
    """The links of the model file that simulates a hand, read by the wing that knows MuJoCo. Raises ConfigError."""
    read: Callable[[HandSpec], Tree] = provided("link tree")
    return read(spec)


def pinocchio_model(tree: Tree) -> pin.Model:
    """The tree as a Pinocchio model, with a frame for every link and tip. The palm stands still."""
    model = pin.Model()
    # For each link: the joint that carries it, and where it is in that joint's frame.
    carried: list[tuple[int, pin.SE3]] = []
    for link in tree.links:
        joint, place = carried[link.parent] if carried else (0, pin.SE3.Identity())
        place = place * pin.SE3(link.placement.rotation, link.placement.position) if carried else place
        for hinge in link.joints:
            kind = pin.JointModelPrismaticUnaligned if hinge.slides else pin.JointModelRevoluteUnaligned
            anchor = pin.SE3(np.eye(3), hinge.anchor)
            joint = model.addJoint(joint, kind(hinge.axis), place * anchor, hinge.name)
            place = _back(hinge) * anchor.inverse()
        model.appendBodyToJoint(joint, pin.Inertia(link.mass, link.centre, link.inertia), place)
        model.addFrame(pin.Frame(link.name, joint, 0, place, pin.FrameType.BODY), False)
        carried.append((joint, place))
    for name, (index, placement) in tree.tips.items():
        joint, place = carried[index]
        at = place * pin.SE3(placement.rotation, placement.position)
        model.addFrame(pin.Frame(name, joint, 0, at, pin.FrameType.OP_FRAME), False)
    return model


def _back(hinge: TreeJoint) -> pin.SE3:
    """From a joint's position zero to the position that its link's placement is about."""
    if hinge.slides:
        return pin.SE3(np.eye(3), -hinge.zero * hinge.axis)
    return pin.SE3(pin.exp3(-hinge.zero * hinge.axis), np.zeros(3))
