"""A hand's links and joints as plain data, whatever file they came from."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from allegro_twin.types import Array


class Placed(NamedTuple):
    """Where a frame is in another."""

    position: Array
    """(3,), m."""
    rotation: Array
    """(3, 3), its columns are the frame's axes."""


class Hinge(NamedTuple):
    """A joint that a link hangs on."""

    name: str
    axis: Array
    """(3,), in the link's axes."""
    anchor: Array
    """(3,), in the link's frame, m."""
    zero: float
    """Position at which the link is where its placement says, rad or m."""
    slides: bool


class Link(NamedTuple):
    """One body, and how it hangs on its parent."""

    name: str
    parent: int
    """Index of the parent; the palm is the first link and its own parent."""
    placed: Placed
    """In the parent's frame."""
    hinges: tuple[Hinge, ...]
    mass: float
    """kg."""
    centre: Array
    """Of mass, (3,), in the link's frame, m."""
    inertia: Array
    """About the centre of mass, (3, 3), kg·m²."""


class Tree(NamedTuple):
    """A hand: parents before children."""

    links: tuple[Link, ...]
    tips: dict[str, tuple[int, Placed]]
    """For each frame of interest, the link that it is on and where."""


def built(tree: Tree) -> pin.Model:
    """The same in Pinocchio, a frame for every link and tip. The palm stands still."""
    model = pin.Model()
    # For each link: the joint that carries it, and where it is in that joint's frame.
    carried: list[tuple[int, pin.SE3]] = []
    for link in tree.links:
        joint, place = carried[link.parent] if carried else (0, pin.SE3.Identity())
        place = place * pin.SE3(link.placed.rotation, link.placed.position) if carried else place
        for hinge in link.hinges:
            kind = pin.JointModelPrismaticUnaligned if hinge.slides else pin.JointModelRevoluteUnaligned
            anchor = pin.SE3(np.eye(3), hinge.anchor)
            joint = model.addJoint(joint, kind(hinge.axis), place * anchor, hinge.name)
            place = _back(hinge) * anchor.inverse()
        model.appendBodyToJoint(joint, pin.Inertia(link.mass, link.centre, link.inertia), place)
        model.addFrame(pin.Frame(link.name, joint, 0, place, pin.FrameType.BODY), False)
        carried.append((joint, place))
    for name, (index, placed) in tree.tips.items():
        joint, place = carried[index]
        at = place * pin.SE3(placed.rotation, placed.position)
        model.addFrame(pin.Frame(name, joint, 0, at, pin.FrameType.OP_FRAME), False)
    return model


def _back(hinge: Hinge) -> pin.SE3:
    """From a joint's position zero to the position that its link's placement is about."""
    if hinge.slides:
        return pin.SE3(np.eye(3), -hinge.zero * hinge.axis)
    return pin.SE3(pin.exp3(-hinge.zero * hinge.axis), np.zeros(3))
